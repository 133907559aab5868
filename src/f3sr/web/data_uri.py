"""Pictures and films as data URIs: letters, digits and signs that no attribute has to escape."""

from __future__ import annotations

import base64
import io

import numpy as np
import PIL.Image
from numpy.typing import NDArray

QUALITY = 82
"""Of JPEG pictures; thin coloured lines keep their colour (no chroma subsampling)."""


def data_uri(data: bytes, kind: str) -> str:
    """``kind``: the media type, such as ``video/mp4``."""
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"


def jpeg_uri(picture: NDArray[np.uint8], quality: int = QUALITY) -> str:
    """(h, w, 3) as JPEG."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(picture).save(buffer, "JPEG", quality=quality, subsampling=0)
    return data_uri(buffer.getvalue(), "image/jpeg")
