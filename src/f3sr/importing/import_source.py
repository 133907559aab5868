"""What a user names for an import: a folder or a file of a program, and what is known besides."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from f3sr.backends.protocols import KnownFocal
from f3sr.errors import InputError
from f3sr.files import limited_file
from f3sr.io.exif import ExifError, focal_by_exif
from f3sr.io.images import as_rgb, open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import ids_of_stems, read_mask
from f3sr.io.photo_hints import PhotoHints
from f3sr.scene import Photo
from f3sr.segmentation.input_folder_writer import MAX_PHOTO_BYTES, OutlinedObject

PHOTO_NAMES = ("image.png", "image.jpg", "image.jpeg")
PHOTO = "a PNG or JPEG image"
Masks = Mapping[int, OutlinedObject]
"""Masks and labels by id."""
MaskReader = Callable[["SourcePhoto"], Masks]
"""Reads the masks that an option names, for a photo."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SourcePhoto:
    """A photo as a file and as pixels."""

    file: Path
    data: bytes
    """The file, byte for byte."""
    photo: Photo
    focal: KnownFocal | None
    """By its EXIF, where that tells."""

    @classmethod
    def of(cls, file: Path) -> SourcePhoto:
        """Raises InputError for what is no PNG or JPEG."""
        data = limited_file.read(file, most=MAX_PHOTO_BYTES, accepted=PHOTO)
        image = open_image(file)
        try:
            focal = focal_by_exif(image)
        except ExifError:
            focal = None
        return cls(file=file, data=data, photo=Photo(rgb=as_rgb(image)), focal=focal)


@dataclass(frozen=True, eq=False, kw_only=True)
class ImportSource:
    """A place on disk and the options beside it. Files below ``path`` are untrusted."""

    path: Path
    photo_file: Path | None = None
    """The photo, where the user names it."""
    mask_reader: MaskReader | None = None
    """Masks that the user names; they overrule those of the place."""
    in_order: bool = False
    """Whether the n-th mesh by name belongs to the n-th mask by id."""
    hints: PhotoHints = field(default_factory=PhotoHints)
    """The focal length, where the user knows it."""
    asset_frame: str = "auto"
    """Axes of the photo's camera that meshes are in; "auto" where they are in a world."""

    @cached_property
    def place(self) -> InputFolder:
        """The folder, or the one that the file lies in."""
        return InputFolder(self.path if self.path.is_dir() else self.path.parent)

    @cached_property
    def photo(self) -> SourcePhoto | None:
        """The photo that the user names, else the folder's own, if it has one. Raises InputError."""
        if self.photo_file is not None:
            return SourcePhoto.of(self.photo_file)
        names = [name for name in PHOTO_NAMES if self.path.is_dir() and self.place.has(name)]
        if len(names) > 1:
            raise InputError(self.path, found=" and ".join(names), accepted="one photo, or --photo")
        return SourcePhoto.of(self.place.file(names[0])) if names else None

    def required_photo(self) -> SourcePhoto:
        """The photo. Raises InputError where there is none."""
        if self.photo is None:
            raise InputError(self.path, found=f"no {' or '.join(PHOTO_NAMES)}", accepted="--photo FILE")
        return self.photo

    def named_masks(self) -> Masks | None:
        """The masks that an option names. Raises InputError."""
        return self.mask_reader(self.required_photo()) if self.mask_reader else None

    def focal(self, photo: SourcePhoto) -> KnownFocal | None:
        """The focal length [px]: the user's, else EXIF's."""
        return self.hints.known_focal(photo.photo) or photo.focal


def masks_of_folder(folder: Path) -> MaskReader:
    """Reads a folder of one black and white PNG per object, named as in masks/ of an input folder."""

    def read(photo: SourcePhoto) -> Masks:
        source = InputFolder(folder, accepted="a folder of *.png files, a mask per object")
        names = source.names()
        if strange := [name for name in names if not name.endswith(".png")]:
            raise InputError(folder, found=strange[0], accepted="nothing but *.png files, a mask each")
        if not names:
            raise InputError(folder, found="no masks", accepted="*.png, a mask per object")
        return masks_named(source, names, photo)

    return read


def masks_named(source: InputFolder, names: list[str], photo: SourcePhoto, base: str = "") -> Masks:
    """Masks by file names below ``base``: leading digits are the id, the rest the label. Raises InputError."""
    told = ids_of_stems(source.path(base), [Path(name).stem for name in names])
    relative = [f"{base}/{name}" if base else name for name in names]
    return {
        id: OutlinedObject(label=label, mask=read_mask(source, file, photo.photo))
        for file, (id, label) in zip(relative, told, strict=True)
    }
