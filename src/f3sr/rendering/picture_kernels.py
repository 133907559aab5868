"""Kernels of the last step: shadows on the ground from bits, and objects over the background, in linear light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, kernel

STEPS = 65535
"""Steps of linear light from 0 to 1 in the table that ends in sRGB: a dark level of eight bits is 20 of them."""
LEAST_LIGHT = np.float32(0.02)
"""Share of its light that ground keeps in any shadow."""
BLUR_SUM = 256
"""Sum of the weights of both blurs, 16 by 16: integers, so that blurring is exact."""


@kernel
def count_lights(
    bits: NDArray[Any],
    rest_bits: NDArray[Any],
    direct: int,
    set_bits: NDArray[Any],
    top: int,
    bottom: int,
    counts: NDArray[Any],
) -> None:
    """Count hidden lights at every pixel of the rows [top, bottom), into ``counts`` (4, h, w).

    ``bits`` (words, h, w) hold one bit per light: the first ``direct`` words are direct light, the others the sky.
    Counts 0 and 1 are direct and sky; counts 2 and 3 are those of them that are hidden in ``rest_bits`` too."""
    # set_bits (256,) is the number of ones in a byte. Rows are walked word by word, as ``bits`` lies in memory.
    words, width = bits.shape[0], bits.shape[2]
    for y in range(top, bottom):
        for x in range(width):
            counts[0, y, x] = counts[1, y, x] = counts[2, y, x] = counts[3, y, x] = 0
        for word in range(words):
            kind = 0 if word < direct else 1
            for x in range(width):
                counts[kind, y, x] += set_bits[bits[word, y, x]]
                counts[2 + kind, y, x] += set_bits[bits[word, y, x] & rest_bits[word, y, x]]


@kernel
def blur_rows(counts: NDArray[Any], reach: int, top: int, bottom: int, blurred: NDArray[Any]) -> None:
    """A binomial filter of ``counts`` (h, w) along rows, times 16, for the rows [top, bottom).

    ``reach`` is 1 or 2 cells; the border is repeated."""
    width = counts.shape[1]
    for y in range(top, bottom):
        for x in range(width):
            # (1, 2, 1) * 4 or (1, 4, 6, 4, 1): both sum to 16, so one constant undoes both.
            a, b, c, d = max(x - 2, 0), max(x - 1, 0), min(x + 1, width - 1), min(x + 2, width - 1)
            if reach == 1:
                blurred[y, x] = 4 * (counts[y, b] + 2 * counts[y, x] + counts[y, c])
            else:
                inner = 4 * (counts[y, b] + counts[y, c]) + 6 * counts[y, x]
                blurred[y, x] = counts[y, a] + inner + counts[y, d]


@kernel
def blur_columns(rows: NDArray[Any], reach: int, top: int, bottom: int, blurred: NDArray[Any]) -> None:
    """The same along columns: after both, times ``BLUR_SUM``."""
    height, width = rows.shape
    for y in range(top, bottom):
        a, b, c, d = max(y - 2, 0), max(y - 1, 0), min(y + 1, height - 1), min(y + 2, height - 1)
        for x in range(width):
            if reach == 1:
                blurred[y, x] = 4 * (rows[b, x] + 2 * rows[y, x] + rows[c, x])
            else:
                blurred[y, x] = rows[a, x] + 4 * (rows[b, x] + rows[c, x]) + 6 * rows[y, x] + rows[d, x]


@kernel
def mark_changed(values: NDArray[Any], before: NDArray[Any], side: int, dirty: NDArray[Any]) -> None:
    """Set ``dirty`` (rows, columns) for squares of ``side`` cells in or next to which ``values`` (k, h, w) are
    others than ``before``."""
    rows, columns = dirty.shape
    for kind in range(len(values)):
        for y in range(values.shape[1]):
            for x in range(values.shape[2]):
                if values[kind, y, x] != before[kind, y, x]:
                    # One cell around: ``_between`` blends neighbouring cells, also across a tile's border.
                    for i in range(max((y - 1) // side, 0), min((y + 1) // side, rows - 1) + 1):
                        for j in range(max((x - 1) // side, 0), min((x + 1) // side, columns - 1) + 1):
                            dirty[i, j] = True


@inline_kernel
def _between(x: int, cell: int, count: int) -> tuple[int, int, float]:
    """The two of ``count`` cells of ``cell`` pixels around the centre of pixel ``x``, and the second's weight."""
    # In cells, minus 0.5: cell i has its centre at i + 0.5. At the border one cell is taken twice.
    s = (x + 0.5) / cell - 0.5
    i = int(np.floor(s))
    return max(i, 0), min(i + 1, count - 1), s - i


@inline_kernel
def _bilinear(values: NDArray[Any], kind: int, rows: tuple[int, int, float], columns: tuple[int, int, float]) -> float:
    upper = (1 - columns[2]) * values[kind, rows[0], columns[0]] + columns[2] * values[kind, rows[0], columns[1]]
    lower = (1 - columns[2]) * values[kind, rows[1], columns[0]] + columns[2] * values[kind, rows[1], columns[1]]
    return (1 - rows[2]) * upper + rows[2] * lower


@inline_kernel
def _hidden(
    blurred: NDArray[Any], first: int, rows: tuple[int, int, float], columns: tuple[int, int, float]
) -> tuple[float, float]:
    """Blurred counts of hidden direct and sky lights, between cells; ``first`` is 0 now, 2 for those hidden at rest."""
    return _bilinear(blurred, first, rows, columns), _bilinear(blurred, first + 1, rows, columns)


@inline_kernel
def _left(receives: Any, hidden: tuple[float, float], weight: NDArray[Any], c: int) -> Any:
    """The share of its light in a channel that the ground keeps."""
    return np.float32(max(1 - receives * (weight[0, c] * hidden[0] + weight[1, c] * hidden[1]), LEAST_LIGHT))


@kernel
def light_left(
    blurred: NDArray[Any], cell: int, weight: NDArray[Any], receives: NDArray[Any], left: NDArray[Any]
) -> None:
    """The share of its light (h, w, 3) that the ground keeps: 1 - ``weight`` (2, 3) times the blurred counts of cells
    of ``cell`` pixels."""
    height, width = receives.shape
    for y in range(height):
        rows = _between(y, cell, blurred.shape[1])
        for x in range(width):
            columns = _between(x, cell, blurred.shape[2])
            hidden = _hidden(blurred, 0, rows, columns)
            for c in range(3):
                left[y, x, c] = _left(receives[y, x], hidden, weight, c)


@inline_kernel
def ground_light(left: Any, stays: Any, rest: Any, shown: Any) -> Any:
    """The factor on the background's light at a ground pixel.

    Three shares of light arrive: ``left`` now, ``stays`` if only lights hidden at rest too count as hidden, ``rest`` at
    rest. ``shown`` is the factor in the photo, which includes the photo's own shadows. It is blended to the drawn
    shadow by the square of the share of darkness that stays. New shadows take their share of what is left of the light.
    Where the photo is brighter than the drawn shadow they take no more than is drawn: little is left there to tell
    shares."""
    # share: how much of the darkness at rest is still there. At rest stays = left = rest, so share is 1 and the result
    # is ``shown``: the photo itself. Once an object has left, stays is 1 and share 0: the clean background under new
    # shadows.
    share = (1 - stays) / (1 - rest) if rest < 1 else np.float32(0)
    beyond = (shown - rest) * share * share
    return left + beyond if beyond > 0 else (stays + beyond) * (left / stays)


@kernel
def compose(
    background: NDArray[Any],
    linear: NDArray[Any],
    blurred: NDArray[Any],
    cell: int,
    weight: NDArray[Any],
    receives: NDArray[Any],
    rest: NDArray[Any],
    shown: NDArray[Any],
    samples: int,
    color: NDArray[Any],
    cover: NDArray[Any],
    table: NDArray[Any],
    tile: int,
    dirty: NDArray[Any],
    top: int,
    bottom: int,
    picture: NDArray[Any],
) -> None:
    """Objects over the background: rows [top, bottom) of ``picture`` (h, w, 3), in ``dirty`` tiles of ``tile`` pixels.

    ``background`` (h, w, 3) has sRGB bytes. Its linear light, ``linear`` (256,), is multiplied by ``ground_light``.
    ``blurred`` (4, rows, columns) are the counts of ``count_lights`` in cells of ``cell`` pixels, ``weight`` (2, 3) the
    light that one of them stands for. ``receives`` (h, w), ``rest`` and ``shown`` (h, w, 3) are the ground's shares of
    light. ``color`` and ``cover`` come from ``shade``; ``table`` (STEPS + 1,) gives sRGB bytes."""
    width = cover.shape[1]
    for y in range(top, bottom):
        rows = _between(y, cell, blurred.shape[1])
        for x in range(width):
            if not dirty[y // tile, x // tile]:
                continue
            columns = _between(x, cell, blurred.shape[2])
            now, still = _hidden(blurred, 0, rows, columns), _hidden(blurred, 2, rows, columns)
            # Counts 0 and 1: hidden now. Counts 2 and 3: hidden now and at rest.
            objects = cover[y, x] / (samples * samples)
            for c in range(3):
                left, stays = _left(receives[y, x], now, weight, c), _left(receives[y, x], still, weight, c)
                factor = ground_light(left, stays, rest[y, x, c], shown[y, x, c])
                # Untouched background keeps its bytes: the table's round trip could move one by a level.
                if objects == 0 and factor == 1:
                    picture[y, x, c] = background[y, x, c]
                else:
                    # ``color`` holds sums over samples on objects only: it is already multiplied by their cover.
                    value = (1 - objects) * linear[background[y, x, c]] * factor
                    value += color[y, x, c] / (samples * samples)
                    picture[y, x, c] = table[int(min(max(value, 0.0), 1.0) * STEPS + 0.5)]
