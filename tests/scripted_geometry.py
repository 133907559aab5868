"""A geometry model for tests: answers with the depths of a folder, and misbehaves on demand. Uses workers/job.py."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "workers"))

from job import Job  # type: ignore[import-not-found]

FACTOR, SCALE, SHIFT = 0.37, 0.02, 0.3


def main() -> None:
    job = Job.from_arguments(__doc__, source="", fault="", meaning="metric", camera=1, points=0)
    with (job.folder / "asked.txt").open("a") as file:
        file.write("asked\n")
    job.say(None, "loading")
    misbehave(job.arguments.fault, job)
    held = np.load(Path(job.arguments.source) / "geometry.npz")
    points, valid = held["points"], held["mask"] > 0
    h, w = valid.shape
    z = points[..., 2]
    meaning = job.arguments.meaning
    depth = {"metric": z, "scaled": FACTOR * z, "relative": (1 / np.where(valid, z, 1) - SHIFT) / SCALE}[meaning]
    K = held["intrinsics"] * [[w], [h], [1]]
    job.answer_geometry(depth, meaning=meaning, K=K if job.arguments.camera else None, valid=valid, model="Scripted",
                        weights="r1", licence="CC0")  # fmt: skip
    if job.arguments.points:
        np.savez(job.folder / "geometry.npz", points=points, valid=valid, K=K)
    spoil(job.arguments.fault, job, points, valid, K)


def misbehave(fault: str, job: Job) -> None:
    """Before the answer."""
    if fault == "crash":
        print("noise\nCUDA out of memory \x1b[31m", file=sys.stderr)
        raise SystemExit(7)
    if fault == "kill":
        os.kill(os.getpid(), 9)
    if fault == "hang":
        time.sleep(600)
    if fault == "silent":
        raise SystemExit(0)
    if fault == "flood":
        with (job.folder / "rubbish.bin").open("wb") as file:
            file.truncate(10**10)
        time.sleep(600)


def spoil(fault: str, job: Job, points: np.ndarray, valid: np.ndarray, K: np.ndarray) -> None:
    """After the answer."""
    document, arrays = job.folder / "geometry.json", job.folder / "geometry.npz"
    answer = json.loads(document.read_text())
    z = points[..., 2]
    replaced = {
        "cropped": {"depth": z[:, :40]},
        "nan": {"depth": np.full_like(z, np.nan)},
        "whole numbers": {"depth": z.astype(int)},
        "three axes": {"depth": points},
        "both": {"depth": z, "points": points},
        "neither": {"valid": valid},
        "other size of mask": {"depth": z, "valid": valid[1:]},
        "no focal length": {"depth": z, "K": K * [[0], [1], [1]]},
        "nan in K": {"depth": z, "K": K * np.nan},
        "mirrored": {"points": points * [-1, -1, 1], "K": K},
        "without a camera": {"points": points},
        "pickle": {"depth": np.array([{"a": 1}], object)},
        "huge": {"depth": np.broadcast_to(np.zeros((), np.float16), (9_000, 12_000))},
    }
    if fault in replaced:
        np.savez_compressed(arrays, **replaced[fault])
    changed = {
        "escape": {"arrays": "../../secret.npz"},
        "no such file": {"arrays": "other.npz"},
        "meaning": {"meaning": "feet"},
        "long model": {"model": "m" * 10_000},
    }
    if fault in changed:
        document.write_text(json.dumps({**answer, **changed[fault]}))
    if fault == "half json":
        document.write_text(document.read_text()[:30])
    if fault == "large file":
        os.truncate(arrays, 2_100_000_000)
    if fault == "no npz":
        arrays.write_bytes(b"<html>no arrays</html>")
    if fault == "link":
        arrays.unlink()
        arrays.symlink_to("/etc/hostname")


if __name__ == "__main__":
    main()
