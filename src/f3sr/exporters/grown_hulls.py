"""Convex parts grown by the contact margin, for programs that have no margin of their own.

Bodies of a package rest two margins apart: there f3sr's contacts end. Grown parts touch in the same place, so nothing
falls when another program starts.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import KDTree

from f3sr.core.mesh import ConvexPart, qhull
from f3sr.core.transforms import Array

SHARPEST = 2.0
"""How far a corner moves at most [margins]: a box's moves by 1.7, that of a blade would move by any number."""
ON_FACET = 1e-6
"""Distance from a facet at which a corner belongs to it [size of the part]."""
LEAST_EDGE = 1e-6
"""Distance [m] below which two corners are one: Drake refuses the slivers between them."""


def grown(part: ConvexPart, by: float) -> ConvexPart:
    """The part [m] whose facets lie ``by`` [m] further out, with no more corners than it has.

    Every corner moves the shortest way that moves all its facets so far. Where edges are so sharp that it would move
    further than ``SHARPEST`` times ``by``, it and its facets stay behind.
    """
    corners = _without_twins(part.vertices)
    planes = np.unique(np.round(qhull(corners).equations, 12), axis=0)
    size = float(np.linalg.norm(np.ptp(corners, axis=0)))
    touching = np.abs(corners @ planes[:, :3].T + planes[:, 3]) < ON_FACET * size
    moves = np.array([_shortest(planes[facets, :3]) for facets in touching])
    lengths = np.linalg.norm(moves, axis=1, keepdims=True)
    moves *= np.minimum(1.0, SHARPEST / np.maximum(lengths, 1.0))
    return ConvexPart.hull_of(corners + by * moves)


def _without_twins(corners: Array) -> Array:
    """Of corners (n, 3) nearer to each other than ``LEAST_EDGE``, one."""
    later = sorted({j for _, j in KDTree(corners).query_pairs(LEAST_EDGE)})
    return np.delete(corners, later, axis=0) if len(corners) - len(later) >= 4 else corners


def _shortest(normals: Array) -> Array:
    """The shortest d (3,) with ``normals @ d >= 1``, by least distance programming (Lawson and Hanson, chapter 23).

    Zero where there is none: the corner of a sheet lies on both of its sides."""
    E = np.vstack([normals.T, np.ones(len(normals))])
    f = np.array([0.0, 0, 0, 1])
    multipliers, residual = nnls(E, f)
    if residual < ON_FACET:
        return np.zeros(3)
    r = E @ multipliers - f
    return -r[:3] / r[3]
