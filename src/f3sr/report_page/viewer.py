"""What the 3-D view shows, packed small: meshes, textures, collision parts, poses and the photo's cameras."""

from __future__ import annotations

from typing import Any

import numpy as np

from f3sr.report_page.page_data import PageData
from f3sr.scene import Scene, SceneObject
from f3sr.vision.pictures import Image, turned_view
from f3sr.web.document import clean
from f3sr.web.light_mesh import lightened
from f3sr.web.packed import TextureIndex, packed_camera, packed_mesh, packed_parts

FACES_EACH = (400, 60_000)
"""Fewest and most triangles of one mesh in the view."""
STILL_TURN = 35
"""How far the still picture's camera is turned from the photo's [degrees]."""


def still_picture(page: PageData) -> Image:
    """Where the view cannot be shown."""
    camera = page.backdrop.camera(page.scene)
    return turned_view(page.scene, turn=np.radians(STILL_TURN), width=camera.width, height=camera.height)


def scene_data(page: PageData) -> dict[str, Any]:
    """All that ``viewer.js`` reads."""
    faces = int(np.clip(page.sizes.faces // len(page.scene.objects), *FACES_EACH))
    textures = TextureIndex(page.sizes.texture)
    return {
        "cameras": {"direct": packed_camera(page.direct.camera), "ours": packed_camera(page.scene.camera)},
        "bounds": {"direct": _bounds(page.direct), "ours": _bounds(page.scene)},
        "objects": [_object(o, page.direct[o.id], faces, textures) for o in page.scene],
        "textures": textures.uris,
    }


def _bounds(scene: Scene) -> list[float]:
    corners = np.concatenate([o.bounds_world for o in scene])
    return [*corners.min(0).tolist(), *corners.max(0).tolist()]


def _object(o: SceneObject, direct: SceneObject, faces: int, textures: TextureIndex) -> dict[str, Any]:
    return {
        "id": o.id,
        "label": clean(o.label),
        "mesh": packed_mesh(lightened(o.mesh, faces), textures.index),
        "parts": packed_parts(o.colliders),
        "direct": direct.T_world_asset.ravel().tolist(),
        "ours": o.T_world_asset.ravel().tolist(),
    }
