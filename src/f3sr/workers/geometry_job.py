"""Jobs of geometry models: the photo and its camera are asked, a map of depths is answered.

f3sr writes the photo and ``request.json`` with K of the photo. The worker writes ``geometry.npz`` and then
``geometry.json``, which says what the map's numbers mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.files import npz
from f3sr.io.geometry import MAX_STRETCH
from f3sr.io.images import MAX_PIXELS
from f3sr.scene import Photo
from f3sr.workers.job_folder import (
    IMAGE,
    ModelAnswer,
    Text,
    document,
    is_asked,
    large_file,
    made_folder,
    png,
    write,
    write_request,
)

ANSWER, ARRAYS = "geometry.json", "geometry.npz"
MAX_ARRAYS_BYTES = 1_000_000_000
"""Largest geometry.npz, also unpacked: points of the largest photo in single precision fit."""
ON_RAYS = 0.01
"""Largest median distance of points from the pixels that they are of, as K projects them [longer sides of the map]: a
pixel of a coarse map is .5 %, axes of another convention are off by half of the picture."""
Meaning = Literal["metric", "scaled", "relative"]
"""Of a map: depths [m], depths times one unknown factor, or inverse depths of unknown scale and shift."""

WANTED = {
    "depth": npz.Wanted(kinds="f", shape=("h", "w"), most=MAX_PIXELS, optional=True),
    "points": npz.Wanted(kinds="f", shape=("h", "w", 3), most=3 * MAX_PIXELS, optional=True),
    "valid": npz.Wanted(kinds="b", shape=("h", "w"), most=MAX_PIXELS, optional=True),
    "K": npz.Wanted(kinds="fiu", shape=(3, 3), optional=True),
}


class GeometryAnswer(ModelAnswer):
    """``geometry.json``."""

    arrays: Text = ARRAYS
    meaning: Meaning


@dataclass(frozen=True, eq=False, kw_only=True)
class WorkerDepth:
    """A checked answer: ``values`` (h, w) over the whole photo, NaN where it has none; ``K`` (3, 3) in pixels of the
    photo, where the model tells it."""

    values: NDArray[np.float32]
    meaning: Meaning
    K: Array | None
    told: str


def write_job(job: Path, image: PromptedImage, K: Array, *, seed: int) -> None:
    """Write what is asked into a job folder, ``request.json`` last. ``K`` (3, 3) in pixels of the photo: the camera
    that somebody tells, else that of f3sr's metrology."""
    if is_asked(job):
        return
    made_folder(job)
    write(job / IMAGE, png(image.photo.rgb))
    request: dict[str, Any] = {"K": K.tolist(), "K_told_by": image.focal.source if image.focal else None}
    write_request(job, request, seed=seed)


def is_done(job: Path) -> bool:
    """Whether there is an answer; whether it is any good shows when it is read."""
    return (job / ANSWER).is_file()


def read_answer(job: Path, photo: Photo) -> WorkerDepth:
    """The map, checked. Raises InputError, naming the file."""
    answer = document(job / ANSWER, GeometryAnswer)
    file = large_file(job / ANSWER, answer.arrays, ".npz", "an npz archive", most=MAX_ARRAYS_BYTES)
    held = npz.read(file, WANTED, accepted="depth (h, w) or points (h, w, 3)", most_bytes=MAX_ARRAYS_BYTES)
    if ("depth" in held) == ("points" in held):
        found = "both depth and points" if "depth" in held else "neither depth nor points"
        raise InputError(file, found=found, accepted="one of depth (h, w) and points (h, w, 3)")
    values = held["depth"] if "depth" in held else held["points"][..., 2]
    h, w = values.shape
    _require_whole(file, w, h, photo)
    K = _camera(file, held["K"].astype(float)) if "K" in held else None
    with np.errstate(over="ignore"):
        values = values.astype(np.float32)
    values = np.where(held.get("valid", True) & np.isfinite(values), values, np.float32(np.nan))
    if "points" in held:
        if answer.meaning == "relative" or K is None:
            found = f"points that are {answer.meaning}{'' if K is not None else ', without K'}"
            raise InputError(file, found=found, accepted="metric or scaled points, with K in pixels of the map")
        _require_on_rays(file, held["points"], np.isfinite(values) & (values > 0), K)
    if np.isnan(values).all():
        raise InputError(file, found="no finite valid value", accepted="a map with some")
    in_photo = None if K is None else K * [[photo.width / w], [photo.height / h], [1]]
    return WorkerDepth(values=values, meaning=answer.meaning, K=in_photo, told=answer.told)


def discard(job: Path) -> None:
    """Forget a bad answer, so that the next run asks again."""
    for name in (ANSWER, ARRAYS):
        (job / name).unlink(missing_ok=True)


def _require_whole(file: Path, w: int, h: int, photo: Photo) -> None:
    """A cropped or padded map would lie on other pixels."""
    if h < 1 or w < 1 or not 1 / MAX_STRETCH <= (w * photo.height) / (h * photo.width) <= MAX_STRETCH:
        accepted = f"the whole photo of {photo.width}x{photo.height}, at any resolution of its aspect"
        raise InputError(file, found=f"a map of {w}x{h} pixels", accepted=accepted)


def _camera(file: Path, K: Array) -> Array:
    """K (3, 3) of the map, of which only numbers and signs are checked here."""
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        rows = ", ".join(str([float(f"{x:.4g}") for x in row]) for row in K)
        accepted = "finite focal lengths above 0, in pixels of the map"
        raise InputError(file, found=f"K = [{rows}]", accepted=accepted)
    return K


def _require_on_rays(file: Path, points: NDArray[Any], usable: NDArray[np.bool_], K: Array) -> None:
    """Points (h, w, 3) that K projects to the pixels they are of."""
    rows, columns = np.nonzero(usable)
    seen = points[rows, columns].astype(float)
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = (seen @ K.T)[:, :2] / seen[:, 2:]
        off = np.hypot(pixels[:, 0] - columns - 0.5, pixels[:, 1] - rows - 0.5)
    most = ON_RAYS * max(usable.shape)
    if len(off) and not float(np.median(off)) <= max(1.0, most):
        found = f"points that K projects {float(np.median(off)):.3g} pixels off their own, in the median"
        raise InputError(file, found=found, accepted="camera axes: x right, y down, z forward")
