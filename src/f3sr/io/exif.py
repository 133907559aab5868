"""The focal length that a camera wrote into its photo (EXIF 2.32, CIPA DC-008)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

from PIL import Image
from PIL.ExifTags import IFD, Base

from f3sr.backends.protocols import KnownFocal
from f3sr.io.geometry import MAX_FOCAL, MIN_FOCAL

FILM_DIAGONAL = math.hypot(36, 24)
"""Diagonal of a 35 mm film frame [mm]: equivalent focal lengths compare diagonals."""
SIGMA = 0.04
"""One standard error of the logarithm: whole millimetres, lens corrections, 2 to 5 % of cut borders."""
UNITS = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""Millimetres in FocalPlaneResolutionUnit: inch, centimetre, millimetre, micrometre."""
CROPPED = 0.02
"""Largest difference of the aspects of the photo and of what the camera wrote: beyond, the photo was cut later."""
MOST_ZOOM = 100.0
"""Largest digital zoom that is taken for one."""


class ExifError(ValueError):
    """EXIF speaks of a focal length, but it cannot be used. The message says why."""


def focal_by_exif(image: Image.Image) -> KnownFocal | None:
    """The focal length [px] of a photo, upright or not; None where its EXIF has none. Raises ExifError.

    FocalLengthIn35mmFilm compares diagonals of pictures, so it needs no size of the sensor. Without it: FocalLength
    over the width of a sensor's pixel, which FocalPlaneXResolution gives."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            tags = dict(image.getexif().get_ifd(IFD.Exif))
        except Exception as error:  # PIL raises many kinds for broken tags
            raise ExifError("its tags cannot be read") from error
    relative = tags.get(Base.FocalLengthIn35mmFilm)
    names = (Base.FocalLength, Base.FocalPlaneXResolution)
    if not relative and not all(name in tags for name in names):  # 0 means unknown
        return None
    scale = _uncropped(tags, image)
    diagonal = math.hypot(image.width, image.height)
    zoom = _zoom(tags)
    if relative:
        # Makers disagree whether this number holds the digital zoom: half of it, with its whole as the error.
        pixels = _number(relative, "FocalLengthIn35mmFilm") * diagonal / FILM_DIAGONAL * math.sqrt(zoom)
        sigma, source = math.hypot(SIGMA, math.log(zoom) / 2), "EXIF, 35 mm equivalent"
    else:
        unit = UNITS.get(tags.get(Base.FocalPlaneResolutionUnit, 2), 0.0)
        density = _number(tags[names[1]], "FocalPlaneXResolution")
        if not unit or not scale:
            raise ExifError("FocalPlaneResolutionUnit or the photo's first size is missing")
        pixels = _number(tags[names[0]], "FocalLength") * density / unit * scale * zoom
        sigma, source = SIGMA, "EXIF, by the sensor's resolution"
    longest = max(image.size)
    if not MIN_FOCAL * longest <= pixels <= MAX_FOCAL * longest:
        raise ExifError(f"it tells a focal length of {pixels:.3g} px, which no lens has")
    return KnownFocal(pixels=pixels, sigma=sigma, source=source)


def _uncropped(tags: Mapping[int, Any], image: Image.Image) -> float:
    """Pixels of the photo per pixel that the camera wrote; 0 where it tells none. ExifError where it was cropped."""
    sizes = [
        n for name in (Base.ExifImageWidth, Base.ExifImageHeight) if isinstance(n := tags.get(name), int) and n > 0
    ]
    if len(sizes) < 2:
        return 0.0
    first, now = sorted(sizes), sorted(image.size)  # in order of length: either may be turned
    if abs(math.log(now[0] * first[1] / (now[1] * first[0]))) > CROPPED:
        raise ExifError(f"the camera wrote {first[1]}x{first[0]} pixels, and the photo was cropped since")
    return float(now[1] / first[1])


def _zoom(tags: Mapping[int, Any]) -> float:
    """The digital zoom; 1 where there is none: 0 says that none was used."""
    if not tags.get(Base.DigitalZoomRatio):
        return 1.0
    zoom = _number(tags[Base.DigitalZoomRatio], "DigitalZoomRatio")
    if not 1 <= zoom <= MOST_ZOOM:
        raise ExifError(f"DigitalZoomRatio is {zoom:.3g}")
    return zoom


def _number(value: Any, name: str) -> float:
    """A positive, finite number. EXIF's fractions may be anything over zero, and texts too."""
    try:
        number = float(value)
    except (TypeError, ValueError, ArithmeticError) as error:
        raise ExifError(f"{name} is no number") from error
    if not 0 < number < math.inf:
        raise ExifError(f"{name} is {number:.3g}")
    return number
