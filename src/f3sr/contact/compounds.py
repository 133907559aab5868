"""Exact relations between compounds, unions of convex polytopes: collision, and least moves that separate them.

A compound is moved and asked as a whole: its parts lie in common arrays, and every question to two compounds is one
kernel over the pairs of parts whose boxes meet.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple, Self, overload
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.contact.horizontal_moves import forbidden_polygon, nearest_free
from f3sr.contact.polytopes import (
    PARALLEL,
    TOUCH,
    Polytope,
    depth_kernel,
    has_gap,
    interval_kernel,
    scale_of,
    touch,
)
from f3sr.contact.sort_order import DEPTH, sort_kernel
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array
from f3sr.runtime.kernels import inner_kernel, kernel


class Arrays(NamedTuple):
    """What polytopes have, of all parts one after the other; kernels take it as it is."""

    vertices: Array
    normals: Array
    offsets: Array
    edge_starts: Array
    edge_directions: Array
    edge_lengths: Array
    edge_normals: Array
    begins: NDArray[np.int64]
    """(k + 1, 3): at which vertex, facet and edge every part begins."""
    boxes: Array
    """(k, 2, 3) lowest and highest corners of every part [m]."""


class Compound(Sequence[Polytope]):
    """The union of convex parts in place [m]: the collision geometry of a body."""

    def __init__(self, source: Arrays, T: Array | None = None) -> None:
        self._source, self._T = source, T
        self._made = source if T is None else None
        self._parts: dict[int, Polytope] = {}

    @classmethod
    def of(cls, bodies: Iterable[Compound | Polytope]) -> Self:
        """All parts of several as one."""
        return cls(_joined([b.arrays if isinstance(b, Compound) else _single(b) for b in bodies]))

    @property
    def arrays(self) -> Arrays:
        """What kernels take, made when first asked for."""
        if self._made is None:
            assert self._T is not None
            self._made = _moved(self._source, self._T)
        return self._made

    @property
    def boxes(self) -> Array:
        """(k, 2, 3) lowest and highest corners of every part [m]."""
        return self.arrays.boxes

    @property
    def bounds(self) -> Array:
        """(2, 3) lowest and highest corner [m]."""
        return np.stack([self.boxes[:, 0].min(0), self.boxes[:, 1].max(0)])

    @property
    def size(self) -> float:
        """Diagonal of its box [m]."""
        return float(np.linalg.norm(np.ptp(self.bounds, axis=0)))

    @property
    def lowest(self) -> float:
        """Height of the lowest point [m]."""
        return float(self.boxes[:, 0, 2].min())

    def moved(self, T: Array) -> Self:
        """The compound under a similarity T (4, 4) without reflection."""
        return type(self)(self._source, T.copy() if self._T is None else T @ self._T)

    def some(self, parts: Iterable[int]) -> Self:
        """Some of its parts."""
        return type(self)(_joined([_single(self[k]) for k in parts]))

    def __len__(self) -> int:
        return len(self._source.begins) - 1

    @overload
    def __getitem__(self, k: int) -> Polytope: ...
    @overload
    def __getitem__(self, k: slice) -> Compound: ...
    def __getitem__(self, k: int | slice) -> Polytope | Compound:
        if isinstance(k, slice):
            return self.some(range(*k.indices(len(self))))
        k = range(len(self))[k]
        if k not in self._parts:
            self._parts[k] = _polytope(self.arrays, k)
        return self._parts[k]


Parts = Sequence[Polytope]
"""A compound, or convex parts that are asked once."""


def compound(parts: Parts) -> Compound:
    """Convex parts as a compound."""
    return parts if isinstance(parts, Compound) else Compound.of(parts)


def placed(parts: Iterable[ConvexPart], T: Array) -> Compound:
    """The compound of convex parts under a similarity T (4, 4)."""
    return Compound(_packed(tuple(parts))).moved(T)


def collide(A: Parts, B: Parts, tolerance: float = 0.0) -> bool:
    """Equation 10: whether some pair of parts overlaps deeper than ``tolerance`` and than contact."""
    return bool(_collide(_arrays(A), _arrays(B), tolerance))


def overlapping_pairs(bodies: Mapping[int, Parts]) -> list[tuple[int, int]]:
    """Pairs of ids whose bodies ``collide``."""
    return [(a, b) for a, b in combinations(bodies, 2) if collide(bodies[a], bodies[b])]


def smallest_shift(A: Parts, B: Parts, direction: ArrayLike, clearance: float = 0.0) -> float:
    """Equation 11: the smallest t >= 0 for which A moved by ``t * direction`` is free of B.

    Exact: the first t outside the union of the forbidden intervals of all pairs of parts. Pairs that are free at t = 0
    and collide on the way are included. ``clearance`` is the gap left behind A along the direction, in t (metres
    for a unit direction).
    """
    return float(_shift(_arrays(A), _arrays(B), np.asarray(direction, float), float(clearance)))


def free_travel(A: Parts, B: Parts, direction: ArrayLike) -> float:
    """The largest t >= 0 by which A can move along ``direction`` before it collides with B, or inf."""
    return float(_travel(_arrays(A), _arrays(B), np.asarray(direction, float)))


def smallest_horizontal_move(A: Parts, B: Parts) -> Array:
    """The shortest horizontal move (2,) after which A is free of B; zeros if it is free already.

    Exact: the forbidden moves are a union of convex polygons. The nearest free point is the origin, its foot on an
    edge, or a crossing of two edges: the nearest of these that is inside no polygon.
    """
    if not collide(A, B):
        return np.zeros(2)
    # Half of what the polygons leave: the point on a side must count as outside.
    slack = min(touch(a, b) for a in A for b in B) / 4
    return nearest_free(forbidden_polygons(A, B), slack)


def forbidden_polygons(A: Parts, B: Parts, *, within: float = np.inf) -> list[Array]:
    """The horizontal moves of A that collide with B: convex polygons, one for each pair of parts that can meet.

    Each is given by its sides (k, 3), rows ``(n, h)`` with unit n (2,): inside is ``n . x + h > 0`` for all. Parts
    with a gap of more than ``within`` along x or y are left out.
    """
    a, b = _arrays(A).boxes, _arrays(B).boxes
    gap = np.array([within, within, 0])
    # (n, m, 3): the high side of one box is below the low side of the other.
    apart = (a[:, None, 1] + gap <= b[None, :, 0]) | (b[None, :, 1] + gap <= a[:, None, 0])
    return [p for i, j in np.argwhere(~apart.any(-1)) if len(p := forbidden_polygon(A[i], B[j]))]


def near_parts(A: Parts, B: Parts, reach: float) -> NDArray[np.int64]:
    """Pairs (k, 2) of parts whose boxes come within ``reach`` [m], and whose faces show no gap of more."""
    return _near(_arrays(A), _arrays(B), reach)


# Arrays


def _arrays(parts: Parts) -> Arrays:
    return compound(parts).arrays


def _single(p: Polytope) -> Arrays:
    counts = [len(p.vertices), len(p.normals), len(p.edge_starts)]
    return _read_only(
        Arrays(
            vertices=p.vertices,
            normals=p.normals,
            offsets=p.offsets,
            edge_starts=p.edge_starts,
            edge_directions=p.edge_directions,
            edge_lengths=p.edge_lengths,
            edge_normals=p.edge_normals,
            begins=np.array([[0, 0, 0], counts]),
            boxes=p.bounds[None],
        )
    )


def _joined(several: Sequence[Arrays]) -> Arrays:
    """The arrays of several compounds as those of one."""
    if len(several) == 1:
        return several[0]
    every = (NOTHING, *several)
    counts = np.concatenate([NOTHING.begins, *(np.diff(a.begins, axis=0) for a in several)])
    return _read_only(
        Arrays(
            vertices=np.concatenate([a.vertices for a in every]),
            normals=np.concatenate([a.normals for a in every]),
            offsets=np.concatenate([a.offsets for a in every]),
            edge_starts=np.concatenate([a.edge_starts for a in every]),
            edge_directions=np.concatenate([a.edge_directions for a in every]),
            edge_lengths=np.concatenate([a.edge_lengths for a in every]),
            edge_normals=np.concatenate([a.edge_normals for a in every]),
            begins=np.cumsum(counts, axis=0),
            boxes=np.concatenate([a.boxes for a in every]),
        )
    )


def _read_only(arrays: Arrays) -> Arrays:
    # Kernels are compiled for the kind of array that a polytope has.
    for array in arrays:
        array.flags.writeable = False
    return arrays


NOTHING = _read_only(
    Arrays(
        vertices=np.empty((0, 3)),
        normals=np.empty((0, 3)),
        offsets=np.empty(0),
        edge_starts=np.empty((0, 3)),
        edge_directions=np.empty((0, 3)),
        edge_lengths=np.empty(0),
        edge_normals=np.empty((0, 2, 3)),
        begins=np.zeros((1, 3), np.int64),
        boxes=np.empty((0, 2, 3)),
    )
)


_PACKED: WeakKeyDictionary[ConvexPart, tuple[tuple[ConvexPart, ...], Arrays]] = WeakKeyDictionary()


def _packed(parts: tuple[ConvexPart, ...]) -> Arrays:
    """The arrays of parts where they are, made once."""
    if not parts:
        return NOTHING
    known = _PACKED.get(parts[0])
    if known is None or known[0] != parts:
        _PACKED[parts[0]] = known = (parts, _joined([_single(Polytope.of(p)) for p in parts]))
    return known[1]


def _moved(source: Arrays, T: Array) -> Arrays:
    made = Arrays(
        vertices=np.empty_like(source.vertices),
        normals=np.empty_like(source.normals),
        offsets=np.empty_like(source.offsets),
        edge_starts=np.empty_like(source.edge_starts),
        edge_directions=np.empty_like(source.edge_directions),
        edge_lengths=np.empty_like(source.edge_lengths),
        edge_normals=np.empty_like(source.edge_normals),
        begins=source.begins,
        boxes=np.empty_like(source.boxes),
    )
    _move(source, np.ascontiguousarray(T), scale_of(T), made)
    return _read_only(made)


def _polytope(arrays: Arrays, k: int) -> Polytope:
    (v, f, e), (v_end, f_end, e_end) = arrays.begins[k : k + 2].tolist()
    return Polytope.with_arrays(
        vertices=arrays.vertices[v:v_end],
        normals=arrays.normals[f:f_end],
        offsets=arrays.offsets[f:f_end],
        edge_starts=arrays.edge_starts[e:e_end],
        edge_directions=arrays.edge_directions[e:e_end],
        edge_lengths=arrays.edge_lengths[e:e_end],
        edge_normals=arrays.edge_normals[e:e_end],
    )


# Kernels


@kernel
def _move(source: Arrays, T: Array, scale: float, made: Arrays) -> None:
    """Fill the arrays of a compound ``made`` with those of ``source`` under a similarity T (4, 4) of a ``scale``."""
    R = T[:3, :3] / scale
    for k in range(len(source.vertices)):
        _place(source.vertices[k], T, made.vertices[k])
    for k in range(len(source.edge_starts)):
        _place(source.edge_starts[k], T, made.edge_starts[k])
        _turn(source.edge_directions[k], R, made.edge_directions[k])
        _turn(source.edge_normals[k, 0], R, made.edge_normals[k, 0])
        _turn(source.edge_normals[k, 1], R, made.edge_normals[k, 1])
        made.edge_lengths[k] = scale * source.edge_lengths[k]
    for k in range(len(source.normals)):
        n = made.normals[k]
        _turn(source.normals[k], R, n)
        made.offsets[k] = scale * source.offsets[k] + n[0] * T[0, 3] + n[1] * T[1, 3] + n[2] * T[2, 3]
    for i in range(len(source.boxes)):
        for x in range(3):
            low, high = np.inf, -np.inf
            for k in range(source.begins[i, 0], source.begins[i + 1, 0]):
                low, high = min(low, made.vertices[k, x]), max(high, made.vertices[k, x])
            made.boxes[i, 0, x], made.boxes[i, 1, x] = low, high


@inner_kernel
def _place(p: Array, T: Array, to: Array) -> None:
    for x in range(3):
        to[x] = T[x, 0] * p[0] + T[x, 1] * p[1] + T[x, 2] * p[2] + T[x, 3]


@inner_kernel
def _turn(v: Array, R: Array, to: Array) -> None:
    for x in range(3):
        to[x] = R[x, 0] * v[0] + R[x, 1] * v[1] + R[x, 2] * v[2]


@kernel
def _collide(a: Arrays, b: Arrays, tolerance: float) -> bool:
    """See ``collide``."""
    for i in range(len(a.boxes)):
        for j in range(len(b.boxes)):
            if _boxes_near(a, i, b, j, 0.0) and _depth(a, i, b, j) > max(tolerance, _touch(a, i, b, j)):
                return True
    return False


@kernel
def _near(a: Arrays, b: Arrays, reach: float) -> NDArray[np.int64]:
    """See ``near_parts``."""
    pairs = np.empty((len(a.boxes) * len(b.boxes), 2), np.int64)
    k = 0
    for i in range(len(a.boxes)):
        for j in range(len(b.boxes)):
            if _boxes_near(a, i, b, j, reach) and not _has_gap(a, i, b, j, reach):
                pairs[k, 0], pairs[k, 1] = i, j
                k += 1
    return pairs[:k].copy()


@kernel
def _shift(a: Arrays, b: Arrays, u: Array, clearance: float) -> float:
    """See ``smallest_shift``."""
    size = len(a.boxes) * len(b.boxes)
    pairs, starts, ends = np.empty((size, 2), np.int64), np.empty(size), np.empty(size)
    found = _meeting(a.boxes, b.boxes, u, -clearance, pairs, starts, ends)
    order = np.arange(found)
    sort_kernel(-ends, order, np.empty((DEPTH, 2), np.int64))
    known, low, high = np.zeros(found, np.bool_), np.empty(found), np.empty(found)
    t = 0.0
    # A pair matters once t is past the start of its boxes' overlap, and while that may end behind what is known. t
    # jumps to the ends of intervals that hold it. Those whose boxes overlap longest come first: they spare the others.
    while True:
        end = t
        for k in order:
            if ends[k] + clearance <= end:
                break
            if starts[k] >= t:
                continue
            if not known[k]:
                low[k], high[k] = _interval(a, pairs[k, 0], b, pairs[k, 1], u, end - clearance, np.inf)
                known[k] = True
            if low[k] < t:
                end = max(end, high[k] + clearance)
        if end <= t:
            return t
        t = end


@kernel
def _travel(a: Arrays, b: Arrays, u: Array) -> float:
    """See ``free_travel``."""
    size = len(a.boxes) * len(b.boxes)
    pairs, starts, ends = np.empty((size, 2), np.int64), np.empty(size), np.empty(size)
    found = _meeting(a.boxes, b.boxes, u, 0.0, pairs, starts, ends)
    order = np.arange(found)
    sort_kernel(starts, order, np.empty((DEPTH, 2), np.int64))
    t = np.inf
    for k in order:
        if starts[k] >= t:
            break
        low, _ = _interval(a, pairs[k, 0], b, pairs[k, 1], u, 0.0, t)
        t = min(t, low)
    return max(0.0, t)


@inner_kernel
def _meeting(a: Array, b: Array, u: Array, beyond: float, pairs: NDArray[np.int64], starts: Array, ends: Array) -> int:
    """Swept broad phase: fill ``pairs`` (n m, 2) with those of boxes (n, 2, 3), (m, 2, 3) that overlap at some shift
    t > ``beyond`` of the first along u, ``starts`` and ``ends`` (n m,) with the t between which they do; returns how
    many."""
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
                pairs[k, 0], pairs[k, 1], starts[k], ends[k] = i, j, first, last
                k += 1
    return k


@inner_kernel
def _boxes_near(a: Arrays, i: int, b: Arrays, j: int, reach: float) -> bool:
    """Whether boxes of parts are less than ``reach`` apart in every axis; for 0 whether they overlap."""
    for x in range(3):
        if a.boxes[i, 0, x] - b.boxes[j, 1, x] >= reach or b.boxes[j, 0, x] - a.boxes[i, 1, x] >= reach:
            return False
    return True


@inner_kernel
def _touch(a: Arrays, i: int, b: Arrays, j: int) -> float:
    """Overlap up to which two parts are in contact."""
    return TOUCH * (_diagonal(a.boxes[i]) + _diagonal(b.boxes[j]))


@inner_kernel
def _diagonal(box: Array) -> float:
    x, y, z = box[1, 0] - box[0, 0], box[1, 1] - box[0, 1], box[1, 2] - box[0, 2]
    return np.sqrt(x * x + y * y + z * z)


@inner_kernel
def _has_gap(a: Arrays, i: int, b: Arrays, j: int, gap: float) -> bool:
    p, q = a.begins, b.begins
    return has_gap(
        a.vertices[p[i, 0] : p[i + 1, 0]],
        a.normals[p[i, 1] : p[i + 1, 1]],
        a.offsets[p[i, 1] : p[i + 1, 1]],
        b.vertices[q[j, 0] : q[j + 1, 0]],
        b.normals[q[j, 1] : q[j + 1, 1]],
        b.offsets[q[j, 1] : q[j + 1, 1]],
        gap,
    )


@inner_kernel
def _depth(a: Arrays, i: int, b: Arrays, j: int) -> float:
    p, q = a.begins, b.begins
    return depth_kernel(
        a.vertices[p[i, 0] : p[i + 1, 0]],
        a.normals[p[i, 1] : p[i + 1, 1]],
        a.offsets[p[i, 1] : p[i + 1, 1]],
        a.edge_starts[p[i, 2] : p[i + 1, 2]],
        a.edge_directions[p[i, 2] : p[i + 1, 2]],
        a.edge_normals[p[i, 2] : p[i + 1, 2]],
        b.vertices[q[j, 0] : q[j + 1, 0]],
        b.normals[q[j, 1] : q[j + 1, 1]],
        b.offsets[q[j, 1] : q[j + 1, 1]],
        b.edge_starts[q[j, 2] : q[j + 1, 2]],
        b.edge_directions[q[j, 2] : q[j + 1, 2]],
        b.edge_normals[q[j, 2] : q[j + 1, 2]],
        0.0,
    )


@inner_kernel
def _interval(a: Arrays, i: int, b: Arrays, j: int, u: Array, after: float, before: float) -> tuple[float, float]:
    p, q = a.begins, b.begins
    return interval_kernel(
        a.vertices[p[i, 0] : p[i + 1, 0]],
        a.normals[p[i, 1] : p[i + 1, 1]],
        a.offsets[p[i, 1] : p[i + 1, 1]],
        a.edge_starts[p[i, 2] : p[i + 1, 2]],
        a.edge_directions[p[i, 2] : p[i + 1, 2]],
        a.edge_normals[p[i, 2] : p[i + 1, 2]],
        b.vertices[q[j, 0] : q[j + 1, 0]],
        b.normals[q[j, 1] : q[j + 1, 1]],
        b.offsets[q[j, 1] : q[j + 1, 1]],
        b.edge_starts[q[j, 2] : q[j + 1, 2]],
        b.edge_directions[q[j, 2] : q[j + 1, 2]],
        b.edge_normals[q[j, 2] : q[j + 1, 2]],
        u,
        _touch(a, i, b, j) / 2,
        after,
        before,
    )


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    part = ConvexPart.hull_of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    a = placed([part, part], np.eye(4))
    collide(a, a)
    near_parts(a, a, 0.0)
    smallest_shift(a, a, UP)
    free_travel(a, a, UP)
