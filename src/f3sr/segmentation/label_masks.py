"""Masks from other programs as pictures: one label map, or a cut-out for every object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.files.limited_file import opened
from f3sr.io.images import open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import MIN_PIXELS, ids_of_stems
from f3sr.scene import Photo
from f3sr.segmentation.input_folder_writer import PNG, OutlinedObject

MAP = "a PNG of 1, 8 or 16 bits grey or with a palette, whose values number the objects; 0 is none"
CUTOUT = "photo-sized *.png, each with an alpha channel that shows one object"
OPAQUE = 127
"""Alpha above which a pixel belongs to the object."""


def read_label_map(file: Path, photo: Photo) -> dict[int, OutlinedObject]:
    """The objects of a label map, by its values, without labels. Raises InputError."""
    with opened(file, accepted=MAP) as stream:
        if stream.read(len(PNG)) != PNG:
            raise InputError(file, found="no PNG", accepted=MAP)
    image = open_image(file)
    if image.mode not in ("1", "L", "P") and not image.mode.startswith("I"):
        raise InputError(file, found=f"a picture of mode {image.mode}", accepted=MAP)
    numbers = np.asarray(image)
    _require_size(file, numbers, photo)
    values = np.unique(numbers)
    values = values[values != 0]
    if not 1 <= len(values) <= MAX_OBJECTS:
        raise InputError(file, found=f"{len(values)} objects", accepted=f"1 to {MAX_OBJECTS}")
    objects = {int(v): OutlinedObject(label="", mask=numbers == v) for v in values}
    for value, o in objects.items():
        _require_seen(file, f"value {value}", o.mask)
    return objects


def read_cutouts(folder: Path, photo: Photo) -> dict[int, OutlinedObject]:
    """The objects of cut-outs, ids and labels by file names as masks/ has them. Raises InputError."""
    source = InputFolder(folder, accepted=f"a folder of {CUTOUT}")
    names = source.names()
    if strange := [name for name in names if not name.endswith(".png")]:
        raise InputError(folder, found=strange[0], accepted=CUTOUT)
    if not 1 <= len(names) <= MAX_OBJECTS:
        raise InputError(folder, found=f"{len(names)} files", accepted=f"1 to {MAX_OBJECTS}, {CUTOUT}")
    objects = dict[int, OutlinedObject]()
    for name, (id, label) in zip(names, ids_of_stems(folder, [Path(name).stem for name in names]), strict=True):
        file = source.file(name)
        image = open_image(file)
        if "A" not in image.getbands():
            raise InputError(file, found=f"a picture of mode {image.mode} without alpha", accepted=CUTOUT)
        alpha = np.asarray(image.getchannel("A"))
        _require_size(file, alpha, photo)
        objects[id] = OutlinedObject(label=label, mask=alpha > OPAQUE)
        _require_seen(file, "its alpha channel", objects[id].mask)
    return objects


def _require_size(file: Path, picture: NDArray[Any], photo: Photo) -> None:
    if picture.shape != (photo.height, photo.width):
        found = f"{picture.shape[1]}x{picture.shape[0]} pixels"
        raise InputError(file, found=found, accepted=f"the photo's size {photo.width}x{photo.height}")


def _require_seen(file: Path, what: str, mask: NDArray[np.bool_]) -> None:
    if (count := int(mask.sum())) < MIN_PIXELS:
        raise InputError(file, found=f"{count} pixels of {what}", accepted=f"at least {MIN_PIXELS} pixels an object")
