"""Pictures of a project that need no scene: its photo, small and large, and the photo with its masks."""

from __future__ import annotations

import colorsys
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.errors import InputError
from f3sr.io.images import as_rgb, open_image, resized
from f3sr.mask_page.mask_pictures import LONGEST_SIDE
from f3sr.scene_package.package_folder import PHOTO
from f3sr.segmentation.input_folder_writer import IMAGES, MASKS
from f3sr.studio.workspace import Project

THUMBNAIL = 360
"""Longest side of the picture in the list of projects [px]."""
TINT = 0.5
"""Share of a mask's colour over the photo."""
QUALITY = 88
GOLDEN = 0.618034
"""Step of the hue from mask to mask: neighbours differ."""


def photo(project: Project, longest: int = LONGEST_SIDE) -> bytes:
    """JPEG of the photo, upright. Raises InputError where none is there, or it cannot be read."""
    return _jpeg(_read(project, longest))


def thumbnail(project: Project) -> bytes:
    """The same for the list of projects."""
    return photo(project, THUMBNAIL)


def masks(project: Project) -> bytes:
    """JPEG of the photo with every mask of the input folder in a colour of its own."""
    picture = _read(project, LONGEST_SIDE).astype(float)
    height, width = picture.shape[:2]
    folder = project.input / MASKS
    for k, file in enumerate(sorted(folder.glob("*.png")) if folder.is_dir() else ()):
        grey = np.asarray(open_image(file).convert("L").resize((width, height)))
        color = 255 * np.array(colorsys.hsv_to_rgb(k * GOLDEN % 1, 0.8, 1))
        picture[grey > 127] = (1 - TINT) * picture[grey > 127] + TINT * color
    return _jpeg(picture.astype(np.uint8))


def _read(project: Project, longest: int) -> NDArray[np.uint8]:
    rgb = as_rgb(open_image(_file(project)))
    scale = min(1.0, longest / max(rgb.shape[:2]))
    return resized(rgb, max(1, round(scale * rgb.shape[1])), max(1, round(scale * rgb.shape[0])))


def _file(project: Project) -> Path:
    """What was given, or what the input folder or the package has."""
    places = [project.photo, *(project.input / name for name in IMAGES), project.package / PHOTO]
    for file in places:
        if file is not None and file.is_file():
            return file
    raise InputError("the project", found="no photo", accepted="one with a photo, an input folder or a package")


def _jpeg(rgb: NDArray[np.uint8]) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(rgb).save(stream, "JPEG", quality=QUALITY)
    return stream.getvalue()
