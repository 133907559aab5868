"""Where the photo shows the surface that things stand on, and where it would without them: shadows fall there only."""

from __future__ import annotations

import numpy as np

from f3sr.background.regions import Mask
from f3sr.frames import Array, Camera, transform
from f3sr.scene import Scene

NEAR = 0.02
"""Height over the ground up to which geometry is the support's, in diagonals of the scene."""
NOISE = 0.01
"""The same in distances from the camera: monocular depth is off by that."""


def support_of(scene: Scene, hole: Mask) -> Mask:
    """Pixels (H, W) of a levelled scene's support, where ``hole`` (H, W) hides it too: what the pixels around a hole
    show goes on in it. All below the horizon, where neither geometry nor a ground mask tell more."""
    below = faces_ground(scene.camera)
    known, seen = _seen(scene)
    if not (known & ~hole).any():
        return below
    return _filled(seen, hole | ~known) & below


def faces_ground(camera: Camera) -> Mask:
    """Pixels (H, W) whose rays meet the plane z = 0 in front of the camera."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ (camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K)).T
    return np.asarray(rays[..., 2] * camera.center[2] < 0, np.bool_)


def _seen(scene: Scene) -> tuple[Mask, Mask]:
    """Pixels (H, W) of which something tells what they show, and those that show the support."""
    shape = (scene.photo.height, scene.photo.width)
    known, seen = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    if scene.geometry is not None:
        height = _heights(scene.geometry.points.astype(float), scene.camera)
        far = np.linalg.norm(scene.geometry.points, axis=-1)
        close = scene.geometry.valid & (np.abs(height) <= NEAR * scene.diagonal + NOISE * far)
        rows, columns = ((np.arange(n) * m) // n for n, m in zip(shape, close.shape, strict=True))
        known |= scene.geometry.valid[rows][:, columns]
        seen |= close[rows][:, columns]
    if scene.ground_mask is not None:
        known |= True
        seen |= scene.ground_mask
    return known, seen


def _heights(points_camera: Array, camera: Camera) -> Array:
    """(h, w) over the ground [m]; 0 where there is no point."""
    points = np.nan_to_num(points_camera, posinf=0.0, neginf=0.0).reshape(-1, 3)
    return transform(camera.T_world_camera, points)[:, 2].reshape(points_camera.shape[:2])


def _filled(seen: Mask, hole: Mask) -> Mask:
    """What the nearest pixel outside the hole shows."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(hole, return_distances=False, return_indices=True)
    return seen[tuple(np.asarray(nearest))]
