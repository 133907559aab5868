"""Aligned poses against what is known of them: true turns, the measured depth, and the scene as it truly was.

Assets of the benchmark scenes are their true objects' meshes, bent and blurred but vertex for vertex, so that the turn
between the two is known.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, invert_pose
from f3sr.io.mesh_files import load_mesh
from f3sr.scene import Scene
from f3sr.vision import rasterizer

LABELLED = (
    *("ycb_cracker_box", "ycb_gelatin_box", "ycb_sugar_box", "hope_macaroni_and_cheese"),
    *("ycb_potted_meat_can", "ycb_tomato_soup_can"),
)
"""Boxes and cans with a front: their yaw is defined by what is printed on them, whatever their outline."""


def yaw_errors(scene: Scene, folder: Path, objects: Path) -> dict[int, float]:
    """By object id, how far the labelled ones are turned about the vertical from the truth [deg], 0 to 180."""
    up = scene.camera.T_camera_world[:3, 2]
    errors: dict[int, float] = {}
    for id, model, R_camera_object in _true_turns(folder):
        if model in LABELLED:
            o = scene[id]
            R_object_asset, _ = similarity(o.mesh.vertices, _mesh(objects / f"{model}.glb").vertices)
            R = scene.camera.T_camera_world[:3, :3] @ o.T_world_object[:3, :3]
            errors[id] = _twist(R @ (R_camera_object @ R_object_asset).T, up)
    return errors


def depth_residual(scene: Scene) -> float:
    """Median of |rendered depth - measured depth| over the pixels of all masks where both are known [m]."""
    geometry = scene.geometry
    assert geometry is not None
    h, w = geometry.valid.shape
    small = scene.camera.resized(w, h)
    residuals: list[Array] = []
    for o in scene:
        depth = rasterizer.render([o], small).depth
        where = geometry.inside(o.mask) & np.isfinite(depth)
        residuals.append(np.abs(depth[where] - geometry.points[where][:, 2]))
    return float(np.median(np.concatenate(residuals)))


def true_scene(scene: Scene, folder: Path, objects: Path) -> Scene | None:
    """The true objects before the true camera, with the photo and masks of ``scene``; None where nobody knows it."""
    if not (folder / "truth.json").exists():
        return None
    truth = json.loads((folder / "truth.json").read_text())
    camera = replace(scene.camera, K=np.array(truth["K"]), T_world_camera=np.array(truth["T_world_camera"]))
    records = (truth["objects"][k] for k in range(len(scene.objects)))
    true = (
        replace(
            o, mesh=_mesh(objects / f"{r['model']}.glb"), T_world_object=np.array(r["T_world_object"]), scale=1.0,
            parts=(),
        )
        for o, r in zip(scene, records, strict=True)
    )  # fmt: skip
    return replace(scene, camera=camera, objects=tuple(true))


def _true_turns(folder: Path) -> Iterator[tuple[int, str, Array]]:
    """Id, model and true rotation in camera axes of the objects of a scene, made or photographed."""
    names = sorted(file.name for file in (folder / "masks").glob("*.png"))
    if (folder / "truth.json").exists():
        truth = json.loads((folder / "truth.json").read_text())
        T_camera_world = invert_pose(np.array(truth["T_world_camera"]))
        for name, r in zip(names, truth["objects"], strict=True):
            yield int(name[:2]), r["model"], (T_camera_world @ np.array(r["T_world_object"]))[:3, :3]
    else:
        for r in json.loads((folder / "source.json").read_text())["objects"]:
            yield int(r["mask"][:2]), r["model"], np.array(r["T_camera_object"])[:3, :3]


def similarity(points: Array, onto: Array) -> tuple[Array, float]:
    """The rotation R (3, 3) and the scale s for which ``onto`` (n, 3) is nearest to s R ``points`` (n, 3), both about
    their means (Umeyama 1991)."""
    a, b = points - points.mean(0), onto - onto.mean(0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return U * signs @ Vt, float((S * signs).sum() / (a**2).sum())


def _twist(R: Array, axis: Array) -> float:
    """The part of a rotation that is about an axis [deg], 0 to 180."""
    sine = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) @ axis
    return float(np.degrees(2 * np.arctan2(abs(sine), 1 + np.trace(R))))


@cache
def _mesh(file: Path) -> Mesh:
    return load_mesh(file)
