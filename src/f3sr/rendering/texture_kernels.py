"""Kernels that make a texture's levels of detail: its borders, halves of halves, and what no triangle shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.runtime.kernels import kernel

UNIT = 65535.0
"""White in textures of 16 bits."""


@kernel
def border(
    texture: NDArray[Any], table: NDArray[Any], drawn: NDArray[Any], sums: NDArray[Any], weights: NDArray[Any]
) -> None:
    """Fill ``sums`` (h, w, 3) and ``weights`` (h, w) with linear colours of a texture (h, w, 3) by ``table`` (256, 3).

    Texels that are ``drawn`` (h, w) have their own colour. Their neighbours, which bilinear samples touch, have the
    mean of drawn neighbours. All others are 0."""
    height, width = drawn.shape
    for y in range(height):
        for x in range(width):
            r = g = b = count = np.float32(0)
            if drawn[y, x]:
                r, g, b = table[texture[y, x, 0], 0], table[texture[y, x, 1], 1], table[texture[y, x, 2], 2]
                count = np.float32(1)
            else:
                for i in range(max(y - 1, 0), min(y + 2, height)):
                    for j in range(max(x - 1, 0), min(x + 2, width)):
                        if drawn[i, j]:
                            r += table[texture[i, j, 0], 0]
                            g += table[texture[i, j, 1], 1]
                            b += table[texture[i, j, 2], 2]
                            count += np.float32(1)
            # From sums to means: ``weights`` become 1 where a colour is known and 0 elsewhere.
            share = 1 / count if count > 0 else np.float32(0)
            sums[y, x, 0], sums[y, x, 1], sums[y, x, 2] = r * share, g * share, b * share
            weights[y, x] = count * share


@kernel
def halve(sums: NDArray[Any], weights: NDArray[Any], half_sums: NDArray[Any], half_weights: NDArray[Any]) -> None:
    """Fill ``half_sums`` (ceil(h / 2), ceil(w / 2), 3) and ``half_weights`` with means of two by two texels.

    ``sums`` are (h, w, 3), ``weights`` (h, w). The last row or column of an odd side counts twice."""
    height, width = weights.shape
    for y in range(half_weights.shape[0]):
        i0, i1 = 2 * y, min(2 * y + 1, height - 1)
        for x in range(half_weights.shape[1]):
            j0, j1 = 2 * x, min(2 * x + 1, width - 1)
            # Sums and weights are halved alike; ``settle`` divides, so that unknown texels have no part in a mean.
            half_weights[y, x] = (weights[i0, j0] + weights[i0, j1] + weights[i1, j0] + weights[i1, j1]) / 4
            for c in range(3):
                total = sums[i0, j0, c] + sums[i0, j1, c] + sums[i1, j0, c] + sums[i1, j1, c]
                half_sums[y, x, c] = total / 4


@kernel
def settle(sums: NDArray[Any], weights: NDArray[Any], coarser: NDArray[Any], texels: NDArray[Any]) -> None:
    """Fill ``texels`` (h, w, 3) of 16 bits: sums over weights, or the ``coarser`` level's texel where nothing is known.

    ``coarser`` (ceil(h / 2), ceil(w / 2), 3) of 16 bits is filled already; for the coarsest level it is ``texels``."""
    height, width = weights.shape
    for y in range(height):
        for x in range(width):
            # Coarse levels come first: an unknown texel finds its parent filled already.
            known = weights[y, x] > 0
            for c in range(3):
                if known:
                    texels[y, x, c] = int(sums[y, x, c] / weights[y, x] * UNIT + 0.5)
                else:
                    texels[y, x, c] = coarser[y // 2, x // 2, c]
