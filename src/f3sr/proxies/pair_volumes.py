"""Pairs of convex parts by the volume that one hull for both has more than they, the least first.

A hull costs much more than a bound of its volume, so most hulls are never made.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable

import numpy as np

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array
from f3sr.proxies.hulls import qhull_of

Pair = tuple[ConvexPart, ConvexPart]


class PairVolumes:
    """What hulls of two parts add."""

    def __init__(self) -> None:
        self._faces: dict[ConvexPart, Array] = {}
        self._added: dict[Pair, float] = {}

    def added(self, a: ConvexPart, b: ConvexPart) -> float:
        """The volume that one hull for both has more than they; infinite where they span none. Made once."""
        if (a, b) not in self._added:
            hull = qhull_of(np.concatenate([a.vertices, b.vertices]))
            self._added[a, b] = np.inf if hull is None else float(hull.volume) - a.volume - b.volume
        return self._added[a, b]

    def least(self, a: ConvexPart, b: ConvexPart) -> float:
        """A lower bound of ``added``: one hull holds all of one part and the vertex of the other that adds most."""
        return max(self._pyramids(a, b) - b.volume, self._pyramids(b, a) - a.volume)

    def _pyramids(self, part: ConvexPart, other: ConvexPart) -> float:
        """The most that one vertex of another part adds: a pyramid over each face that it sees."""
        if part not in self._faces:
            self._faces[part] = _faces(part)
        faces = self._faces[part]
        return float(np.maximum(other.vertices @ faces[:, :3].T - faces[:, 3], 0).sum(1).max())


class PairQueue:
    """Pairs of parts in the order of the volume that they add, up to ``most``; of equals the first one pushed."""

    def __init__(self, volumes: PairVolumes, most: float) -> None:
        self._volumes, self._most = volumes, most
        self._heap: list[tuple[float, int, bool, Pair]] = []
        self._pushed = 0

    def push(self, pairs: Iterable[Pair]) -> None:
        for pair in pairs:
            self._pushed += 1
            self._put(self._volumes.least(*pair), self._pushed, False, pair)

    def pop(self, among: Iterable[ConvexPart] | None = None) -> tuple[float, Pair] | None:
        """The least volume that a pair adds, and that pair; None at the end. Pairs not ``among`` parts are dropped."""
        parts = None if among is None else set(among)
        while self._heap:
            volume, number, is_exact, pair = heapq.heappop(self._heap)
            if parts is not None and not parts.issuperset(pair):
                continue
            if is_exact:
                return volume, pair
            self._put(self._volumes.added(*pair), number, True, pair)
        return None

    def _put(self, volume: float, number: int, is_exact: bool, pair: Pair) -> None:
        if volume <= self._most:
            heapq.heappush(self._heap, (volume, number, is_exact, pair))


def _faces(part: ConvexPart) -> Array:
    """A part's triangles as planes (m, 4), ``n . x - d``, with normals as long as a third of their area."""
    triangles = part.vertices[part.faces]
    normals = area_vectors(triangles) / 6
    return np.c_[normals, np.einsum("ij,ij->i", normals, triangles[:, 0])]
