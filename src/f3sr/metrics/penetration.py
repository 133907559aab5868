"""R_pen: how many triangles of different objects pierce each other, on surfaces remeshed to one edge length."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.runtime.kernels import inline_kernel, inner_kernel, kernel

EDGE_LENGTH = 0.01
"""Longest edge of refined surfaces, as a share of the scene's diagonal (equation 12's protocol)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Crossing:
    """Where the surfaces ``a`` and ``b`` (by index) pierce each other: ``count`` pairs of triangles, all inside the
    box ``bounds`` (2, 3) [m]."""

    a: int
    b: int
    count: int
    bounds: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Penetration:
    """Equation 12: ``r_pen`` is the number of ``crossings``, times the mean edge, by the scene's diagonal."""

    r_pen: float
    crossings: int
    pairs: tuple[Crossing, ...]
    """The pairs of surfaces that cross at all."""


Surface = tuple[Array, NDArray[np.int32]]
"""World vertices (n, 3) [m] and faces (m, 3)."""


def penetration(surfaces: Sequence[Surface]) -> Penetration:
    """R_pen of a scene of welded surfaces, one per object.

    Surfaces are refined until no edge is longer than 1% of the scene's diagonal. Surfaces that do not cross need no
    refinement. They are never decimated: a shift by more than the contact margin would make false crossings.
    """
    corners = np.concatenate([np.stack([v.min(0), v.max(0)]) for v, _ in surfaces])
    diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
    length = EDGE_LENGTH * diagonal
    if not any(_crossings(surfaces, length)):
        return Penetration(r_pen=0.0, crossings=0, pairs=())
    refined = [refine(v, f, length) for v, f in surfaces]
    mean_edge = float(np.concatenate([_edge_lengths(v, f) for v, f in refined]).mean())
    pairs = tuple(_crossings(refined, length))
    total = sum(pair.count for pair in pairs)
    return Penetration(r_pen=total * mean_edge / diagonal, crossings=total, pairs=pairs)


def _crossings(surfaces: Sequence[Surface], length: float) -> Iterator[Crossing]:
    """The pairs of surfaces, with edges of about ``length`` [m], that cross."""
    boxes = [np.stack([v.min(0), v.max(0)]) for v, _ in surfaces]
    for a, b, low, high in _meeting(boxes):
        count, bounds = crossings_of(_within(surfaces[a], low, high), _within(surfaces[b], low, high), 1.5 * length)
        if count:
            yield Crossing(a=b, b=a, count=count, bounds=bounds)


def _meeting(boxes: Sequence[Array]) -> Iterator[tuple[int, int, Array, Array]]:
    """Pairs of boxes (2, 3) that overlap, the later one first, and the corners of what they share."""
    for a, box in enumerate(boxes):
        for b, other in enumerate(boxes[:a]):
            low, high = np.maximum(box[0], other[0]), np.minimum(box[1], other[1])
            if np.all(low < high):
                yield a, b, low, high


def _within(surface: Surface, low: Array, high: Array) -> Array:
    """The triangles (n, 3, 3) of a surface whose boxes meet a box."""
    vertices, faces = surface
    # Bit 0: below the box, bit 1: above it, per axis. A triangle is apart if its three corners share a bit on some
    # axis.
    beyond = (vertices < low).astype(np.uint8) + 2 * (vertices > high).astype(np.uint8)
    apart = np.bitwise_and.reduce(beyond[faces], axis=1).any(1)
    return vertices[faces[~apart]]


def refine(vertices: Array, faces: NDArray[np.int32], length: float) -> Surface:
    """The same surface with no edge longer than ``length`` [m]: Manifold where the mesh is one, else subdivision."""
    import manifold3d as mf
    import trimesh

    solid = mf.Manifold(mf.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))
    if solid.status() == mf.Error.NoError and solid.num_tri():
        mesh = solid.refine_to_length(length).to_mesh()
        return np.asarray(mesh.vert_properties[:, :3], float), np.asarray(mesh.tri_verts, np.int32)
    finer = trimesh.remesh.subdivide_to_size(vertices, faces, length, max_iter=20)
    return np.asarray(finer[0], float), np.asarray(finer[1], np.int32)


def crossings_of(a: Array, b: Array, cell: float) -> tuple[int, Array]:
    """Pairs of triangles, one of a (n, 3, 3) and one of b (m, 3, 3), where an edge of one strictly pierces the other:
    how many, and the box (2, 3) around where such pairs meet.

    ``cell`` [m] is the width of the grid that finds near pairs; any positive value gives the same answer.
    """
    bounds = np.array([[np.inf] * 3, [-np.inf] * 3])
    if not len(a) or not len(b):
        return 0, bounds
    # Crossings lie in the box that both sets share; the grid covers that box.
    low = np.maximum(a.min((0, 1)), b.min((0, 1)))
    high = np.minimum(a.max((0, 1)), b.max((0, 1)))
    if np.any(low >= high):
        return 0, bounds
    a, b = (t[np.all(t.max(1) >= low, 1) & np.all(t.min(1) <= high, 1)] for t in (a, b))
    # At most 256 cells a side: a tiny cell must not exhaust memory.
    cells = np.clip(((high - low) / cell).astype(np.int64) + 1, 1, 256)
    return int(_count(np.ascontiguousarray(a), np.ascontiguousarray(b), low, high, cells, bounds)), bounds


def warm_up() -> None:
    """Compile every kernel of this module."""
    t = np.array([[[0.0, 0, 0], [1, 0, 1], [0, 1, 1]]])
    crossings_of(t, t[:, :, [2, 0, 1]], 0.5)


def _edge_lengths(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Of every edge once."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    # An edge as one number, low * n + high: unique numbers are faster than unique rows.
    a, b = np.divmod(np.unique(edges[:, 0] * len(vertices) + edges[:, 1]), len(vertices))
    return np.linalg.norm(vertices[a] - vertices[b], axis=1)


Point = tuple[float, float, float]


@inline_kernel
def _orient(a: Point, b: Point, c: Point, d: Point) -> float:
    """Six times the signed volume of the tetrahedron a, b, c, d."""
    ax, ay, az = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    bx, by, bz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cx, cy, cz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    return ax * (by * cz - bz * cy) - ay * (bx * cz - bz * cx) + az * (bx * cy - by * cx)


@inner_kernel
def _pierces(segment: Any, k: int, t: Any) -> bool:
    """Whether edge ``k`` of a triangle crosses the interior of triangle t strictly."""
    # The ends lie strictly on both sides of the triangle's plane, and the segment passes all three edges on one side.
    n = (k + 1) % 3
    p, q = (segment[k, 0], segment[k, 1], segment[k, 2]), (segment[n, 0], segment[n, 1], segment[n, 2])
    a, b, c = (t[0, 0], t[0, 1], t[0, 2]), (t[1, 0], t[1, 1], t[1, 2]), (t[2, 0], t[2, 1], t[2, 2])
    s, e = _orient(a, b, c, p), _orient(a, b, c, q)
    if not ((s > 0 and e < 0) or (s < 0 and e > 0)):
        return False
    u, v, w = _orient(p, q, a, b), _orient(p, q, b, c), _orient(p, q, c, a)
    return (u > 0 and v > 0 and w > 0) or (u < 0 and v < 0 and w < 0)


@inner_kernel
def _cross(s: Any, t: Any) -> bool:
    """Whether an edge of one triangle pierces the other."""
    for k in range(3):
        if min(s[0, k], s[1, k], s[2, k]) > max(t[0, k], t[1, k], t[2, k]):
            return False
        if max(s[0, k], s[1, k], s[2, k]) < min(t[0, k], t[1, k], t[2, k]):
            return False
    for e in range(3):  # noqa: SIM110 - numba compiles no generators
        if _pierces(s, e, t) or _pierces(t, e, s):
            return True
    return False


@inner_kernel
def _box(t: Any, low: Any, high: Any, cells: Any, out: Any) -> None:
    """Grid cells (first and last per axis) that a triangle's box touches."""
    for k in range(3):
        width = (high[k] - low[k]) / cells[k]
        first = int((min(t[0, k], t[1, k], t[2, k]) - low[k]) / width)
        last = int((max(t[0, k], t[1, k], t[2, k]) - low[k]) / width)
        out[k] = min(max(first, 0), cells[k] - 1)
        out[3 + k] = min(max(last, 0), cells[k] - 1)


@inner_kernel
def _bins(b: Any, low: Any, high: Any, cells: Any) -> Any:
    """Triangles per grid cell, as starts (n + 1,) into a list of members."""
    box = np.empty(6, np.int64)
    # Counting sort: counts, then starts, then members (compressed rows). A triangle is a member of every cell of its
    # box.
    starts = np.zeros(cells[0] * cells[1] * cells[2] + 1, np.int64)
    for t in range(b.shape[0]):
        _box(b[t], low, high, cells, box)
        for i in range(box[0], box[3] + 1):
            for j in range(box[1], box[4] + 1):
                for k in range(box[2], box[5] + 1):
                    starts[(i * cells[1] + j) * cells[2] + k + 1] += 1
    filled = np.empty(len(starts) - 1, np.int64)
    for cell in range(len(filled)):
        filled[cell] = starts[cell]
        starts[cell + 1] += starts[cell]
    members = np.empty(starts[len(filled)], np.int64)
    for t in range(b.shape[0]):
        _box(b[t], low, high, cells, box)
        for i in range(box[0], box[3] + 1):
            for j in range(box[1], box[4] + 1):
                for k in range(box[2], box[5] + 1):
                    cell = (i * cells[1] + j) * cells[2] + k
                    members[filled[cell]] = t
                    filled[cell] += 1
    return starts, members


@inner_kernel
def _meet(s: Any, t: Any, bounds: Any) -> None:
    """Let ``bounds`` (2, 3) take in the box that two triangles share."""
    for k in range(3):
        low = max(min(s[0, k], s[1, k], s[2, k]), min(t[0, k], t[1, k], t[2, k]))
        high = min(max(s[0, k], s[1, k], s[2, k]), max(t[0, k], t[1, k], t[2, k]))
        bounds[0, k], bounds[1, k] = min(bounds[0, k], low), max(bounds[1, k], high)


@kernel
def _count(a: Any, b: Any, low: Any, high: Any, cells: Any, bounds: Any) -> int:
    """Crossing pairs; each pair is tested once, in the first cell that both share. ``bounds`` grows around them."""
    starts, members = _bins(b, low, high, cells)
    # seen[s]: the last triangle of a that s was tested against. A pair may share many cells.
    seen = np.full(b.shape[0], -1, np.int64)
    box = np.empty(6, np.int64)
    total = 0
    for t in range(a.shape[0]):
        _box(a[t], low, high, cells, box)
        for i in range(box[0], box[3] + 1):
            for j in range(box[1], box[4] + 1):
                for k in range(box[2], box[5] + 1):
                    cell = (i * cells[1] + j) * cells[2] + k
                    for n in range(starts[cell], starts[cell + 1]):
                        s = members[n]
                        if seen[s] != t:
                            seen[s] = t
                            if _cross(a[t], b[s]):
                                total += 1
                                _meet(a[t], b[s], bounds)
    return total
