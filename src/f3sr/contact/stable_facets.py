"""Stable facets: faces of a body's hull on which it can rest, and the rotation onto the nearest one."""

from __future__ import annotations

import numpy as np

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, cross, rotation_between


def stable_normals(hull: ConvexPart, center: Array) -> Array:
    """Outward unit normals (k, 3) of the hull's triangles that the centre of mass (3,) projects into.

    A body standing on such a triangle does not tip over: its centre is above its support polygon.
    """
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normals = cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    real = lengths > 1e-12 * lengths.max()
    a, b, c, normals = a[real], b[real], c[real], normals[real] / lengths[real, None]
    inside = np.ones(len(a), bool)
    for p, q in ((a, b), (b, c), (c, a)):
        # The centre is inside the three planes through the sides, at right angles to the triangle.
        inside &= np.einsum("ij,ij->i", cross(q - p, center - p), normals) >= 0
    return normals[inside]


def resting_turn(hull: ConvexPart, center: Array, R_world: Array, *, max_tilt: float) -> Array | None:
    """The smallest world rotation (3, 3) that puts the body on a stable facet on level ground.

    ``R_world`` (3, 3) turns the hull's axes into the world. None when no stable facet lies within ``max_tilt`` [rad].
    """
    normals = stable_normals(hull, center) @ R_world.T
    if not len(normals):
        return None
    # The facet that faces down most needs the smallest turn.
    best = normals[int(np.argmin(normals[:, 2]))]
    if -best[2] < np.cos(max_tilt):
        return None
    return rotation_between(best, [0, 0, -1])
