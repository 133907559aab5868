"""Flats of convex parts: faces that are plane up to micrometres become exactly plane.

An engine finds where two parts touch from one face of each. A flat of several faces hands it one of them at a time: the
body rocks from face to face by micrometres, and friction lets it creep by centimetres (docs: proxies).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array

ROUNDING = 1e-12
"""What lies this far behind a plane is on it [size of the part]."""


def flattened(part: ConvexPart, within: float) -> ConvexPart:
    """A part whose vertices at most ``within`` (unit of the part) behind the plane of a flat lie on it.

    A flat has at least four vertices, for a triangle is plane. The part grows: a vertex moves outward onto the planes
    of all its flats, those of large faces first. It moves by no more than ``within``, else it stays off that flat. So
    none passes the plane of another flat. The part itself if all of that is so already."""
    planes = [np.zeros((0, 4)) for _ in part.vertices]
    ways = np.zeros_like(part.vertices)
    for plane, on in facets(part, within):
        for v in np.flatnonzero(on) if on.sum() > 3 else ():
            both = np.concatenate([planes[v], plane[None]])
            way = np.linalg.pinv(both[:, :3]) @ -(both[:, :3] @ part.vertices[v] + both[:, 3])
            if len(both) <= 3 and np.linalg.norm(way) <= within:
                planes[v], ways[v] = both, way
    if np.abs(ways).max() <= ROUNDING * np.ptp(part.vertices, axis=0).max():
        return part
    return ConvexPart.hull_of(part.vertices + ways)


def facets(part: ConvexPart, within: float) -> Iterator[tuple[Array, NDArray[np.bool_]]]:
    """Plane (4,), n . x + d = 0 with an outward unit normal, and the vertices (n,) at most ``within`` behind it.

    Faces of which a larger one's facet has all vertices are part of it. Those of large faces come first."""
    across = area_vectors(part.vertices[part.faces])
    areas = np.linalg.norm(across, axis=1)
    left = areas > 0
    while left.any():
        largest = int(np.where(left, areas, 0).argmax())
        normal = across[largest] / areas[largest]
        heights = part.vertices @ normal
        on = heights >= heights.max() - within
        left &= ~on[part.faces].all(1)
        left[largest] = False
        yield np.array([*normal, -heights.max()]), on
