"""What a user knows of a photo, where its geometry is made from it: focal length, camera height, known lengths."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from f3sr.backends.protocols import KnownFocal
from f3sr.errors import InputError
from f3sr.io.exif import FILM_DIAGONAL
from f3sr.io.geometry import MAX_FOCAL, MIN_FOCAL
from f3sr.scene import Instance, Photo

LENGTHS = (1e-3, 100.0)
"""Least and largest known length of an object [m]."""
HEIGHTS = (0.02, 1000.0)
"""Least and largest height of a camera above the ground [m]: from a macro shot to a drone."""
MILLIMETRES = (4.0, 1300.0)
"""Least and largest focal length, 35 mm equivalent [mm]."""
KNOWN = '"LABEL=METRES" or "ID=METRES", comma separated'


@dataclass(frozen=True, kw_only=True)
class PhotoHints:
    """Values of a user, which override what the photo and its EXIF tell. Raises InputError for one out of range."""

    focal: float | None = None
    """Focal length [px] of the upright photo."""
    focal_35mm: float | None = None
    """The same in 35 mm equivalent [mm]: by diagonals, as EXIF has it. At most one of the two."""
    camera_height: float | None = None
    """Height of the camera above the ground, that is, above what the objects stand on [m]."""
    known: Mapping[str, float] = field(default_factory=dict[str, float])
    """Longest side of the tightest box around an object [m], by the object's id or label."""

    def __post_init__(self) -> None:
        if self.focal is not None and self.focal_35mm is not None:
            raise InputError("--focal", found="also --focal-35mm", accepted="one of the two")
        _require("--focal-35mm", self.focal_35mm, MILLIMETRES, "mm")
        _require("--camera-height", self.camera_height, HEIGHTS, "m")
        for name, length in self.known.items():
            _require(f"--known {name}", length, LENGTHS, "m")

    @property
    def options(self) -> tuple[str, ...]:
        """The options that were given."""
        given = {"--focal": self.focal, "--focal-35mm": self.focal_35mm, "--camera-height": self.camera_height}
        return (*(name for name, value in given.items() if value is not None), *(["--known"] if self.known else []))

    def known_focal(self, photo: Photo) -> KnownFocal | None:
        """The focal length in pixels of the photo, exact. Raises InputError for one that no lens has."""
        longest = max(photo.width, photo.height)
        if self.focal is not None:
            _require("--focal", self.focal, (MIN_FOCAL * longest, MAX_FOCAL * longest), "px")
            return KnownFocal(pixels=self.focal, sigma=0, source="--focal")
        if self.focal_35mm is not None:
            pixels = self.focal_35mm * math.hypot(photo.width, photo.height) / FILM_DIAGONAL
            return KnownFocal(pixels=pixels, sigma=0, source="--focal-35mm")
        return None

    def known_lengths(self, instances: tuple[Instance, ...]) -> dict[int, float]:
        """Known lengths [m] by object id. Raises InputError for a name that fits no object, or several."""
        lengths = dict[int, float]()
        for name, length in self.known.items():
            fitting = [i.id for i in instances if str(i.id) == name] or [i.id for i in instances if i.label == name]
            if len(fitting) != 1 or fitting[0] in lengths:
                named = ", ".join(f"{i.id} {i.label}".strip() for i in instances)
                why = "no object" if not fitting else "named twice" if len(fitting) == 1 else f"objects {fitting}"
                raise InputError("--known", found=f"{name} ({why})", accepted=f"one of {named}, each once")
            lengths[fitting[0]] = length
        return lengths


def known_of(text: str) -> dict[str, float]:
    """Lengths [m] by name from ``NAME=METRES,...``. Raises InputError."""
    lengths = dict[str, float]()
    for part in filter(None, map(str.strip, text.split(","))):
        name, _, value = part.rpartition("=")
        name = " ".join(name.split()).lower()
        try:
            length = float(value)
        except ValueError:
            length = math.nan
        if not name or name in lengths or not math.isfinite(length):
            raise InputError("--known", found=part, accepted=KNOWN)
        lengths[name] = length
    return lengths


def _require(option: str, value: float | None, span: tuple[float, float], unit: str) -> None:
    if value is not None and not span[0] <= value <= span[1]:  # NaN is not
        raise InputError(option, found=f"{value:g}", accepted=f"{span[0]:g} to {span[1]:g} {unit}")
