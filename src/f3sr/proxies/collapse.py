"""Convex polytopes of few vertices that contain a given one: edges collapsed outward, then, of round ones, all vertices
moved inward.

A vertex takes the place of an edge, or of itself, so that none of its facets cuts the body. The place of least volume
is a linear programme in three variables (progressive hulls: Sander, Gu, Gortler, Hoppe, Snyder, Silhouette Clipping,
SIGGRAPH 2000). Its planes touch the body, as those of the facets so far may stand off. A flat keeps its plane, as a
vertex beyond it would add volume over all of its area. A round body has a better start than itself: as many vertices
as there may be, spread evenly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import area_vectors
from f3sr.core.transforms import Array, frozen
from f3sr.proxies.hulls import qhull_of, spread
from f3sr.runtime.kernels import inline_kernel, kernel

Indices = NDArray[np.int64]

MOST_PLANES = 14, 32
"""Planes around an edge, and around a vertex, up to which it is tried: work grows with the fourth power."""
ON = 1e-11
"""What lies this far behind a plane still counts as on it [size]."""
OUT = 1e-9
"""Distance of the body outside a polytope that is rounding [size]."""
LOWER = 1e-6
"""How far new vertices stay behind a plane on a vertex that is kept [size]."""
SINGULAR = 1e-6
"""Volume that three unit normals span below which they meet in no definite point."""
AT_ONCE = 0.15
"""Share of the vertices that is collapsed before the hull is made again."""
CHEAP = 0.1
"""Share of the edges, the cheapest, of which these are: where an edge is collapsed its neighbours have to wait."""
CLOSE = 4
"""Vertices as a multiple of those allowed from which on planes touch the body: before, facets stand off by little."""
PER_VERTEX = 12
"""Planes of a body for every vertex allowed, above which only the largest of those turned alike make its start."""
FACETS = 2000
"""Facets up to which distances are measured from all, otherwise from the largest of those turned alike."""
ROUND = 3
"""Loss of vertices spread evenly, as a multiple of that with edges collapsed, from which on a body is not round."""
STEPS = (0.5,) * 10 + (1.0,) * 10
"""Steps of a round body's vertices to their best places. Half of the way leaves to the neighbours some of the room that
a facet has."""
LEAST_GAIN = 1e-5
"""Gain of a vertex below which it stays [its share of the volume]."""
EVENING, STRIDE = 60, 0.3
"""How often vertices that are spread repel each other, and by how much at first [their distance]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Bounds:
    """What new vertices keep: all vertices within ``radius`` of points (k, 3), and ``normals . x <= offsets``.

    No new vertex is farther than ``farthest`` from the plane of a facet of the body [size]. Where few edges may go,
    some would shoot far."""

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
    hull = qhull_of(points)
    if hull is None:
        return points
    body = _Body(points, hull, most, bounds)
    if len(body.corners) <= most:
        return body.corners
    first, even = body.starts()
    few = _fewer(first, body)
    found = [(few, *body.judged(few))]
    if even is not None and body.judged(even)[0] < ROUND * found[0][1]:
        found += [(c, *body.judged(c)) for c in (_drawn_in(few, body), _drawn_in(_fewer(even, body), body))]
    allowed = [(max(most, len(corners)), loss, k) for k, (corners, loss, is_allowed) in enumerate(found) if is_allowed]
    return found[min(allowed)[2]][0] if allowed else body.corners


class _Body:
    """What a polytope has to contain, and how."""

    def __init__(self, points: Array, hull: Any, most: int, bounds: Bounds) -> None:
        self.most, self.farthest = most, bounds.farthest
        self.corners = np.ascontiguousarray(points[np.sort(hull.vertices)])
        is_kept = np.zeros(len(points), bool)
        is_kept[hull.vertices] = bounds.keeps(points[hull.vertices])
        self.kept = points[is_kept]
        self.volume = float(hull.volume)
        self._triangles = points[hull.simplices]
        self._planes = hull.equations
        self._facets = np.unique(hull.equations if len(hull.equations) <= FACETS else self._largest(FACETS), axis=0)
        around = np.unique(hull.equations[is_kept[hull.simplices].any(1)], axis=0)
        offsets = np.maximum(bounds.offsets - OUT, (self.corners @ bounds.normals.T).max(0, initial=-np.inf))
        self._cuts = np.concatenate([np.c_[bounds.normals, -offsets], around])
        normals = _normals(hull, self._areas)[is_kept]
        lower = np.c_[normals, LOWER - (normals * self.kept).sum(1)]
        self.bounds = np.concatenate([np.c_[bounds.normals, -offsets], lower])
        """Planes (b, 4) that new vertices stay behind: n . x + d <= 0. One on each vertex kept leaves it a corner."""

    def starts(self) -> tuple[Array, Array | None]:
        """Corners (k, 3) of polytopes to begin with: one hardly larger than the body, and one if it were round.

        That has vertices spread evenly around the body, and is cut off at the bounds."""
        count = PER_VERTEX * self.most
        first = self.corners if len(self.corners) <= count else self._behind(self._largest(count))
        hull = qhull_of(self._spread(max(4, self.most - len(self.kept))))
        if hull is None:
            return first, None
        normals, reach = hull.equations[:, :3], -hull.equations[:, 3]
        touched = ((self.corners - self._center) @ normals.T).max(0)
        return first, self._behind(np.c_[normals, -(touched / reach).max() * reach - normals @ self._center])

    def _largest(self, count: int) -> Array:
        """The planes of the largest facets of those turned alike, about ``count``."""
        largest = self._planes[np.argsort(-self._areas, kind="stable")]
        cells = np.round(largest[:, :3] / np.sqrt(4 * np.pi / count))
        return largest[np.sort(np.unique(cells, axis=0, return_index=True)[1])]

    def _spread(self, count: int) -> Array:
        """Points (count, 3) on the body, from its centre, evenly where it is an ellipsoid."""
        arms = self._triangles.mean(1) - self._center
        values, axes = np.linalg.eigh(arms.T @ (arms * self._areas[:, None]))
        rays = _evenly(count) @ (axes * np.sqrt(np.maximum(values, 0) / self._areas.sum())).T
        heights = -self._heights(self._planes, self._center[None])[0]
        return rays / (self._planes[:, :3] @ rays.T / heights[:, None]).max(0)[:, None]

    def judged(self, corners: Array) -> tuple[float, bool]:
        """The squared stand-off of a polytope's surface [size^4]; whether it holds the body and is nowhere too far."""
        hull, heights = qhull_of(corners), self.height(corners)
        loss = _areas(corners[hull.simplices]) @ (heights**2)[hull.simplices].mean(1)
        is_out = self._heights(hull.equations, self.corners).max() > OUT
        return float(loss), not is_out and float(heights.max()) <= self.farthest

    def height(self, points: Array) -> Array:
        """Distance (n,) of points from the farthest of the facets' planes, at least 0."""
        return np.maximum(self._heights(self._facets, points).max(1), 0)

    def _behind(self, planes: Array) -> Array:
        """Corners (k, 3) of what is behind planes (m, 4) and the bounds; the body's where that is too thin."""
        from scipy.spatial import HalfspaceIntersection, QhullError

        planes = np.concatenate([planes, self._cuts])
        planes = planes[self._heights(planes, self._center[None])[0] < 0]
        try:
            corners = HalfspaceIntersection(planes, self._center).intersections
        except QhullError:
            return self.corners
        for shift in (0, 0.5):  # many planes meet in one corner
            corners = corners[np.unique(np.floor(corners / OUT + shift), axis=0, return_index=True)[1]]
        if len(self.kept):
            near = np.abs(corners[:, None] - self.kept).max(2).min(1) < OUT
            corners = np.concatenate([self.kept, corners[~near]])
        return self.corners if qhull_of(corners) is None else corners

    @cached_property
    def _areas(self) -> Array:
        return _areas(self._triangles)

    @cached_property
    def _center(self) -> Array:
        return self._areas @ self._triangles.mean(1) / self._areas.sum()

    @staticmethod
    def _heights(planes: Array, points: Array) -> Array:
        return points @ planes[:, :3].T + planes[:, 3]


def _normals(hull: Any, areas: Array) -> Array:
    """Normals (n, 3) of a hull's points, as means of those of their triangles; 0 of points inside."""
    normals = np.zeros((len(hull.points), 3))
    for k in range(3):
        np.add.at(normals, hull.simplices[:, k], hull.equations[:, :3] * areas[:, None])
    return normals / np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]


def _areas(triangles: Array) -> Array:
    return np.sqrt((area_vectors(triangles) ** 2).sum(1)) / 2


@cache
def _evenly(count: int) -> Array:
    """Directions (count, 3) all around: points on a sphere that repel each other."""
    x = spread(count)
    for k in range(EVENING):
        apart = x[:, None] - x
        squares = (apart**2).sum(2)
        np.fill_diagonal(squares, np.inf)
        push = (apart / squares[:, :, None]).sum(1)
        push -= (push * x).sum(1)[:, None] * x
        x = x + STRIDE * (1 - k / EVENING) * np.sqrt(4 * np.pi / count) * push / np.linalg.norm(push, axis=1).max()
        x /= np.linalg.norm(x, axis=1)[:, None]
    return frozen(x)


def _fewer(points: Array, body: _Body) -> Array:
    """The corners (k, 3) after edges of the hull of points (n, 3) were collapsed to as few as wanted."""
    while True:
        surface = _Triangulated(points, body)
        surplus = len(surface.corners) - body.most
        if surplus <= 0:
            return points[surface.corners]
        is_close = len(surface.corners) <= CLOSE * body.most
        places, costs = surface.places(surface.edges, is_close)
        costs = surface.cheap(surface.edges, places, costs)
        if not np.isfinite(costs).any():
            return points[surface.corners]
        count = max(1, min(surplus, round(AT_ONCE * len(surface.corners))))
        points = surface.moved(surface.edges, places, costs, count)


def _drawn_in(points: Array, body: _Body) -> Array:
    """The corners (k, 3) after every vertex went some of the way to its best place, several times."""
    for step in STEPS:
        surface = _Triangulated(points, body)
        each = surface.corners[:, None]
        corners = points[surface.corners]
        places, costs = surface.places(each, True)
        costs = surface.whole(each, places, costs)
        places = corners + step * (places - corners)
        gains = costs < -LEAST_GAIN * body.volume / len(each)
        farthest = min(body.farthest, float(body.height(corners).max()))
        gains[gains] = body.height(places[gains]) <= farthest
        costs[~gains] = np.inf
        points = surface.moved(each, places, costs, len(each))
        if not np.isfinite(costs).any():
            break
    return points[_Triangulated(points, body).corners]


class _Triangulated:
    """The hull of points as triangles (f, 3), counterclockwise from outside."""

    def __init__(self, points: Array, body: _Body) -> None:
        hull = qhull_of(points)
        self._points, self._body = points, body
        self.corners: Indices = np.sort(hull.vertices).astype(np.int64)
        across = area_vectors(points[hull.simplices])
        is_turned = (across * hull.equations[:, :3]).sum(1) < 0
        self._triangles = np.where(is_turned[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
        self._planes = np.ascontiguousarray(hull.equations)
        self._areas = np.sqrt((across**2).sum(1)) / 2
        corners = self._triangles.ravel()
        # The triangles around vertex v are ``around[starts[v]:starts[v + 1]]``.
        self._around: Indices = np.argsort(corners, kind="stable") // 3
        self._starts: Indices = np.cumsum([0, *np.bincount(corners, minlength=len(points))])

    @cached_property
    def edges(self) -> Indices:
        """The edges (e, 2)."""
        ends = np.concatenate([self._triangles[:, [0, 1]], self._triangles[:, [1, 2]], self._triangles[:, [2, 0]]])
        return np.ascontiguousarray(ends[ends[:, 0] < ends[:, 1]])

    def places(self, items: Indices, is_close: bool) -> tuple[Array, Array]:
        """For every edge, or vertex, of items (e, 1 or 2) the vertex (e, 3) to take its place, and the volume added."""
        body = self._body.corners if is_close else self._body.corners[:0]
        touching = np.empty((len(self._triangles), 3, 4))
        _touching(self._points, self._triangles, self._planes, body, touching)
        places, costs = np.zeros((len(items), 3)), np.full(len(items), np.inf)
        _cheapest(
            *(self._points, self._triangles, touching, self._body.bounds),
            *(MOST_PLANES[items.shape[1] - 1], items, self._around, self._starts, places, costs),
        )
        if len(self._body.kept):
            costs[self._is_kept[items].any(1)] = np.inf
        return places, costs

    def whole(self, items: Indices, places: Array, costs: Array) -> Array:
        """The costs (e,) with what places add beyond facets elsewhere."""
        full, order = np.full(len(costs), np.inf), np.flatnonzero(np.isfinite(costs))
        _with_beyond(order, len(order), items, self._triangles, self._planes, self._areas, places, costs, full)
        return full

    def cheap(self, edges: Indices, places: Array, costs: Array) -> Array:
        """The costs (e,) of the cheapest edges, of all where none of these may go; infinite for others.

        What a place adds beyond facets elsewhere is only looked for where an edge may be one of the cheapest."""
        order = np.argsort(costs, kind="stable")[: int(np.isfinite(costs).sum())]
        for share in (CHEAP, 1.0):
            full, most = np.full(len(costs), np.inf), int(np.ceil(share * len(order)))
            _with_beyond(order, most, edges, self._triangles, self._planes, self._areas, places, costs, full)
            cheapest = np.argsort(full, kind="stable")[:most]
            may = cheapest[self._body.height(places[cheapest]) <= self._body.farthest]
            if len(may):
                break
        found = np.full(len(costs), np.inf)
        found[may] = full[may]
        return found

    def moved(self, items: Indices, places: Array, costs: Array, count: int) -> Array:
        """The corners after the cheapest items, no two of neighbours, gave way to their places."""
        order = np.argsort(costs, kind="stable")[: int(np.isfinite(costs).sum())]
        taken, chosen = np.zeros(len(self._points), np.bool_), np.empty(count, np.int64)
        found = chosen[: _chosen(order, items, self._triangles, self._around, self._starts, taken, chosen)]
        is_left = np.ones(len(self._points), np.bool_)
        is_left[items[found]] = False
        return np.concatenate([self._points[self.corners[is_left[self.corners]]], places[found]])

    @property
    def _is_kept(self) -> NDArray[np.bool_]:
        return (self._points[:, None] == self._body.kept).all(2).any(1)


@kernel
def _chosen(
    order: Indices,
    items: Indices,
    triangles: Indices,
    around: Indices,
    starts: Indices,
    taken: NDArray[np.bool_],
    chosen: Indices,
) -> int:
    """Fill ``chosen`` with the first items of an order, no two of neighbours; returns how many.

    ``taken`` (n,) is False for every vertex."""
    count = 0
    for e in order:
        if count == len(chosen):
            break
        if not (taken[items[e, 0]] or taken[items[e, -1]]):
            chosen[count] = e
            count += 1
            for v in items[e]:
                for r in range(starts[v], starts[v + 1]):
                    for k in range(3):
                        taken[triangles[around[r], k]] = True
    return count


@kernel
def _touching(points: Array, triangles: Indices, planes: Array, body: Array, touching: Array) -> None:
    """Fill in planes (f, 3, 4) that touch the body: each of a triangle's, turned around the edge across from a corner.

    Without a body they are the triangle's own."""
    for f in range(len(triangles)):
        nx, ny, nz = planes[f, 0], planes[f, 1], planes[f, 2]
        for k in range(3):
            a, b = triangles[f, (k + 1) % 3], triangles[f, (k + 2) % 3]
            ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
            ex, ey, ez = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
            length = np.sqrt(ex * ex + ey * ey + ez * ez)
            ux, uy, uz = (ny * ez - nz * ey) / length, (nz * ex - nx * ez) / length, (nx * ey - ny * ex) / length
            along, down = _first_met(body, ax, ay, az, nx, ny, nz, ux, uy, uz)
            mx, my, mz = along * nx + down * ux, along * ny + down * uy, along * nz + down * uz
            touching[f, k, 0], touching[f, k, 1], touching[f, k, 2] = mx, my, mz
            touching[f, k, 3] = -(mx * ax + my * ay + mz * az)


@inline_kernel
def _first_met(
    body: Array,
    ax: float,
    ay: float,
    az: float,
    nx: float,
    ny: float,
    nz: float,
    ux: float,
    uy: float,
    uz: float,
) -> tuple[float, float]:
    """Cosine and sine of the angle by which a half plane from a line along u, turned towards -n, meets the body."""
    along, down = (-1.0, 0.0) if len(body) else (1.0, 0.0)
    for p in range(len(body)):
        px, py, pz = body[p, 0] - ax, body[p, 1] - ay, body[p, 2] - az
        t = max(0.0, -(nx * px + ny * py + nz * pz))
        s = ux * px + uy * py + uz * pz
        is_first = t * along < down * s or (down == 0.0 and along < 0 and (t > 0 or s > 0))
        if is_first and t * t + s * s > OUT * OUT:
            along, down = s, t
    length = np.sqrt(along * along + down * down)
    return along / length, down / length


@kernel
def _cheapest(
    points: Array,
    triangles: Indices,
    touching: Array,
    bounds: Array,
    most: int,
    items: Indices,
    around: Indices,
    starts: Indices,
    places: Array,
    costs: Array,
) -> None:
    """Fill in, for every item, the place of least volume so that no facet around it cuts the body or a bound.

    The triangles around vertex v are ``around[starts[v]:starts[v + 1]]``."""
    met = np.empty((most + TIMES, 4))
    for e in range(len(items)):
        i, j = items[e, 0], items[e, -1]
        count, volume = 0, 0.0
        gx = gy = gz = 0.0
        start, next_start = int(starts[i]), int(starts[j])
        first, others = int(starts[i + 1]) - start, 0 if i == j else int(starts[j + 1]) - next_start
        for r in range(first + others):
            f = int(around[start + r if r < first else next_start + r - first])
            if r >= first and (triangles[f, 0] == i or triangles[f, 1] == i or triangles[f, 2] == i):
                continue
            volume += _six_volumes(points, triangles[f, 0], triangles[f, 1], triangles[f, 2])
            k = _only(triangles, f, i, j)
            if k >= 0:
                a, b = triangles[f, (k + 1) % 3], triangles[f, (k + 2) % 3]
                gx += points[a, 1] * points[b, 2] - points[a, 2] * points[b, 1]
                gy += points[a, 2] * points[b, 0] - points[a, 0] * points[b, 2]
                gz += points[a, 0] * points[b, 1] - points[a, 1] * points[b, 0]
                if count <= most and not _has(met, count, touching, f, k):
                    if count < most:
                        met[count] = touching[f, k]
                    count += 1
        if count < 3 or count > most:
            continue
        for _ in range(TIMES):
            x, y, z, least = _lowest(met, count, gx, gy, gz)
            worst = _worst(bounds, x, y, z) if least < np.inf else -1
            if worst < 0:
                if least < np.inf:
                    places[e, 0], places[e, 1], places[e, 2] = x, y, z
                    costs[e] = (least - volume) / 6
                break
            met[count] = -bounds[worst]
            count += 1


TIMES = 4
"""How often a place may cross a bound before it is given up; each time that bound becomes one of its planes."""


@kernel
def _with_beyond(
    order: Indices,
    most: int,
    items: Indices,
    triangles: Indices,
    planes: Array,
    areas: Array,
    places: Array,
    costs: Array,
    full: Array,
) -> None:
    """Fill in the full costs of items in an order of ascending costs, until ``most`` of them are full already."""
    count = 0
    for e in order:
        if count == most:
            break
        beyond = _beyond(planes, areas, triangles, items[e, 0], items[e, -1], places[e, 0], places[e, 1], places[e, 2])
        full[e] = costs[e] + beyond
        if beyond <= ON:
            count += 1


@inline_kernel
def _six_volumes(points: Array, a: int, b: int, c: int) -> float:
    """Six times the volume between a triangle and the origin."""
    px, py, pz = points[a, 0], points[a, 1], points[a, 2]
    qx, qy, qz = points[b, 0], points[b, 1], points[b, 2]
    x, y, z = points[c, 0], points[c, 1], points[c, 2]
    return px * (qy * z - qz * y) + py * (qz * x - qx * z) + pz * (qx * y - qy * x)


@inline_kernel
def _only(triangles: Indices, f: int, i: int, j: int) -> int:
    """Which corner of a triangle is i or j; -1 where two are, or none."""
    found, count = -1, 0
    for k in range(3):
        if triangles[f, k] == i or triangles[f, k] == j:
            found = k
            count += 1
    return found if count == 1 else -1


@inline_kernel
def _has(planes: Array, count: int, touching: Array, f: int, k: int) -> bool:
    """Whether a plane is among the first ``count``: a flat has many triangles."""
    for r in range(count):
        if (
            abs(planes[r, 0] - touching[f, k, 0]) + abs(planes[r, 1] - touching[f, k, 1]) < OUT
            and abs(planes[r, 2] - touching[f, k, 2]) + abs(planes[r, 3] - touching[f, k, 3]) < OUT
        ):
            return True
    return False


@inline_kernel
def _lowest(planes: Array, count: int, gx: float, gy: float, gz: float) -> tuple[float, float, float, float]:
    """The lowest point along g in which three planes meet and that is behind none, and its height or infinity.

    It is an end of what the other planes leave of the line in which two meet."""
    x = y = z = 0.0
    least = np.inf
    for i in range(count):
        for j in range(i + 1, count):
            ax, ay, az = planes[i, 0], planes[i, 1], planes[i, 2]
            bx, by, bz = planes[j, 0], planes[j, 1], planes[j, 2]
            wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            square = wx * wx + wy * wy + wz * wz
            if square <= SINGULAR * SINGULAR:
                continue
            d, e = -planes[i, 3] / square, -planes[j, 3] / square
            px = d * (by * wz - bz * wy) + e * (wy * az - wz * ay)
            py = d * (bz * wx - bx * wz) + e * (wz * ax - wx * az)
            pz = d * (bx * wy - by * wx) + e * (wx * ay - wy * ax)
            first, last = _ends(planes, count, px, py, pz, wx, wy, wz)
            for t in (first, last):
                qx, qy, qz = px + t * wx, py + t * wy, pz + t * wz
                height = gx * qx + gy * qy + gz * qz
                if abs(t) < np.inf and height < least and _is_outside(planes, count, qx, qy, qz):
                    x, y, z, least = qx, qy, qz, height
    return x, y, z, least


@inline_kernel
def _ends(
    planes: Array, count: int, px: float, py: float, pz: float, wx: float, wy: float, wz: float
) -> tuple[float, float]:
    """First and last t for which p + t w is behind none of the first ``count`` planes; infinite where there is none.

    Planes that are nearly parallel to w have no part in it."""
    first, last, until, since = -np.inf, np.inf, np.inf, -np.inf
    for r in range(count):
        along = planes[r, 0] * wx + planes[r, 1] * wy + planes[r, 2] * wz
        height = planes[r, 0] * px + planes[r, 1] * py + planes[r, 2] * pz + planes[r, 3]
        if along > SINGULAR:
            first, since = max(first, -height / along), max(since, (-height - ON) / along)
        elif along < -SINGULAR:
            last, until = min(last, -height / along), min(until, (-height - ON) / along)
        if since > until:
            return np.inf, np.inf
    return first, last


@inline_kernel
def _is_outside(planes: Array, count: int, x: float, y: float, z: float) -> bool:
    """Whether a point is behind none of the first ``count`` planes."""
    r = 0
    while r < count and planes[r, 0] * x + planes[r, 1] * y + planes[r, 2] * z + planes[r, 3] >= -ON:
        r += 1
    return r == count


@inline_kernel
def _worst(planes: Array, x: float, y: float, z: float) -> int:
    """The plane that a point is farthest beyond; -1 where it is behind all."""
    worst, most = -1, ON
    for r in range(len(planes)):
        off = planes[r, 0] * x + planes[r, 1] * y + planes[r, 2] * z + planes[r, 3]
        if off > most:
            worst, most = r, off
    return worst


@inline_kernel
def _beyond(planes: Array, areas: Array, triangles: Indices, i: int, j: int, x: float, y: float, z: float) -> float:
    """The volume that a point adds beyond the triangles that have neither i nor j as a corner."""
    total = 0.0
    for p in range(len(areas)):
        off = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2] * z + planes[p, 3]
        if off > 0:
            a, b, c = triangles[p, 0], triangles[p, 1], triangles[p, 2]
            if a != i and a != j and b != i and b != j and c != i and c != j:
                total += off * areas[p]
    return total / 3


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    directions = np.random.default_rng(0).normal(size=(24, 3))
    collapsed(directions / np.linalg.norm(directions, axis=1)[:, None], 20)
