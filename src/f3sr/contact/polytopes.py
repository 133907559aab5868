"""Exact relations between two convex polytopes: depth and forbidden shifts.

Everything follows from the facets of the Minkowski difference B - A. ``A`` moved by ``x`` overlaps ``B`` if and only if
``normal . x > -height`` for every facet. Facets have three sources: A's faces, B's faces negated, and pairs of edges
whose arcs cross on the Gauss map (Gregorius, "The Separating Axis Test between Convex Polyhedra", GDC 2013).

- The depth is the smallest height (equation 10).
- The overlapping shifts along a direction form one interval (equation 11).

Lengths have the unit of the polytopes: metres in the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import AFTER, Array, bounds_of, cross, frozen
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
        across = area_vectors(part.vertices[part.faces])
        group = _coplanar_groups(part, across, left, right)
        normals = _group_normals(across, group)
        # Edges inside a facet are the triangulation's, not the polytope's.
        real = group[left] != group[right]
        start, end = part.vertices[edges[real, 0]], part.vertices[edges[real, 1]]
        length = np.linalg.norm(end - start, axis=1)
        long = length > 0  # rounding merges corners; where they meet is no edge
        real[real] = long
        start, end, length = start[long], end[long], length[long]
        beside = np.stack([normals[group[left[real]]], normals[group[right[real]]]], axis=1)
        return cls.with_arrays(
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
        return bounds_of(self.vertices)

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
        A, t = np.ascontiguousarray(T[:3, :3].T), T[:3, 3]
        scale = scale_of(T)
        R = A / scale
        normals = self.normals @ R
        return type(self).with_arrays(
            vertices=self.vertices @ A + t,
            normals=normals,
            offsets=scale * self.offsets + normals @ t,
            edge_starts=self.edge_starts @ A + t,
            edge_directions=self.edge_directions @ R,
            edge_lengths=scale * self.edge_lengths,
            edge_normals=self.edge_normals @ R,
        )

    @classmethod
    def with_arrays(cls, **arrays: Array) -> Self:
        """A polytope of arrays that are its own: they are not copied, and cannot be written any more."""
        made = object.__new__(cls)
        for array in arrays.values():
            array.flags.writeable = False
        made.__dict__.update(arrays)
        return made


_MADE: WeakKeyDictionary[ConvexPart, Polytope] = WeakKeyDictionary()


def scale_of(T: Array) -> float:
    """Factor of lengths under a similarity T (4, 4), which scales all columns alike: the first one's length."""
    return float(np.sqrt(T[0, 0] ** 2 + T[1, 0] ** 2 + T[2, 0] ** 2))


# One pair of convex polytopes


def overlap_depth(a: Polytope, b: Polytope) -> float:
    """Length [m] of the smallest move that ends the overlap; <= 0 without overlap (then it is no distance)."""
    return float(depth_kernel(*a.packed, *b.packed, 0.0))


def separation(a: Polytope, b: Polytope, enough: float = np.inf) -> float:
    """Gap [m] along the facet that separates two polytopes best, negative if they overlap.

    Of a gap of ``enough`` or more it is only some such gap."""
    return -float(depth_kernel(*a.packed, *b.packed, -enough))


def forbidden_interval(
    a: Polytope, b: Polytope, direction: ArrayLike, *, after: float = -np.inf, before: float = np.inf
) -> tuple[float, float]:
    """The open interval (lo, hi) of t where ``a`` moved by ``t * direction`` (3,) collides with ``b``.

    Without any collision it is (inf, -inf), as is one that ends by ``after`` or starts from ``before`` on.
    """
    u = np.asarray(direction, float)
    return interval_kernel(*a.packed, *b.packed, u, touch(a, b) / 2, after, before)


def facets(a: Polytope, b: Polytope) -> tuple[Array, Array]:
    """Unit normals (k, 3) and heights (k,): ``a`` moved by x overlaps ``b`` iff all ``n . x > -h``.

    Facets of faces come first: those of a's, then those of b's."""
    planes = planes_kernel(*a.packed, *b.packed)
    return planes[:, :3], planes[:, 3]


# Facets of the Minkowski difference


def touch(a: Polytope, b: Polytope) -> float:
    """Overlap [m] up to which two polytopes are in contact, not in collision."""
    return TOUCH * (a.size + b.size)


@inner_kernel
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
    k: int,
) -> int:
    """Fill ``planes`` (n, 4), normal and height, from row k on, for the edge pairs whose Gauss-map arcs cross, b's arcs
    negated. Returns the row after the last; there must be one for each pair of edges."""
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
def planes_kernel(
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
) -> Array:
    """All facets (k, 4), normal and height."""
    m, n = len(faces_a), len(faces_b)
    planes = np.empty((m + n + len(starts_a) * len(starts_b), 4))
    # Height = support of a along n, less the least of b along n: how far a reaches into b.
    for k in range(m):
        planes[k, :3], planes[k, 3] = faces_a[k], offsets_a[k] - _lowest(points_b, faces_a, k)
    for k in range(n):
        planes[m + k, :3], planes[m + k, 3] = -faces_b[k], offsets_b[k] - _lowest(points_a, faces_b, k)
    k = _edge_planes(
        points_a, starts_a, directions_a, normals_a, points_b, starts_b, directions_b, normals_b, planes, m + n
    )
    return planes[:k]


@inner_kernel
def has_gap(
    points_a: Array, faces_a: Array, offsets_a: Array, points_b: Array, faces_b: Array, offsets_b: Array, gap: float
) -> bool:
    """Whether a face of one of them shows a gap of more than ``gap``."""
    for k in range(len(faces_a)):
        if offsets_a[k] - _lowest(points_b, faces_a, k) < -gap:
            return True
    for k in range(len(faces_b)):  # noqa: SIM110 (a kernel)
        if offsets_b[k] - _lowest(points_a, faces_b, k) < -gap:
            return True
    return False


@kernel
def depth_kernel(
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
    enough: float,
) -> float:
    """The least height of all facets; that of the first face at most ``enough`` if there is one."""
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
    planes = np.empty((len(starts_a) * len(starts_b), 4))
    found = _edge_planes(
        points_a, starts_a, directions_a, normals_a, points_b, starts_b, directions_b, normals_b, planes, 0
    )
    for k in range(found):
        depth = min(depth, planes[k, 3])
    return depth


@kernel
def interval_kernel(
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
    u: Array,
    slack: float,
    after: float,
    before: float,
) -> tuple[float, float]:
    """The t for which ``t u`` is in all half-spaces ``normal . x > slack - height``; (inf, -inf) if none is, if they
    end by ``after`` or start from ``before`` on."""
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
    planes = np.empty((len(starts_a) * len(starts_b), 4))
    found = _edge_planes(
        points_a, starts_a, directions_a, normals_a, points_b, starts_b, directions_b, normals_b, planes, 0
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


# Facets and edges of a triangulated convex part


def _adjacent(faces: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """Per edge of a closed surface: the triangles to its left and right, and its directed ends (e, 2)."""
    # Directed edges: the owner has its inside to the left. On a closed surface each occurs once, and its reverse once.
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    start, end = edges.T.astype(np.int64)
    forward, backward = np.flatnonzero(start < end), np.flatnonzero(start > end)
    # Both sorted by the same pair of vertices: row k of one is the reverse of row k of the other.
    count = int(faces.max(initial=-1)) + 1
    forward = forward[np.argsort(end[forward] * count + start[forward], kind="stable")]
    backward = backward[np.argsort(start[backward] * count + end[backward], kind="stable")]
    if not np.array_equal(edges[forward], edges[backward][:, ::-1]):
        raise ValueError(f"a convex part of {len(faces)} faces is not closed")
    return owner[forward], owner[backward], edges[forward]


def _directions(edges: Array, beside: Array, short: float) -> Array:
    """Unit directions (e, 3) of edges (e, 3) between facets with normals ``beside`` (e, 2, 3).

    Rounding decides what the ends of a ``short`` edge tell; it is at right angles to both normals."""
    across = cross(beside[:, 0], beside[:, 1])
    # Rounding turns an edge by 1e-16 over its length, or over the sine between its facets.
    by_facets = (np.linalg.norm(edges, axis=1) < short) & across.any(1)
    edges = np.where(by_facets[:, None], across, edges)
    return edges / np.linalg.norm(edges, axis=1)[:, None]


def _coplanar_groups(
    part: ConvexPart, across: Array, left: NDArray[np.int64], right: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Label (m,) per triangle: neighbours share one when the smaller lies in the plane of the larger.

    ``across`` (m, 3) are the area vectors; neighbours are ``left`` and ``right`` (e,) of an edge. A sliver lies in the
    planes of all its neighbours. It joins the largest one only, so it links no two facets."""
    corners = part.vertices[part.faces]
    area = np.linalg.norm(across, axis=1)
    # (2, e): the larger triangle's plane is the better known one.
    large, small = np.where(area[left] >= area[right], (left, right), (right, left))
    unit = across[large] / np.maximum(area[large], np.finfo(float).tiny)[:, None]
    # (e,) largest distance of the smaller triangle's corners from the larger one's plane.
    away = np.abs(np.einsum("eki,ei->ek", corners[small] - corners[large, :1], unit)).max(1)
    size = float(np.linalg.norm(np.ptp(part.vertices, axis=0)))
    same = away <= COPLANAR * size
    longest = np.linalg.norm(corners - corners[:, AFTER], axis=2).max(1)
    is_sliver = (area <= SLIVER * COPLANAR * size * longest)[small]
    if (same & is_sliver).any():
        # Per small triangle its links by the area of the neighbour: ``unique`` gives the first, its largest neighbour.
        order = np.lexsort((-area[large], small))
        first = np.zeros(len(same), bool)
        first[order[np.unique(small[order], return_index=True)[1]]] = True
        same &= first | ~is_sliver
    return _linked(len(area), left[same], right[same])


def _linked(count: int, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Label (count,) of the things that links from a (k,) to b (k,) hold together, in the order of the first ones.

    As scipy's ``connected_components``, whose matrix costs more than all else for a few links."""
    first = np.arange(count)
    while (first[a] != first[b]).any():
        np.minimum.at(first, a, first[b])
        np.minimum.at(first, b, first[a])
        first = first[first]
    return np.unique(first, return_inverse=True)[1]


def _group_normals(across: Array, group: NDArray[np.int64]) -> Array:
    """Outward unit normal (f, 3) of every group of triangles: the direction of their summed area vectors (m, 3)."""
    total = np.stack([np.bincount(group, weights=across[:, k]) for k in range(3)], axis=1)
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    a = Polytope.of(ConvexPart.hull_of(corners))
    overlap_depth(a, a)
    facets(a, a)
    forbidden_interval(a, a, (0, 0, 1))
