"""How much of its mask an object loses when it moves: what the picture feels of a displacement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array


def loss_per_pixel(mask: NDArray[np.bool_]) -> Array:
    """IoU lost per pixel of shift to the right and downward (2,), for small shifts.

    For a silhouette A shifted by d, 1 - IoU = |A xor (A + d)| / |A or (A + d)|. Every border pixel across d counts
    once."""
    # A shift by one pixel changes both ends of every run: each border costs a pixel of |A xor (A + d)|; the union is
    # |A|.
    across = np.count_nonzero(mask[:, 1:] != mask[:, :-1]), np.count_nonzero(mask[1:] != mask[:-1])
    return np.array(across) / max(1, np.count_nonzero(mask))


def loss_matrix(mask: NDArray[np.bool_], camera: Camera, point: Array) -> Array:
    """W (3, 3) [1/m2]: d' W d is the squared IoU that an object at ``point`` (3,) loses by a small world shift d (3,).

    It is singular along the viewing ray, and zero for a point that is not in front of the camera."""
    x, y, z = camera.to_camera(point[None])[0]
    if z <= 0:
        return np.zeros((3, 3))
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    # Derivative (2, 3) of the projection at the point, by world shifts [px/m].
    pixels = np.array([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]]) @ camera.T_camera_world[:3, :3]
    weighted = loss_per_pixel(mask)[:, None] * pixels
    return weighted.T @ weighted
