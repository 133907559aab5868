"""Opening images that come from outside: size checked before pixels are decoded, one error for whatever is wrong."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from f3sr.errors import InputError

MAX_PIXELS = 100_000_000
"""Largest photo, mask or depth image accepted."""


def open_image(path: Path) -> Image.Image:
    """A decoded PNG or JPEG image, turned as its EXIF orientation says; InputError when unreadable or too large."""
    try:
        with warnings.catch_warnings(), Image.open(path, formats=("PNG", "JPEG")) as image:
            warnings.simplefilter("ignore")  # PIL's own, lower limit
            if image.width * image.height > MAX_PIXELS:
                raise InputError(
                    path,
                    found=f"{image.width}x{image.height} pixels",
                    accepted=f"at most {MAX_PIXELS:,} pixels",
                )
            image.load()
            return ImageOps.exif_transpose(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, RuntimeError) as error:
        raise InputError(path, found=f"no readable image ({error})", accepted="a PNG or JPEG image") from error


def as_rgb(image: Image.Image) -> NDArray[np.uint8]:
    """(h, w, 3) 8-bit RGB; 16-bit grey is scaled, alpha is ignored."""
    if image.mode.startswith("I"):
        image = Image.fromarray((np.asarray(image) / 257).clip(0, 255).astype(np.uint8))
    return np.asarray(image.convert("RGB"))
