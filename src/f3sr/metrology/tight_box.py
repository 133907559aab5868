"""How long a thing is: the sides of the tightest box around it."""

from __future__ import annotations

import numpy as np

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array

MOST_FACES = 200
"""Most faces of the hull that the box may lie on, the largest first: the rest are slivers of round shapes."""


def box_sides(points: Array) -> Array:
    """The sides (3,) of the box of least volume around points (n, 3), longest first, of those on a face of their hull.

    One of its faces holds a hull's face, or nearly so. In that plane a side of the least rectangle holds an edge of
    the outline (Freeman and Shapira 1975). Raises ValueError where the points span no volume."""
    hull = ConvexPart.hull_of(points)
    areas = area_vectors(hull.vertices[hull.faces])
    sizes = np.linalg.norm(areas, axis=1)
    best = np.full(3, np.inf)
    for k in np.argsort(-sizes, kind="stable")[:MOST_FACES]:
        normal = areas[k] / max(sizes[k], 1e-300)
        height = float(np.ptp(hull.vertices @ normal))
        sides = np.array([height, *rectangle_sides(hull.vertices @ _plane_axes(normal))])
        if sides.prod() < best.prod():
            best = sides
    return np.sort(best)[::-1]


def _plane_axes(normal: Array) -> Array:
    """Two unit vectors (3, 2) at right angles to a normal and to each other."""
    first: Array = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))]).astype(float)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first)])


def rectangle_sides(points: Array) -> Array:
    """The sides (2,) of the rectangle of least area around points (n, 2)."""
    from scipy.spatial import ConvexHull

    outline: Array = points[ConvexHull(points).vertices]
    edges = np.roll(outline, -1, axis=0) - outline
    edges = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.column_stack([-edges[:, 1], edges[:, 0]])
    along, beside = np.ptp(outline @ edges.T, axis=0), np.ptp(outline @ across.T, axis=0)
    k = int(np.argmin(along * beside))
    return np.array([along[k], beside[k]])
