"""What a package is worth against the truth of its scene, and its physics at true scale.

usage: truth.py INPUT PACKAGE OBJECTS
prints one JSON object: measures of the result and of direct composition that ``f3sr reconstruct`` cannot know.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, invert_pose, transform
from f3sr.io.mesh_files import load_mesh
from f3sr.physics.release import release
from f3sr.scene import GROUND, Scene
from f3sr.scene_package.package import read_package
from f3sr.stages.evaluate import direct_composition

SAMPLES = 1500
"""Surface points per object, as many as the referee takes."""


def main() -> None:
    folder, package, objects = map(Path, sys.argv[1:4])
    content = read_package(package)
    scenes = {"f3sr": content.scene}
    if content.direct:
        scenes["direct composition"] = direct_composition(content.direct, content.scene)
    print(json.dumps({name: against_truth(scene, folder, objects) for name, scene in scenes.items()}, allow_nan=False))


def against_truth(scene: Scene, folder: Path, objects: Path) -> dict[str, float]:
    """Measures that need truth.json, and K and D with the one global scale [m per length of the scene]."""
    truth = json.loads((folder / "truth.json").read_text())
    T_world_camera = np.array(truth["T_world_camera"])
    index = {file.name: k for k, file in enumerate(sorted((folder / "masks").glob("*.png")))}

    true = [true_points(truth["objects"][index[o.mask_name]], T_world_camera, objects) for o in scene]
    ours = [scene.camera.to_camera(sample_surface(o.vertices_world, o.mesh.faces, SAMPLES)) for o in scene]
    scale = global_scale(true, ours)
    K, D = release(scene.objects, true_scale=scale)

    return {
        "true_scale": scale,
        "K_max_J": K,
        "D_max_cm": 100 * D,
        "tilt_deg": tilt(scene.camera.T_world_camera, T_world_camera),
        **shape_errors(true, [scale * q for q in ours]),
        **support_scores(scene, truth, index),
    }


def global_scale(true: Sequence[Array], ours: Sequence[Array]) -> float:
    """The factor that brings our objects' mean points (camera frame) nearest to the true ones, least squares."""
    P, Q = (np.array([points.mean(0) for points in side]) for side in (true, ours))
    return float((P * Q).sum() / (Q * Q).sum())


def tilt(T_ours: Array, T_true: Array) -> float:
    """Angle [deg] between the two up vectors as the camera sees them."""
    up, true_up = T_ours[2, :3], T_true[2, :3]
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(up, true_up)), up @ true_up)))


def shape_errors(true: Sequence[Array], ours: Sequence[Array]) -> dict[str, float]:
    """Mean chamfer distance and mean distance of centres, in % of the true object's size."""
    chamfer, centre = [], []
    for p, q in zip(true, ours, strict=True):
        size = np.linalg.norm(np.ptp(p, axis=0))
        chamfer.append((KDTree(p).query(q)[0].mean() + KDTree(q).query(p)[0].mean()) / 2 / size)
        centre.append(np.linalg.norm(p.mean(0) - q.mean(0)) / size)
    return {"chamfer_pct": 100 * float(np.mean(chamfer)), "centre_pct": 100 * float(np.mean(centre))}


def support_scores(scene: Scene, truth: dict[str, Any], index: dict[str, int]) -> dict[str, float]:
    """Precision and recall of (object, its support) pairs; nothing where either side knows no supports."""
    name = {o.id: index[o.mask_name] for o in scene} | {GROUND: -1}
    found = {(name[o.id], name[s.id]) for o in scene for s in o.supports}
    true = {(a, b) for a, b in truth.get("supports", [])}
    if not found or not true:
        return {}
    hits = len(found & true)
    return {"support_precision": hits / len(found), "support_recall": hits / len(true)}


def true_points(record: dict[str, Any], T_world_camera: Array, objects: Path) -> Array:
    """Points (SAMPLES, 3) on a true object's surface, in the camera frame [m]."""
    mesh = load_mesh(objects / f"{record['model']}.glb")
    T_camera_object = invert_pose(T_world_camera) @ np.array(record["T_world_object"])
    return transform(T_camera_object, sample_surface(mesh.vertices, mesh.faces, SAMPLES))


if __name__ == "__main__":
    main()
