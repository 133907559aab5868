"""Convex polytopes of fewer vertices that contain the given one: edges collapsed outward.

An edge becomes one vertex outside all facets that meet it. The place that adds least volume is a linear programme in
three variables (progressive hulls: Sander, Gu, Gortler, Hoppe, Snyder, Silhouette Clipping, SIGGRAPH 2000). A flat
keeps its plane, as a vertex beyond it would add volume over all of its area.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.proxies.hulls import qhull_of

MOST_PLANES = 14
"""Planes around an edge up to which it is tried: their triples grow with the third power."""
ON = 1e-9
"""What lies this far behind a plane still counts as on it [size]."""
FARTHEST = 0.02
"""Largest distance of a new vertex from the plane of a facet [size]: where few edges may go, some would shoot far."""
AT_ONCE = 0.12
"""Share of the vertices that is collapsed before the hull is made again."""
SINGULAR = 1e-6
"""Volume that three unit normals span below which they meet in no definite point."""

Planes = list[NDArray[np.int64]]
"""Indices of planes, for each vertex or edge."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Facets:
    """The facets of a hull: unit normals (m, 3), offsets (m,), areas (m,); the edges (e, 2) between them."""

    normals: Array
    offsets: Array
    areas: Array
    edges: NDArray[np.int64]
    around: dict[int, set[int]]
    """The facets at each vertex."""

    @classmethod
    def of(cls, points: Array, hull: Any) -> _Facets:
        planes, facet = np.unique(hull.equations, axis=0, return_inverse=True)
        facet = facet.ravel()
        a, b, c = (points[hull.simplices[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        around: dict[int, set[int]] = {int(v): set() for v in hull.vertices}
        for corners, k in zip(hull.simplices.tolist(), facet.tolist(), strict=True):
            for v in corners:
                around[v].add(k)
        # neighbors[:, k] is the triangle across from corner k.
        own, across = np.repeat(np.arange(len(facet)), 3), hull.neighbors.ravel()
        ends = np.stack([np.roll(hull.simplices, -1, 1).ravel(), np.roll(hull.simplices, -2, 1).ravel()], axis=1)
        real = (own < across) & (facet[own] != facet[across])
        return cls(
            normals=planes[:, :3],
            offsets=-planes[:, 3],
            areas=np.asarray(np.bincount(facet, area, minlength=len(planes)), np.float64),
            edges=ends[real].astype(np.int64),
            around=around,
        )

    def added(self, points: Array) -> Array:
        """Volume (n,) between each of points (n, 3) and the hull."""
        return np.maximum(points @ self.normals.T - self.offsets, 0) @ self.areas / 3


def none(points: Array) -> NDArray[np.bool_]:
    """Of points (n, 3) no one."""
    return np.zeros(len(points), bool)


def collapsed(points: Array, most: int, kept: Callable[[Array], NDArray[np.bool_]] = none) -> Array:
    """Corners (k, 3) of a polytope that contains points (n, 3) [size], at most ``most`` of them.

    Edges with an end (n, 3) that is ``kept`` stay. More corners are left where no edge can be collapsed."""
    while True:
        hull = qhull_of(points)
        if hull is None:
            return points
        corners = np.sort(hull.vertices)
        smaller = _once(points, hull, corners, most, kept) if len(corners) > most else None
        if smaller is None:
            return points[corners]
        points = smaller


def _once(
    points: Array, hull: Any, corners: NDArray[np.int64], most: int, kept: Callable[[Array], NDArray[np.bool_]]
) -> Array | None:
    """The corners after the cheapest collapses, no two of neighbours; None where there is none."""
    facets = _Facets.of(points, hull)
    places, costs = _places(facets)
    costs[kept(points)[facets.edges].any(1)] = np.inf
    limit = max(1, min(len(corners) - most, round(AT_ONCE * len(corners))))
    beside: dict[int, set[int]] = {int(v): {int(v)} for v in corners}
    for a, b in facets.edges.tolist():
        beside[a].add(b)
        beside[b].add(a)
    taken, gone, new = set[int](), set[int](), list[Array]()
    for k in np.argsort(costs, kind="stable"):
        if len(new) == limit or not np.isfinite(costs[k]):
            break
        a, b = facets.edges[k].tolist()
        if taken.isdisjoint((a, b)):
            taken |= beside[a] | beside[b]
            gone |= {a, b}
            new.append(places[k])
    if not new:
        return None
    return np.concatenate([points[[v for v in corners.tolist() if v not in gone]], new])


def _places(facets: _Facets) -> tuple[Array, Array]:
    """For each edge the vertex (e, 3) that would take its place, and the volume (e,) that this adds."""
    places, costs = np.zeros((len(facets.edges), 3)), np.full(len(facets.edges), np.inf)
    for edges, stars in _by_count(facets):
        found = _meeting(facets.normals[stars], facets.offsets[stars], facets.areas[stars])
        met = np.isfinite(found).all(1)
        places[edges[met]] = found[met]
        beyond = (found[met] @ facets.normals.T - facets.offsets).max(1)
        costs[edges[met]] = np.where(beyond <= FARTHEST, facets.added(found[met]), np.inf)
    return places, costs


def _by_count(facets: _Facets) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Edges (k,) with equally many facets around them, and those facets (k, count)."""
    stars = [sorted(facets.around[a] | facets.around[b]) for a, b in facets.edges.tolist()]
    counts = np.array([len(s) for s in stars])
    for count in np.unique(counts[(counts >= 3) & (counts <= MOST_PLANES)]):
        edges = np.flatnonzero(counts == count)
        yield edges, np.array([stars[k] for k in edges])


def _meeting(normals: Array, offsets: Array, areas: Array) -> Array:
    """The points (k, 3) behind none of planes (k, count) that add least volume; NaN where planes meet in no point."""
    triples = np.array(list(combinations(range(normals.shape[1]), 3)))
    (n1, n2, n3), (d1, d2, d3) = (np.moveaxis(x[:, triples], 2, 0) for x in (normals, offsets))
    n23 = np.cross(n2, n3)
    volume = np.einsum("ktc,ktc->kt", n1, n23)
    sure = np.abs(volume) > SINGULAR
    points = d1[..., None] * n23 + d2[..., None] * np.cross(n3, n1) + d3[..., None] * np.cross(n1, n2)
    points /= np.where(sure, volume, 1.0)[..., None]
    behind = (offsets[:, None] - np.einsum("ktc,kpc->ktp", points, normals)).max(2)
    cost = np.einsum("ktc,kc->kt", points, np.einsum("kp,kpc->kc", areas, normals))
    cost[~sure | (behind > ON)] = np.inf
    best = cost.argmin(1)
    rows = np.arange(len(best))
    return np.where(np.isfinite(cost[rows, best])[:, None], points[rows, best], np.nan)
