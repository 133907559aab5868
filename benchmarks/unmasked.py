"""Occluders without masks: every half hidden object of the rendered scenes, aligned with and without what hides it.

usage: python benchmarks/unmasked.py [--scenes NAME ...] [--data PATH]
The measure is the IoU of the whole silhouette, hidden parts included, with the true object's.
Exit codes: 0 SHARE of the objects end within NEAR of the IoU that they have with all masks (or no data), 1 they do not.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean, median
from typing import Any

import numpy as np

import contact as bench
import f3sr
import tables
from f3sr.core.transforms import invert_pose
from f3sr.io.mesh_files import load_mesh
from f3sr.metrics.measures import full_silhouette
from f3sr.pipeline import as_given, assemble, level
from f3sr.pipeline_config import Config
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align import align
from f3sr.vision.silhouette import Mask, iou
from run import REPO

NEAR = 0.02
"""Loss of IoU by occluders without masks at which an object is where it should be."""
SHARE = 0.9
"""Of the objects, how many should be there."""
HIDDEN = 0.05
"""Share of an object's true silhouette outside of its mask from which on it is one of them."""
HIDES = 0.03
"""Share of that in the mask of another object from which on this is one of those that hide it."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One object: the share of it that is hidden, and its IoUs with all masks and without those of its occluders."""

    scene: str
    name: str
    hidden: float
    masked: float
    unmasked: float


def main() -> int:
    args = _arguments()
    folders = {name: folder for name, (group, folder) in bench.chosen(args).items() if group == "rendered"}
    runs = [run for name, folder in folders.items() for run in measured(name, folder, args.data / "objects")]
    if not runs:
        print("skipped: no hidden objects")
        return 0
    lines = [["scene", "object", "hidden", "all masks", "without"]]
    lines += [[r.scene, r.name, f"{r.hidden:.2f}", f"{r.masked:.3f}", f"{r.unmasked:.3f}"] for r in runs]
    for name, of in (("mean", mean), ("median", median)):
        hidden, masked, unmasked = (of(x) for x in zip(*((r.hidden, r.masked, r.unmasked) for r in runs), strict=True))
        lines.append([name, "", f"{hidden:.2f}", f"{masked:.3f}", f"{unmasked:.3f}"])
    tables.show(lines)
    there = mean(float(r.unmasked >= r.masked - NEAR) for r in runs)
    print(f"within {NEAR} of the IoU with all masks: {there:.2f} of {len(runs)} objects")
    return int(there < SHARE)


def measured(name: str, folder: Path, objects: Path) -> Iterator[Run]:
    """The half hidden objects of a scene."""
    config = Config()
    truth = json.loads((folder / "truth.json").read_text())
    scene, _ = level(assemble(as_given(f3sr.read_inputs(folder)), config.assemble)[0], config.level)
    aligned, _ = align(scene, config.align)
    for o in scene:
        true = true_silhouette(o, scene, truth, objects)
        beyond = true & ~o.mask
        hidden = np.count_nonzero(beyond) / np.count_nonzero(true)
        hides = {p.id for p in scene if p is not o and np.mean(p.mask[beyond]) > HIDES} if beyond.any() else set[int]()
        if hidden < HIDDEN or not hides:
            continue
        bare, _ = align(replace(scene, objects=tuple(p for p in scene if p.id not in hides)), config.align)
        masked, unmasked = (iou(full_silhouette(s[o.id], s.camera), true) for s in (aligned, bare))
        yield Run(scene=name, name=o.label or o.mask_name, hidden=hidden, masked=masked, unmasked=unmasked)


def true_silhouette(o: SceneObject, scene: Scene, truth: Mapping[str, Any], objects: Path) -> Mask:
    """The whole silhouette (H, W) of the true object that a mask shows, through the true camera."""
    record = next(r for r in truth["objects"] if o.mask_name.startswith(f"{r['index']:02d}_"))
    camera = replace(scene.camera, K=np.array(truth["K"], float))
    T_camera_object = invert_pose(np.array(truth["T_world_camera"])) @ np.array(record["T_world_object"])
    mesh = load_mesh(objects / f"{record['model']}.glb")
    true = replace(o, mesh=mesh, T_world_object=camera.T_world_camera @ T_camera_object, scale=1.0)
    return full_silhouette(true, camera)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], metavar="NAME", help="all rendered ones by default")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/ and objects/")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
