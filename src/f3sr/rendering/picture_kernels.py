"""Kernels of the last step: shadows on the ground from bits, and objects over the background, in linear light."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.kernels import kernel

STEPS = 65535
"""Steps of linear light in the table that ends in sRGB: the darkest ones of eight bits are 20 of these wide."""
BLUR = np.array([1, 4, 6, 4, 1], np.int64)
"""Binomial filter over the counts of lights."""
BLUR_SUM = 256


@kernel
def count_lights(
    bits: NDArray[Any], direct: int, set_bits: NDArray[Any], top: int, bottom: int, counts: NDArray[Any]
) -> None:
    """How many lights are hidden at every pixel of the rows [top, bottom): ``counts`` (2, h, w) of the direct light,
    which the first ``direct`` words of ``bits`` (words, h, w) are of, and of the sky."""
    words, width = bits.shape[0], bits.shape[2]
    for y in range(top, bottom):
        for x in range(width):
            counts[0, y, x] = counts[1, y, x] = 0
        for word in range(words):
            kind = 0 if word < direct else 1
            for x in range(width):
                counts[kind, y, x] += set_bits[bits[word, y, x]]


@kernel
def blur_rows(counts: NDArray[Any], top: int, bottom: int, blurred: NDArray[Any]) -> None:
    """``BLUR`` along the rows of ``counts`` (2, h, w), mirrored at the border."""
    width = counts.shape[2]
    for kind in range(2):
        for y in range(top, bottom):
            for x in range(width):
                total = 0
                for k in range(-2, 3):
                    total += BLUR[k + 2] * counts[kind, y, min(max(x + k, 0), width - 1)]
                blurred[kind, y, x] = total


@kernel
def compose(
    background: NDArray[Any],
    linear: NDArray[Any],
    blurred: NDArray[Any],
    weight: NDArray[Any],
    receives: NDArray[Any],
    already: NDArray[Any],
    samples: int,
    color: NDArray[Any],
    cover: NDArray[Any],
    table: NDArray[Any],
    top: int,
    bottom: int,
    picture: NDArray[Any],
) -> None:
    """The rows [top, bottom) of ``picture``: objects over the background (h, w, 3), whose linear light ``linear[value]``
    is multiplied by what of the light is left: 1 - ``weight`` (2, 3) times the blurred counts, divided by the share that was
    left in the background ``already`` (h, w, 3)."""
    height, width = cover.shape
    for y in range(top, bottom):
        for x in range(width):
            first = second = 0
            if receives[y, x] > 0:
                for k in range(-2, 3):
                    line = min(max(y + k, 0), height - 1)
                    first += BLUR[k + 2] * blurred[0, line, x]
                    second += BLUR[k + 2] * blurred[1, line, x]
            objects = cover[y, x] / (samples * samples)
            for c in range(3):
                left = 1 - receives[y, x] * (weight[0, c] * first + weight[1, c] * second)
                factor = left / already[y, x, c]
                value = linear[background[y, x, c]]
                if objects == 0 and factor == 1:
                    picture[y, x, c] = background[y, x, c]
                else:
                    value = (1 - objects) * value * factor + color[y, x, c] / (samples * samples)
                    picture[y, x, c] = table[int(min(max(value, 0.0), 1.0) * STEPS + 0.5)]
