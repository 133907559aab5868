"""Pixels that several masks claim, given to one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr.segmentation.box_fill import fills, share_within
from f3sr.segmentation.colour_mixture import SAMPLES, ColourMixture, colour_mixture, lab
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.object_window import Box, object_window
from f3sr.vision.regions import grown

OWN = 0.1
"""Least share of a mask that no other claims, if its colours are to be learnt there."""
NESTED = 0.7
"""Share of a box within another box from which on its object stands in, or before, the other's."""
PIXELS = 10_000
"""Most pixels at which a contest is held."""
AROUND = 6
"""Pixels of the photo around the contested ones, whose owners are known."""


def disjoint(rgb: NDArray[np.uint8], masks: Sequence[Mask], boxes: Sequence[Box]) -> tuple[Mask, ...]:
    """The masks (h, w) without shared pixels, in their order, which does not matter.

    A contested pixel goes to the mask whose colours and border explain it better: a minimum cut. Colours are learnt
    where the other mask claims nothing. An object whose box lies within the other's shows them in all of its mask. A
    mask with too few pixels of its own is a leak, unless its box is such an inner one or it fills its box. ``boxes``
    are what each mask should fill.
    """
    given = [mask.copy() for mask in masks]
    for i, first in enumerate(masks):
        for j in range(i + 1, len(masks)):
            shared = first & masks[j]
            if shared.any():
                kept = _first_keeps(rgb, (first, masks[j]), (boxes[i], boxes[j]))
                given[i] &= ~shared | kept
                given[j] &= ~(shared & kept)
    return tuple(given)


def _first_keeps(rgb: NDArray[np.uint8], masks: tuple[Mask, Mask], boxes: tuple[Box, Box]) -> Mask:
    """Which of the shared pixels (h, w) the first of two masks keeps."""
    if _order(masks[1], boxes[1]) < _order(masks[0], boxes[0]):
        return masks[0] & masks[1] & ~_first_keeps(rgb, (masks[1], masks[0]), (boxes[1], boxes[0]))
    shared = masks[0] & masks[1]
    own = [mask & ~shared for mask in masks]
    shares = [o.sum() / mask.sum() for o, mask in zip(own, masks, strict=True)]
    within = [share_within(boxes[k], boxes[1 - k]) for k in (0, 1)]
    inner = int(np.argmax(within))
    if within[inner] >= NESTED:
        if shares[1 - inner] < OWN:
            return shared if inner == 0 else np.zeros_like(shared)
        learnt = [masks[k] if k == inner else own[k] for k in (0, 1)]
        return shared & _contest(rgb, shared, own, learnt)
    if min(shares) >= OWN:
        return shared & _contest(rgb, shared, own, own)
    least = int(np.argmin(shares))
    return shared if fills(masks[least], boxes[least]) == (least == 0) else np.zeros_like(shared)


def _order(mask: Mask, box: Box) -> tuple[int, Box, int]:
    """Decides who comes first, so that the order in which masks are given decides nothing."""
    return int(mask.sum()), box, int(np.argmax(mask))


def _contest(rgb: NDArray[np.uint8], shared: Mask, own: Sequence[Mask], learnt: Sequence[Mask]) -> Mask:
    """Pixels (h, w) of the first of two masks, of those that they share.

    ``own`` are the pixels that each has alone, ``learnt`` those that tell its colours."""
    rows, columns = np.flatnonzero(shared.any(1)), np.flatnonzero(shared.any(0))
    place = (columns[0] - AROUND, rows[0] - AROUND, columns[-1] + 1 + AROUND, rows[-1] + 1 + AROUND)
    window = object_window(rgb, place, pixels=PIXELS, margin=0.0)
    cost = _colours_of(rgb, learnt[0]).cost(window.colours) - _colours_of(rgb, learnt[1]).cost(window.colours)
    mine, theirs = window.lowered(own[0]), window.lowered(own[1])
    cost[~(grown(window.lowered(shared), 1) | mine | theirs)] = 0.0
    cost[mine], cost[theirs] = -np.inf, np.inf
    return window.raised(window.grid.cut(cost))


def _colours_of(rgb: NDArray[np.uint8], mask: Mask) -> ColourMixture:
    """Of at most about ``SAMPLES`` pixels of a mask, spread evenly."""
    pixels = rgb[mask]
    return colour_mixture(lab(pixels[:: max(1, len(pixels) // SAMPLES)]))


def none_vanished(apart: Sequence[Mask], claimed: Sequence[Mask]) -> tuple[Mask, ...]:
    """Disjoint masks (h, w), of which those that lost every pixel have all that they claimed, the smallest first."""
    masks = [mask.copy() for mask in apart]
    for lost in sorted((k for k, mask in enumerate(apart) if not mask.any()), key=lambda k: -int(claimed[k].sum())):
        for other in masks:
            other &= ~claimed[lost]
        masks[lost] = claimed[lost].copy()
    return tuple(masks)


def bounds(mask: Mask) -> Box:
    """The box of a mask (h, w), not empty."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)
