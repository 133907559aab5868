"""Whether a mask fills the box that somebody drew around its object, and where it does not."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import Array
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.object_window import Box

LOOSE = 0.15
"""Of a box's side: a mask that ends further from it does not fill its box. People's boxes are a few percent loose."""


def gaps(mask: Mask, box: Box) -> Array:
    """Between a mask (h, w), not empty, and the left, top, right and bottom of its box, as shares of the box."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    left, top, right, bottom = box
    apart = np.array([columns[0] - left, rows[0] - top, right - columns[-1] - 1, bottom - rows[-1] - 1])
    return apart / np.tile([right - left, bottom - top], 2)


def fills(mask: Mask, box: Box) -> bool:
    """Whether a mask (h, w) reaches all four sides of its box, as a box that somebody drew demands (Lempitsky 2009)."""
    return bool(mask.any() and gaps(mask, box).max() <= LOOSE)


def strip(shape: tuple[int, int], box: Box, side: int) -> Mask:
    """Pixels (h, w) of a box that are close enough to its left, top, right or bottom side to fill it there."""
    left, top, right, bottom = box
    x, y = np.arange(shape[1])[None] + 0.5, np.arange(shape[0])[:, None] + 0.5
    wide, high = LOOSE * (right - left), LOOSE * (bottom - top)
    near = (x < left + wide, y < top + high, x > right - wide, y > bottom - high)[side]
    return near & inner(shape, box)


def inner(shape: tuple[int, int], box: Box) -> Mask:
    """Pixels (h, w) whose centres lie in a box."""
    left, top, right, bottom = box
    x, y = np.arange(shape[1])[None] + 0.5, np.arange(shape[0])[:, None] + 0.5
    return (x > left) & (x < right) & (y > top) & (y < bottom)


def share_within(inner: Box, outer: Box) -> float:
    """Share of a box's area that lies in another box."""
    wide = max(0.0, min(inner[2], outer[2]) - max(inner[0], outer[0]))
    high = max(0.0, min(inner[3], outer[3]) - max(inner[1], outer[1]))
    return wide * high / ((inner[2] - inner[0]) * (inner[3] - inner[1]))
