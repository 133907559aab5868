"""A worker for tests: answers with the meshes of an input folder, and misbehaves on demand. Uses workers/job.py."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "workers"))

from job import Job  # type: ignore[import-not-found]


def main() -> None:
    job = Job.from_arguments(__doc__, source="", fault="", at=-1, convention="sam3d")
    source = Path(job.arguments.source) / "assets"
    poses = {p["mask"]: p for p in json.loads((source / "poses.json").read_text())["objects"]}
    by_id = {int(name.partition("_")[0].partition(".")[0]): p for name, p in poses.items()}
    fault, at = job.arguments.fault, job.arguments.at
    for item in job.open_items():
        with (job.folder / "asked.txt").open("a") as file:
            file.write(f"{item['id']}\n")
        given = by_id[item["id"]]
        pose = {"convention": "sam3d", **{k: given[k] for k in ("rotation", "translation", "scale")}}
        if job.arguments.convention == "xyzw":
            w, *xyz = given["rotation"]
            pose["rotation"] = [*xyz, w]
        if job.arguments.convention == "none":
            pose = {"convention": "none"}
        if item["id"] == at:
            misbehave(fault, job, item)
        job.answer(item, lambda path, mesh=given["mesh"]: shutil.copy(source / mesh, path), model="Scripted",
                   licence="CC0", weights="r1", up="+y", pose=pose)  # fmt: skip
        if item["id"] == at:
            spoil(fault, job, item)


def misbehave(fault: str, job: Job, item: dict[str, object]) -> None:
    """Before the answer."""
    if fault == "crash":
        print("noise\nCUDA out of memory \x1b[31m", file=sys.stderr)
        raise SystemExit(7)
    if fault == "kill":
        os.kill(os.getpid(), 9)
    if fault == "hang":
        time.sleep(600)
    if fault == "chatter":
        for _ in range(200):
            print("[[[ no progress " + "x" * 5000, flush=True)
            print("y" * 5000, file=sys.stderr, flush=True)
    if fault == "drip":
        while True:
            job.say(item["id"], "still working")
            time.sleep(0.05)
    if fault == "flood":
        with (job.folder / "rubbish.bin").open("wb") as file:
            file.truncate(10**10)
        time.sleep(600)


def spoil(fault: str, job: Job, item: dict[str, int]) -> None:
    """After the answer."""
    file, mesh = (job.folder / f"{item['id']:02d}{suffix}" for suffix in (".json", ".glb"))
    answer = json.loads(file.read_text())
    changed = {
        "escape": {"mesh": "../../secret.glb"},
        "no such mesh": {"mesh": "99.glb"},
        "wrong id": {"id": 77},
        "no rotation": {"pose": {"convention": "sam3d"}},
        "zero rotation": {"pose": {**answer["pose"], "rotation": [0, 0, 0, 0]}},
        "negative scale": {"pose": {**answer["pose"], "scale": [-1, -1, -1]}},
        "bad up": {"up": "sideways"},
        "long model": {"model": "m" * 10_000},
        "other type": {"mesh": "request.json"},
    }
    if fault in changed:
        file.write_text(json.dumps({**answer, **changed[fault]}))
    if fault == "nan":
        file.write_text(json.dumps(answer).replace("0.", "NaN", 1))
    if fault == "half json":
        file.write_text(file.read_text()[:40])
    if fault == "large json":
        file.write_text(json.dumps({**answer, "model": " " * 200_000}))
    if fault == "huge mesh":
        os.truncate(mesh, 2_100_000_000)
    if fault == "no glb":
        mesh.write_bytes(b"<html>not a mesh</html>")
    if fault == "link":
        mesh.unlink()
        mesh.symlink_to("/etc/hostname")
    if fault == "stranger":
        (job.folder / "88.json").write_text(json.dumps({**answer, "id": 88}))
    if fault == "forget":
        file.unlink()


if __name__ == "__main__":
    main()
