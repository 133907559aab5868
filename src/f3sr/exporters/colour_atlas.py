"""Vertex colours as a texture, for programs that know no vertex colours.

Every cell of the atlas shows one triangle, or two that share an edge. Corners lie on the middles of texels, so bilinear
samples inside are the linear interpolation of the corners' colours in linear light. Cells have even sides and begin at
even texels, and texels beside a triangle go on with its slopes. So a cell's samples stay in the cell at level 0 and at
level 1, where they keep their colour too, unless the slopes leave the range of colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.core.mesh import places
from f3sr.core.srgb import linear, srgb
from f3sr.core.transforms import Array
from f3sr.settings import settings

SIDES = (4, 8, 16)
"""Sides of cells [texels]: the corners of a triangle are ``side - BESIDE`` texels apart. Larger ones are for triangles
whose slopes would leave the range of colours beyond their long side."""
BESIDE = 3
"""Texels of a side that no corner's distance needs: half of one at both ends, and one more on both sides."""
FLAT = 2
"""Side of a cell of one colour [texels]."""
WITHIN = ((0.5, 0.5), (0.25, 0.25), (0.5, 0.25), (0.25, 0.5), (0.75, 0.25), (0.25, 0.75))
"""Places in the half of a square of four texels where samples are compared with the interpolation."""
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
"""Corners of a cell: of a triangle the first three, of two the second and third are their common edge."""


@settings
class AtlasConfig:
    longest: Annotated[int, Interval(ge=16, le=16384)] = 4096
    """Longest side of a texture [px]. Graphics cards take 8192, and packages are to stay small. Where triangles do not
    fit, each gets one colour."""
    tolerance: Annotated[float, Interval(gt=0, le=32)] = 1.0
    """Largest difference of a sample from the interpolation that an own cell, or a larger one, is made for [levels of
    255]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ColourAtlas:
    """``texture`` (h, w, 3) uint8 sRGB; ``uv`` (k, 2) with v upwards, and its rows (m, 3) of all triangles' corners."""

    texture: NDArray[np.uint8]
    uv: Array
    uv_faces: NDArray[np.int32]


@dataclass(frozen=True, eq=False, kw_only=True)
class _Cells:
    """Cells of one side: ``texels`` (k, side, side, 3) of linear light, corner places ``at`` (k, c, 2) [texels], and
    the triangles (k, 2) in each, -1 for none, with the rows (k, 2, 3) of their corners in ``at``."""

    texels: Array
    at: Array
    faces: NDArray[np.int64]
    corners: NDArray[np.int64]


def bake_colours(
    vertices: Array, faces: NDArray[np.int32], colours: NDArray[np.uint8], config: AtlasConfig | None = None
) -> ColourAtlas | None:
    """The colours (n, 3) uint8 sRGB of vertices (n, 3) over triangles (m, 3), m > 0.

    None where not even one colour a triangle fits into the longest side."""
    config = config or AtlasConfig()
    light = linear(np.arange(256) / 255)[colours]
    for cells in (lambda: _best(vertices, faces, light, config.tolerance), lambda: _flat(faces, light)):
        parts = cells()
        width = _width(parts)
        heights = [_rows(part, width) * part.texels.shape[1] for part in parts]
        if width <= config.longest and sum(heights) <= config.longest:
            return _packed(parts, width, heights, len(faces))
    return None


def _best(vertices: Array, faces: NDArray[np.int32], light: Array, tolerance: float) -> list[_Cells]:
    """Two triangles a cell where that shows both, else each alone, in the least cell that shows it."""
    pairs = _pairs(vertices, faces, light, tolerance)
    single = np.ones(len(faces), np.bool_)
    single[pairs[:, :, 0]] = False
    alone = np.flatnonzero(single)
    turn, side = _shown(light[faces[alone]], tolerance)
    parts = list[_Cells]()
    for size in reversed(SIDES):
        own = alone[side == size]
        order = (turn[side == size][:, None] + np.arange(3)) % 3
        if len(own):
            parts.append(_triangles(own, order, light[faces[own[:, None], order]], size))
    return [*parts, _squares(pairs, faces, light)] if len(pairs) else parts


def _flat(faces: NDArray[np.int32], light: Array) -> list[_Cells]:
    """One colour a triangle."""
    m = len(faces)
    return [
        _Cells(
            texels=np.broadcast_to(light[faces].mean(1)[:, None, None], (m, FLAT, FLAT, 3)),
            at=np.full((m, 1, 2), FLAT / 2),
            faces=np.column_stack([np.arange(m), np.full(m, -1)]),
            corners=np.zeros((m, 2, 3), np.int64),
        )
    ]


# --- which triangles share a cell -----------------------------------------------------------------------------------


def _pairs(vertices: Array, faces: NDArray[np.int32], light: Array, tolerance: float) -> NDArray[np.int64]:
    """(p, 2, 2) of two triangles and the corner of each that is not on their common edge; each triangle in one pair."""
    _, place = places(vertices)
    # Corners are the same where place and colour are.
    _, same = np.unique(np.column_stack([place, light]), axis=0, return_inverse=True)
    corner = same.reshape(-1)[faces].astype(np.int64)
    edges = np.sort(corner[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    keys = edges[:, 0] * (int(corner.max()) + 1) + edges[:, 1]
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, other = order[first], order[first + 1]
    own = one // 3 != other // 3
    both = np.stack([one[own], other[own]], 1)
    both = both[_square_error(*_of_square(both, corner, faces, light)) <= tolerance]
    both = both[np.argsort(both.min(1), kind="stable")]
    taken, chosen = np.zeros(len(faces), np.bool_).tolist(), list[int]()
    for k, (f, g) in enumerate((both // 3).tolist()):
        if not taken[f] and not taken[g]:
            taken[f] = taken[g] = True
            chosen.append(k)
    return np.stack([both[chosen] // 3, both[chosen] % 3], -1)


def _of_square(
    both: NDArray[np.int64], corner: NDArray[np.int64], faces: NDArray[np.int32], light: Array
) -> tuple[Array, Array, Array, Array]:
    """Colours (p, 3) of the corners of two triangles, in the order of ``SQUARE``."""
    f, k = both // 3, both % 3
    a, b, c, d = (faces[f[:, i], (k[:, i] + more) % 3] for i, more in ((0, 0), (0, 1), (0, 2), (1, 0)))
    return light[a], light[b], light[c], light[d]


def _square_error(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Largest difference (p,) [levels] of bilinear samples of a square from its two triangles' interpolation."""
    bent = a + d - b - c
    worst = np.zeros(len(a))
    for s, t in WITHIN:
        for near, along, across in ((a, b, c), (d, c, b)):
            exact = near + s * (along - near) + t * (across - near)
            worst = np.maximum(worst, _levels(exact, exact + s * t * bent))
    return worst


def _levels(exact: Array, shown: Array) -> Array:
    """Largest difference of the channels of colours (..., 3) in linear light [levels of 255]."""
    both = np.clip(np.stack([exact, shown]), 0, 1)
    return 255 * np.abs(np.diff(srgb(both), axis=0)[0]).max(-1)


# --- triangles alone ------------------------------------------------------------------------------------------------


def _shown(corners: Array, tolerance: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which corner of triangles (k, 3, 3) is the right angle of its cell (k,), and the cell's side (k,)."""
    turn, side = np.zeros(len(corners), np.int64), np.full(len(corners), SIDES[0])
    left = np.arange(len(corners))
    for size in SIDES:
        errors = np.stack([_clipping_error(np.roll(corners[left], -k, axis=1), size - BESIDE) for k in range(3)], 1)
        turn[left], side[left] = errors.argmin(1), size
        left = left[errors.min(1) > tolerance]
    return turn, side


def _clipping_error(corners: Array, steps: int) -> Array:
    """Largest difference (k,) [levels] of samples of triangles (k, 3, 3): texels beyond the long side are clipped."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    worst = np.zeros(len(corners))
    right, down = (b - a) / steps, (c - a) / steps
    for i in range(steps):
        inner = a + i * right + (steps - 1 - i) * down
        outer = inner + right + down
        lost = np.clip(outer, 0, 1) - outer
        if not lost.any():
            continue
        for s, t in WITHIN:
            exact = inner + s * right + t * down
            worst = np.maximum(worst, _levels(exact, exact + s * t * lost))
    return worst


# --- texels ---------------------------------------------------------------------------------------------------------


def _triangles(own: NDArray[np.int64], order: NDArray[np.int64], corners: Array, side: int) -> _Cells:
    """Cells of triangles ``own`` (k,) whose corners (k, 3, 3) have the places ``order`` (k, 3) among their own."""
    s = _along(side)[:, None]
    a, b, c = (corners[:, k, None, None] for k in range(3))
    back = np.argsort(order, axis=1)
    return _Cells(
        texels=a + s * (b - a) + s[:, None] * (c - a),
        at=np.broadcast_to(_places(side)[:3], (len(own), 3, 2)),
        faces=np.column_stack([own, np.full(len(own), -1)]),
        corners=np.stack([back, np.zeros_like(back)], 1),
    )


def _squares(pairs: NDArray[np.int64], faces: NDArray[np.int32], light: Array) -> _Cells:
    """Cells of pairs (p, 2, 2)."""
    f, k = pairs[..., 0], pairs[..., 1]
    both = 3 * f + k
    a, b, c, d = (v[:, None, None] for v in _of_square(both, faces.astype(np.int64), faces, light))
    s = _along(SIDES[0])[:, None]
    t = s[:, None]
    # From the corner off the edge on, the first triangle has corners 0 1 2 of the cell. The second has 3 2 1, or 3 1 2
    # where it is wound the other way.
    turned = (light[faces[f[:, 1], (k[:, 1] + 1) % 3]] != light[faces[f[:, 0], (k[:, 0] + 2) % 3]]).any(1)
    first, second = ((np.arange(3) - k[:, j, None]) % 3 for j in range(2))
    wound = np.where(turned[:, None], [3, 1, 2], [3, 2, 1])
    return _Cells(
        texels=(1 - s) * (1 - t) * a + s * (1 - t) * b + (1 - s) * t * c + s * t * d,
        at=np.broadcast_to(_places(SIDES[0]), (len(pairs), 4, 2)),
        faces=f,
        corners=np.stack([first, np.take_along_axis(wound, second, 1)], 1),
    )


def _along(side: int) -> Array:
    """Places (side,) of the texels' middles, 0 at the first corner and 1 at the second."""
    return (np.arange(side) - 1) / (side - BESIDE)


def _places(side: int) -> Array:
    """Corners (4, 2) of ``SQUARE`` in a cell [texels]."""
    return 1.5 + (side - BESIDE) * SQUARE


# --- packing --------------------------------------------------------------------------------------------------------


def _width(parts: Sequence[_Cells]) -> int:
    """Width of a texture that is about square [texels], a multiple of all cells' sides."""
    area = sum(part.texels[..., 0].size for part in parts)
    return max(SIDES) * int(np.ceil(np.sqrt(area) / max(SIDES)))


def _rows(part: _Cells, width: int) -> int:
    return -(-len(part.texels) // (width // part.texels.shape[1]))


def _packed(parts: Sequence[_Cells], width: int, heights: Sequence[int], count: int) -> ColourAtlas:
    """All cells in rows, the largest first; ``count`` triangles."""
    height = sum(heights)
    uv, uv_faces, first, top = list[Array](), np.zeros((count, 3), np.int32), 0, 0
    strips = list[NDArray[np.uint8]]()
    for part, high in zip(parts, heights, strict=True):
        k, side = part.texels.shape[:2]
        across = width // side
        strips.append(_strip(part, across, high // side))
        corner = np.stack([np.arange(k) % across, np.arange(k) // across], 1) * side + [0, top]
        places_in = (corner[:, None] + part.at).reshape(-1, 2)
        uv.append(places_in / [width, -height] + [0, 1])
        for j in range(2):
            there = part.faces[:, j] >= 0
            rows = first + np.arange(k)[:, None] * part.at.shape[1] + part.corners[:, j]
            uv_faces[part.faces[there, j]] = rows[there]
        first, top = first + len(places_in), top + high
    return ColourAtlas(texture=np.concatenate(strips), uv=np.concatenate(uv), uv_faces=uv_faces)


def _strip(part: _Cells, across: int, down: int) -> NDArray[np.uint8]:
    """The cells (down * side, across * side, 3), ``across`` in a row; what is left over has their mean colour."""
    k, side = part.texels.shape[:2]
    texels = np.empty((across * down, side, side, 3), np.uint8)
    texels[:k] = _bytes(part.texels)
    texels[k:] = _bytes(np.clip(part.texels, 0, 1).mean((0, 1, 2)))
    rows = texels.reshape(down, across, side, side, 3).transpose(0, 2, 1, 3, 4)
    return rows.reshape(down * side, across * side, 3)


def _bytes(light: Array) -> NDArray[np.uint8]:
    return np.rint(255 * srgb(np.clip(light, 0, 1))).astype(np.uint8)
