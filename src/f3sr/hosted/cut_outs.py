"""What is sent of a photo: the photo itself and masks, or one object on a transparent ground."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

JPEG_QUALITY = 95
MARGIN = 0.1
"""Of a cut-out's side, on each of its four sides."""
SHRINK = 0.85
"""Factor of a cut-out's side until its file is small enough."""
LEAST_SIDE = 64
"""Side at which a cut-out is sent as it is [px]."""


def photo_jpeg(rgb: NDArray[np.uint8], *, longest: int) -> tuple[bytes, tuple[int, int]]:
    """JPEG of a photo (H, W, 3) with at most ``longest`` pixels a side, without metadata, and its width and height."""
    image = Image.fromarray(np.ascontiguousarray(rgb))
    image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return buffer.getvalue(), image.size


def mask_png(mask: NDArray[np.bool_], size: tuple[int, int]) -> bytes:
    """PNG of a mask (H, W), 255 on the object, in ``size`` (width, height) of the photo that is sent."""
    image = Image.fromarray(mask.astype(np.uint8) * 255)
    return _png(image if image.size == size else image.resize(size, Image.Resampling.NEAREST))


def cut_out_png(rgb: NDArray[np.uint8], mask: NDArray[np.bool_], *, least: int, longest: int, most_bytes: int) -> bytes:
    """RGBA PNG of one object: a square around its mask (H, W) with a margin, alpha 255 on the mask and 0 elsewhere.

    Its side is between ``least`` and ``longest`` [px]. It shrinks, to ``LEAST_SIDE`` at least, until its file has
    at most ``most_bytes``. Pixels off the mask are black: no neighbour is sent."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = int(rows[0]), int(columns[0])
    height, width = int(rows[-1]) + 1 - top, int(columns[-1]) + 1 - left
    side = int(np.ceil(max(height, width) / (1 - 2 * MARGIN)))
    square = np.zeros((side, side, 4), np.uint8)
    y, x = (side - height) // 2, (side - width) // 2
    inside = mask[top : top + height, left : left + width]
    square[y : y + height, x : x + width, :3] = rgb[top : top + height, left : left + width] * inside[..., None]
    square[y : y + height, x : x + width, 3] = inside * np.uint8(255)
    return _small_enough(Image.fromarray(square), min(max(side, least), longest), most_bytes)


def data_uri_of(data: bytes, kind: str) -> str:
    """``kind``: the media type, as ``image/png``."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def _small_enough(image: Image.Image, side: int, most_bytes: int) -> bytes:
    # A filter without negative lobes: others leave faint alpha around the object.
    while True:
        data = _png(image if image.width == side else image.resize((side, side), Image.Resampling.BILINEAR))
        if len(data) <= most_bytes or side <= LEAST_SIDE:
            return data
        side = max(LEAST_SIDE, int(side * SHRINK))


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", compress_level=6)
    return buffer.getvalue()
