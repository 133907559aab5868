"""Convex parts as OBJ files: where the package keeps them, for every format that names files for collision."""

from __future__ import annotations

from collections.abc import Mapping

from f3sr.exporters.obj import part_to_obj
from f3sr.physics.mujoco_model import Body


def collision_path(id: int, part: int) -> str:
    """Where a convex part lies, relative to the folder."""
    return f"collision/{id:02d}/{part:02d}.obj"


def grown_path(id: int, part: int) -> str:
    """Where the same part lies, grown by the contact margin for ``scene.xml``."""
    return f"collision/{id:02d}/{part:02d}_grown.obj"


def collision_files(id: int, body: Body) -> Mapping[str, bytes]:
    """The convex parts of a body, object frame, metres, by their paths."""
    return {collision_path(id, k): part_to_obj(part).encode() for k, part in enumerate(body.parts)}
