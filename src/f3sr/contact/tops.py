"""The upper sides of convex parts over a region seen from above, exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

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
    found = [points for p in near for points in (_clipped_edges(p, region), _at_corners(p, region.corners))]
    return np.concatenate(found) if found else np.zeros((0, 3))


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


def _clipped_edges(part: ConvexPart, region: Outline) -> Array:
    """Ends (n, 3) of the edges of a part inside the region (Liang and Barsky 1984)."""
    start, end = np.concatenate([part.faces, np.roll(part.faces, -1, axis=1)]).reshape(2, -1)
    start, end = start[start < end], end[start < end]
    beyond = part.vertices[:, :2] @ region.normals.T - region.offsets
    a, b = beyond[start], beyond[end]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = a / (a - b)
    enters = np.where(a > b, crossing, np.where((a == b) & (a > 0), np.inf, -np.inf)).max(1)
    leaves = np.where(b > a, crossing, np.inf).min(1)
    first, last = np.maximum(enters, 0.0), np.minimum(leaves, 1.0)
    met = first <= last
    p, q = part.vertices[start[met]], part.vertices[end[met]]
    return np.concatenate([p + share[met, None] * (q - p) for share in (first, last)])


def _at_corners(part: ConvexPart, corners: Array) -> Array:
    """The upper side of a part over points (k, 2): points (n, 3), none where the part is not."""
    triangles = part.vertices[part.faces]
    normals = area_vectors(triangles)
    lengths = np.linalg.norm(normals, axis=1)
    real = lengths > 0
    normals, a = normals[real] / lengths[real, None], triangles[real, 0]
    # (k, m): how far each corner may rise below each face, times the face's vertical share.
    room = np.einsum("mi,mi->m", normals, a) - corners @ normals[:, :2].T
    up, down = normals[:, 2] > STEEP, normals[:, 2] < -STEEP
    top = (room[:, up] / normals[up, 2]).min(1)
    bottom = (room[:, down] / normals[down, 2]).max(1)
    is_over = (room[:, ~up & ~down] >= 0).all(1) & (top >= bottom)
    return np.column_stack([corners, top])[is_over]
