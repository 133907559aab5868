"""Kernels of what is seen: the nearest face at every sample, and its lit colour in linear light."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from f3sr.rendering.shadow_kernels import arriving
from f3sr.rendering.texture_kernels import UNIT
from f3sr.runtime.kernels import inline_kernel, kernel
from f3sr.vision.scan_conversion import bounds, centres, corner, determinant, edge_functions, row_of, span

SAME = 0.97
"""Least cosine between two normals at which samples of a pixel share one light: 14 degrees."""
NEARBY = 0.01
"""Largest difference of their depths at which they do, as a share of the depth."""


class Shapes(NamedTuple):
    """All triangles of a scene, as they were loaded."""

    faces: NDArray[np.int32]
    """(F, 3) rows of vertices."""
    object: NDArray[np.int32]
    """(F,) index of the object that a face belongs to."""
    slot: NDArray[np.int32]
    """(F,) row of the face's material in ``Textures``."""
    normals: NDArray[np.float32]
    """(F, 3, 3) unit normal of every corner, in the object's frame."""
    flat: NDArray[np.float32]
    """(F, 3) unit normal of the face itself, in the object's frame."""
    uv: NDArray[np.float32]
    """(V, 2) texture coordinates; 1 is the whole picture, v points up."""
    colors: NDArray[np.float32]
    """(V, 3) vertex colours in linear light, in [0, 1]."""


class Textures(NamedTuple):
    """Pictures of all materials at all levels of detail, in linear light, one after the other."""

    texels: NDArray[np.uint16]
    """(n, 3) linear light, ``UNIT`` is white; rows of a level follow each other from the top."""
    starts: NDArray[np.int64]
    """(S, L) first texel of a level; S materials, L levels of the largest texture."""
    sizes: NDArray[np.int32]
    """(S, L, 2) height and width of a level."""
    levels: NDArray[np.int32]
    """(S,) how many there are, at least 1."""


class FrameGeometry(NamedTuple):
    """Where everything is in one frame."""

    points: NDArray[np.float64]
    """(V, 5) rows of ``scan_conversion.Point``, in pixels of the grid of samples."""
    turns: NDArray[np.float64]
    """(O, 3, 3) rotations from the objects' frames to the world."""
    extents: NDArray[np.float64]
    """(O, 4) least and largest u, least and largest v of every object [samples].

    An object with a vertex before the near plane has (-inf, inf, -inf, inf): it may be anywhere. An object without
    vertices has (inf, -inf, inf, -inf)."""
    rays: NDArray[np.float64]
    """(3, 4) [R K^-1 | eye]: a sample q = (x, y, 1) at depth z [m] shows the world point z R K^-1 q + eye."""


class Lamps(NamedTuple):
    """The light of a frame."""

    directions: NDArray[np.float64]
    """(L, 3) unit vectors towards the lights, in the world; those of the direct light come first."""
    frames: NDArray[np.float64]
    """(L, 3, 4) from world points to their maps: see ``cast_map``."""
    maps: NDArray[np.float32]
    """(L, s, s) height of the nearest occluder towards the light [m], -inf where there is none."""
    direct: int
    """How many of the L lights stand for the direct light."""
    offset: float
    """By how much points are moved along their normals [m]."""
    bias: float
    """By how much an occluder must be nearer to the light [m]."""
    strength: NDArray[np.float64]
    """(4, 3) linear light per channel: even, direct, of the sky, from below."""
    exposures: NDArray[np.float64]
    """(O, 3, 3) from every object's colours to exposed ones."""


@kernel
def find_extents(points: NDArray[Any], starts: NDArray[Any], near: float, extents: NDArray[Any]) -> None:
    """Fill ``FrameGeometry.extents`` (O, 4) of objects whose vertices begin at ``starts`` (O + 1,) in ``points``."""
    for k in range(len(extents)):
        u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
        for i in range(starts[k], starts[k + 1]):
            if points[i, 2] < near:
                # A vertex before the near plane has no pixel, and its faces may reach any pixel.
                u0, u1, v0, v1 = -np.inf, np.inf, -np.inf, np.inf
                break
            u0, u1 = min(u0, points[i, 3]), max(u1, points[i, 3])
            v0, v1 = min(v0, points[i, 4]), max(v1, points[i, 4])
        extents[k, 0], extents[k, 1], extents[k, 2], extents[k, 3] = u0, u1, v0, v1


@kernel
def nearest_faces(
    points: NDArray[Any],
    faces: NDArray[Any],
    first: int,
    stop: int,
    outward: bool,
    near: float,
    top: int,
    bottom: int,
    face: NDArray[Any],
    nearness: NDArray[Any],
) -> None:
    """Draw the faces [first, stop) into ``face`` (h, w) and ``nearness`` (h, w), 1 / z, in the rows [top, bottom).

    Of equally near faces the first is kept, in whatever order they are drawn. 1 / z is linear over the picture:
    (e_a + e_b + e_c) / det in terms of ``rasterizer``. ``outward``: faces that show their back are hidden by others.
    """
    width = face.shape[1]
    size = float(max(face.shape))
    for f in range(first, stop):
        a, b, c = corner(points, faces[f, 0]), corner(points, faces[f, 1]), corner(points, faces[f, 2])
        u0, u1, v0, v1 = bounds(a, b, c, near)
        low, high = centres(v0, v1, top, bottom)
        left, right = centres(u0, u1, 0, width)
        if low > high or left > right:
            continue
        # det < 0 is a front face: outward faces turn counter-clockwise, and y points down in pictures.
        det = determinant(a, b, c)
        if not 0 < abs(det) < np.inf or (outward and det > 0):
            continue
        edges = edge_functions(a, b, c, np.sign(det), size, near)
        ea, eb, ec, _ = edges
        scale = 1 / abs(det)
        # e_k / |det| are barycentrics over z, so that their sum is 1 / z: one multiplication and one addition a sample.
        slope = (ea[0] + eb[0] + ec[0]) * scale
        for y in range(low, high + 1):
            row = row_of(edges, y + 0.5)
            start, end = span(edges, row, left, right)
            constant = (row[0] + row[1] + row[2]) * scale
            for x in range(start, end + 1):
                # Rounding to the buffer's float32 comes before the comparison. Otherwise the winner would depend on the
                # order. Ties go to the lower face. A sample of the background has face -1, which no face undercuts: it
                # wins its ties.
                w = np.float32(slope * (x + 0.5) + constant)
                if w > nearness[y, x] or (w == nearness[y, x] and f < face[y, x]):
                    nearness[y, x] = w
                    face[y, x] = f


@inline_kernel
def _wrapped(t: float, size: int) -> tuple[int, int, float]:
    """The two texels around ``t`` in [0, 1] of a repeating texture, and the second's weight."""
    # Texel i has its centre at (i + 0.5) / size.
    s = t * size - 0.5
    i = int(np.floor(s))
    j = i + 1
    return (i + size if i < 0 else i), (j - size if j >= size else j), s - np.floor(s)


@inline_kernel
def _bilinear(textures: Textures, slot: Any, level: Any, u: float, v: float) -> tuple[float, float, float]:
    """A level's colour at u and v in [0, 1], v from the bottom."""
    # v points up, rows of texels run down: hence 1 - v.
    texels, start = textures.texels, textures.starts[slot, level]
    h, w = textures.sizes[slot, level, 0], textures.sizes[slot, level, 1]
    x0, x1, fx = _wrapped(u, w)
    y0, y1, fy = _wrapped(1 - v, h)
    i, j, k, m = start + y0 * w + x0, start + y0 * w + x1, start + y1 * w + x0, start + y1 * w + x1
    a, b, c, d = (1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx
    return (
        a * texels[i, 0] + b * texels[j, 0] + c * texels[k, 0] + d * texels[m, 0],
        a * texels[i, 1] + b * texels[j, 1] + c * texels[k, 1] + d * texels[m, 1],
        a * texels[i, 2] + b * texels[j, 2] + c * texels[k, 2] + d * texels[m, 2],
    )


@inline_kernel
def texture_at(textures: Textures, slot: Any, u: float, v: float, footprint: float) -> tuple[float, float, float]:
    """The trilinear colour of a texture where a sample covers the square ``footprint`` of level 0's texels."""
    u, v = u - np.floor(u), v - np.floor(v)
    last = textures.levels[slot] - 1
    # A level halves both sides, so its texels have four times the area: the level is log4(footprint).
    lod = 0.5 * np.log2(footprint) if footprint > 1 else 0.0
    level: Any = min(int(lod), last)
    # On the coarsest level there is nothing to blend with.
    share = min(lod - level, 1.0) if level < last else 0.0
    r, g, b = _bilinear(textures, slot, level, u, v)
    if share > 0:
        r1, g1, b1 = _bilinear(textures, slot, level + 1, u, v)
        r, g, b = r + share * (r1 - r), g + share * (g1 - g), b + share * (b1 - b)
    return r / UNIT, g / UNIT, b / UNIT


@inline_kernel
def light_at(x: float, y: float, z: float, nx: float, ny: float, nz: float, lamps: Lamps) -> tuple[float, float, float]:
    """Direct light, sky light and light from below at a point with a normal; each is 1 without obstacles."""
    directions, frames, maps, bias = lamps.directions, lamps.frames, lamps.maps, lamps.bias
    x, y, z = x + lamps.offset * nx, y + lamps.offset * ny, z + lamps.offset * nz
    # Cast from off the surface: a face must not shade itself by the error of its map.
    direct = sky = 0.0
    count = len(directions)
    for light in range(lamps.direct):
        direct += arriving(x, y, z, nx, ny, nz, light, directions, frames, maps, bias)
    for light in range(lamps.direct, count):
        sky += arriving(x, y, z, nx, ny, nz, light, directions, frames, maps, bias)
    # The mean cosine of directions spread evenly over the upper half sphere is 1/2 on a level surface: hence the 2. The
    # half space below fills the share (1 - n_z) / 2 of what a surface sees, weighted by the cosine.
    return direct / max(lamps.direct, 1), 2 * sky / max(count - lamps.direct, 1), 0.5 - 0.5 * nz


@inline_kernel
def _is_even(row: int, column: int, samples: int, shapes: Shapes, face: NDArray[Any], nearness: NDArray[Any]) -> bool:
    """Whether all samples of a pixel show one material of one object, there nearly flat: one colour stands for them."""
    # The first sample, top left, stands for the pixel; all others are compared with it.
    y, x = row * samples, column * samples
    f, w = face[y, x], nearness[y, x]
    if f < 0:
        return False
    a, b, c = shapes.flat[f, 0], shapes.flat[f, 1], shapes.flat[f, 2]
    for s in range(1, samples * samples):
        i, j = y + s // samples, x + s % samples
        g = face[i, j]
        if g == f:
            continue
        if g < 0 or shapes.slot[g] != shapes.slot[f] or abs(nearness[i, j] - w) > NEARBY * w:
            return False
        if a * shapes.flat[g, 0] + b * shapes.flat[g, 1] + c * shapes.flat[g, 2] < SAME:
            return False
    return True


Vector = tuple[float, float, float]


@inline_kernel
def _weights(
    points: NDArray[Any], faces: NDArray[Any], f: Any, x: float, y: float, size: float, near: float
) -> tuple[Vector, Vector, Vector, float]:
    """Barycentrics of a sample in a face, clamped to its border, and their derivatives along x and y.

    The last value is 1 if the face shows its front, otherwise -1."""
    a, b, c = corner(points, faces[f, 0]), corner(points, faces[f, 1]), corner(points, faces[f, 2])
    sign = 1.0 if determinant(a, b, c) > 0 else -1.0
    ea, eb, ec, _ = edge_functions(a, b, c, sign, size, near)
    # The place may lie outside the face: the middle of an even pixel, or a border sample that the raised edges let in.
    # Clamping keeps its colour on the face.
    wa = max(ea[0] * x + ea[1] * y + ea[2], 0.0)
    wb = max(eb[0] * x + eb[1] * y + eb[2], 0.0)
    wc = max(ec[0] * x + ec[1] * y + ec[2], 0.0)
    whole = 1 / (wa + wb + wc)
    # These are de/dx / sum(e) only. ``_color`` applies the rest of the quotient rule, on attributes.
    along = whole * ea[0], whole * eb[0], whole * ec[0]
    down = whole * ea[1], whole * eb[1], whole * ec[1]
    return (wa * whole, wb * whole, wc * whole), along, down, -sign


@inline_kernel
def _color(
    shapes: Shapes, textures: Textures, f: Any, weights: Vector, along: Vector, down: Vector, area: float
) -> Vector:
    """Colour without light of a face at some barycentrics, over ``area`` samples."""
    faces, uv, colors, sizes = shapes.faces, shapes.uv, shapes.colors, textures.sizes
    i, j, k, slot = faces[f, 0], faces[f, 1], faces[f, 2], shapes.slot[f]
    wa, wb, wc = weights
    ua, ub, uc, va, vb, vc = uv[i, 0], uv[j, 0], uv[k, 0], uv[i, 1], uv[j, 1], uv[k, 1]
    u, v = wa * ua + wb * ub + wc * uc, wa * va + wb * vb + wc * vc
    high, wide = sizes[slot, 0, 0], sizes[slot, 0, 1]
    # d(u)/dx by the quotient rule: barycentrics are e / sum(e), so their derivatives weigh differences to u itself.
    ux = (along[0] * (ua - u) + along[1] * (ub - u) + along[2] * (uc - u)) * wide
    uy = (down[0] * (ua - u) + down[1] * (ub - u) + down[2] * (uc - u)) * wide
    vx = (along[0] * (va - v) + along[1] * (vb - v) + along[2] * (vc - v)) * high
    vy = (down[0] * (va - v) + down[1] * (vb - v) + down[2] * (vc - v)) * high
    # The longer of the two derivatives, as OpenGL's scale factor: where they differ, blur and not aliasing.
    r, g, b = texture_at(textures, slot, u, v, area * max(ux * ux + vx * vx, uy * uy + vy * vy))
    r *= wa * colors[i, 0] + wb * colors[j, 0] + wc * colors[k, 0]
    g *= wa * colors[i, 1] + wb * colors[j, 1] + wc * colors[k, 1]
    b *= wa * colors[i, 2] + wb * colors[j, 2] + wc * colors[k, 2]
    return r, g, b


@inline_kernel
def _normal(normals: NDArray[Any], turns: NDArray[Any], f: Any, o: Any, weights: Vector, front: float) -> Vector:
    """Unit normal in the world of a face at some barycentrics, on the side that is seen."""
    wa, wb, wc = weights
    x = wa * normals[f, 0, 0] + wb * normals[f, 1, 0] + wc * normals[f, 2, 0]
    y = wa * normals[f, 0, 1] + wb * normals[f, 1, 1] + wc * normals[f, 2, 1]
    z = wa * normals[f, 0, 2] + wb * normals[f, 1, 2] + wc * normals[f, 2, 2]
    # ``front`` -1 turns the normal of a back towards the camera: open surfaces are lit on both sides.
    norm = front / max(np.sqrt(x * x + y * y + z * z), 1e-12)
    return (
        norm * (turns[o, 0, 0] * x + turns[o, 0, 1] * y + turns[o, 0, 2] * z),
        norm * (turns[o, 1, 0] * x + turns[o, 1, 1] * y + turns[o, 1, 2] * z),
        norm * (turns[o, 2, 0] * x + turns[o, 2, 1] * y + turns[o, 2, 2] * z),
    )


@inline_kernel
def _depth(points: NDArray[Any], faces: NDArray[Any], f: Any, weights: Vector) -> float:
    a, b, c = points[faces[f, 0], 2], points[faces[f, 1], 2], points[faces[f, 2], 2]
    return weights[0] * a + weights[1] * b + weights[2] * c


@inline_kernel
def _place(rays: NDArray[Any], x: float, y: float, depth: float) -> Vector:
    """The point in the world of a sample at some depth."""
    return (
        depth * (rays[0, 0] * x + rays[0, 1] * y + rays[0, 2]) + rays[0, 3],
        depth * (rays[1, 0] * x + rays[1, 1] * y + rays[1, 2]) + rays[1, 3],
        depth * (rays[2, 0] * x + rays[2, 1] * y + rays[2, 2]) + rays[2, 3],
    )


@inline_kernel
def _exposed(exposures: NDArray[Any], o: Any, r: float, g: float, b: float) -> Vector:
    return (
        max(exposures[o, 0, 0] * r + exposures[o, 0, 1] * g + exposures[o, 0, 2] * b, 0.0),
        max(exposures[o, 1, 0] * r + exposures[o, 1, 1] * g + exposures[o, 1, 2] * b, 0.0),
        max(exposures[o, 2, 0] * r + exposures[o, 2, 1] * g + exposures[o, 2, 2] * b, 0.0),
    )


@kernel
def shade(
    shapes: Shapes,
    textures: Textures,
    view: FrameGeometry,
    lamps: Lamps,
    samples: int,
    near: float,
    top: int,
    bottom: int,
    tile: int,
    dirty: NDArray[Any],
    face: NDArray[Any],
    nearness: NDArray[Any],
    color: NDArray[Any],
    cover: NDArray[Any],
) -> None:
    """Shade the pixels of ``dirty`` squares of ``tile`` pixels in the rows [top, bottom).

    ``color`` (h, w, 3) takes the sums of the samples' colours, ``cover`` (h, w) the number of samples on objects.
    ``face`` and ``nearness`` (samples h, samples w) are the drawn buffers. Samples of a pixel with nearly equal place
    and normal share the light of the first."""
    faces, points, rays, turns = shapes.faces, view.points, view.rays, view.turns
    owners, normals, strength, exposures = shapes.object, shapes.normals, lamps.strength, lamps.exposures
    size, width, whole = float(max(face.shape)), cover.shape[1], samples * samples
    for row in range(top, bottom):
        for column in range(width):
            if not dirty[row // tile, column // tile]:
                continue
            count, lit = 0, -1
            total0 = total1 = total2 = 0.0
            e0 = e1 = e2 = lx = ly = lz = ld = 0.0
            # An even pixel takes one sample at its middle with the footprint of all of them.
            even = _is_even(row, column, samples, shapes, face, nearness)
            for s in range(1 if even else whole):
                sy, sx = row * samples + s // samples, column * samples + s % samples
                f = face[sy, sx]
                if f < 0:
                    continue
                x, y, area = sx + 0.5, sy + 0.5, 1
                if even:
                    x, y, area = (column + 0.5) * samples, (row + 0.5) * samples, whole
                count += area
                weights, along, down, front = _weights(points, faces, f, x, y, size, near)
                r, g, b = _color(shapes, textures, f, weights, along, down, float(area))
                o, depth = owners[f], _depth(points, faces, f, weights)
                nx, ny, nz = _normal(normals, turns, f, o, weights, front)
                # Light is the expensive part: reuse that of the last lit sample where place and normal agree.
                if not (lit == o and nx * lx + ny * ly + nz * lz > SAME and abs(depth - ld) < NEARBY * depth):
                    px, py, pz = _place(rays, x, y, depth)
                    direct, sky, below = light_at(px, py, pz, nx, ny, nz, lamps)
                    e0 = strength[0, 0] + strength[1, 0] * direct + strength[2, 0] * sky + strength[3, 0] * below
                    e1 = strength[0, 1] + strength[1, 1] * direct + strength[2, 1] * sky + strength[3, 1] * below
                    e2 = strength[0, 2] + strength[1, 2] * direct + strength[2, 2] * sky + strength[3, 2] * below
                    # lit: the object of the last lit sample, -1 if none; l: its normal; ld: its depth; e: its light.
                    lit, lx, ly, lz, ld = o, nx, ny, nz, depth
                r, g, b = _exposed(exposures, o, r, g, b)
                # Clipped per sample, before the mean: a bright sample must not whiten its pixel's border.
                total0 += area * min(r * e0, 1.0)
                total1 += area * min(g * e1, 1.0)
                total2 += area * min(b * e2, 1.0)
            cover[row, column] = count
            color[row, column, 0], color[row, column, 1], color[row, column, 2] = total0, total1, total2


@kernel
def seen_at(
    shapes: Shapes,
    textures: Textures,
    view: FrameGeometry,
    near: float,
    pixels: NDArray[Any],
    face: NDArray[Any],
    albedo: NDArray[Any],
    place: NDArray[Any],
    normal: NDArray[Any],
) -> None:
    """Colour without light, place and normal (n, 3), in the world, of what samples ``pixels`` (n, 2) [row, column] of
    ``face`` show."""
    faces, points, size = shapes.faces, view.points, float(max(face.shape))
    for q in range(len(pixels)):
        f = face[pixels[q, 0], pixels[q, 1]]
        x, y = pixels[q, 1] + 0.5, pixels[q, 0] + 0.5
        weights, along, down, front = _weights(points, faces, f, x, y, size, near)
        albedo[q, 0], albedo[q, 1], albedo[q, 2] = _color(shapes, textures, f, weights, along, down, 1.0)
        o, depth = shapes.object[f], _depth(points, faces, f, weights)
        normal[q, 0], normal[q, 1], normal[q, 2] = _normal(shapes.normals, view.turns, f, o, weights, front)
        place[q, 0], place[q, 1], place[q, 2] = _place(view.rays, x, y, depth)


@kernel
def tile_depths(
    nearness: NDArray[Any], side: int, top: int, bottom: int, left: int, right: int, out: NDArray[Any]
) -> None:
    """Least and largest 1 / z of the samples of each tile, into ``out`` (rows, columns, 2); both 0 in empty tiles.

    Tiles have ``side`` samples; those in the rows [top, bottom) and columns [left, right) are computed."""
    height, width = nearness.shape
    for i in range(top, bottom):
        for j in range(left, right):
            # Range of 1 / z over drawn samples; 0 marks an empty sample.
            low, high = np.float32(np.inf), np.float32(0)
            for y in range(i * side, min((i + 1) * side, height)):
                for x in range(j * side, min((j + 1) * side, width)):
                    w = nearness[y, x]
                    if w > 0:
                        low, high = min(low, w), max(high, w)
            out[i, j, 0], out[i, j, 1] = (low, high) if high > 0 else (np.float32(0), np.float32(0))


@inline_kernel
def _in_frame(frames: NDArray[Any], light: int, x: float, y: float, z: float) -> Vector:
    """A point in a light's frame: column, row and height."""
    return (
        frames[light, 0, 0] * x + frames[light, 0, 1] * y + frames[light, 0, 2] * z + frames[light, 0, 3],
        frames[light, 1, 0] * x + frames[light, 1, 1] * y + frames[light, 1, 2] * z + frames[light, 1, 3],
        frames[light, 2, 0] * x + frames[light, 2, 1] * y + frames[light, 2, 2] * z + frames[light, 2, 3],
    )


@inline_kernel
def _is_clear(
    x: float,
    y: float,
    z: float,
    radius: float,
    light: int,
    frames: NDArray[Any],
    limits: NDArray[Any],
    around: float,
    texel: float,
    offset: float,
) -> bool:
    """Whether the samples inside a ball read nothing of a light's map within its ``limits`` (L, 5): see
    ``note_changes``.

    (x, y, z) and ``radius`` [m] are the ball's, ``around`` [texel] is how far from their place samples read."""
    u, v, t = _in_frame(frames, light, x, y, z)
    # limits hold texel indices, a texel reaches one farther: hence the 1.
    reach = radius / texel + around + 1
    if u + reach < limits[light, 0] or u - reach > limits[light, 1]:
        return True
    if v + reach < limits[light, 2] or v - reach > limits[light, 3]:
        return True
    # An occluder counts where it is higher than the sample. If all changed heights, old and new, are below the ball,
    # then none shaded it and none shades it.
    return t - radius - offset >= limits[light, 4]


@kernel
def mark_shadowed(
    depths: NDArray[Any],
    side: int,
    rays: NDArray[Any],
    frames: NDArray[Any],
    spans: NDArray[Any],
    block: int,
    limits: NDArray[Any],
    offset: float,
    bias: float,
    texel: float,
    top: int,
    bottom: int,
    dirty: NDArray[Any],
) -> None:
    """Set ``dirty`` (rows, columns) for tiles in the rows [top, bottom) whose light may have changed.

    There a map texel that the tile reads was on one side of it and is now on the other. ``depths`` (rows, columns, 2)
    come from ``tile_depths`` with tiles of ``side`` samples. ``spans`` (L, b, b, 2), of ``block`` texels, and
    ``limits`` (L, 5) come from ``note_changes``. ``rays``, ``frames``, ``offset`` and ``bias`` are those of ``shade``;
    ``texel`` is the side of a map's texel [m]. It may mark tiles whose light stays."""
    # Samples read up to ``offset`` beside their place, plus the bilinear half texel; a quarter is to spare.
    corners, middle = np.empty((8, 3)), np.empty(3)
    around, last = offset / texel + 0.75, spans.shape[1] - 1
    for i in range(top, bottom):
        for j in range(depths.shape[1]):
            if dirty[i, j] or depths[i, j, 1] == 0:
                continue
            # The tile's frustum between its nearest and farthest sample: bits of k choose column, row and depth.
            for k in range(8):
                x, y = float((j + (k & 1)) * side), float((i + ((k >> 1) & 1)) * side)
                z = 1 / float(depths[i, j, k >> 2])
                for c in range(3):
                    corners[k, c] = z * (rays[c, 0] * x + rays[c, 1] * y + rays[c, 2]) + rays[c, 3]
            # Half the diagonal of the corners' box, around their mean: a cheap first test that rules out most lights.
            radius = 0.0
            for c in range(3):
                low = high = middle[c] = corners[0, c]
                for k in range(1, 8):
                    low, high = min(low, corners[k, c]), max(high, corners[k, c])
                    middle[c] += corners[k, c]
                radius += ((high - low) / 2) ** 2
            radius = np.sqrt(radius)
            mx, my, mz = middle[0] / 8, middle[1] / 8, middle[2] / 8
            for light in range(len(frames)):
                if _is_clear(mx, my, mz, radius, light, frames, limits, around, texel, offset):
                    continue
                # The tile's box in the light's frame: columns, rows and heights. A frustum is the hull of its corners,
                # and the frame is affine, so the corners bound it.
                u0, u1, v0, v1, low, high = np.inf, -np.inf, np.inf, -np.inf, np.inf, -np.inf
                for k in range(8):
                    u, v, t = _in_frame(frames, light, corners[k, 0], corners[k, 1], corners[k, 2])
                    u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                    low, high = min(low, t - offset), max(high, t + offset + bias)
                first_column, last_column = max((u0 - around) // block, 0), min((u1 + around) // block, last)
                first_row, last_row = max((v0 - around) // block, 0), min((v1 + around) // block, last)
                for row in range(int(first_row), int(last_row) + 1):
                    for column in range(int(first_column), int(last_column) + 1):
                        # Light changes where a height passes a sample: some changed height lies above the tile's lowest
                        # sample, and some lies below its highest.
                        if spans[light, row, column, 1] > low and spans[light, row, column, 0] <= high:
                            dirty[i, j] = True
                if dirty[i, j]:
                    break
