"""Points on a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, cross


def sample_surface(vertices: Array, faces: NDArray[np.int32], count: int) -> Array:
    """``count`` points (count, 3) sampled on a surface by area, with a fixed seed."""
    rng = np.random.default_rng(0)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    # Uniform over the triangle: the parallelogram's upper half is folded onto the lower.
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
