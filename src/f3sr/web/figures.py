"""Pictures as data URIs and figures."""

from __future__ import annotations

import base64
import io

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from f3sr.web.markup import Child, Markup, el

QUALITY = 82
"""Of JPEG pictures; thin coloured lines keep their colour (no chroma subsampling)."""


def data_uri(picture: NDArray[np.uint8], quality: int = QUALITY) -> Markup:
    """(h, w, 3) as JPEG."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(picture).save(buffer, "JPEG", quality=quality, subsampling=0)
    return Markup("data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode())


def img(picture: NDArray[np.uint8], alt: str, **attributes: str) -> Markup:
    height, width = picture.shape[:2]
    return el("img", src=data_uri(picture), alt=alt, width=width, height=height, **attributes)


def figure(content: Child, caption: Child, **attributes: str) -> Markup:
    return el("figure", content, el("figcaption", caption), **attributes)
