"""Masks from COCO JSON: run-length codes, compressed or not, and polygons (cocodataset.org/#format-data)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.files.bounds import MAX_OBJECTS, NewLabel
from f3sr.io.masks import MIN_PIXELS
from f3sr.scene import Photo
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.input_folder_writer import OutlinedObject

ACCEPTED = "COCO JSON: images and annotations with a segmentation, or a list of such annotations"
MAX_CODE = 10_000_000
"""Most characters, or runs, of a code: the file itself is not longer."""
MAX_SHIFT = 30
"""Most bits of a number of a compressed code before its last five: no run is longer than the largest photo."""
FAR = 1e6
"""Largest coordinate of a polygon [px]: ten times a photo's longest side."""
FINER = 4
"""Times that polygons are drawn finer than the photo: a pixel belongs to one that covers half of it."""

Count = Annotated[int, Field(ge=0, le=2**31)]
Place = Annotated[float, Field(ge=-FAR, le=FAR, allow_inf_nan=False)]
Polygon = Annotated[list[Place], Field(min_length=6, max_length=MAX_CODE)]


class RunLengthCode(BaseModel):
    """Runs of 0 and 1 in turn, 0 first, down the columns of a mask of ``size`` rows, columns."""

    model_config = ConfigDict(extra="ignore")

    size: tuple[Count, Count]
    counts: Annotated[str, Field(max_length=MAX_CODE)] | Annotated[list[Count], Field(max_length=MAX_CODE)]


class _Annotation(BaseModel):
    model_config = ConfigDict(extra="ignore")

    image_id: int | str | None = None
    category_id: int | None = None
    segmentation: RunLengthCode | Annotated[list[Polygon], Field(min_length=1, max_length=10_000)]


class _Picture(BaseModel):
    model_config = ConfigDict(extra="ignore")

    id: int | str
    file_name: str = ""
    width: int | None = None
    height: int | None = None


class _Category(BaseModel):
    model_config = ConfigDict(extra="ignore")

    id: int
    name: NewLabel


class _CocoDocument(BaseModel):
    model_config = ConfigDict(extra="ignore")

    images: list[_Picture] = []
    annotations: list[dict[str, Any]]
    categories: list[_Category] = []


def read_coco(file: Path, photo: Photo, *, name: str = "") -> dict[int, OutlinedObject]:
    """The objects of a COCO file by their place in it, with the names of their categories.

    Of several images, the one with the file ``name`` counts. Raises InputError for what is no such file, or has
    another size than the photo.
    """
    value = strict_json.read(file, accepted=ACCEPTED)
    try:
        document = _CocoDocument.model_validate({"annotations": value} if isinstance(value, list) else value)
        chosen = _of_image(file, document, name)
        if not 1 <= len(chosen) <= MAX_OBJECTS:
            raise InputError(file, found=f"{len(chosen)} annotations", accepted=f"1 to {MAX_OBJECTS} of the photo")
        annotations = [_Annotation.model_validate(annotation) for annotation in chosen]
    except ValidationError as error:
        found, accepted = strict_json.problem(error, "annotations")
        raise InputError(file, found=found, accepted=accepted) from error
    names = {category.id: category.name for category in document.categories}
    return {k: _object(file, k, a, names, photo) for k, a in enumerate(annotations)}


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


def _of_image(file: Path, document: _CocoDocument, name: str) -> list[dict[str, Any]]:
    """The annotations of the photo."""
    if len(document.images) < 2:
        return document.annotations
    ids = [picture.id for picture in document.images if Path(picture.file_name).name == name]
    if len(ids) != 1:
        found = f"{len(document.images)} images, {len(ids)} of them named {name}"
        raise InputError(file, found=found, accepted="one image, or one with the photo's file name")
    return [annotation for annotation in document.annotations if annotation.get("image_id") == ids[0]]


def _object(file: Path, number: int, a: _Annotation, names: dict[int, str], photo: Photo) -> OutlinedObject:
    where, shape = f"annotation {number}", (photo.height, photo.width)
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
    return OutlinedObject(label=names.get(a.category_id, "") if a.category_id is not None else "", mask=mask)


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
