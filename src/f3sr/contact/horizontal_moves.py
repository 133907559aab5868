"""Horizontal moves of a convex polytope that collide with another one: a convex polygon, and the ways out of several.

A facet of the Minkowski difference is a line in the plane of horizontal moves (``polytopes``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.polytopes import PARALLEL, Polytope, planes_kernel, touch
from f3sr.contact.sort_order import sort_order
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array
from f3sr.runtime.kernels import inner_kernel, kernel


def forbidden_polygon(a: Polytope, b: Polytope) -> Array:
    """The horizontal moves of a that collide with b: half-planes (k, 3), ``n . x + h > 0``, none where no move does."""
    low, high = b.bounds[0] - a.bounds[1], b.bounds[1] - a.bounds[0]
    return _sliced(planes_kernel(*a.packed, *b.packed), touch(a, b) / 2, low, high)


def nearest_free(polygons: Sequence[Array], slack: float) -> Array:
    """The point (2,) nearest to the origin that lies in none of the polygons deeper than ``slack``."""
    planes, starts = np.concatenate(polygons), np.cumsum([0, *map(len, polygons)]).astype(np.int64)
    ends, near = np.empty((len(planes), 2)), np.empty(len(planes))
    if _measure_sides(planes, starts, slack, ends, near):
        return np.zeros(2)
    return np.array(_nearest_free(planes, starts, ends, near, sort_order(near), slack))


@kernel
def _sliced(facets: Array, slack: float, low: Array, high: Array) -> Array:
    """The half-planes (k, 3) that bound facets (n, 4) in the plane z = 0 of shifts; none where they hold no shift.

    Shifts that collide are between ``low`` and ``high`` (2,)."""
    planes = np.empty((len(facets) + 4, 3))
    k = 0
    for i in range(len(facets)):
        x, y, height = facets[i, 0], facets[i, 1], facets[i, 3] - slack
        length = np.sqrt(x * x + y * y)
        if length > PARALLEL:
            # Divided by the length of its level part the normal is unit again.
            planes[k, 0], planes[k, 1], planes[k, 2] = x / length, y / length, height / length
            k += 1
        elif height <= 0.0:  # a level facet separates them at any shift
            return planes[:0]
    # Box against box bounds every shift that collides: the start of clipping. Order: bottom, right, top, left.
    planes[k], planes[k + 1] = np.array([0.0, 1.0, -low[1]]), np.array([-1.0, 0.0, high[0]])
    planes[k + 2], planes[k + 3] = np.array([0.0, -1.0, high[1]]), np.array([1.0, 0.0, -low[0]])
    # Two buffers swap after each clip; a clip adds at most one corner.
    corners, sides = np.empty((2, k + 12, 2)), np.empty((2, k + 12), np.int64)
    return planes[sides[0, : _polygon_sides(planes[: k + 4], corners, sides)]]


@inner_kernel
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


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    a = Polytope.of(ConvexPart.hull_of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])))
    nearest_free([forbidden_polygon(a, a)], 0.0)
