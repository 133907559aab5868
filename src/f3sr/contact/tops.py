"""The upper sides of convex parts over a region seen from above, exactly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.undersides import Outline, SupportPlane
from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array, bounds_of, boxes_of, cross

STEEP = 1e-9
"""Vertical share of a unit normal below which a face has no height over a point."""


def highest_points(parts: Sequence[ConvexPart], region: Outline) -> Array:
    """Points (n, 3) that span the upper hull of convex parts over a region, among others that are not above it.

    They are the ends of the parts' edges, clipped to the region, and the parts' upper sides at its corners."""
    low, high = bounds_of(region.corners)
    boxes = boxes_of([p.vertices[:, :2] for p in parts]) if parts else np.empty((0, 2, 2))
    is_near = ((boxes[:, 0] <= high) & (boxes[:, 1] >= low)).all(1)
    near = [parts[k] for k in np.flatnonzero(is_near).tolist()]
    if not near:
        return np.zeros((0, 3))
    joined = _Joined.of(near)
    return np.concatenate([_clipped_edges(joined, region), _at_corners(joined, region.corners)])


class _Joined(NamedTuple):
    """Convex parts, one after the other."""

    vertices: Array
    faces: NDArray[np.int64]
    begins: NDArray[np.int64]
    """(k,): the first face of every part."""

    @classmethod
    def of(cls, parts: Sequence[ConvexPart]) -> Self:
        first = np.cumsum([0, *(len(p.vertices) for p in parts)])
        return cls(
            vertices=np.concatenate([p.vertices for p in parts]),
            faces=np.concatenate([p.faces + k for p, k in zip(parts, first[:-1], strict=True)]),
            begins=np.cumsum([0, *(len(p.faces) for p in parts[:-1])]),
        )


def facet_above(points: Array, center: Array, max_turn: float) -> SupportPlane | None:
    """The upper facet of the hull of points (n, 3) that a vertical line through ``center`` meets.

    None if there is none, or it is turned by more than ``max_turn`` [rad]."""
    if len(points) < 3:
        return None
    # A point far below gives points of one plane a hull.
    apex = points.mean(0) - np.array([0.0, 0.0, np.ptp(points, axis=0).max()])
    try:
        hull = ConvexPart.hull_of(np.concatenate([points, apex[None]]))
    except ValueError:
        return None
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normals = cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    met = normals[:, 2] > np.cos(max_turn)
    # Inside the triangle seen from above: to the left of its three edges, which run counter-clockwise.
    for p, q in ((a, b), (b, c), (c, a)):
        met &= (q - p)[:, 0] * (center[1] - p[:, 1]) - (q - p)[:, 1] * (center[0] - p[:, 0]) >= 0
    if not met.any():
        return None
    k = int(np.argmax(met))
    return SupportPlane(normal=normals[k], offset=float(normals[k] @ a[k]))


def _clipped_edges(parts: _Joined, region: Outline) -> Array:
    """Ends (n, 3) of the edges of parts inside the region (Liang and Barsky 1984)."""
    start, end = np.concatenate([parts.faces, np.roll(parts.faces, -1, axis=1)]).reshape(2, -1)
    start, end = start[start < end], end[start < end]
    beyond = parts.vertices[:, :2] @ region.normals.T - region.offsets
    a, b = beyond[start], beyond[end]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = a / (a - b)
    enters = np.where(a > b, crossing, np.where((a == b) & (a > 0), np.inf, -np.inf)).max(1)
    leaves = np.where(b > a, crossing, np.inf).min(1)
    first, last = np.maximum(enters, 0.0), np.minimum(leaves, 1.0)
    met = first <= last
    p, q = parts.vertices[start[met]], parts.vertices[end[met]]
    return np.concatenate([p + share[met, None] * (q - p) for share in (first, last)])


def _at_corners(parts: _Joined, corners: Array) -> Array:
    """The upper sides of parts over points (k, 2): points (n, 3), none where a part is not."""
    triangles = parts.vertices[parts.faces]
    normals = area_vectors(triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    # (k, m): how far each corner may rise below each face, times the face's vertical share.
    room = np.einsum("mi,mi->m", normals, triangles[:, 0]) - corners @ normals[:, :2].T
    up, down = normals[:, 2] > STEEP, normals[:, 2] < -STEEP
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = room / normals[:, 2]
    # Of every part (k, parts): the least of its upper faces, the most of its lower ones, and whether it is beside none.
    top = np.minimum.reduceat(np.where(up, rise, np.inf), parts.begins, axis=1)
    bottom = np.maximum.reduceat(np.where(down, rise, -np.inf), parts.begins, axis=1)
    beside = np.minimum.reduceat(np.where(up | down, 0.0, room), parts.begins, axis=1)
    corner, part = np.nonzero((beside >= 0) & (top >= bottom))
    return np.column_stack([corners[corner], top[corner, part]])
