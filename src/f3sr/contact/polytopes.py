"""Exact relations between convex polytopes and unions of them: depth, forbidden shifts, least separating moves.

Everything follows from the facets of the Minkowski difference B - A. ``A`` moved by ``x`` overlaps ``B`` if and only if
``normal . x > -height`` for every facet. Facets have three sources: A's faces, B's faces negated, and pairs of edges
whose arcs cross on the Gauss map (Gregorius, "The Separating Axis Test between Convex Polyhedra", GDC 2013).

- The depth is the smallest height (equation 10).
- The overlapping shifts along a direction form one interval (equation 11).
- The overlapping horizontal shifts form one convex polygon.

Lengths have the unit of the polytopes: metres in the world.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.contact.sort_order import sort_order
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, frozen
from f3sr.runtime.kernels import inner_kernel, kernel

COPLANAR = 1e-7
"""Triangles merge into one facet when they leave its plane by less than this share of the polytope's size."""
SLIVER = 10.0
"""A triangle is a sliver when its height is below ``SLIVER`` times ``COPLANAR`` times the polytope's size."""
TOUCH = 1e-9
"""Overlaps up to this share of the two parts' sizes are contact, not collision.

Shifts leave half of it: rounding cannot turn their final contact into a collision."""
SHORT = 1e-6
"""Length of an edge, as a share of the polytope's size, below which its facets tell its direction, not its ends."""
PARALLEL = 1e-12
"""Sine below which a facet counts as parallel to a direction: rounding of unit vectors."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Polytope:
    """A convex polytope with the data of separating-axis tests; coplanar triangles are one facet.

    ``vertices`` (n, 3); outward unit ``normals`` (f, 3), ``offsets`` (f,): inside is ``normals . x <= offsets``.
    Per edge: ``edge_starts`` (e, 3), unit ``edge_directions`` (e, 3), ``edge_lengths`` (e,) and ``edge_normals``
    (e, 2, 3). The last are the normals of the facets to its left and right, seen from outside: left x right points
    along the edge.
    """

    vertices: Array
    normals: Array
    offsets: Array
    edge_starts: Array
    edge_directions: Array
    edge_lengths: Array
    edge_normals: Array

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of(cls, part: ConvexPart) -> Self:
        """The polytope of a convex part, made once: facets from its triangles, edges where two facets meet.

        Raises ValueError for a part whose surface is not closed."""
        if part not in _MADE:
            _MADE[part] = cls._made_of(part)
        return cast(Self, _MADE[part])

    @classmethod
    def _made_of(cls, part: ConvexPart) -> Self:
        left, right, edges = _adjacent(part.faces)
        group = _coplanar_groups(part, left, right)
        normals = _group_normals(part, group)
        # Edges inside a facet are the triangulation's, not the polytope's.
        real = group[left] != group[right]
        start, end = part.vertices[edges[real, 0]], part.vertices[edges[real, 1]]
        length = np.linalg.norm(end - start, axis=1)
        long = length > 0  # rounding merges corners; where they meet is no edge
        real[real] = long
        start, end, length = start[long], end[long], length[long]
        beside = np.stack([normals[group[left[real]]], normals[group[right[real]]]], axis=1)
        return cls(
            vertices=part.vertices,
            normals=normals,
            offsets=(part.vertices @ normals.T).max(0),
            edge_starts=start,
            edge_directions=_directions(end - start, beside, SHORT * float(np.linalg.norm(np.ptp(start, axis=0)))),
            edge_lengths=length,
            edge_normals=beside,
        )

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lowest and highest corner of the bounding box [m]."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box [m]."""
        return float(np.linalg.norm(self.bounds[1] - self.bounds[0]))

    @cached_property
    def packed(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """The arrays that the kernels take, in their order."""
        return self.vertices, self.normals, self.offsets, self.edge_starts, self.edge_directions, self.edge_normals

    def shifted(self, t: ArrayLike) -> Self:
        """The polytope moved by t (3,)."""
        T = np.eye(4)
        T[:3, 3] = t
        return self.moved(T)

    def moved(self, T: Array) -> Self:
        """The polytope under a similarity T (4, 4) without reflection; facets and edges are carried along."""
        # A similarity scales all columns alike: the first one's length is the scale.
        scale = float(np.sqrt(T[0, 0] ** 2 + T[1, 0] ** 2 + T[2, 0] ** 2))
        A, t = np.ascontiguousarray(T[:3, :3].T), T[:3, 3]
        R = A / scale
        normals = self.normals @ R
        moved = object.__new__(type(self))
        moved.__dict__.update(
            vertices=self.vertices @ A + t,
            normals=normals,
            offsets=scale * self.offsets + normals @ t,
            edge_starts=self.edge_starts @ A + t,
            edge_directions=self.edge_directions @ R,
            edge_lengths=scale * self.edge_lengths,
            edge_normals=self.edge_normals @ R,
        )
        for array in moved.__dict__.values():
            array.flags.writeable = False
        return moved


_MADE: WeakKeyDictionary[ConvexPart, Polytope] = WeakKeyDictionary()


def placed(parts: Iterable[ConvexPart], T: Array) -> tuple[Polytope, ...]:
    """The polytopes of convex parts under a similarity T (4, 4)."""
    return tuple(Polytope.of(p).moved(T) for p in parts)


Body = Sequence[Polytope]
"""A body is the union of its convex parts."""


# One pair of convex polytopes


def overlap_depth(a: Polytope, b: Polytope) -> float:
    """Length [m] of the smallest move that ends the overlap; <= 0 without overlap (then it is no distance)."""
    return float(_depth(*a.packed, *b.packed, _room(a, b), 0.0))


def separation(a: Polytope, b: Polytope, enough: float = np.inf) -> float:
    """Gap [m] along the facet that separates two polytopes best, negative if they overlap.

    Of a gap of ``enough`` or more it is only some such gap."""
    return -float(_depth(*a.packed, *b.packed, _room(a, b), -enough))


def forbidden_interval(
    a: Polytope, b: Polytope, direction: ArrayLike, *, after: float = -np.inf, before: float = np.inf
) -> tuple[float, float]:
    """The open interval (lo, hi) of t where ``a`` moved by ``t * direction`` (3,) collides with ``b``.

    Without any collision it is (inf, -inf), as is one that ends by ``after`` or starts from ``before`` on.
    """
    u = np.asarray(direction, float)
    return _interval(*a.packed, *b.packed, _room(a, b), u, _touch(a, b) / 2, after, before)


def facets(a: Polytope, b: Polytope) -> tuple[Array, Array]:
    """Unit normals (k, 3) and heights (k,): ``a`` moved by x overlaps ``b`` iff all ``n . x > -h``."""
    face_normals, face_heights = face_facets(a, b)
    edge_normals, edge_heights = _edge_facets(a, b)
    return np.concatenate([face_normals, edge_normals]), np.concatenate([face_heights, edge_heights])


# Bodies made of several parts


def collide(A: Body, B: Body, tolerance: float = 0.0) -> bool:
    """Equation 10: whether some pair of parts overlaps deeper than ``tolerance`` and than contact."""
    return any(
        overlap_depth(A[i], B[j]) > max(tolerance, _touch(A[i], B[j])) for i, j in _boxes_overlap(A, B, (0, 1, 2))
    )


def smallest_shift(A: Body, B: Body, direction: ArrayLike, clearance: float = 0.0) -> float:
    """Equation 11: the smallest t >= 0 for which A moved by ``t * direction`` is free of B.

    Exact: the first t outside the union of the forbidden intervals of all pairs of parts. Pairs that are free at t = 0
    and collide on the way are included. ``clearance`` is the gap left behind A along the direction, in t (metres
    for a unit direction).
    """
    u, t, done = np.asarray(direction, float), 0.0, 0
    pairs, starts = _boxes_meet(A, B, u, -clearance)
    found = list[tuple[float, float]]()
    # A pair matters once t is past the start of its boxes' overlap. t jumps to the ends of intervals that hold it.
    while True:
        now = int(np.searchsorted(starts, t))
        found += [forbidden_interval(A[i], B[j], u, after=t - clearance) for i, j in pairs[done:now]]
        done = now
        end = max((hi + clearance for lo, hi in found if lo < t), default=t)
        if end <= t:
            return t
        t = end


def free_travel(A: Body, B: Body, direction: ArrayLike) -> float:
    """The largest t >= 0 by which A can move along ``direction`` before it collides with B, or inf."""
    u, t = np.asarray(direction, float), np.inf
    for (i, j), start in zip(*_boxes_meet(A, B, u, 0.0), strict=True):
        if start >= t:
            break
        t = min(t, forbidden_interval(A[i], B[j], u, after=0.0, before=t)[0])
    return max(0.0, t)


def smallest_horizontal_move(A: Body, B: Body) -> Array:
    """The shortest horizontal move (2,) after which A is free of B; zeros if it is free already.

    Exact: the forbidden moves are a union of convex polygons. The nearest free point is the origin, its foot on an
    edge, or a crossing of two edges: the nearest of these that is inside no polygon.
    """
    if not collide(A, B):
        return np.zeros(2)
    # Half of what the polygons leave: the point on a side must count as outside.
    slack = min(_touch(a, b) for a in A for b in B) / 4
    return nearest_free(forbidden_polygons(A, B), slack)


def forbidden_polygons(A: Body, B: Body, *, within: float = np.inf) -> list[Array]:
    """The horizontal moves of A that collide with B: convex polygons, one for each pair of parts that can meet.

    Each is given by its sides (k, 3), rows ``(n, h)`` with unit n (2,): inside is ``n . x + h > 0`` for all. Parts
    with a gap of more than ``within`` along x or y are left out.
    """
    near = _boxes_overlap(A, B, (0, 1, 2), gap=np.array([within, within, 0]))
    return [p for i, j in near if len(p := _horizontal_slice(A[i], B[j]))]


def nearest_free(polygons: Sequence[Array], slack: float) -> Array:
    """The point (2,) nearest to the origin that lies in none of the polygons deeper than ``slack``."""
    planes, starts = np.concatenate(polygons), np.cumsum([0, *map(len, polygons)]).astype(np.int64)
    ends, near = np.empty((len(planes), 2)), np.empty(len(planes))
    if _measure_sides(planes, starts, slack, ends, near):
        return np.zeros(2)
    return np.array(_nearest_free(planes, starts, ends, near, sort_order(near), slack))


def _boxes_overlap(A: Body, B: Body, axes: tuple[int, ...], gap: Array | float = 0.0) -> NDArray[np.int64]:
    """Broad phase: pairs (k, 2) of parts whose bounding boxes overlap in the given axes, or nearly: ``gap`` apart."""
    a, b = (np.stack([p.bounds for p in body])[:, :, axes] for body in (A, B))
    # (n, m, axes): the high side of one box is below the low side of the other.
    apart = (a[:, None, 1] + gap <= b[None, :, 0]) | (b[None, :, 1] + gap <= a[:, None, 0])
    return np.argwhere(~apart.any(-1))


def _boxes_meet(A: Body, B: Body, u: Array, beyond: float) -> tuple[NDArray[np.int64], Array]:
    """Swept broad phase: pairs (k, 2) of parts whose boxes overlap at some shift t > ``beyond`` along u, and from which
    t on (k,), which ascends."""
    a, b = (np.stack([p.bounds for p in body]) for body in (A, B))
    pairs, starts = np.empty((len(a) * len(b), 2), np.int64), np.empty(len(a) * len(b))
    found = _meeting(a, b, u, beyond, pairs, starts)
    order = np.argsort(starts[:found], kind="stable")
    return pairs[order], starts[order]


@kernel
def _meeting(a: Array, b: Array, u: Array, beyond: float, pairs: NDArray[np.int64], starts: Array) -> int:
    """Fill ``pairs`` (n m, 2) with those of boxes (n, 2, 3), (m, 2, 3) that overlap at some shift t > ``beyond`` of
    the first along u, and ``starts`` (n m,) with the t from which on; returns how many."""
    k = 0
    still = PARALLEL * np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for i in range(len(a)):
        for j in range(len(b)):
            # Slab test: per axis the boxes overlap while low < t u < high.
            first, last = -np.inf, np.inf
            for x in range(3):
                low, high = b[j, 0, x] - a[i, 1, x], b[j, 1, x] - a[i, 0, x]
                if abs(u[x]) > still:
                    s, t = low / u[x], high / u[x]
                    first, last = max(first, min(s, t)), min(last, max(s, t))
                elif low >= 0 or high <= 0:
                    last = -np.inf
                if first >= last or last <= beyond:
                    break
            if first < last and last > beyond:
                pairs[k, 0], pairs[k, 1], starts[k] = i, j, first
                k += 1
    return k


# Facets of the Minkowski difference


def _touch(a: Polytope, b: Polytope) -> float:
    return TOUCH * (a.size + b.size)


def face_facets(a: Polytope, b: Polytope) -> tuple[Array, Array]:
    """Facets whose normal is a face's of a, or the negated one of a face of b."""
    # Height = support of a along n, less the least of b along n: how far a reaches into b.
    heights_a = a.offsets - (b.vertices @ a.normals.T).min(0)
    heights_b = b.offsets - (a.vertices @ b.normals.T).min(0)
    return np.concatenate([a.normals, -b.normals]), np.concatenate([heights_a, heights_b])


def _edge_facets(a: Polytope, b: Polytope) -> tuple[Array, Array]:
    """Facets spanned by one edge of each."""
    planes = _room(a, b)
    found = _edge_planes(
        a.vertices,
        a.edge_starts,
        a.edge_directions,
        a.edge_normals,
        b.vertices,
        b.edge_starts,
        b.edge_directions,
        b.edge_normals,
        planes,
    )
    return planes[:found, :3], planes[:found, 3]


def _room(a: Polytope, b: Polytope) -> Array:
    """Empty rows for what ``_edge_planes`` finds: one for each pair of edges."""
    return np.empty((len(a.edge_starts) * len(b.edge_starts), 4))


@kernel
def _edge_planes(
    points_a: Array,
    starts_a: Array,
    directions_a: Array,
    normals_a: Array,
    points_b: Array,
    starts_b: Array,
    directions_b: Array,
    normals_b: Array,
    planes: Array,
) -> int:
    """Fill ``planes`` (n, 4), normal and height, for the edge pairs whose Gauss-map arcs cross, b's arcs negated.

    Returns how many; n must be the number of edge pairs."""
    k = 0
    for i in range(len(starts_a)):
        px, py, pz = directions_a[i, 0], directions_a[i, 1], directions_a[i, 2]
        l0x, l0y, l0z = normals_a[i, 0, 0], normals_a[i, 0, 1], normals_a[i, 0, 2]
        l1x, l1y, l1z = normals_a[i, 1, 0], normals_a[i, 1, 1], normals_a[i, 1, 2]
        for j in range(len(starts_b)):
            # On the Gauss map an edge is the arc between its two face normals; two edges make a facet of B - A where
            # arc (l0, l1) of a crosses arc (-r0, -r1) of b. p and q are the normals of the arcs' great circles, so
            # c, d, e, f say on which side of the other circle each end lies.
            c = normals_b[j, 0, 0] * px + normals_b[j, 0, 1] * py + normals_b[j, 0, 2] * pz
            d = normals_b[j, 1, 0] * px + normals_b[j, 1, 1] * py + normals_b[j, 1, 2] * pz
            if c * d >= 0.0:  # b's arc stays on one side of the plane of a's arc
                continue
            qx, qy, qz = directions_b[j, 0], directions_b[j, 1], directions_b[j, 2]
            e = l0x * qx + l0y * qy + l0z * qz
            f = l1x * qx + l1y * qy + l1z * qz
            if e * f >= 0.0 or c * f >= 0.0:  # a's arc on one side of b's; or crossing on opposite hemispheres
                continue
            # The facet's normal is across both edges.
            nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
            sine = np.sqrt(nx * nx + ny * ny + nz * nz)
            if sine < 1e-10:  # parallel edges: their facet is a face's
                continue
            if nx * (l0x + l1x) + ny * (l0y + l1y) + nz * (l0z + l1z) < 0.0:  # outward from a
                sine = -sine
            nx, ny, nz = nx / sine, ny / sine, nz / sine
            if abs(sine) > 1e-5:
                h = nx * (starts_a[i, 0] - starts_b[j, 0])
                h += ny * (starts_a[i, 1] - starts_b[j, 1])
                h += nz * (starts_a[i, 2] - starts_b[j, 2])
            else:  # nearly parallel edges: their normal is uncertain, so take the true support along it
                high, low = -np.inf, np.inf
                for m in range(len(points_a)):
                    high = max(high, points_a[m, 0] * nx + points_a[m, 1] * ny + points_a[m, 2] * nz)
                for m in range(len(points_b)):
                    low = min(low, points_b[m, 0] * nx + points_b[m, 1] * ny + points_b[m, 2] * nz)
                h = high - low
            planes[k, 0], planes[k, 1], planes[k, 2], planes[k, 3] = nx, ny, nz, h
            k += 1
    return k


@inner_kernel
def _lowest(points: Array, normals: Array, k: int) -> float:
    """The least of ``normals[k] . p`` over points (n, 3)."""
    low, x, y, z = np.inf, normals[k, 0], normals[k, 1], normals[k, 2]
    for m in range(len(points)):
        low = min(low, points[m, 0] * x + points[m, 1] * y + points[m, 2] * z)
    return low


@kernel
def _depth(
    points_a: Array,
    faces_a: Array,
    offsets_a: Array,
    starts_a: Array,
    directions_a: Array,
    normals_a: Array,
    points_b: Array,
    faces_b: Array,
    offsets_b: Array,
    starts_b: Array,
    directions_b: Array,
    normals_b: Array,
    planes: Array,
    enough: float,
) -> float:
    """The least height of all facets; that of the first face at most ``enough`` if there is one.

    ``planes`` is ``_room``."""
    depth = np.inf
    # Faces first: they are few, and one of them separates most pairs that are free of each other.
    for k in range(len(faces_a)):
        depth = min(depth, offsets_a[k] - _lowest(points_b, faces_a, k))
        if depth <= enough:
            return depth
    for k in range(len(faces_b)):
        depth = min(depth, offsets_b[k] - _lowest(points_a, faces_b, k))
        if depth <= enough:
            return depth
    found = _edge_planes(
        points_a, starts_a, directions_a, normals_a, points_b, starts_b, directions_b, normals_b, planes
    )
    for k in range(found):
        depth = min(depth, planes[k, 3])
    return depth


@kernel
def _interval(
    points_a: Array,
    faces_a: Array,
    offsets_a: Array,
    starts_a: Array,
    directions_a: Array,
    normals_a: Array,
    points_b: Array,
    faces_b: Array,
    offsets_b: Array,
    starts_b: Array,
    directions_b: Array,
    normals_b: Array,
    planes: Array,
    u: Array,
    slack: float,
    after: float,
    before: float,
) -> tuple[float, float]:
    """The t for which ``t u`` is in all half-spaces ``normal . x > slack - height``; (inf, -inf) if none is, if they
    end by ``after`` or start from ``before`` on.

    ``planes`` is ``_room``."""
    lo, hi = -np.inf, np.inf
    still = PARALLEL * np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for k in range(len(faces_a)):
        speed = faces_a[k, 0] * u[0] + faces_a[k, 1] * u[1] + faces_a[k, 2] * u[2]
        # n . (t u) > slack - height, with height = offset - lowest.
        lo, hi = _clipped(lo, hi, speed, slack - offsets_a[k] + _lowest(points_b, faces_a, k), still)
        if lo >= min(hi, before) or hi <= after:
            return np.inf, -np.inf
    for k in range(len(faces_b)):
        speed = -(faces_b[k, 0] * u[0] + faces_b[k, 1] * u[1] + faces_b[k, 2] * u[2])
        lo, hi = _clipped(lo, hi, speed, slack - offsets_b[k] + _lowest(points_a, faces_b, k), still)
        if lo >= min(hi, before) or hi <= after:
            return np.inf, -np.inf
    found = _edge_planes(
        points_a, starts_a, directions_a, normals_a, points_b, starts_b, directions_b, normals_b, planes
    )
    for k in range(found):
        speed = planes[k, 0] * u[0] + planes[k, 1] * u[1] + planes[k, 2] * u[2]
        lo, hi = _clipped(lo, hi, speed, slack - planes[k, 3], still)
        if lo >= min(hi, before) or hi <= after:
            return np.inf, -np.inf
    return lo, hi


@inner_kernel
def _clipped(lo: float, hi: float, speed: float, bound: float, still: float) -> tuple[float, float]:
    """The interval (lo, hi) of t where also ``speed t > bound``."""
    if abs(speed) <= still:
        return (lo, hi) if bound < 0.0 else (np.inf, -np.inf)
    if speed > 0.0:
        return max(lo, bound / speed), hi
    return lo, min(hi, bound / speed)


# Horizontal moves: polygons in the plane of shifts


def _horizontal_slice(a: Polytope, b: Polytope) -> Array:
    """The polygon of horizontal shifts where a collides with b: half-planes (k, 3), ``n . x + h > 0``."""
    normals, heights = facets(a, b)
    heights = heights - _touch(a, b) / 2
    lengths = np.linalg.norm(normals[:, :2], axis=1)
    level = lengths <= PARALLEL
    if (heights[level] <= 0).any():  # a level facet separates them at any shift
        return np.empty((0, 3))
    # In the plane z = 0 of shifts a facet is a line; divided by the length of its level part the normal is unit again.
    planes = np.column_stack([normals[~level, :2], heights[~level]]) / lengths[~level, None]
    low, high = b.bounds[0] - a.bounds[1], b.bounds[1] - a.bounds[0]
    # Box against box bounds every shift that collides: the start of clipping. Order: bottom, right, top, left.
    box = np.array([[0, 1, -low[1]], [-1, 0, high[0]], [0, -1, high[1]], [1, 0, -low[0]]])
    planes = np.concatenate([planes, box])
    # Two buffers swap after each clip; a clip adds at most one corner.
    corners, sides = np.empty((2, len(planes) + 8, 2)), np.empty((2, len(planes) + 8), np.int64)
    return planes[sides[0, : _polygon_sides(planes, corners, sides)]]


@kernel
def _polygon_sides(planes: Array, corners: Array, sides: NDArray[np.int64]) -> int:
    """Which half-planes (k, 3) bound their common polygon: the first of ``sides[0]``; returns how many.

    The last four half-planes are a box around it. Sutherland-Hodgman clipping; 0 when the half-planes have nothing in
    common."""
    # Corner i is corners[now, i]; sides[now, i] is the half-plane that bounds the polygon from there to corner i + 1.
    k = len(planes)
    # Rows [0, 1, -bottom], [-1, 0, right], [0, -1, top], [1, 0, -left]: counter-clockwise from the bottom.
    for i in range(4):
        corners[0, i, 0] = -planes[k - 1, 2] if i == 0 or i == 3 else planes[k - 3, 2]
        corners[0, i, 1] = -planes[k - 4, 2] if i < 2 else planes[k - 2, 2]
        sides[0, i] = k - 4 + i
    now, n = 0, 4
    for p in range(k - 4):
        m, then = 0, 1 - now
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            x, y = corners[now, i, 0], corners[now, i, 1]
            next_x, next_y = corners[now, j, 0], corners[now, j, 1]
            here = planes[p, 0] * x + planes[p, 1] * y + planes[p, 2]
            there = planes[p, 0] * next_x + planes[p, 1] * next_y + planes[p, 2]
            if here >= 0.0:
                corners[then, m, 0], corners[then, m, 1], sides[then, m] = x, y, sides[now, i]
                m += 1
            if (here >= 0.0) != (there >= 0.0):
                w = here / (here - there)
                corners[then, m, 0], corners[then, m, 1] = x + w * (next_x - x), y + w * (next_y - y)
                # Going out starts the new side, coming in resumes the old one.
                sides[then, m] = p if here >= 0.0 else sides[now, i]
                m += 1
        now, n = then, m
    for i in range(n):
        sides[0, i] = sides[now, i]
    return n


@kernel
def _measure_sides(planes: Array, starts: NDArray[np.int64], slack: float, ends: Array, near: Array) -> bool:
    """Fill ``ends`` (k, 2) with what each side of its polygon spans, and ``near`` (k,) with its distance.

    The distance is that to the origin, inf for a side without length. True when the origin itself is free: then
    nothing is filled. Polygon p has the half-planes ``planes[starts[p]:starts[p + 1]]``, rows (unit normal, height)."""
    if _is_free(0.0, 0.0, planes, starts, slack):
        return True
    for p in range(len(starts) - 1):
        for i in range(starts[p], starts[p + 1]):
            # Line i of polygon p bounds it between these two t; the parameter runs along the line from the origin's
            # foot.
            low, high = _across(i, p, planes, starts, 0.0)
            t = min(max(0.0, low), high)  # t = 0 is the foot of the origin on the line
            ends[i, 0], ends[i, 1] = low, high
            near[i] = np.sqrt(planes[i, 2] ** 2 + t * t) if low <= high else np.inf
    return False


@kernel
def _nearest_free(
    planes: Array, starts: NDArray[np.int64], ends: Array, near: Array, order: NDArray[np.int64], slack: float
) -> tuple[float, float]:
    """The point nearest to the origin that lies in no polygon deeper than ``slack``.

    The point lies on a side of some polygon. Sides are visited in ``order``, by their distance. From the nearest point
    of a side the search walks along it both ways, out of one polygon after the other. It ends at a free point, at the
    side's end, or beyond the best.
    """
    best, best_x, best_y = np.inf, 0.0, 0.0
    for place in range(len(order)):
        i = order[place]
        if near[i] >= best:
            break
        low, high, height = ends[i, 0], ends[i, 1], planes[i, 2]
        for turn in range(2):
            t = min(max(0.0, low), high)
            q = _inside(i, t, planes, starts, slack)
            # Inside q: jump to where the line leaves it. t only grows, or only falls, so the walk ends.
            while q >= 0 and low <= t <= high and height * height + t * t < best * best:
                a, b = _across(i, q, planes, starts, slack)
                t = b if turn == 0 else a
                q = _inside(i, t, planes, starts, slack)
            distance = np.sqrt(height * height + t * t)
            if q < 0 and low <= t <= high and distance < best:
                best = distance
                best_x, best_y = _on_line(i, t, planes)
    return best_x, best_y


@inner_kernel
def _on_line(i: int, t: float, planes: Array) -> tuple[float, float]:
    """The point of a line at t from the origin's foot on it."""
    nx, ny, h = planes[i, 0], planes[i, 1], planes[i, 2]
    return -h * nx - t * ny, -h * ny + t * nx


@inner_kernel
def _across(i: int, p: int, planes: Array, starts: NDArray[np.int64], slack: float) -> tuple[float, float]:
    """The interval of t where line i is inside polygon p, deeper than ``slack``; its own side counts as inside."""
    nx, ny, h = planes[i, 0], planes[i, 1], planes[i, 2]
    low, high = -np.inf, np.inf
    for k in range(starts[p], starts[p + 1]):
        if k == i:
            continue
        # Line i is p(t) = -h n + t (-n_y, n_x); half-plane k on it is along t + value > 0.
        along = planes[k, 1] * nx - planes[k, 0] * ny
        value = planes[k, 2] - h * (planes[k, 0] * nx + planes[k, 1] * ny) - slack
        if abs(along) < PARALLEL:
            if value <= 0 and starts[p] <= i < starts[p + 1]:
                continue
            if value <= 0:
                return np.inf, -np.inf
        elif along > 0:
            low = max(low, -value / along)
        else:
            high = min(high, -value / along)
    return low, high


@inner_kernel
def _inside(i: int, t: float, planes: Array, starts: NDArray[np.int64], slack: float) -> int:
    """A polygon that a point of a line lies in, deeper than ``slack``; else -1."""
    x, y = _on_line(i, t, planes)
    for p in range(len(starts) - 1):
        # A point on a polygon's own side is on its border, not in it.
        inside = not starts[p] <= i < starts[p + 1]
        for k in range(starts[p], starts[p + 1]):
            if planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] <= slack:
                inside = False
                break
        if inside:
            a, b = _across(i, p, planes, starts, slack)
            if a < t < b:
                return p
    return -1


@inner_kernel
def _is_free(x: float, y: float, planes: Array, starts: NDArray[np.int64], slack: float) -> bool:
    """Whether a point lies in no polygon deeper than ``slack``: beyond some side of each."""
    for p in range(len(starts) - 1):
        inside = True
        for i in range(starts[p], starts[p + 1]):
            if planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] <= slack:
                inside = False
                break
        if inside:
            return False
    return True


# Facets and edges of a triangulated convex part


def _adjacent(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """Per edge of a closed surface: the triangles to its left and right, and its directed ends (e, 2)."""
    # Directed edges: the owner has its inside to the left. On a closed surface each occurs once, and its reverse once.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    forward = np.flatnonzero(edges[:, 0] < edges[:, 1])
    backward = np.flatnonzero(edges[:, 0] > edges[:, 1])
    # Both sorted by the same pair of vertices: row k of one is the reverse of row k of the other.
    forward = forward[np.lexsort(edges[forward].T)]
    backward = backward[np.lexsort(edges[backward][:, ::-1].T)]
    if not np.array_equal(edges[forward], edges[backward][:, ::-1]):
        raise ValueError(f"a convex part of {len(faces)} faces is not closed")
    return owner[forward], owner[backward], edges[forward]


def _directions(edges: Array, beside: Array, short: float) -> Array:
    """Unit directions (e, 3) of edges (e, 3) between facets with normals ``beside`` (e, 2, 3).

    Rounding decides what the ends of a ``short`` edge tell; it is at right angles to both normals."""
    across = np.cross(beside[:, 0], beside[:, 1])
    # Rounding turns an edge by 1e-16 over its length, or over the sine between its facets.
    by_facets = (np.linalg.norm(edges, axis=1) < short) & across.any(1)
    edges = np.where(by_facets[:, None], across, edges)
    return edges / np.linalg.norm(edges, axis=1)[:, None]


def _coplanar_groups(part: ConvexPart, left: NDArray[np.int64], right: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label (m,) per triangle: neighbours share one when the smaller lies in the plane of the larger.

    A sliver lies in the planes of all its neighbours. It joins the largest one only, so it links no two facets."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = part.vertices[part.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    # (2, e): the larger triangle's plane is the better known one.
    large, small = np.where(area[left] >= area[right], (left, right), (right, left))
    unit = cross[large] / np.maximum(area[large], np.finfo(float).tiny)[:, None]
    # (e,) largest distance of the smaller triangle's corners from the larger one's plane.
    away = np.abs(np.einsum("eki,ei->ek", corners[small] - corners[large][:, :1], unit)).max(1)
    size = float(np.linalg.norm(np.ptp(part.vertices, axis=0)))
    same = away <= COPLANAR * size
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    is_sliver = area <= SLIVER * COPLANAR * size * longest
    # Per small triangle its links by the area of the neighbour: ``unique`` gives the first, its largest neighbour.
    order = np.lexsort((-area[large], small))
    first = np.zeros(len(same), bool)
    first[order[np.unique(small[order], return_index=True)[1]]] = True
    same &= first | ~is_sliver[small]
    links = coo_array((np.ones(same.sum()), (left[same], right[same])), shape=(len(area), len(area)))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _group_normals(part: ConvexPart, group: NDArray[np.int64]) -> Array:
    """Outward unit normal (f, 3) of every group of triangles: the direction of their summed area."""
    corners = part.vertices[part.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(group, weights=cross[:, k]) for k in range(3)], axis=1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    a = Polytope.of(ConvexPart.hull_of(corners))
    smallest_horizontal_move([a], [a.shifted((0.1, 0.2, 0.1))])
    smallest_shift([a], [a], (0, 0, 1))
