"""What is known of a mesh's parts and of hulls of several, wherever other bodies are.

Attempts at fewer parts differ in their limits and in the bodies around. The parts that they begin with are the same.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, bounds_of
from f3sr.proxies.collapse import Bounds, collapsed
from f3sr.proxies.hulls import planes
from f3sr.proxies.pair_volumes import PairVolumes

if TYPE_CHECKING:
    from scipy.spatial import KDTree

SAMPLES = 20_000
"""Points on a mesh from which distances are measured."""


class KnownParts:
    """Hulls, planes, boxes and volumes of the parts of one mesh (asset frame). Each is made once."""

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self.size = mesh.diagonal
        self.volumes = PairVolumes()
        self._hulls: dict[tuple[ConvexPart, ...], ConvexPart | None] = {}
        self._planes: dict[ConvexPart, tuple[Array, Array]] = {}
        self._boxes: dict[ConvexPart, Array] = {}
        self._few: dict[tuple[object, ...], ConvexPart] = {}

    @cached_property
    def surface(self) -> KDTree:
        """Points on the mesh."""
        from scipy.spatial import KDTree

        mesh = self._mesh
        points = np.concatenate([mesh.vertices, sample_surface(mesh.vertices, mesh.faces, SAMPLES)])
        return KDTree(points, balanced_tree=False, compact_nodes=False)  # faster for few queries

    def hull(self, parts: tuple[ConvexPart, ...]) -> ConvexPart | None:
        """One hull of some parts; None where they span hardly a volume."""
        if parts not in self._hulls:
            self._hulls[parts] = hull_of(np.concatenate([part.vertices for part in parts]))
        return self._hulls[parts]

    def planes(self, part: ConvexPart) -> tuple[Array, Array]:
        """Outward unit normals (m, 3) and offsets (m,) of a part's triangles."""
        if part not in self._planes:
            self._planes[part] = planes(part)
        return self._planes[part]

    def box(self, part: ConvexPart) -> Array:
        """(2, 3) lowest and highest corner of a part."""
        if part not in self._boxes:
            self._boxes[part] = bounds_of(part.vertices)
        return self._boxes[part]

    def few(self, part: ConvexPart, most: int, near: Bounds) -> ConvexPart:
        """A hull of at most ``most`` vertices, where edges can be collapsed, that holds a part; bounds [size]."""
        arrays = (part.vertices, near.normals, near.offsets, near.points)
        key = (most, near.radius, near.farthest, *(array.tobytes() for array in arrays))
        if key not in self._few:
            self._few[key] = ConvexPart.hull_of(collapsed(part.vertices / self.size, most, near) * self.size)
        return self._few[key]


def hull_of(points: Array) -> ConvexPart | None:
    """The hull of points (n, 3); None where they span hardly a volume."""
    try:
        return ConvexPart.hull_of(points)
    except ValueError:
        return None
