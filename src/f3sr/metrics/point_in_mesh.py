"""Points inside closed surfaces, by signed crossings of a vertical ray, and inside unions of convex parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array
from f3sr.runtime.kernels import inline_kernel, inner_kernel, kernel
from f3sr.vision.rasterizer import fixed

PER_CELL = 2.0
"""Mean number of triangles per cell of the grid that finds those over a point."""


def winding_number(points: Array, vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """How often a closed surface, ``vertices`` (n, 3) and ``faces`` (m, 3), winds around each of ``points`` (k, 3).

    1 inside a surface that faces outward, 0 outside. Exact but for points within rounding of the surface: what two
    triangles share counts for one of them, so no ray slips through an edge or a corner.
    """
    number = np.zeros(len(points), np.int64)
    if not len(points):
        return number
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    triangles = vertices[faces]
    first, last = triangles.min(1), triangles.max(1)
    # Rays go up: only triangles over the points' rectangle that end above the lowest point can be hit.
    above = np.all(first[:, :2] <= high, 1) & np.all(last[:, :2] >= low, 1) & (last[:, 2] > points[:, 2].min())
    triangles = np.ascontiguousarray(triangles[above])
    side = max(1, int(np.sqrt(len(triangles) / PER_CELL)))
    width = np.maximum((high - low) / side, np.finfo(float).tiny)
    _count(fixed(points, float), triangles, low, width, side, number)
    return number


@inline_kernel
def _cell(x: float, low: float, width: float, side: int) -> int:
    return int(min(max((x - low) / width, 0.0), side - 1.0))


@inner_kernel
def _crosses(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> int:
    """1 where the directed edge a-b runs up through y to the right of x, -1 where it runs down; an edge gives exactly
    the opposite of its reverse."""
    # Half open in y: a vertex at the ray's height counts for one of its two edges.
    if (ay <= y) == (by <= y):
        return 0
    # Each direction is evaluated from its lower end, so that an edge and its reverse round alike.
    if ay <= y:
        return 1 if (bx - ax) * (y - ay) - (x - ax) * (by - ay) > 0 else 0
    return -1 if (ax - bx) * (y - by) - (x - bx) * (ay - by) > 0 else 0


@inner_kernel
def _height(x: float, y: float, t: Any) -> float:
    """Of a triangle's plane over (x, y), within the triangle's own heights."""
    ux, uy, vx, vy = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[2, 0] - t[0, 0], t[2, 1] - t[0, 1]
    area = ux * vy - uy * vx
    low, high = min(t[0, 2], t[1, 2], t[2, 2]), max(t[0, 2], t[1, 2], t[2, 2])
    # Seen from its edge: any height between its own is on it.
    if area == 0:
        return (low + high) / 2
    px, py = x - t[0, 0], y - t[0, 1]
    z = t[0, 2] + ((px * vy - py * vx) * (t[1, 2] - t[0, 2]) + (ux * py - uy * px) * (t[2, 2] - t[0, 2])) / area
    return min(max(z, low), high)


@inner_kernel
def _box(t: Any, low: Any, width: Any, side: int, box: Any) -> None:
    """First and last cell, along x and along y, that a triangle may lie over."""
    for k in range(2):
        box[k] = _cell(min(t[0, k], t[1, k], t[2, k]), low[k], width[k], side)
        box[2 + k] = _cell(max(t[0, k], t[1, k], t[2, k]), low[k], width[k], side)


@inner_kernel
def _bins(triangles: Any, low: Any, width: Any, side: int) -> Any:
    """Triangles per cell, as starts (side * side + 1,) into a list of members."""
    box, starts = np.empty(4, np.int64), np.zeros(side * side + 1, np.int64)
    for f in range(len(triangles)):
        _box(triangles[f], low, width, side, box)
        for i in range(box[0], box[2] + 1):
            for j in range(box[1], box[3] + 1):
                starts[i * side + j + 1] += 1
    # Counting sort: counts, then starts, then members (compressed rows).
    filled = np.empty(side * side, np.int64)
    for cell in range(len(filled)):
        filled[cell] = starts[cell]
        starts[cell + 1] += starts[cell]
    members = np.empty(starts[len(filled)], np.int64)
    for f in range(len(triangles)):
        _box(triangles[f], low, width, side, box)
        for i in range(box[0], box[2] + 1):
            for j in range(box[1], box[3] + 1):
                members[filled[i * side + j]] = f
                filled[i * side + j] += 1
    return starts, members


@kernel
def _count(points: Any, triangles: Any, low: Any, width: Any, side: int, number: Any) -> None:
    """Add up the crossings of every point's ray, over the triangles of its cell."""
    starts, members = _bins(triangles, low, width, side)
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        cell = _cell(x, low[0], width[0], side) * side + _cell(y, low[1], width[1], side)
        for n in range(starts[cell], starts[cell + 1]):
            t = triangles[members[n]]
            # The winding number of the triangle's projection around (x, y): 1 if it faces up, -1 if down, 0 beside it.
            turn = _crosses(x, y, t[0, 0], t[0, 1], t[1, 0], t[1, 1])
            turn += _crosses(x, y, t[1, 0], t[1, 1], t[2, 0], t[2, 1])
            turn += _crosses(x, y, t[2, 0], t[2, 1], t[0, 0], t[0, 1])
            if turn and _height(x, y, t) > z:
                number[k] += turn


def union_distance(points: Array, parts: Sequence[ConvexPart]) -> Array:
    """Signed distance (k,) of points (k, 3) to the facet planes of the part that they are least outside of.

    It is negative inside some part. Outside it is a lower bound of the distance, as a corner may be nearest."""
    polytopes = [Polytope.of(p) for p in parts]
    planes = np.concatenate([np.column_stack([p.normals, p.offsets]) for p in polytopes])
    starts = np.cumsum([0, *(len(p.offsets) for p in polytopes)])
    return _union_distance(fixed(points, float), planes, starts)


@kernel
def _union_distance(points: Any, planes: Any, starts: Any) -> Any:
    """``union_distance`` to ``planes`` (f, 4), rows (normal, offset), of parts that begin at ``starts`` (p + 1,)."""
    least = np.empty(len(points))
    near = 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        best, first = np.inf, near
        for turn in range(len(starts) - 1):  # the last point's part first: it is likely to be this one's too
            p = first if turn == 0 else (turn - 1 if turn <= first else turn)
            beyond = -np.inf
            for i in range(starts[p], starts[p + 1]):
                beyond = max(beyond, planes[i, 0] * x + planes[i, 1] * y + planes[i, 2] * z - planes[i, 3])
                # The maximum over facets only grows: this part cannot be nearer than the best one.
                if beyond >= best:
                    break
            if beyond < best:
                best, near = beyond, p
        least[k] = best
    return least


def warm_up() -> None:
    """Compile every kernel of this module."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    points = np.array([[0.2, 0.2, 0.2]])
    winding_number(points, corners, faces)
    union_distance(points, [ConvexPart(vertices=corners, faces=faces)])
