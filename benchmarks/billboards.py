"""Flat billboards instead of lifted meshes: what a photo gives without shapes, against the truth of its scene.

usage: billboards.py INPUT PACKAGE OBJECTS
prints one JSON object: chamfer and centre errors of the package's objects, and of an upright sheet for every mask that
faces the camera where the object rests.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array
from f3sr.scene import SceneObject
from f3sr.scene_package.package import read_package
from truth import SAMPLES, global_scale, shape_errors, true_points


def main() -> None:
    folder, package, objects = map(Path, sys.argv[1:4])
    scene = read_package(package).scene
    truth = json.loads((folder / "truth.json").read_text())
    index = {file.name: k for k, file in enumerate(sorted((folder / "masks").glob("*.png")))}
    true = [
        true_points(truth["objects"][index[o.mask_name]], np.array(truth["T_world_camera"]), objects) for o in scene
    ]
    ours = [sample_surface(o.vertices_world, o.mesh.faces, SAMPLES) for o in scene]
    sheets = [billboard(o, scene.camera) for o in scene]
    answer = dict[str, float]()
    for name, points in (("lifted", ours), ("billboard", sheets)):
        seen = [scene.camera.to_camera(p) for p in points]
        scale = global_scale(true, seen)
        answer |= {f"{name}_{key}": value for key, value in shape_errors(true, [scale * q for q in seen]).items()}
    print(json.dumps(answer))


def billboard(o: SceneObject, camera: Camera) -> Array:
    """Points (n, 3) of the mask on the upright plane that faces the camera, through its nearest low point."""
    vertices = o.vertices_world
    low = vertices[vertices[:, 2] < vertices[:, 2].min() + 0.02 * np.ptp(vertices[:, 2])]
    away = (vertices.mean(0) - camera.center) * [1, 1, 0]
    away /= np.linalg.norm(away)
    offset = float((low @ away).min())
    rows, columns = np.nonzero(o.mask)
    chosen = np.random.default_rng(0).integers(len(rows), size=SAMPLES)
    pixels = np.column_stack([columns[chosen] + 0.5, rows[chosen] + 0.5, np.ones(SAMPLES)])
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.T_world_camera[:3, :3].T
    t = (offset - camera.center @ away) / (rays @ away)
    return camera.center + t[:, None] * rays


if __name__ == "__main__":
    main()
