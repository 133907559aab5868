"""Convex polytopes of fewer vertices that contain the given one: edges collapsed outward.

An edge becomes one vertex outside all facets that meet it. The place that adds least volume is a linear programme in
three variables (progressive hulls: Sander, Gu, Gortler, Hoppe, Snyder, Silhouette Clipping, SIGGRAPH 2000). A flat
keeps its plane, as a vertex beyond it would add volume over all of its area.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.proxies.hulls import qhull_of
from f3sr.runtime.kernels import inline_kernel, kernel

MOST_PLANES = 14
"""Planes around an edge up to which it is tried: work grows with the fourth power."""
ON = 1e-9
"""What lies this far behind a plane still counts as on it [size]."""
AT_ONCE = 0.15
"""Share of the vertices that is collapsed before the hull is made again."""
SINGULAR = 1e-6
"""Volume that three unit normals span below which they meet in no definite point."""


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
            normals=np.ascontiguousarray(planes[:, :3]),
            offsets=-planes[:, 3],
            areas=np.asarray(np.bincount(facet, area, minlength=len(planes)), np.float64),
            edges=ends[real].astype(np.int64),
            around=around,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Bounds:
    """What collapsing keeps: all vertices within ``radius`` of points (k, 3), and ``normals . x <= offsets``.

    No new vertex is farther than ``farthest`` from the plane of a facet [size]. Where few edges may go, some would
    shoot far."""

    normals: Array
    offsets: Array
    points: Array
    radius: float
    farthest: float

    def keeps(self, points: Array) -> NDArray[np.bool_]:
        """Which of points (n, 3) stay."""
        from scipy.spatial import KDTree

        if not len(self.points):
            return np.zeros(len(points), bool)
        return KDTree(self.points).query(points)[0] <= self.radius


UNBOUNDED = Bounds(normals=np.zeros((0, 3)), offsets=np.zeros(0), points=np.zeros((0, 3)), radius=0.0, farthest=np.inf)


def collapsed(points: Array, most: int, bounds: Bounds = UNBOUNDED) -> Array:
    """Corners (k, 3) of a polytope that contains points (n, 3) [size], at most ``most`` of them.

    More are left where no edge can be collapsed."""
    while True:
        hull = qhull_of(points)
        if hull is None:
            return points
        corners = np.sort(hull.vertices)
        smaller = _once(points, hull, corners, most, bounds) if len(corners) > most else None
        if smaller is None:
            return points[corners]
        points = smaller


def _once(points: Array, hull: Any, corners: NDArray[np.int64], most: int, bounds: Bounds) -> Array | None:
    """The corners after the cheapest collapses, no two of neighbours; None where there is none."""
    facets = _Facets.of(points, hull)
    places, costs = _places(facets, bounds)
    costs[bounds.keeps(points)[facets.edges].any(1)] = np.inf
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


def _places(facets: _Facets, bounds: Bounds) -> tuple[Array, Array]:
    """For each edge the vertex (e, 3) that would take its place, and the volume (e,) that this adds."""
    stars = [sorted(facets.around[a] | facets.around[b]) for a, b in facets.edges.tolist()]
    starts = np.cumsum([0, *map(len, stars)])
    star = np.fromiter(chain.from_iterable(stars), np.int64, int(starts[-1]))
    places, costs = np.zeros((len(stars), 3)), np.full(len(stars), np.inf)
    _cheapest(
        *(facets.normals, facets.offsets, facets.areas, bounds.normals, bounds.offsets, bounds.farthest),
        *(star, starts, places, costs),
    )
    return places, costs


@kernel
def _cheapest(
    normals: Array,
    offsets: Array,
    areas: Array,
    bound_normals: Array,
    bound_offsets: Array,
    farthest: float,
    star: NDArray[np.int64],
    starts: NDArray[np.int64],
    places: Array,
    costs: Array,
) -> None:
    """Fill in, for every edge, the meeting point of three of its planes that is behind none of them and adds least.

    The planes of edge e are ``star[starts[e]:starts[e + 1]]``."""
    for e in range(len(places)):
        low, high = starts[e], starts[e + 1]
        if high - low < 3 or high - low > MOST_PLANES:
            continue
        least = np.inf
        for i in range(low, high):
            for j in range(i + 1, high):
                for k in range(j + 1, high):
                    x, y, z, is_sure = _meeting(normals, offsets, star[i], star[j], star[k])
                    if is_sure and _is_within(bound_normals, bound_offsets, x, y, z):
                        price = _price(normals, offsets, areas, star, low, high, x, y, z)
                        if price < least:
                            least = price
                            places[e, 0], places[e, 1], places[e, 2] = x, y, z
        if least < np.inf:
            costs[e] = _added(normals, offsets, areas, farthest, places[e, 0], places[e, 1], places[e, 2])


@inline_kernel
def _meeting(normals: Array, offsets: Array, i: int, j: int, k: int) -> tuple[float, float, float, bool]:
    """The point in which three planes meet, and whether that is definite."""
    ax, ay, az = normals[i, 0], normals[i, 1], normals[i, 2]
    bx, by, bz = normals[j, 0], normals[j, 1], normals[j, 2]
    cx, cy, cz = normals[k, 0], normals[k, 1], normals[k, 2]
    ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    volume = ax * ux + ay * uy + az * uz
    if abs(volume) <= SINGULAR:
        return 0.0, 0.0, 0.0, False
    d, e, f = offsets[i] / volume, offsets[j] / volume, offsets[k] / volume
    return d * ux + e * vx + f * wx, d * uy + e * vy + f * wy, d * uz + e * vz + f * wz, True


@inline_kernel
def _is_within(normals: Array, offsets: Array, x: float, y: float, z: float) -> bool:
    """Whether a point is behind all planes."""
    beyond = -np.inf
    for p in range(len(offsets)):
        beyond = max(beyond, normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z - offsets[p])
    return beyond <= 0


@inline_kernel
def _price(
    normals: Array,
    offsets: Array,
    areas: Array,
    star: NDArray[np.int64],
    low: int,
    high: int,
    x: float,
    y: float,
    z: float,
) -> float:
    """Three times the volume that a point adds over an edge's planes; infinite where it is behind one of them."""
    total = 0.0
    for r in range(low, high):
        p = star[r]
        off = normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z - offsets[p]
        if off < -ON:
            return np.inf
        total += off * areas[p]
    return total


@inline_kernel
def _added(normals: Array, offsets: Array, areas: Array, farthest: float, x: float, y: float, z: float) -> float:
    """The volume between a point and the hull; infinite where it is too far from a facet's plane."""
    total = 0.0
    for p in range(len(offsets)):
        off = normals[p, 0] * x + normals[p, 1] * y + normals[p, 2] * z - offsets[p]
        if off > farthest:
            return np.inf
        if off > 0:
            total += off * areas[p]
    return total / 3


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    directions = np.random.default_rng(0).normal(size=(24, 3))
    collapsed(directions / np.linalg.norm(directions, axis=1)[:, None], 20)
