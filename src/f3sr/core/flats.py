"""Flats of convex parts: faces that are plane up to micrometres become exactly plane.

An engine finds where two parts touch from one face of each. A flat of several faces hands it one of them at a time: the
body rocks from face to face by micrometres, and friction lets it creep by centimetres (docs: proxies).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array

ROUNDING = 1e-12
"""What lies this far behind a plane is on it [size of the part]."""
PARALLEL = 1e-6
"""Sine of an angle at which directions are one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ShortestWay:
    """The shortest ``way`` (3,) of a point onto some planes, and an orthonormal ``basis`` (k, 3) of their normals."""

    basis: Array
    way: Array

    @classmethod
    def none(cls) -> Self:
        """To stay where one is."""
        return cls(basis=np.zeros((0, 3)), way=np.zeros(3))

    def onto(self, normal: Array, ahead: float, slack: float) -> Self | None:
        """Also onto a plane with unit ``normal`` (3,), which lies ``ahead`` of the point along it.

        None where it has no point in common with the others, up to ``slack`` (same unit). Of the normal only what is
        new moves the point further (Gram-Schmidt), so its way remains the shortest."""
        new = normal
        for _ in range(2 if len(self.basis) else 0):  # twice is enough against rounding
            new = new - (self.basis @ new) @ self.basis
        size, lacking = math.sqrt(new @ new), ahead - float(normal @ self.way)
        if size > PARALLEL:
            basis = np.concatenate([self.basis, (new / size)[None]])
            return type(self)(basis=basis, way=self.way + lacking / size**2 * new)
        return self if abs(lacking) <= slack else None


def flattened(part: ConvexPart, within: float) -> ConvexPart:
    """A part whose vertices at most ``within`` (unit of the part) behind the plane of a flat lie on it.

    A flat has at least four vertices, for a triangle is plane. The part grows: a vertex moves outward onto the planes
    of all its flats, those of large faces first. It moves by no more than ``within``, else it stays off that flat. So
    none passes the plane of another flat. The part itself if all of that is so already, and
    where it is no thicker than that."""
    met, rounding = [ShortestWay.none() for _ in part.vertices], ROUNDING * np.ptp(part.vertices, axis=0).max()
    for plane, on in facets(part, within):
        for v in np.flatnonzero(on) if on.sum() > 3 else ():
            if len(met[v].basis) < 3:
                more = met[v].onto(plane[:3], -float(plane[:3] @ part.vertices[v] + plane[3]), rounding)
                if more is not None and more.way @ more.way <= within**2:
                    met[v] = more
    ways = np.array([each.way for each in met])
    if np.abs(ways).max() <= rounding:
        return part
    try:
        return ConvexPart.hull_of(part.vertices + ways)
    except ValueError:  # all on one plane
        return part


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
