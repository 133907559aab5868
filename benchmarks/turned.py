"""Starts turned about the vertical: every object of the rendered scenes, one at a time, through `align`.

usage: python benchmarks/turned.py [--scenes NAME ...] [--turns DEGREES ...] [--data PATH]
Exit codes: 0 SHARE of every turn's starts end within NEAR of the IoU from the given start (or no data), 1 they do not.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import contact as bench
import f3sr
import tables
from f3sr.core.transforms import UP, rotation_about, rotation_angle, turn_about
from f3sr.metrics.measures import full_silhouette
from f3sr.pipeline import as_given, assemble, level
from f3sr.pipeline_config import Config
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align import align
from f3sr.vision.occlusion import nearer_objects, visible_region
from f3sr.vision.silhouette import iou
from run import REPO

NEAR = 0.02
"""Loss of IoU, where nothing nearer hides an object, at which a turned start has arrived: what looks alike counts."""
SHARE = 0.9
"""Of the starts of a turn, how many should arrive."""
SAME = math.radians(15)
"""Turn [rad] from the pose of the given start within which it is the same orientation."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One turned start: IoUs where it began and ended, and from the given start; the turn between both ends."""

    scene: str
    name: str
    degrees: float
    began: float
    ended: float
    given: float
    off: float
    """[rad]"""
    cpu: float
    """[s]"""


def main() -> int:
    args = _arguments()
    folders = {name: folder for name, (group, folder) in bench.chosen(args).items() if group == "rendered"}
    if not folders:
        return 0
    runs = [run for name, folder in folders.items() for run in turned(name, folder, args.turns)]
    lines = [["turn", "starts", f"within {NEAR}", "same orientation", "median loss", "worst", "of", "CPU s"]]
    arrived: list[float] = []
    for degrees in args.turns:
        some = [r for r in runs if r.degrees == degrees]
        worst = min(some, key=lambda r: r.ended - r.given)
        arrived.append(sum(r.ended >= r.given - NEAR for r in some) / len(some))
        lines.append([
            f"{degrees:.0f}", str(len(some)), f"{arrived[-1]:.3f}",
            f"{sum(r.off < SAME for r in some) / len(some):.3f}",
            f"{median(r.given - r.ended for r in some):.4f}", f"{worst.given - worst.ended:.3f}",
            f"{worst.name} of {worst.scene}", f"{sum(r.cpu for r in some) / len(some):.2f}",
        ])  # fmt: skip
    tables.show(lines)
    return int(min(arrived) < SHARE)


def turned(name: str, folder: Path, turns: list[float]) -> Iterator[Run]:
    """All objects of a scene from all turned starts, before the camera that the given starts have."""
    config = Config()
    scene, _ = level(assemble(as_given(f3sr.read_inputs(folder)), config.assemble)[0], config.level)
    given, _ = align(scene, config.align)
    scene = replace(scene, camera=given.camera)
    fixed, nearer = replace(config.align, camera=False), nearer_objects(given)

    def seen(o: SceneObject) -> float:
        return iou(full_silhouette(o, given.camera), o.mask, visible_region(given[o.id], nearer[o.id]))

    for o in scene:
        same, _ = align(scene, fixed, only=[o.id])
        for degrees in turns:
            start = _turned(scene, o, math.radians(degrees))
            began = time.process_time()
            end, _ = align(start, fixed, only=[o.id])
            cpu = time.process_time() - began
            R = end[o.id].T_world_object[:3, :3] @ same[o.id].T_world_object[:3, :3].T
            yield Run(
                scene=name, name=o.label or o.mask_name, degrees=degrees, began=seen(start[o.id]),
                ended=seen(end[o.id]), given=seen(same[o.id]), off=rotation_angle(R), cpu=cpu,
            )  # fmt: skip


def _turned(scene: Scene, o: SceneObject, yaw: float) -> Scene:
    T = turn_about(o.middle, rotation_about(UP, yaw))
    return scene.with_objects(o.moved(T, stage="start", reason="turned"))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], metavar="NAME", help="all rendered ones by default")
    parser.add_argument("--turns", nargs="+", type=float, default=[90.0, 180.0, 270.0], metavar="DEGREES")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
