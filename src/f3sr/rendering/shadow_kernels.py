"""Kernels of light and shadow: maps of what faces a light, shadows thrown on the ground, and light that arrives."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, inner_kernel, kernel
from f3sr.vision.scan_conversion import Point, bounds, centres, corner, determinant, edge_functions, row_of, span

FADE = 12.0
"""Texels from the border of a map over which its shadows fade: what leaves the scene does not lose them at once."""


@kernel
def cast_map(
    vertices: NDArray[Any], faces: NDArray[Any], closed: bool, frame: NDArray[Any], nearest: NDArray[Any]
) -> None:
    """Raise the shadow map ``nearest`` (s, s) to the height towards the light that triangles reach.

    Rows of ``frame`` (3, 4) map a world point to column [texel], row [texel] and height against the light's rays [m].
    Of a ``closed`` surface only faces towards the light are drawn: the others are behind them."""
    # Height grows towards the light: of two occluders the higher one is nearer to it.
    side = len(nearest)
    placed = np.empty((len(vertices), 3))
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            placed[i, k] = frame[k, 0] * x + frame[k, 1] * y + frame[k, 2] * z + frame[k, 3]
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, va, ub, vb, uc, vc = placed[a, 0], placed[a, 1], placed[b, 0], placed[b, 1], placed[c, 0], placed[c, 1]
        left, right = centres(min(ua, ub, uc), max(ua, ub, uc), 0, side)
        top, bottom = centres(min(va, vb, vc), max(va, vb, vc), 0, side)
        # Twice the signed area in texels. The frame is right-handed with the height towards the light, so that outward
        # faces turned to the light have a positive one.
        area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        if left > right or top > bottom or area == 0 or (closed and area < 0):
            continue
        # Height is linear over the map: t = ta + wb tb + wc tc with the unnormalised barycentrics below.
        tb, tc = (placed[b, 2] - placed[a, 2]) / area, (placed[c, 2] - placed[a, 2]) / area
        sign = 1.0 if area > 0 else -1.0
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                # Barycentrics times the signed area: a texel is inside where all three have the area's sign.
                wb = (x - ua) * (vc - va) - (uc - ua) * (y - va)
                wc = (ub - ua) * (y - va) - (x - ua) * (vb - va)
                if sign * wb >= 0 and sign * wc >= 0 and sign * (area - wb - wc) >= 0:
                    t = np.float32(placed[a, 2] + wb * tb + wc * tc)
                    if t > nearest[row, column]:
                        nearest[row, column] = t


@kernel
def note_changes(
    nearest: NDArray[Any],
    before: NDArray[Any],
    parts: NDArray[Any],
    block: int,
    spans: NDArray[Any],
    limits: NDArray[Any],
) -> None:
    """Copy a light's map to ``before`` (s, s) in some ``parts`` and note the changes.

    ``parts`` (k, 4): first and last column, first and last row of each. ``spans`` (b, b, 2): per square of ``block``
    texels the least and largest height, old or new, of changed texels; inf and -inf where none changed. ``limits``
    (5,): first and last changed column, first and last changed row, largest height."""
    side = len(nearest)
    # Empty ranges: whatever is compared with them lies outside.
    for i in range(spans.shape[0]):
        for j in range(spans.shape[1]):
            spans[i, j, 0], spans[i, j, 1] = np.inf, -np.inf
    limits[0], limits[1], limits[2], limits[3], limits[4] = np.inf, -np.inf, np.inf, -np.inf, -np.inf
    for k in range(len(parts)):
        for row in range(max(parts[k, 2], 0), min(parts[k, 3] + 1, side)):
            for column in range(max(parts[k, 0], 0), min(parts[k, 1] + 1, side)):
                # Both heights count: a texel lights what the old one shaded, and shades what the new one hides.
                # ``parts`` may overlap; ``before`` is brought up to date at once, so that no change is noted twice.
                new, old = nearest[row, column], before[row, column]
                if new != old:
                    i, j = row // block, column // block
                    spans[i, j, 0] = min(spans[i, j, 0], new, old)
                    spans[i, j, 1] = max(spans[i, j, 1], new, old)
                    limits[0], limits[1] = min(limits[0], column), max(limits[1], column)
                    limits[2], limits[3] = min(limits[2], row), max(limits[3], row)
                    limits[4] = max(limits[4], new, old)
                    before[row, column] = new


Line = tuple[float, float, float]
"""(a, b, side) of a line x = a y + b: side is 1 if the triangle is to its right, -1 if to its left.

A level line has side 0; the triangle is where a y + b >= 0."""


@inline_kernel
def _side(ux: float, uy: float, vx: float, vy: float, sign: float) -> Line:
    """The line from u to v of a triangle that ``sign`` turns clockwise."""
    # a x + b y + c >= 0 inside; solved for x, the border is x = -(b y + c) / a.
    a, b = sign * (uy - vy), sign * (vx - ux)
    c = -(a * ux + b * uy)
    if a == 0:
        return b, c, 0.0
    return -b / a, -c / a, 1.0 if a > 0 else -1.0


@inline_kernel
def _cut(low: float, high: float, line: Line, y: float) -> tuple[float, float]:
    """The part of [low, high] in x that is inside a line at row y."""
    x = line[0] * y + line[1]
    if line[2] > 0:
        return max(low, x), high
    if line[2] < 0:
        return low, min(high, x)
    # A level line holds all of a row or nothing: (1, 0) is an empty interval.
    return (low, high) if x >= 0 else (1.0, 0.0)


@kernel
def cast_on_ground(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    closed: bool,
    P: NDArray[Any],
    lights: NDArray[Any],
    near: float,
    bits: NDArray[Any],
) -> None:
    """Set bit k of ``bits`` (h, w) where the ground z = 0 is in the shadow of triangles from light k.

    ``P`` (3, 4) = K T_camera_world projects the ground; ``lights`` (k, 3) point to the lights. Of a ``closed`` surface
    only one side is drawn: both sides have the same shadow."""
    height, width = bits.shape
    size = float(max(height, width))
    points = np.empty((len(vertices), 5))
    for light in range(len(lights)):
        bit = np.uint8(1 << light)
        # Shift of a shadow per height: (x, y, z) -> (x - z sx, y - z sy, 0). Lights are above the horizon.
        sx, sy = lights[light, 0] / lights[light, 2], lights[light, 1] / lights[light, 2]
        for i in range(len(vertices)):
            # The vertex's shadow on z = 0; what is below the ground casts from the ground.
            above = max(vertices[i, 2], 0.0)
            x, y = vertices[i, 0] - above * sx, vertices[i, 1] - above * sy
            # z = 0: the third column of P has no part.
            px, py = P[0, 0] * x + P[0, 1] * y + P[0, 3], P[1, 0] * x + P[1, 1] * y + P[1, 3]
            pz = P[2, 0] * x + P[2, 1] * y + P[2, 3]
            points[i, 0], points[i, 1], points[i, 2] = px, py, pz
            points[i, 3], points[i, 4] = (px / pz, py / pz) if pz >= near else (np.nan, np.nan)
        for f in range(len(faces)):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            # Rare, and exact: the homogeneous edge functions need no division by z. The path below is the fast one.
            if min(points[i, 2], points[j, 2], points[k, 2]) < near:
                _cover_clipped(corner(points, i), corner(points, j), corner(points, k), near, size, bit, bits)
                continue
            ux, uy, vx, vy = points[i, 3], points[i, 4], points[j, 3], points[j, 4]
            wx, wy = points[k, 3], points[k, 4]
            # A closed surface covers a point of the plane as often with one orientation as with the other. So faces of
            # one sign alone cast the whole shadow.
            area = (vx - ux) * (wy - uy) - (wx - ux) * (vy - uy)
            if area == 0 or (closed and area < 0):
                continue
            top, bottom = centres(min(uy, vy, wy), max(uy, vy, wy), 0, height)
            # Places in pixels, not indices: ``_cut`` narrows them, ``centres`` ends in indices.
            left, right = max(min(ux, vx, wx), 0.0), min(max(ux, vx, wx), float(width))
            if top > bottom or left > right:
                continue
            sign = 1.0 if area > 0 else -1.0
            first_side, second_side = _side(ux, uy, vx, vy, sign), _side(vx, vy, wx, wy, sign)
            third_side = _side(wx, wy, ux, uy, sign)
            for row in range(top, bottom + 1):
                low, high = _cut(left, right, first_side, row + 0.5)
                low, high = _cut(low, high, second_side, row + 0.5)
                low, high = _cut(low, high, third_side, row + 0.5)
                if low <= high:
                    first, last = centres(low, high, 0, width)
                    for column in range(first, last + 1):
                        bits[row, column] |= bit


@inner_kernel
def _cover_clipped(a: Point, b: Point, c: Point, near: float, size: float, bit: Any, bits: NDArray[Any]) -> None:
    """Set ``bit`` in ``bits`` (h, w) where the part of a triangle at z >= ``near`` covers the centre.

    ``size`` [px] is the longer side of ``bits``: it bounds the rounding of edge functions."""
    u0, u1, v0, v1 = bounds(a, b, c, near)
    top, bottom = centres(v0, v1, 0, bits.shape[0])
    left, right = centres(u0, u1, 0, bits.shape[1])
    det = determinant(a, b, c)
    if top > bottom or left > right or not 0 < abs(det) < np.inf:
        return
    edges = edge_functions(a, b, c, np.sign(det), size, near)
    for y in range(top, bottom + 1):
        first, last = span(edges, row_of(edges, y + 0.5), left, right)
        for x in range(first, last + 1):
            bits[y, x] |= bit


@inline_kernel
def arriving(
    px: float,
    py: float,
    pz: float,
    nx: float,
    ny: float,
    nz: float,
    light: int,
    directions: NDArray[Any],
    frames: NDArray[Any],
    maps: NDArray[Any],
    bias: float,
) -> float:
    """Cosine of a light's angle at a point with a normal, times the share of the light that arrives there.

    The share is the bilinear weight of the four texels around that hold nothing nearer (percentage-closer filtering,
    Reeves et al. 1987)."""
    cosine = nx * directions[light, 0] + ny * directions[light, 1] + nz * directions[light, 2]
    if cosine <= 0:
        return 0.0
    side = maps.shape[1]
    # Minus 0.5: from places to indices, as texel i has its centre at i + 0.5.
    u = frames[light, 0, 0] * px + frames[light, 0, 1] * py + frames[light, 0, 2] * pz + frames[light, 0, 3] - 0.5
    v = frames[light, 1, 0] * px + frames[light, 1, 1] * py + frames[light, 1, 2] * pz + frames[light, 1, 3] - 0.5
    inside = min(u, v, side - 1 - u, side - 1 - v)
    if not inside > 0:  # outside the map nothing casts; FADE texels inside its border shadows fade in
        return cosine
    # Own height plus bias: an occluder must be higher by more than that.
    t = frames[light, 2, 0] * px + frames[light, 2, 1] * py + frames[light, 2, 2] * pz + frames[light, 2, 3] + bias
    # inside > 0 keeps i, j, i + 1 and j + 1 in the map.
    i, j = int(u), int(v)
    fu, fv = u - i, v - j
    hidden = 0.0
    if maps[light, j, i] > t:
        hidden += (1 - fu) * (1 - fv)
    if maps[light, j, i + 1] > t:
        hidden += fu * (1 - fv)
    if maps[light, j + 1, i] > t:
        hidden += (1 - fu) * fv
    if maps[light, j + 1, i + 1] > t:
        hidden += fu * fv
    return cosine * (1 - hidden * min(inside / FADE, 1.0))


@kernel
def arrivals(
    points: NDArray[Any],
    normals: NDArray[Any],
    directions: NDArray[Any],
    frames: NDArray[Any],
    maps: NDArray[Any],
    offset: float,
    bias: float,
    out: NDArray[Any],
) -> None:
    """``arriving`` of every light (L,) at points (n, 3) with normals (n, 3), moved along these by ``offset`` [m], into
    ``out`` (n, L)."""
    for i in range(len(points)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        x, y, z = points[i, 0] + offset * nx, points[i, 1] + offset * ny, points[i, 2] + offset * nz
        for light in range(len(directions)):
            out[i, light] = arriving(x, y, z, nx, ny, nz, light, directions, frames, maps, bias)
