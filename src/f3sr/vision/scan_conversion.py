"""Triangle scan conversion in kernels: projection, homogeneous edge functions and the spans of pixels they hold.

``rasterizer`` explains the method; every z-buffer of the product draws with these.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, inner_kernel, kernel

PAD = 1e-6
"""Slack [px] of bounding boxes: wider than any rounding error, so that only the edge functions decide."""

ROUNDING = 1e-15
"""Bound of the relative rounding error of an edge function: nine half units in the last place, 9 * 2^-53."""

SHORT = 8
"""Longest span [px] that is tested pixel by pixel: below it, solving for the crossings costs more."""


def warm_up() -> None:
    """Compile the kernel that Python calls, with the types that it is called with; the rest belong to their callers."""
    vertices, K = np.array([[0.0, 0, 1]]), np.eye(3)
    for given in (vertices, K):
        given.setflags(write=False)
    project(vertices, K, 1e-3, np.empty((1, 5)))


@kernel
def project(vertices: NDArray[Any], K: NDArray[Any], near: float, points: NDArray[Any]) -> tuple[float, float]:
    """Fill ``points`` (n, 5) with p = K v (so p_z = z) and its pixel u, v, the latter only where z >= near.

    ``vertices`` (n, 3) [m] are in camera axes, ``K`` (3, 3) [px] has the last row (0, 0, 1). Where z < near, u and v
    are NaN. Returns the lowest and highest v; infinite ones when a vertex lies before the near plane."""
    low, high = np.inf, -np.inf
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        points[i, 0] = K[0, 0] * x + K[0, 1] * y + K[0, 2] * z
        points[i, 1] = K[1, 0] * x + K[1, 1] * y + K[1, 2] * z
        points[i, 2] = z
        if z >= near:
            points[i, 3] = points[i, 0] / z
            points[i, 4] = points[i, 1] / z
            low = points[i, 4] if points[i, 4] < low else low
            high = points[i, 4] if points[i, 4] > high else high
        else:
            points[i, 3] = points[i, 4] = np.nan
            # Later vertices cannot narrow it again: no v is below -inf or above inf.
            low, high = -np.inf, np.inf
    return low, high


# Small kernels pass tuples of numbers: a numba array handed on in a loop costs atomic reference counts.

Vector = tuple[float, float, float]
Point = tuple[float, float, float, float, float]
"""A row of ``points``: p_x, p_y, z, u, v."""
Edges = tuple[Vector, Vector, Vector, Vector]
"""Coefficients of e_a, e_b, e_c and of the near plane, each a function of q."""
Row = tuple[float, float, float, float]
"""The four edge functions' constant parts along one row of pixels."""


@inline_kernel
def corner(points: NDArray[Any], i: int) -> Point:
    """Row ``i`` of ``points`` (n, 5), as numbers."""
    return points[i, 0], points[i, 1], points[i, 2], points[i, 3], points[i, 4]


@inline_kernel
def bounds(a: Point, b: Point, c: Point, near: float) -> tuple[float, float, float, float]:
    """Lowest and highest u, lowest and highest v of a triangle's part at z >= near; low > high if none."""
    if min(a[2], b[2], c[2]) < near:
        return clipped_bounds((a, b, c), near)
    return min(a[3], b[3], c[3]), max(a[3], b[3], c[3]), min(a[4], b[4], c[4]), max(a[4], b[4], c[4])


@inner_kernel
def clipped_bounds(corners: tuple[Point, Point, Point], near: float) -> tuple[float, float, float, float]:
    """``bounds`` of a triangle that crosses the near plane, a pixel wider for the rounding in the cuts."""
    u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
    for k in range(3):
        p, q = corners[k], corners[(k + 1) % 3]
        if p[2] >= near:
            u0, u1, v0, v1 = min(u0, p[3]), max(u1, p[3]), min(v0, p[4]), max(v1, p[4])
        if (p[2] >= near) != (q[2] >= near):
            t = (near - p[2]) / (q[2] - p[2])  # where the edge p q crosses z = near
            u, v = (p[0] + t * (q[0] - p[0])) / near, (p[1] + t * (q[1] - p[1])) / near
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    return u0 - 1, u1 + 1, v0 - 1, v1 + 1


@inline_kernel
def centres(low: float, high: float, start: int, stop: int) -> tuple[int, int]:
    """First and last index in [start, stop) of the pixels whose centres, at +0.5, lie in [low, high]."""
    # Compared as floats: an infinite or a huge bound has no int. (0, -1) is the empty range.
    first = max(np.ceil(low - 0.5 - PAD), start)
    last = min(np.floor(high - 0.5 + PAD), stop - 1.0)
    return (int(first), int(last)) if first <= last else (0, -1)


@inline_kernel
def edge(p: Point, q: Point, sign: float, size: float) -> Vector:
    """sign (p x q), raised by what rounding can do to its product with a pixel (x, y, 1), x and y <= size."""
    # Raising by the error bound decides for "inside": triangles overlap by a billionth of a pixel, none leaves a crack.
    yz, zy, zx, xz, xy, yx = p[1] * q[2], p[2] * q[1], p[2] * q[0], p[0] * q[2], p[0] * q[1], p[1] * q[0]
    doubt = ROUNDING * ((abs(yz) + abs(zy) + abs(zx) + abs(xz)) * size + abs(xy) + abs(yx))
    return sign * (yz - zy), sign * (zx - xz), sign * (xy - yx) + doubt


@inline_kernel
def determinant(a: Point, b: Point, c: Point) -> float:
    """det(a, b, c) = a . ((b - a) x (c - a)); with differences, for tiny triangles far away."""
    # Same determinant, as a . (a x c) = a . (b x a) = 0; the plain triple product would cancel.
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return a[0] * (by * cz - bz * cy) + a[1] * (bz * cx - bx * cz) + a[2] * (bx * cy - by * cx)


@inline_kernel
def edge_functions(a: Point, b: Point, c: Point, sign: float, size: float, near: float) -> Edges:
    """The edge functions, turned by ``sign``, that of det(a, b, c), so that they are >= 0 inside."""
    ea, eb, ec = edge(b, c, sign, size), edge(c, a, sign, size), edge(a, b, sign, size)
    za, zb, zc = a[2] - near, b[2] - near, c[2] - near
    if min(za, zb, zc) >= 0:  # all in front: the near plane's function is 0, which is inside everywhere
        return ea, eb, ec, (0.0, 0.0, 0.0)
    # At a pixel, sum(z_k e_k) / sum(e_k) is the depth, so sum((z_k - near) e_k) >= 0 says depth >= near.
    x = za * ea[0] + zb * eb[0] + zc * ec[0]
    y = za * ea[1] + zb * eb[1] + zc * ec[1]
    z = za * ea[2] + zb * eb[2] + zc * ec[2]
    return ea, eb, ec, (x, y, z)


@inline_kernel
def row_of(edges: Edges, y: float) -> Row:
    """What the edge functions are at x = 0 of the row through ``y`` [px]: their first coefficient is the slope in x."""
    ea, eb, ec, en = edges
    return ea[1] * y + ea[2], eb[1] * y + eb[2], ec[1] * y + ec[2], en[1] * y + en[2]


@inline_kernel
def inside(x: float, edges: Edges, row: Row) -> bool:
    """Whether the place ``x`` [px] of a row is in the triangle and not before the near plane."""
    ea, eb, ec, en = edges
    # Bitwise and: four comparisons without a branch.
    in_triangle = (ea[0] * x + row[0] >= 0) & (eb[0] * x + row[1] >= 0) & (ec[0] * x + row[2] >= 0)
    return in_triangle & (en[0] * x + row[3] >= 0)


@inline_kernel
def narrowed(low: float, high: float, slope: float, constant: float) -> tuple[float, float]:
    """Pixels [low, high] without those where slope x + constant < 0 at the centre; up to one too many at each end."""
    if slope > 0:
        # Rounded outward: the loops of ``span`` drop what is too much, nothing would bring back what is missing.
        return max(low, np.floor(-constant / slope - 0.5)), high
    if slope < 0:
        return low, min(high, np.ceil(-constant / slope - 0.5))
    return low, high


@inline_kernel
def span(edges: Edges, row: Row, first: int, last: int) -> tuple[int, int]:
    """First and last pixel of a row in [first, last] that lie inside; first > last when none does.

    In a long row the crossings are solved for; then both ends are tested exactly."""
    if last - first > SHORT:
        low, high = float(first), float(last)
        low, high = narrowed(low, high, edges[0][0], row[0])
        low, high = narrowed(low, high, edges[1][0], row[1])
        low, high = narrowed(low, high, edges[2][0], row[2])
        low, high = narrowed(low, high, edges[3][0], row[3])
        # A crossing may be infinite, which has no int; then the range is empty.
        low, high = (low, high) if low <= high else (0.0, -1.0)
        first, last = int(low), int(high)
    while first <= last and not inside(first + 0.5, edges, row):
        first += 1
    while first <= last and not inside(last + 0.5, edges, row):
        last -= 1
    return first, last
