"""A worker that answers with the meshes of an input folder in a producer's own axes, unit and convention of poses.

Started by ``producers.py``: python scripted_producer.py --source FOLDER --frame NAME --run ANY --job DIR
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, quaternion_from_rotation, rotation_about
from f3sr.io.mesh_files import load_mesh, save_glb
from f3sr.io.pose_conventions import (
    CAMERAS,
    FILE_AXES,
    GLTF_FROM_Z_UP,
    SAM3D,
    PoseConvention,
    SignedAxes,
    rotation_as_read,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "workers"))
from job import Job  # type: ignore[import-not-found]

Z_UP = GLTF_FROM_Z_UP.matrix
"""From a glTF's axes to Z-up ones."""
FACING = rotation_about([0, 0, 1], np.pi / 2)
"""TripoSR's meshes are Z-up and look along +x."""
SEED = 5


@dataclass(frozen=True, kw_only=True)
class Frame:
    """How a producer leaves a mesh whose file here is Y-up in a unit box."""

    up: str = "+y"
    longest: float = 0.0
    """Longest side of the box of its meshes about the origin; 0: as the file has it."""
    yaws: bool = False
    """Whether it turns each mesh about the vertical by an angle that nobody tells."""
    pose: PoseConvention | None = None
    """As poses are written; None where it gives none."""


FRAMES = {
    "sam3d": Frame(pose=SAM3D),
    "fal-sam3d": Frame(pose=PoseConvention("xyzw", "row", GLTF_FROM_Z_UP, CAMERAS["pytorch3d"])),
    "three.js": Frame(pose=PoseConvention("xyzw", "column", FILE_AXES, CAMERAS["opengl"])),
    "unity": Frame(pose=PoseConvention("xyzw", "column", SignedAxes("-x+y+z"), CAMERAS["unity"])),
    "trellis2": Frame(longest=1.0, yaws=True),
    "hunyuan3d": Frame(longest=1.98, yaws=True),
    "triposr": Frame(up="+z", longest=1.1, yaws=True),
}
"""By producer; those with a pose give poses. three.js and Unity are where users of the first two take them."""


def as_left(given: Mesh, entry: dict[str, Any], frame: Frame, id: int) -> tuple[Mesh, dict[str, Any] | None]:
    """The mesh and the pose as the producer leaves them; ``entry`` is the folder's own, of SAM 3D Objects."""
    vertices = given.vertices
    if frame.pose is None:
        if frame.yaws:
            yaw = np.random.default_rng([SEED, id]).uniform(0, 2 * np.pi)
            vertices = vertices @ rotation_about([0, 1, 0], yaw).T
        if frame.up == "+z":
            vertices = vertices @ (FACING @ Z_UP).T
        low, high = vertices.min(0), vertices.max(0)
        vertices = (vertices - (low + high) / 2) * (frame.longest / (high - low).max())
        return given.with_vertices(vertices), None
    # x_camera = F_sam Q_sam A_sam v: the same place by the producer's own F and A, of a file that may be mirrored.
    Q = rotation_as_read(entry["rotation"], SAM3D.order, SAM3D.vectors)
    R = SAM3D.camera.matrix @ Q @ SAM3D.mesh.matrix
    F, A = frame.pose.camera.matrix, frame.pose.mesh.matrix
    M = np.diag([-1.0, 1, 1]) if frame.pose.camera.mirrors else np.eye(3)
    turned: Array = F.T @ R @ M @ (A.T if not frame.pose.camera.mirrors else np.eye(3))
    vertices = vertices @ M @ A if frame.pose.camera.mirrors else vertices
    w, x, y, z = quaternion_from_rotation(turned.T if frame.pose.vectors == "row" else turned).tolist()
    pose = {
        "convention": "sam3d",
        "rotation": [w, x, y, z] if frame.pose.order == "wxyz" else [x, y, z, w],
        "translation": (F.T @ SAM3D.camera.matrix @ np.array(entry["translation"])).tolist(),
        "scale": entry["scale"],
    }
    return given.with_vertices(vertices), pose


def main() -> None:
    """Answer all that a job asks for."""
    job = Job.from_arguments(__doc__, source="", frame="sam3d", run="")
    frame = FRAMES[job.arguments.frame]
    assets = Path(job.arguments.source) / "assets"
    entries = {int(p["mask"][:2]): p for p in json.loads((assets / "poses.json").read_text())["objects"]}
    for item in job.open_items():
        entry = entries[item["id"]]
        mesh, pose = as_left(load_mesh(assets / entry["mesh"]), entry, frame, item["id"])
        job.answer(item, partial(_saved, mesh), model=f"scripted {job.arguments.frame}", up=frame.up, pose=pose)


def _saved(mesh: Mesh, path: str) -> None:
    save_glb(mesh, Path(path))


if __name__ == "__main__":
    main()
