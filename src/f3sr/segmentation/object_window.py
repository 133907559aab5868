"""The part of a photo around one object, at a resolution of its own: colours, edges, and what is decided there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from f3sr.backends.protocols import Stroke
from f3sr.core.transforms import Array
from f3sr.segmentation.colour_mixture import lab
from f3sr.segmentation.grid_cut import Mask, PixelGrid, pixel_grid

Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]."""

MARGIN = 0.3
"""Of a box's longer side, around it: surroundings to learn colours from."""
EDGE = 10.0
"""Cost of a cut between equal pixels, in units of a pixel's log-likelihood. Rother 2004 has 50 for densities of full
contrast; ours are bounded. Of 3, 10 and 30, the middle is best (docs: segmentation)."""
CONTRAST = 4.0
"""Least mean square of neighbours' differences [Lab^2]: two levels of noise."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectWindow:
    """Pixels (h, w) of a part of a photo of the size ``photo`` (rows, columns)."""

    photo: tuple[int, int]
    place: tuple[int, int, int, int]
    """Left, top, right, bottom in the photo."""
    colours: Array
    """(h, w, 3) Lab."""

    @property
    def shape(self) -> tuple[int, int]:
        return self.colours.shape[0], self.colours.shape[1]

    @property
    def scale(self) -> float:
        """Pixels of the window a pixel of the photo."""
        return self.shape[1] / (self.place[2] - self.place[0])

    @cached_property
    def grid(self) -> PixelGrid:
        return pixel_grid(self.colours, weight=EDGE, floor=CONTRAST)

    def inner(self, box: Box) -> Box:
        """A box of the photo in pixels of the window."""
        (h, w), (left, top, right, bottom) = self.shape, self.place
        x, y = w / (right - left), h / (bottom - top)
        return (box[0] - left) * x, (box[1] - top) * y, (box[2] - left) * x, (box[3] - top) * y

    def drawn(self, strokes: Sequence[Stroke]) -> Mask:
        """(h, w) of pixels that strokes of the photo run through."""
        canvas = Image.new("1", (self.shape[1], self.shape[0]))
        pen = ImageDraw.Draw(canvas)
        for stroke in strokes:
            at = [self.inner((x, y, x, y))[:2] for x, y in stroke]
            pixels = [(math.floor(x), math.floor(y)) for x, y in at]
            pen.line(pixels, fill=1) if len(pixels) > 1 else pen.point(pixels, fill=1)
        return np.array(canvas, np.bool_)

    def lowered(self, mask: Mask) -> Mask:
        """(h, w) of a mask of the photo: pixels of which it has more than half."""
        left, top, right, bottom = self.place
        return _resized(mask[top:bottom, left:right], *self.shape, Image.Resampling.BOX)

    def raised(self, mask: Mask) -> Mask:
        """The mask (rows, columns) of the photo from one (h, w) of the window."""
        left, top, right, bottom = self.place
        whole = np.zeros(self.photo, np.bool_)
        whole[top:bottom, left:right] = _resized(mask, bottom - top, right - left, Image.Resampling.BILINEAR)
        return whole


def object_window(rgb: NDArray[np.uint8], box: Box, *, pixels: int, margin: float = MARGIN) -> ObjectWindow:
    """The window of a photo (rows, columns, 3) around a box, of at most about so many pixels."""
    rows, columns = rgb.shape[:2]
    around = margin * max(box[2] - box[0], box[3] - box[1])
    left, top = max(0, math.floor(box[0] - around)), max(0, math.floor(box[1] - around))
    right, bottom = min(columns, math.ceil(box[2] + around)), min(rows, math.ceil(box[3] + around))
    scale = min(1.0, math.sqrt(pixels / ((right - left) * (bottom - top))))
    size = max(1, round((right - left) * scale)), max(1, round((bottom - top) * scale))
    part = Image.fromarray(np.ascontiguousarray(rgb[top:bottom, left:right]))
    picture = np.asarray(part if part.size == size else part.resize(size, Image.Resampling.BOX))
    return ObjectWindow(photo=(rows, columns), place=(left, top, right, bottom), colours=lab(picture))


def _resized(mask: Mask, h: int, w: int, how: Image.Resampling) -> Mask:
    if mask.shape == (h, w):
        return mask
    grey = Image.fromarray(mask.astype(np.uint8) * 255)
    return np.asarray(grey.resize((w, h), how)) > 127
