"""Images: opened after their size is checked, with one kind of error for all faults; resized; encoded as PNG."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps

from f3sr.errors import InputError
from f3sr.files.limited_file import opened

MAX_PIXELS = 100_000_000
"""Largest photo, mask or depth image: twice what cameras of full format give, 300 MB decoded."""
MIN_SIDE = 16
"""Shortest side of a photo, mask or depth image: less shows no scene."""
ACCEPTED = f"a PNG or JPEG image of at most {MAX_PIXELS:,} pixels"


def open_image(path: Path) -> Image.Image:
    """A decoded PNG or JPEG image, turned as its EXIF orientation says; InputError when unreadable or too large."""
    try:
        with opened(path) as file:
            image = decode_image(file, ("PNG", "JPEG"), size_only=True)
            if image.width * image.height > MAX_PIXELS or min(image.size) < MIN_SIDE:
                raise InputError(
                    path,
                    found=f"{image.width}x{image.height} pixels",
                    accepted=f"sides of at least {MIN_SIDE}, and at most {MAX_PIXELS:,} pixels",
                )
            if image.format == "PNG" and getattr(image, "is_animated", False):
                raise InputError(path, found="an animation", accepted="a still image")
            file.seek(0)
            return decode_image(file, ("PNG", "JPEG"))
    except ValueError as error:
        raise InputError(path, found=f"no readable image: {error}", accepted=ACCEPTED) from error


def exif_orientation(path: Path) -> int:
    """By which EXIF tells how a readable photo is turned and mirrored: 1 where it is upright, or nothing is told."""
    with opened(path) as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return int(Image.open(file, formats=("PNG", "JPEG")).getexif().get(ExifTags.Base.Orientation, 1))
        except Exception:  # PIL raises many kinds for broken tags, and turns no such photo
            return 1


def decode_image(file: IO[bytes], formats: tuple[str, ...], *, size_only: bool = False) -> Image.Image:
    """A PIL image, upright by its EXIF orientation; with ``size_only`` only its header is read.

    Raises ValueError for any fault. PIL's own warnings are off.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            image = Image.open(file, formats=formats)
            if size_only:
                return image
            image.load()
            return ImageOps.exif_transpose(image)
        except Exception as error:  # PIL raises many kinds for a broken file
            raise ValueError(_words(error)) from error


def _words(error: Exception) -> str:
    """What is wrong, without PIL's own words: they name memory addresses and change with its version."""
    if isinstance(error, Image.DecompressionBombError):
        return "too many pixels"
    return "another format" if isinstance(error, Image.UnidentifiedImageError) else "damaged"


def as_rgb(image: Image.Image) -> NDArray[np.uint8]:
    """(h, w, 3) uint8 sRGB of an image; 16-bit grey is scaled, alpha is ignored."""
    if image.mode.startswith("I"):
        # 65535 / 257 = 255: white stays white.
        image = Image.fromarray((np.asarray(image) / 257).clip(0, 255).astype(np.uint8))
    return np.asarray(image.convert("RGB"))


def encode_png(rgb: NDArray[np.uint8]) -> bytes:
    """PNG bytes of (h, w, 3) uint8, or of grey (h, w)."""
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(rgb)).save(stream, format="PNG", compress_level=4)
    return stream.getvalue()


def resized(picture: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """A picture (h, w, 3) with other pixels (height, width, 3), filtered."""
    if picture.shape[:2] == (height, width):
        return picture
    image = Image.fromarray(picture)
    return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS, reducing_gap=3.0))
