"""Spreading known values smoothly over the pixels between them: a membrane, harmonic between what holds it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.background.patchmatch import Picture, relax
from f3sr.vision.regions import Mask

SWEEPS = 12
"""Sweeps per level: what is left after them the next finer level corrects; below a grey level at the end."""
COARSEST = 8
"""Pixels of the longer side at which halving ends."""


def membrane(values: Picture, known: Mask, bend: Picture | None = None, hold: float = 0.0) -> Picture:
    """``values`` (h, w, c) where ``known`` (h, w); elsewhere the solution of ``laplace(u) - hold u = bend`` (h, w, c),
    harmonic by default, with no slope at the picture's border.

    Solved from coarse to fine (cascadic multigrid, Bornemann and Deuflhard 1996). Zero where nothing is known.
    """
    if known.all():
        return values
    bend = np.zeros_like(values) if bend is None else bend
    start = np.zeros_like(values)
    if max(known.shape) > COARSEST:
        coarse, some = halved(values, known)
        # At twice the pixel size h^2 is 4 times as large: bend sums over four pixels, and hold grows by 4.
        start = doubled(membrane(coarse, some, quads(bend).sum(axis=(1, 3)), 4 * hold), known.shape)
    result = np.where(known[..., None], values, start)
    # The coarsest level has no better start than 0.
    sweeps = SWEEPS if max(known.shape) > COARSEST else 8 * SWEEPS
    relax(result, _places(~known), bend, hold, sweeps)
    return result


def _places(mask: Mask) -> NDArray[np.int32]:
    """Rows and columns (k, 2) of a mask's pixels, in rows."""
    flat = np.flatnonzero(mask)
    places = np.empty((len(flat), 2), np.int32)
    np.divmod(flat, mask.shape[1], out=(places[:, 0], places[:, 1]), casting="same_kind")
    return places


def halved(values: Picture, known: Mask) -> tuple[Picture, Mask]:
    """At half the resolution, means of what is known among four pixels; known where one of them is."""
    weights = quads(known.astype(np.float32)[..., None]).sum(axis=(1, 3))
    sums = quads(values * known[..., None]).sum(axis=(1, 3))
    return sums / np.maximum(weights, 1), weights[..., 0] > 0


def quads(values: Picture) -> Picture:
    """(h / 2, 2, w / 2, 2, c): pixels in fours, zeros where the last row or column has no partner."""
    h, w, c = values.shape
    padded = np.pad(values, ((0, h % 2), (0, w % 2), (0, 0)))
    return padded.reshape((h + 1) // 2, 2, (w + 1) // 2, 2, c)


def doubled(values: Picture, shape: tuple[int, ...]) -> Picture:
    """At twice the resolution, cut to ``shape`` (h, w), linear between the middles of pixels."""
    for axis in (0, 1):
        n = values.shape[axis]
        # Bilinear at a quarter and three quarters of a pixel: own value 3/4, and 1/4 of the neighbour on that side.
        steps = np.arange(2 * n) // 2 + np.where(np.arange(2 * n) % 2, 1, -1)
        far = np.take(values, np.clip(steps, 0, n - 1), axis)
        far *= np.float32(0.25)
        values = np.repeat(values, 2, axis)
        values *= np.float32(0.75)
        values += far
    return values[: shape[0], : shape[1]]
