"""The pinhole camera of depth maps that have the photo's pixels."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import Array


def camera_matrix(focal: float, centre: tuple[float, float]) -> Array:
    """K (3, 3) of square pixels [px]."""
    return np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])


def rays(K: Array, width: int, height: int) -> Array:
    """Directions (height, width, 3) of depth 1 through the centres of the photo's pixels."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1).astype(float)
