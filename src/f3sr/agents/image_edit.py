"""The background by a model that edits pictures: photo and mask are sent, the answer is fitted to the photo."""

from __future__ import annotations

import base64
import binascii
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import f3sr
from f3sr.backends.protocols import BackgroundCompleter
from f3sr.backends.registry import Backend
from f3sr.errors import InputError
from f3sr.io.images import as_rgb, decode_image, resized
from f3sr.models.model_client import ModelConfig, ModelError, answered, require_extra
from f3sr.models.model_endpoint import ModelEndpoint, model_endpoint
from f3sr.scene import Photo
from f3sr.vision.set_of_marks import limited

PROMPT = """Remove the masked objects and their shadows. Continue the surface and the background behind them, with the
same light, texture and grain. Add nothing. Keep everything outside of the mask as it is."""
LONGEST = 1536
"""Longer side of what is sent [px]: services take no more."""
MOST_PIXELS = 40_000_000
"""Largest picture that is decoded [px]."""
REPLY_BYTES = 60_000_000
"""Largest reply: a picture of 1536 by 1024 as base64 has 4 MB."""
SHIFT = 0.02
"""Largest shift that is undone, in longer sides of the photo: models crop and pad by a few pixels."""


class ImageEdit:
    """A ``BackgroundCompleter`` over OpenAI's images edit endpoint, or a server that speaks it."""

    def __init__(self, endpoint: ModelEndpoint, config: ModelConfig | None = None) -> None:
        self.endpoint = endpoint
        self.config = config or ModelConfig(timeout=300.0, deadline=600.0, reply_bytes=REPLY_BYTES)

    def complete(self, photo: Photo, hole: NDArray[np.bool_], support: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
        """The photo (H, W, 3) with its hole (H, W) filled. Raises ModelError without a picture."""
        small = limited(photo.rgb, LONGEST)
        height, width = small.shape[:2]
        mask = np.asarray(Image.fromarray(hole).resize((width, height), Image.Resampling.NEAREST))
        alpha = np.where(mask, 0, 255).astype(np.uint8)  # transparent is what is to be edited
        data = answered(self.endpoint, self.config, lambda http: self._edited(http, _png(small), _png(small, alpha)))
        picture = resized(_decoded(self.endpoint, data), photo.width, photo.height)
        return aligned(picture, photo.rgb, hole)

    async def _edited(self, http: Any, image: bytes, mask: bytes) -> str:
        from openai import AsyncOpenAI

        client = AsyncOpenAI(api_key=self.endpoint.key, base_url=self.endpoint.url, http_client=http, max_retries=0)
        found: Any = await client.images.edit(
            model=self.endpoint.name,
            image=("photo.png", image, "image/png"),
            mask=("mask.png", mask, "image/png"),
            prompt=PROMPT,
        )
        data = found.data[0].b64_json if found.data else None
        if not isinstance(data, str):
            raise ModelError(f"{self.endpoint}: no picture in the reply; accepted: b64_json")
        return data


def image_edit(spec: str) -> Backend[BackgroundCompleter]:
    """The completer of a model's spec. Raises InputError for a bad one, or one that edits no pictures."""
    require_extra()
    endpoint = model_endpoint(spec)
    if endpoint.provider != "openai":
        raise InputError("--background", found=spec, accepted="openai:NAME, or openai:NAME@URL")
    return Backend(kind="background", name=spec, version=f3sr.__version__, made=ImageEdit(endpoint))


def _png(rgb: NDArray[np.uint8], alpha: NDArray[np.uint8] | None = None) -> bytes:
    pixels = rgb if alpha is None else np.dstack([rgb, alpha])
    with io.BytesIO() as file:
        Image.fromarray(pixels).save(file, "PNG")
        return file.getvalue()


def _decoded(endpoint: ModelEndpoint, data: str) -> NDArray[np.uint8]:
    """The picture of a reply. Raises ModelError."""
    try:
        file = io.BytesIO(base64.b64decode(data, validate=True))
        size = decode_image(file, ("PNG", "JPEG", "WEBP"), size_only=True).size
        if size[0] * size[1] > MOST_PIXELS or min(size) < 16:
            raise ValueError(f"{size[0]}x{size[1]} pixels")
        file.seek(0)
        return as_rgb(decode_image(file, ("PNG", "JPEG", "WEBP")))
    except (ValueError, binascii.Error) as error:
        raise ModelError(f"{endpoint}: no readable picture: {error}") from None


def aligned(picture: NDArray[np.uint8], photo: NDArray[np.uint8], hole: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """A picture (H, W, 3) shifted so that it lies on the photo outside of the hole, by whole pixels.

    Phase correlation (Kuglin and Hines 1975) of the luminance; a shift that is too large or makes it no better is not
    made."""
    grey = [p.astype(np.float64).mean(2) for p in (picture, photo)]
    known = ~hole
    if not known.any():
        return picture
    waves = [np.fft.rfft2(np.where(known, g - g[known].mean(), 0.0)) for g in grey]
    cross = waves[1] * np.conj(waves[0])
    peak = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-9), s=hole.shape)
    y, x = (int(k) for k in np.unravel_index(int(np.argmax(peak)), hole.shape))
    shift = [k - n if k > n // 2 else k for k, n in zip((y, x), hole.shape, strict=True)]
    if max(map(abs, shift)) > SHIFT * max(hole.shape):
        return picture
    moved = np.roll(picture, shift, axis=(0, 1))

    def off(p: NDArray[np.uint8]) -> float:
        return float(np.abs(p[known].astype(int) - photo[known]).mean())

    return moved if off(moved) < off(picture) else picture
