"""Writing a prompted-image folder: the photo as it is, a mask for every object, the ground, and the prompts."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError, OutputError
from f3sr.files import limited_file
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.io.images import as_rgb, encode_png, open_image
from f3sr.io.masks import MAX_ID_DIGITS, MIN_PIXELS
from f3sr.runtime.unchanged_folder import FolderNote
from f3sr.scene import Photo
from f3sr.segmentation.selection import Selection
from f3sr.segmentation.selection_json import PROMPTS, selection_bytes

MASKS, GROUND_FILE = "masks", "ground.png"
IMAGES = ("image.png", "image.jpg")
OUTLINED = FolderNote(name=PROMPTS, writer="f3sr segment")
MAX_PHOTO_BYTES = 200_000_000
"""Largest photo file: a PNG of the largest photo, hardly compressed."""
MAX_NAME = 60
"""Most characters of a label in a file's name."""
PNG = b"\x89PNG"


@dataclass(frozen=True, eq=False, kw_only=True)
class OutlinedObject:
    """An object's ``mask`` (H, W) and its label, which may be empty."""

    label: str
    mask: NDArray[np.bool_]


def read_photo(file: Path) -> Photo:
    """A PNG or JPEG, upright by its EXIF orientation. Raises InputError."""
    return Photo(rgb=as_rgb(open_image(file)))


def write_input_folder(
    out: Path,
    *,
    photo: Path,
    objects: Mapping[int, OutlinedObject],
    ground: NDArray[np.bool_],
    selection: Selection | None = None,
) -> Path:
    """Write a prompted-image folder whole or not at all; returns its full path.

    ``photo`` is copied byte for byte. ``objects`` are by id, ``ground`` (H, W) may be empty. An older folder is
    replaced as f3sr segment wrote it, not a changed one. Raises InputError for masks that no input folder may hold,
    OutputError for any other place.
    """
    data = limited_file.read(photo, most=MAX_PHOTO_BYTES, accepted="a PNG or JPEG image")
    _require_objects(objects)
    full = Path(out).absolute().resolve()
    if Path(photo).resolve().is_relative_to(full):
        raise OutputError(f"{full}: holds the photo; give another folder")
    with OUTLINED.writing(full) as folder:
        folder.write(IMAGES[0] if data.startswith(PNG) else IMAGES[1], data)
        for id, o in sorted(objects.items()):
            folder.write(f"{MASKS}/{mask_name(id, o.label)}", _grey(o.mask))
        if ground.sum() >= MIN_PIXELS:
            folder.write(GROUND_FILE, _grey(ground))
        folder.end(lambda files: selection_bytes(selection or Selection(prompts=()), files))
    return full


def require_writable(out: Path) -> Path:
    """The full path of a folder that ``write_input_folder`` may write, or the OutputError that it would raise."""
    return OUTLINED.check(Path(out).absolute().resolve())


def mask_name(id: int, label: str) -> str:
    """The file name of a mask: ``3``, "Red mug!" is 03_Red_mug.png. Letters of any script stay."""
    plain = unicodedata.normalize("NFC", label)
    words = "".join(c if c.isalnum() or c in "-'." else " " for c in plain).strip(" .")
    short = re.sub(r"\s+", "_", words)[:MAX_NAME]
    while len(short.encode()) > 3 * MAX_NAME:
        short = short[:-1]
    return f"{id:02d}_{short}.png" if short else f"{id:02d}.png"


def _grey(mask: NDArray[np.bool_]) -> bytes:
    return encode_png(mask.astype(np.uint8) * 255)


def _require_objects(objects: Mapping[int, OutlinedObject]) -> None:
    """As an input folder is read: enough pixels, few enough objects, ids that names can hold."""
    if not 1 <= len(objects) <= MAX_OBJECTS:
        raise InputError("objects", found=f"{len(objects)}", accepted=f"1 to {MAX_OBJECTS}")
    for id, o in objects.items():
        if not 0 <= id < 10**MAX_ID_DIGITS:
            raise InputError("objects", found=f"the id {id}", accepted=f"0 to {MAX_ID_DIGITS} digits")
        if (count := int(o.mask.sum())) < MIN_PIXELS:
            name = f"object {id}" + (f" ({o.label:.40})" if o.label else "")
            raise InputError(name, found=f"{count} pixels that no other mask holds", accepted=f"at least {MIN_PIXELS}")
