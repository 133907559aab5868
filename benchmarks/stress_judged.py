"""What became of a stress scene: who went far or fell over, and which overlaps are left that no decision names.

usage: stress_judged.py INPUT PACKAGE OBJECTS PICTURE
prints one JSON object; writes the sheet of the scene before and after.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import poses
from f3sr.core.transforms import invert_pose
from f3sr.io.mesh_files import load_mesh
from f3sr.metrics import penetration
from f3sr.physics.release import filling
from f3sr.scene import Scene, SceneObject
from f3sr.scene_package.package import read_package
from f3sr.vision.pictures import pictures_of

FALLEN = 20.0
"""Turn from upright beyond what it truly has from which on an object has fallen over [deg]."""


def main() -> None:
    folder, package, objects, picture = map(Path, sys.argv[1:5])
    content = read_package(package)
    assert content.direct is not None
    Image.fromarray(pictures_of(content.direct, content.scene)["sheet"]).save(picture)
    report = json.loads((package / "report.json").read_text())
    true = json.loads((folder / "truth.json").read_text())
    print(json.dumps(judged(content.scene, content.direct, report, true, objects), allow_nan=False))


def judged(
    scene: Scene, start: Scene, report: Mapping[str, Any], true: Mapping[str, Any], objects: Path
) -> dict[str, Any]:
    decisions = [d for stage in report["stages"] for d in stage["decisions"]]
    left = [m["after"] for stage in report["stages"] for m in stage["measures"] if m["name"] == "overlapping pairs"]
    travel = travels(scene, start)
    pairs = crossing_pairs(scene)
    return {
        "far_pct": 100 * max(travel.values()),
        "farthest": max(travel, key=lambda id: travel[id]),
        "left_scene": [o.id for o in scene if is_outside(o.middle, start)],
        "fallen": fallen(scene, true, objects),
        "overlaps_left": left[-1] if left else None,
        "crossing": pairs,
        "unnamed": [[a, b] for a, b in pairs if not any(names(d, a, b) for d in decisions)],
        "hidden": true["hidden"],
        "weight_N": weight(scene),
    }


def weight(scene: Scene) -> float:
    """Of all movable objects in the release protocol [N]."""
    volumes = [filling(o) * o.scale**3 * sum(p.volume for p in o.solids) for o in scene if o.mobility != "fixed"]
    return 9.81 * 600 * sum(volumes)


def travels(scene: Scene, start: Scene) -> dict[int, float]:
    """How far the middle of every object is from where it came, as a share of the scene's diagonal."""
    return {o.id: float(np.linalg.norm(o.middle - start[o.id].middle)) / start.diagonal for o in scene}


def is_outside(point: Any, start: Scene) -> bool:
    """Whether a point is farther than a quarter of the scene's diagonal from the box around all."""
    corners = np.concatenate([o.bounds_world for o in start])
    low, high = corners.min(0), corners.max(0)
    return bool(np.linalg.norm(point - np.clip(point, low, high)) > 0.25 * start.diagonal)


def fallen(scene: Scene, true: Mapping[str, Any], objects: Path) -> list[int]:
    """Ids of the objects that are turned by more than FALLEN but for turns about the vertical; balls cannot fall."""
    T_camera_world = invert_pose(np.array(true["T_world_camera"]))
    found: list[int] = []
    for o, record in zip(scene, true["objects"], strict=True):
        if record["round"]:
            continue
        mesh = load_mesh(objects / f"{record['model']}.glb")
        R_true = T_camera_world[:3, :3] @ np.array(record["T_world_object"])[:3, :3]
        R_ours = scene.camera.T_camera_world[:3, :3] @ o.T_world_object[:3, :3]
        R_object_asset, _ = poses.similarity(o.mesh.vertices, mesh.vertices)
        R = R_ours @ R_object_asset.T @ R_true.T
        up = scene.camera.T_camera_world[:3, 2]
        if np.degrees(np.arccos(np.clip(up @ R @ up, -1, 1))) > FALLEN:
            found.append(o.id)
    return found


def crossing_pairs(objects: Iterable[SceneObject]) -> list[tuple[int, int]]:
    """Pairs whose visual meshes pierce each other."""
    bodies = {o.id: (o.vertices_world, o.mesh.faces) for o in objects}
    found, ids = penetration.penetration([*bodies.values()]), [*bodies]
    return [(ids[p.a], ids[p.b]) for p in found.pairs]


def names(decision: Mapping[str, Any], a: int, b: int) -> bool:
    """Whether a decision is about one of a pair and tells of the other by its id."""
    words = f"{decision['choice']} {decision['reason']}".replace(",", " ").replace(":", " ").split()
    return (decision["about"] == a and str(b) in words) or (decision["about"] == b and str(a) in words)


if __name__ == "__main__":
    main()
