"""Starts that are turned or far off: every object of the rendered scenes, one at a time or together, through `align`.

usage: python benchmarks/starts.py [--scenes NAME ...] [--starts NAME ...] [--together] [--data PATH]
Exit codes: 0 SHARE of every kind of starts end within NEAR of the IoU from the given start, and AS_GIVEN in its
orientation (or there are no data), 1 they do not.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean, median

import numpy as np

import contact as bench
import f3sr
import tables
from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array, pose, rotation_about, rotation_angle, turn_about
from f3sr.metrics.measures import full_silhouette
from f3sr.pipeline import as_given, assemble, level
from f3sr.pipeline_config import Config
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align import align
from f3sr.vision.occlusion import nearer_objects, visible_region
from f3sr.vision.rasterizer import NEAR as NEAREST
from f3sr.vision.silhouette import iou
from run import REPO

NEAR = 0.02
"""Loss of IoU, where nothing nearer hides an object, at which a start has arrived: what looks alike counts."""
SHARE = 0.9
"""Of the starts of a kind, how many should arrive."""
SAME = math.radians(15)
"""Turn [rad] from the pose of the given start within which it is the same orientation."""
AS_GIVEN: Mapping[str, float] = {"turned 90": 0.85, "turned 180": 0.85, "turned 270": 0.85, "upside down": 0.68}
"""Of some kinds of starts, how many should end in the orientation of the given one. Balls and plates need not."""


@dataclass(frozen=True)
class Run:
    """One start: IoUs where it began and ended, and from the given start; the turn between both ends."""

    scene: str
    name: str
    start: str
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
    runs = [r for name, folder in folders.items() for r in measured(name, folder, args.starts, together=args.together)]
    lines = [["start", "objects", "began", f"within {NEAR}", "same orientation", "median loss", "worst", "of", "CPU s"]]
    failed = False
    for start in args.starts:
        some = [r for r in runs if r.start == start]
        worst = min(some, key=lambda r: r.ended - r.given)
        arrived, same = mean(float(r.ended >= r.given - NEAR) for r in some), mean(float(r.off < SAME) for r in some)
        failed |= arrived < SHARE or same < AS_GIVEN.get(start, 0.0)
        lines.append([
            start, str(len(some)), f"{mean(r.began for r in some):.3f}", f"{arrived:.3f}", f"{same:.3f}",
            f"{median(r.given - r.ended for r in some):.4f}", f"{worst.given - worst.ended:.3f}",
            f"{worst.name} of {worst.scene}", f"{mean(r.cpu for r in some):.2f}",
        ])  # fmt: skip
    tables.show(lines)
    return int(failed)


def measured(name: str, folder: Path, starts: Collection[str], *, together: bool) -> Iterator[Run]:
    """All objects of a scene from all starts, together or one at a time, then before the camera of the given starts."""
    config = Config()
    scene, _ = level(assemble(as_given(f3sr.read_inputs(folder)), config.assemble)[0], config.level)
    given, _ = align(scene, config.align)
    if not together:
        scene = replace(scene, camera=given.camera)
    settings, nearer = replace(config.align, camera=together), nearer_objects(given)

    def seen(o: SceneObject, camera: Camera) -> float:
        if camera.to_camera(o.vertices_world)[:, 2].min() <= NEAREST:
            return 0.0
        return iou(full_silhouette(o, camera), o.mask, visible_region(given[o.id], nearer[o.id]))

    def run(start: str, o: SceneObject, begun: Scene, ended: Scene, same: Scene, cpu: float) -> Run:
        R = ended[o.id].T_world_object[:3, :3] @ same[o.id].T_world_object[:3, :3].T
        ious = (seen(s[o.id], s.camera) for s in (begun, ended, same))
        return Run(name, o.label or o.mask_name, start, *ious, off=rotation_angle(R), cpu=cpu)

    def aligned(begun: Scene, only: list[int] | None) -> tuple[Scene, float]:
        began = time.process_time()
        return align(begun, settings, only=only)[0], time.process_time() - began

    if together:
        for start in starts:
            begun = scene.with_objects(*(STARTS[start](o, scene.camera) for o in scene))
            ended, cpu = aligned(begun, None)
            yield from (run(start, o, begun, ended, given, cpu / len(scene.objects)) for o in scene)
        return
    for o in scene:
        same, _ = aligned(scene, [o.id])
        for start in starts:
            begun = scene.with_objects(STARTS[start](o, scene.camera))
            ended, cpu = aligned(begun, [o.id])
            yield run(start, o, begun, ended, same, cpu)


def _turned(o: SceneObject, degrees: float, axis: Array = UP) -> SceneObject:
    return o.moved(turn_about(o.middle, rotation_about(axis, math.radians(degrees))), stage="start", reason="turned")


def _resized(o: SceneObject, factor: float) -> SceneObject:
    return o.moved(pose(t=(1 - factor) * o.middle), scale=factor, stage="start", reason="resized")


def _shifted(o: SceneObject, shift: Array) -> SceneObject:
    return o.moved(pose(t=shift), stage="start", reason="shifted")


def _to_the_right(o: SceneObject, camera: Camera, sizes: float) -> SceneObject:
    return _shifted(o, sizes * o.size * camera.T_world_camera[:3, 0])


STARTS: Mapping[str, Callable[[SceneObject, Camera], SceneObject]] = {
    "turned 90": lambda o, _: _turned(o, 90),
    "turned 180": lambda o, _: _turned(o, 180),
    "turned 270": lambda o, _: _turned(o, 270),
    "on its side": lambda o, camera: _turned(o, 90, camera.T_world_camera[:3, 0]),
    "upside down": lambda o, camera: _turned(o, 180, camera.T_world_camera[:3, 0]),
    "leaning": lambda o, _: _turned(o, 40, np.array([1.0, 1, 0])),
    "half": lambda o, _: _resized(o, 1 / 2),
    "double": lambda o, _: _resized(o, 2),
    "a tenth": lambda o, _: _resized(o, 1 / 10),
    "tenfold": lambda o, _: _resized(o, 10),
    "beside": lambda o, camera: _to_the_right(o, camera, 1),
    "three sizes beside": lambda o, camera: _to_the_right(o, camera, 3),
    "behind the camera": lambda o, camera: _shifted(o, 2 * (camera.center - o.middle)),
    "all of these": lambda o, camera: _turned(_resized(_to_the_right(o, camera, 2), 2), 180),
}
"""Ways in which objects come wrong: turned about the vertical, in a wrong unit, elsewhere in the picture or outside."""


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], metavar="NAME", help="all rendered ones by default")
    parser.add_argument("--starts", nargs="+", choices=STARTS, default=list(STARTS), metavar="NAME")
    parser.add_argument("--together", action="store_true", help="all objects of a scene come so")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
