"""Time that every object of packages takes to export, a format at a time, with all that it needs computed anew.

usage: python benchmarks/export_times.py PACKAGE ... [--format NAMES]
Prints seconds of the processor and of the clock, and what is over ``MOST``. Exit codes: 0 nothing is, 1 something is.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.protocol import Exporter
from f3sr.scene import Scene
from f3sr.scene_export import exporters_of
from f3sr.scene_package.package import read_package

MOST = 1.0
"""Seconds of an object in a format."""
FORMATS = "usd,urdf,sdf,mjcf,robosuite"
BACKPLATE = "textures/"
"""Pictures of USD's camera, which are the scene's and no object's."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", nargs="+", type=Path, metavar="PACKAGE")
    parser.add_argument("--format", default=FORMATS)
    args = parser.parse_args()
    scenes = {package.name: read_package(package).scene for package in args.packages}
    slow = False
    for backend in exporters_of(args.format.split(",")):
        exporter = backend.made
        first = next(iter(scenes.values()))
        seconds(exporter, next(alone(first))[1])  # what is loaded once
        took = {
            f"{package} {name}": seconds(exporter, scene)
            for package, whole in scenes.items()
            for name, scene in alone(whole)
        }
        rows = np.array(list(took.values()))
        median, most = np.median(rows, axis=0), rows.max(0)
        print(
            f"{backend.name}: {len(rows)} objects; processor: median {median[0]:.2f} s, most {most[0]:.2f} s; "
            f"clock: median {median[1]:.2f} s, most {most[1]:.2f} s",
            flush=True,
        )
        for name, (processor, clock) in sorted(took.items(), key=lambda item: -item[1][0]):
            if processor > MOST:
                slow = True
                print(f"  over {MOST:g} s: {name}, processor {processor:.2f} s, clock {clock:.2f} s")
    return int(slow)


def alone(scene: Scene) -> Iterator[tuple[str, ExportedScene]]:
    """Every object's name, and a scene of it alone that knows the names of the others."""
    whole = ExportedScene.of(scene)
    for o in whole.objects:
        fresh = ExportedScene.of(scene)
        one = ExportedScene(scene=scene, objects=tuple(x for x in fresh.objects if x.id == o.id), physics=whole.physics)
        one.__dict__["names"] = whole.names
        yield o.name, one


def seconds(exporter: Exporter, exported: ExportedScene) -> tuple[float, float]:
    """Processor time and clock time [s] of all files but the scene's pictures."""
    processor = clock = 0.0
    files = exporter.files(exported)
    while True:
        began, ticks = time.perf_counter(), os.times()
        file = next(files, None)
        after = os.times()
        if file is None:
            return processor, clock
        if not file[0].startswith(BACKPLATE):
            processor += sum(after[:4]) - sum(ticks[:4])
            clock += time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
