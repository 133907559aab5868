"""A small picture of one object, as catalogues of assets show it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.transforms import Array, pose
from f3sr.io.images import encode_png, resized
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer

SIDE = 256
"""Of the picture [px]; NVIDIA's validator wants this one."""
SAMPLES = 2
"""Along each side of a pixel."""
PAPER = 235
"""Grey behind the object."""
AWAY = 6.0
"""Distance of the camera [diagonals of the object]."""
FRAME = 1.12
"""Size of the picture over that of the object."""
LEAST_ELEVATION = np.radians(25)
"""The camera looks down at least so much: photos are often taken from lower, which hides tops."""
SHADE = 0.35
"""Share of its brightness that a surface loses where it is seen edge on."""


def thumbnail_png(o: SceneObject, camera: Camera) -> bytes:
    """``thumbnail`` as PNG."""
    return encode_png(thumbnail(o, camera))


def thumbnail(o: SceneObject, camera: Camera) -> NDArray[np.uint8]:
    """The object (256, 256, 3) as it stands in the scene, from the photo's side, darker towards its outline."""
    view = _view(o, camera.T_world_camera[:3, 2])
    fragments = rasterizer.render([o], view)
    covered = fragments.ids != rasterizer.EMPTY
    colors = rasterizer.shade(fragments, [o])[covered]
    normals = corner_normals(o.mesh)[fragments.face[covered]]
    normal = np.einsum("ij,ijk->ik", fragments.bary[covered], normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    toward = o.T_world_object[:3, :3].T @ view.T_world_camera[:3, 2]
    picture = np.full((view.height, view.width, 3), PAPER, np.uint8)
    light = 1 - SHADE * (1 - np.abs(normal @ toward))
    picture[covered] = (255 * colors * light[:, None]).round().clip(0, 255)
    return resized(picture, SIDE, SIDE)


def _view(o: SceneObject, forward: Array) -> Camera:
    """A camera that looks along ``forward`` (3,), but down, at all of the object."""
    level = forward * [1, 1, 0]
    level = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-6 else np.array([0.0, 1, 0])
    elevation = max(LEAST_ELEVATION, float(np.arcsin(np.clip(-forward[2] / np.linalg.norm(forward), -1, 1))))
    ahead = np.cos(elevation) * level + [0, 0, -np.sin(elevation)]
    right = np.cross(level, [0, 0, 1])
    R = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    seen = o.vertices_world @ R
    low, high = seen.min(0), seen.max(0)
    distance = AWAY * o.size
    eye = (low + high) / 2 - [0, 0, distance]
    pixels = SAMPLES * SIDE
    focal = (distance - (high[2] - low[2]) / 2) * pixels / FRAME / max(high[:2] - low[:2])
    K = np.array([[focal, 0, pixels / 2], [0, focal, pixels / 2], [0, 0, 1]])
    return Camera(width=pixels, height=pixels, K=K, T_world_camera=pose(R, R @ eye))
