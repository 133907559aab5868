"""What the page shows of photo and masks: pictures no larger than a screen needs."""

from __future__ import annotations

import base64
import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.io.images import resized
from f3sr.scene import Photo

LONGEST_SIDE = 2048
"""Of the photo as it is shown [px]: more than most windows have, and three times as many as they show at once."""
QUALITY = 90
"""Of its JPEG: edges that somebody traces have to be seen."""


def shown_scale(photo: Photo) -> float:
    """Pixels of the shown photo per pixel of the photo, at most 1."""
    return min(1.0, LONGEST_SIDE / max(photo.width, photo.height))


def shown_size(photo: Photo) -> tuple[int, int]:
    """Width and height of the shown photo [px]."""
    scale = shown_scale(photo)
    return max(1, round(scale * photo.width)), max(1, round(scale * photo.height))


def shown_photo(photo: Photo) -> bytes:
    """JPEG of the shown photo."""
    stream = io.BytesIO()
    picture = Image.fromarray(resized(photo.rgb, *shown_size(photo)))
    picture.save(stream, "JPEG", quality=QUALITY, subsampling=0)
    return stream.getvalue()


def mask_picture(mask: NDArray[np.bool_], size: tuple[int, int]) -> dict[str, Any] | None:
    """A mask (H, W) as the page takes it: corner x, y in the shown photo of ``size`` [px], and a PNG that is white and
    opaque where the mask is. None for a mask without pixels."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return None
    across, down = size[0] / mask.shape[1], size[1] / mask.shape[0]
    left, right = math.floor(across * columns[0]), math.ceil(across * (columns[-1] + 1))
    top, bottom = math.floor(down * rows[0]), math.ceil(down * (rows[-1] + 1))
    region = (left / across, top / down, min(right / across, mask.shape[1]), min(bottom / down, mask.shape[0]))
    whole = Image.fromarray(mask.view(np.uint8) * np.uint8(255))
    cut = whole.resize((right - left, bottom - top), Image.Resampling.BOX, box=region)
    alpha = Image.fromarray((np.asarray(cut) >= 128).view(np.uint8) * np.uint8(255))
    stream = io.BytesIO()
    Image.merge("LA", (Image.new("L", alpha.size, 255), alpha)).save(stream, "PNG", compress_level=1)
    return {"x": left, "y": top, "png": base64.b64encode(stream.getvalue()).decode()}
