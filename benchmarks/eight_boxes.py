"""How long boxes on a photo take beside a given folder with meshes and geometry of the same eight objects.

usage: python benchmarks/eight_boxes.py [NAME ...] [--data PATH] [--out FOLDER]
Both are whole commands that alternate in one run. Kernels are compiled before; nothing else is known. Each given folder
also runs with collision proxies known, as a second run has them. Exit codes: 0 the bound holds, 1 it does not.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from PIL import Image

import caches
import process
from run import REPO
from segmentation import loose_box

OBJECTS = 8
MOST = 1.5
"""Longest time of boxes, over that of the given folder: median over scenes, wall clock and processor."""


def main() -> int:
    args = _arguments()
    folders = [f for f in sorted((args.data / "scenes").glob("*")) if len(list((f / "masks").glob("*.png"))) == OBJECTS]
    folders = [f for f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no scene of {OBJECTS} objects in {args.data}")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    kernels, _ = caches.kept(args.out / "warm_up.log")
    rows = dict[str, dict[str, Any]]()
    for folder in folders:
        rows[folder.name] = timed(folder, args.out / folder.name, kernels)
        print(_line(folder.name, rows[folder.name]), flush=True)
    (args.out / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
    return int(judge(rows))


def timed(folder: Path, out: Path, kernels: Path) -> dict[str, Any]:
    """``wall`` and ``cpu`` seconds of the photo with boxes, of the given folder, and of the latter with proxies."""
    row = dict[str, Any]()
    with caches.fresh(kernels) as cache:
        row["boxes"] = _times(_from_boxes(folder, out / "boxes", {"F3SR_CACHE_DIR": str(cache)}), out / "boxes.times")
    with caches.fresh(kernels) as cache:
        environment = {"F3SR_CACHE_DIR": str(cache)}
        for name in ("given", "given, proxies known"):
            shutil.rmtree(cache / "stages", ignore_errors=True)
            finished = process.reconstruct(folder, out / "given", environment=environment)
            row[name] = _times(finished, out / "given.times")
    return row


def box(mask: Path) -> str:
    """The option of a loose box around a mask, with the label in the file's name."""
    sides = ",".join(map(str, loose_box(np.asarray(Image.open(mask)) > 0)))
    return f"--box={sides}:{mask.stem.partition('_')[2].replace('_', ' ')}"


def judge(rows: Mapping[str, dict[str, Any]]) -> bool:
    """Print the ratios; whether a bound does not hold."""
    wrong = False
    for given in ("given", "given, proxies known"):
        for kind in ("wall", "cpu"):
            ratio = median(row["boxes"][kind] / row[given][kind] for row in rows.values())
            bound = f" (at most {MOST:g})" if given == "given" else ""
            missed = bool(bound) and ratio > MOST
            wrong |= missed
            print(f"boxes over {given}, {kind}: {ratio:.2f}{bound}{'  DOES NOT HOLD' if missed else ''}")
    return wrong


def _from_boxes(folder: Path, out: Path, environment: Mapping[str, str]) -> process.Finished:
    shutil.rmtree(out.parent, ignore_errors=True)
    out.parent.mkdir(parents=True)
    photo = out.parent / "photo.png"
    shutil.copy(next(folder.glob("image.*")), photo)
    boxes = [box(mask) for mask in sorted((folder / "masks").glob("*.png"))]
    arguments = ["timed_cli.py", out.with_suffix(".times"), "photo", photo, "-o", out, *boxes, "--no-open", "--json"]
    return process.run(arguments, out.with_suffix(".log"), environment=environment)


def _times(finished: process.Finished, steps: Path) -> dict[str, Any]:
    return {"wall": finished.wall, "cpu": finished.cpu, "steps": json.loads(steps.read_text())}


def _line(name: str, row: Mapping[str, Any]) -> str:
    return f"{name}: " + ", ".join(f"{k} {v['wall']:.1f} s (processor {v['cpu']:.1f} s)" for k, v in row.items())


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "eight_boxes")
    args = parser.parse_args()
    args.out = args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
