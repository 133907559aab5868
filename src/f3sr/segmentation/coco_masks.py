"""Masks from COCO JSON: run-length codes, compressed or not, and polygons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from f3sr.errors import InputError
from f3sr.io.masks import MIN_PIXELS
from f3sr.scene import Photo
from f3sr.segmentation.coco_document import MAX_CODE, CocoAnnotation, RunLengthCode, read_annotations
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.input_folder_writer import OutlinedObject

MAX_SHIFT = 30
"""Most bits of a number of a compressed code before its last five: no run is longer than the largest photo."""
FINER = 4
"""Times that polygons are drawn finer than the photo: a pixel belongs to one that covers half of it."""


def read_coco(file: Path, photo: Photo, *, name: str = "") -> dict[int, OutlinedObject]:
    """The objects of a COCO file by their place in it, with the names of their categories.

    Of several images, the one with the file ``name`` counts. Raises InputError for what is no such file, or has
    another size than the photo.
    """
    found = read_annotations(file, photo, name)
    return {k: _object(file, f"annotation {k}", a, label, photo) for k, (a, label) in enumerate(found)}


def decoded(code: RunLengthCode) -> Mask:
    """The mask (h, w) of a run-length code. Raises ValueError where its runs do not fill the mask."""
    h, w = code.size
    runs = _numbers(code.counts) if isinstance(code.counts, str) else np.array(code.counts, np.int64)
    if len(runs) > h * w + 1 or (len(runs) and int(runs.max()) > h * w) or int(runs.sum()) != h * w:
        raise ValueError(f"runs of {sum(map(int, runs))} pixels for {h} x {w}")
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(w, h).T.copy()


def _numbers(text: str) -> NDArray[np.int64]:
    """Runs of a compressed code: five bits a character, 48 is 0, the lowest first; the sixth bit says that more follow.

    The last of a number's bits is its sign. From the fourth on, a number is added to the one before the last."""
    runs, value, shift = list[int](), 0, 0
    for character in text:
        bits = ord(character) - 48
        if not 0 <= bits < 64 or shift > MAX_SHIFT:
            raise ValueError(f"the character {character!r} in a run-length code")
        value |= (bits & 31) << shift
        shift += 5
        if bits & 32:
            continue
        value -= (1 << shift) if bits & 16 else 0
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
        value, shift = 0, 0
    if shift or any(run < 0 or run > 2**31 for run in runs):
        raise ValueError("a run-length code that ends too early, or with negative runs")
    return np.array(runs, np.int64)


def _object(file: Path, where: str, a: CocoAnnotation, label: str, photo: Photo) -> OutlinedObject:
    shape = (photo.height, photo.width)
    try:
        if isinstance(a.segmentation, RunLengthCode):
            if a.segmentation.size != shape:
                raise ValueError(f"a size of {a.segmentation.size[1]}x{a.segmentation.size[0]} pixels")
            mask = decoded(a.segmentation)
        else:
            mask = _drawn(a.segmentation, shape)
        if (count := int(mask.sum())) < MIN_PIXELS:
            raise ValueError(f"{count} pixels")
    except ValueError as error:
        accepted = f"masks of {photo.width}x{photo.height} pixels, at least {MIN_PIXELS} of them set"
        raise InputError(file, found=f"{where}: {error}", accepted=accepted) from error
    return OutlinedObject(label=label, mask=mask)


def _drawn(polygons: list[list[float]], shape: tuple[int, int]) -> Mask:
    """The union (h, w) of polygons of x, y in turn."""
    mask = np.zeros(shape, np.bool_)
    for polygon in polygons:
        if len(polygon) % 2:
            raise ValueError(f"a polygon of {len(polygon)} numbers")
        points = np.array(polygon).reshape(-1, 2)
        low = np.clip(np.floor(points.min(0)).astype(int), 0, shape[::-1])
        high = np.clip(np.ceil(points.max(0)).astype(int), low, shape[::-1])
        if (high > low).all():
            mask[low[1] : high[1], low[0] : high[0]] |= _filled(points - low, *(high - low))
    return mask


def _filled(points: NDArray[np.float64], w: int, h: int) -> Mask:
    """Pixels (h, w) of which a polygon covers at least half."""
    finer = FINER if w * h * FINER**2 <= 4 * MAX_CODE else 1
    canvas = Image.new("L", (w * finer, h * finer))
    ImageDraw.Draw(canvas).polygon([(x, y) for x, y in points * finer - 0.5], fill=1)
    parts = np.asarray(canvas).reshape(h, finer, w, finer)
    return parts.sum((1, 3)) * 2 >= finer**2
