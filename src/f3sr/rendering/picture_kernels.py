"""Kernels of the last step: shadows on the ground from bits, and objects over the background, in linear light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import inline_kernel, kernel

STEPS = 65535
"""Steps of linear light in the table that ends in sRGB: the darkest ones of eight bits are 20 of these wide."""
LEAST_LIGHT = np.float32(0.02)
"""Share of its light that ground keeps in any shadow."""
BLUR_SUM = 256
"""Of the weights of both blurs."""


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
                    for i in range(max((y - 1) // side, 0), min((y + 1) // side, rows - 1) + 1):
                        for j in range(max((x - 1) // side, 0), min((x + 1) // side, columns - 1) + 1):
                            dirty[i, j] = True


@inline_kernel
def _between(x: int, cell: int, count: int) -> tuple[int, int, float]:
    """The two cells around the centre of pixel ``x``, and the second's weight."""
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
    """Of the direct light and of the sky, between cells."""
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
    rest. ``shown`` is the factor in the photo, which includes the photo's own shadows. The first bracket blends from
    ``shown`` at rest to the drawn shadow, by the square of the share of darkness that stays. The last factor adds new
    shadows."""
    share = (1 - stays) / (1 - rest) if rest < 1 else np.float32(0)
    return (stays + (shown - rest) * share * share) * (left / stays)


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
    """The rows [top, bottom) of ``picture``, where squares of ``tile`` pixels are ``dirty``: objects over the
    background (h, w, 3), whose linear light ``linear[value]`` is multiplied by ``ground_light``."""
    width = cover.shape[1]
    for y in range(top, bottom):
        rows = _between(y, cell, blurred.shape[1])
        for x in range(width):
            if not dirty[y // tile, x // tile]:
                continue
            columns = _between(x, cell, blurred.shape[2])
            now, still = _hidden(blurred, 0, rows, columns), _hidden(blurred, 2, rows, columns)
            objects = cover[y, x] / (samples * samples)
            for c in range(3):
                left, stays = _left(receives[y, x], now, weight, c), _left(receives[y, x], still, weight, c)
                factor = ground_light(left, stays, rest[y, x, c], shown[y, x, c])
                if objects == 0 and factor == 1:
                    picture[y, x, c] = background[y, x, c]
                else:
                    value = (1 - objects) * linear[background[y, x, c]] * factor
                    value += color[y, x, c] / (samples * samples)
                    picture[y, x, c] = table[int(min(max(value, 0.0), 1.0) * STEPS + 0.5)]
