"""What COCO JSON says of a photo's objects: segmentations and names, checked (cocodataset.org/#format-data)."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from f3sr.errors import F3srWarning, InputError
from f3sr.files import strict_json
from f3sr.files.bounds import MAX_OBJECTS, NewLabel
from f3sr.scene import Photo

ACCEPTED = "COCO JSON: images and annotations with a segmentation, or a list of such annotations"
MAX_CODE = 10_000_000
"""Most characters, or runs, of a code: the file itself is not longer."""
FAR = 1e6
"""Largest coordinate of a polygon [px]: ten times a photo's longest side."""
LISTED = 20
"""Most ids that an error lists."""

Id = int | str
K = TypeVar("K", bound=Id)
V = TypeVar("V")
Count = Annotated[int, Field(ge=0, le=2**31)]
Place = Annotated[float, Field(ge=-FAR, le=FAR, allow_inf_nan=False)]
Polygon = Annotated[list[Place], Field(min_length=6, max_length=MAX_CODE)]


def _by_type(accepted: str, **tags: type) -> Discriminator:
    """Which part of a union a value is for: an error then is of that part alone."""

    def tag(value: object) -> str | None:
        return next((name for name, kind in tags.items() if isinstance(value, kind)), None)

    return Discriminator(tag, custom_error_type="kind", custom_error_message=accepted)


class RunLengthCode(BaseModel):
    """Runs of 0 and 1 in turn, 0 first, down the columns of a mask of ``size`` rows, columns."""

    model_config = ConfigDict(extra="ignore")

    size: tuple[Count, Count]
    counts: Annotated[
        Annotated[str, Field(max_length=MAX_CODE), Tag("text")]
        | Annotated[list[Count], Field(max_length=MAX_CODE), Tag("runs")],
        _by_type("text or a list of runs", text=str, runs=list),
    ]


class CocoAnnotation(BaseModel):
    """One object."""

    model_config = ConfigDict(extra="ignore")

    category_id: int | None = None
    iscrowd: Literal[0, 1] = 0
    segmentation: Annotated[
        Annotated[RunLengthCode, Tag("code")]
        | Annotated[list[Polygon], Field(min_length=1, max_length=10_000), Tag("polygons")],
        _by_type("a run-length code or a list of polygons", code=dict, polygons=list),
    ]


class _OfImage(BaseModel):
    """An annotation that is not looked at before it is known to be of the photo."""

    model_config = ConfigDict(extra="allow")

    image_id: Id | None = None


class _Picture(BaseModel):
    model_config = ConfigDict(extra="ignore")

    id: Id
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
    annotations: list[_OfImage]
    categories: list[_Category] = []


def read_annotations(file: Path, photo: Photo, name: str) -> list[tuple[CocoAnnotation, str]]:
    """The annotations of a photo with the file ``name``, and the names of their categories. Raises InputError.

    One image of another name is taken, and an F3srWarning tells it: photos are renamed."""
    value = strict_json.read(file, accepted=ACCEPTED)
    try:
        document = _CocoDocument.model_validate({"annotations": value} if isinstance(value, list) else value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, "annotations")
        raise InputError(file, found=found, accepted=accepted) from error
    names = _by_id(file, "categories", [(category.id, category.name) for category in document.categories])
    chosen = _of_photo(file, document, photo, name)
    if not 1 <= len(chosen) <= MAX_OBJECTS:
        raise InputError(file, found=f"{len(chosen)} annotations", accepted=f"1 to {MAX_OBJECTS} of the photo")
    return [_named(file, f"annotation {k}", a.model_extra or {}, names) for k, a in enumerate(chosen)]


def _of_photo(file: Path, document: _CocoDocument, photo: Photo, name: str) -> list[_OfImage]:
    """The annotations of the photo."""
    annotations, images = document.annotations, _by_id(file, "images", [(i.id, i) for i in document.images])
    if not images:
        if len(told := list(dict.fromkeys(a.image_id for a in annotations))) > 1:
            found = f"no images, and annotations of the images {_listed(told)}"
            raise InputError(file, found=found, accepted="annotations of one image, or images with their file names")
        return annotations
    alone = len(images) == 1
    for k, a in enumerate(annotations):
        if a.image_id not in images and not (alone and a.image_id is None):
            found = f"annotation {k}: image_id {a.image_id!r}"
            raise InputError(file, found=found, accepted=f"an id of images: {_listed(list(images))}")
    fitting = [i for i in images.values() if Path(i.file_name).name == name]
    if len(fitting) != 1 and not alone:
        found = f"{len(images)} images, {len(fitting)} of them named {name}"
        raise InputError(file, found=found, accepted="one image, or one with the photo's file name")
    image = (fitting or list(images.values()))[0]
    if (size := (image.width or photo.width, image.height or photo.height)) != (photo.width, photo.height):
        found = f"an image of {size[0]}x{size[1]} pixels"
        raise InputError(file, found=found, accepted=f"the photo's {photo.width}x{photo.height}")
    if image.file_name and name and not fitting:
        told = f"{file}: its image is {Path(image.file_name).name}, the photo {name}; they are taken for the same"
        warnings.warn(told, F3srWarning, stacklevel=2)
    return [a for a in annotations if alone or a.image_id == image.id]


def _named(file: Path, where: str, annotation: dict[str, Any], names: Mapping[int, str]) -> tuple[CocoAnnotation, str]:
    """An annotation and the name of its category, which may be empty."""
    try:
        found = CocoAnnotation.model_validate(annotation)
    except ValidationError as error:
        problem, accepted = strict_json.problem(error, "segmentation")
        raise InputError(file, found=f"{where}: {problem}", accepted=accepted) from error
    if found.iscrowd:
        accepted = "iscrowd 0: each is one object"
        raise InputError(file, found=f"{where}: iscrowd 1, a group of objects", accepted=accepted)
    if found.category_id is None or not names:
        return found, ""
    if found.category_id not in names:
        accepted = f"an id of categories: {_listed(list(names))}"
        raise InputError(file, found=f"{where}: category_id {found.category_id}", accepted=accepted)
    return found, names[found.category_id]


def _by_id(file: Path, what: str, items: Sequence[tuple[K, V]]) -> dict[K, V]:
    """Things by their ids. Raises InputError for an id that two have."""
    (id, count), *_ = Counter(id for id, _ in items).most_common(1) or [("", 0)]
    if count > 1:
        raise InputError(file, found=f"{what}: {count} with the id {id!r}", accepted="each id once")
    return dict(items)


def _listed(ids: Sequence[Id | None]) -> str:
    return ", ".join(repr(id) for id in ids[:LISTED]) + (", ..." if len(ids) > LISTED else "")
