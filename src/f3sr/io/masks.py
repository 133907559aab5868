"""Masks: which pixels belong to which object, ids and labels from file names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.io.images import open_image
from f3sr.io.input_folder import InputFolder
from f3sr.scene import Instance, Photo

MAX_OVERLAP = 0.05
"""Share of the smaller mask that two masks may overlap by: more than the uncertain pixels of a border are two
opinions on an object. Shared pixels go to the smaller mask."""
MOST_OVERLAP = 0.5
"""Largest share that a user may allow: then it is one object twice."""
BORDER = 4
"""Width of a soft border of a mask [px]."""
DARK, SHADED = 0.75, 0.05
"""Of the brightest level, what is darker; and the share of pixels inside from which on a mask is a shaded picture."""
MAX_ID_DIGITS = 8
"""Longer numbers are hashes or dates, not ids."""
MIN_PIXELS = 16
"""A smaller mask holds no usable silhouette."""
MAX_OBJECTS = 500
"""Most masks of one photo: more is an over-segmentation, not objects."""
MAX_MASK_PIXELS = 2_000_000_000
"""Pixels of all masks together, a byte each: 166 masks of a 12 megapixel photo."""


def read_instances(folder: InputFolder, photo: Photo, *, overlap: float | None = None) -> tuple[Instance, ...]:
    """The objects by id, their masks (H, W) disjoint. ``overlap``: largest share of a mask that another may also have.

    Raises InputError, which names the file, for what is invalid."""
    if overlap is not None and not 0 <= overlap <= MOST_OVERLAP:
        raise InputError("--mask-overlap", found=f"{overlap:g}", accepted=f"a share from 0 to {MOST_OVERLAP:g}")
    place = folder.path("masks")
    names = folder.names("masks")
    if strange := [name for name in names if not name.endswith(".png")]:
        raise InputError(place, found=strange[0], accepted="nothing but *.png files")
    if not names:
        raise InputError(place, found="no masks", accepted="masks/*.png, one binary mask per object")
    most = min(MAX_OBJECTS, MAX_MASK_PIXELS // (photo.width * photo.height))
    if len(names) > most:
        raise InputError(place, found=f"{len(names)} masks", accepted=f"at most {most} for a photo of this size")
    ids = ids_of_stems(place, [Path(name).stem for name in names])
    instances = [
        Instance(id=id, label=label, name=name, mask=read_mask(folder, f"masks/{name}", photo))
        for name, (id, label) in zip(names, ids, strict=True)
    ]
    return _disjoint(folder, sorted(instances, key=lambda i: i.id), MAX_OVERLAP if overlap is None else overlap)


def read_mask(folder: InputFolder, relative: str, photo: Photo) -> NDArray[np.bool_]:
    """A binary mask (H, W); grey levels between are cut in the middle.

    Raises InputError for another size than the photo's, or fewer than ``MIN_PIXELS`` set pixels."""
    path = folder.file(relative)
    gray = _levels(folder, path)
    if gray.shape != (photo.height, photo.width):
        size = f"{gray.shape[1]}x{gray.shape[0]} pixels"
        turned = ": a photo is turned as its EXIF says" if gray.shape == (photo.width, photo.height) else ""
        raise InputError(path, found=size, accepted=f"the photo's size {photo.width}x{photo.height}{turned}")
    levels = np.unique(gray)
    threshold = 0
    if len(levels) > 2 or (len(levels) == 2 and levels[0] > 0):
        threshold = (int(levels.max()) + (int(levels.min()) if len(levels) == 2 else 0)) // 2
        found = "two grey levels, neither of them 0" if len(levels) == 2 else f"{len(levels)} grey levels, not two"
        shaded = len(levels) > 2 and _is_shaded(gray)
        found += ", also inside it, as in a cut-out of the photo: dark parts may be missing" if shaded else ""
        folder.decide(f"{path.name}: pixels above {threshold} belong to the mask", found, fallback=shaded)
    mask = gray > threshold
    if mask.sum() < MIN_PIXELS:
        raise InputError(
            path,
            found=f"{int(mask.sum())} set pixels",
            accepted=f"a mask of at least {MIN_PIXELS} pixels",
        )
    return mask


def _is_shaded(gray: NDArray[Any]) -> bool:
    """Whether a picture has dark pixels inside what it shows, and not only at its soft borders."""
    from scipy.ndimage import binary_erosion

    inside: NDArray[np.bool_] = np.asarray(binary_erosion(gray > 0, iterations=BORDER), bool)
    return bool(inside.any() and (gray[inside] < DARK * gray.max()).mean() > SHADED)


def _levels(folder: InputFolder, path: Path) -> NDArray[Any]:
    """Grey levels (h, w) of a mask picture; a cut-out holds its mask in the alpha channel."""
    image = open_image(path)
    if "A" in image.getbands() and len(np.unique(alpha := np.asarray(image.getchannel("A")))) > 1:
        folder.decide(f"{path.name}: its alpha channel is the mask", "a picture with transparent pixels")
        return alpha
    return np.asarray(image) if image.mode.startswith("I") else np.asarray(image.convert("L"))  # I: 16 bits


def _disjoint(folder: InputFolder, instances: list[Instance], most: float) -> tuple[Instance, ...]:
    """Overlapping pixels go to the smaller mask where the overlap is small; a larger one is an error."""
    if not _overlap(instances):
        return tuple(instances)
    area = {i.id: int(i.mask.sum()) for i in instances}
    masks = {i.id: i.mask.copy() for i in instances}
    boxes = {i.id: _box(i.mask) for i in instances}
    for k, a in enumerate(instances):
        for b in instances[k + 1 :]:
            if not _meet(boxes[a.id], boxes[b.id]) or not (shared := a.mask & b.mask).any():
                continue
            small, large = sorted((a, b), key=lambda i: (area[i.id], i.id))
            share = shared.sum() / area[small.id]
            if share >= most:
                raise InputError(
                    folder.root / "masks" / small.name,
                    found=f"{100 * share:.0f}% of it also in {large.name}",
                    accepted=f"masks that overlap by less than {100 * most:.0f}% of the smaller (--mask-overlap)",
                )
            masks[large.id] &= ~shared
            folder.decide(
                f"masks: {int(shared.sum())} shared pixels go to {small.name}",
                f"also in {large.name}",
                small.id,
            )
    for i in instances:
        if masks[i.id].sum() < MIN_PIXELS:
            found = f"{int(masks[i.id].sum())} pixels that no smaller mask holds"
            raise InputError(folder.root / "masks" / i.name, found=found, accepted=f"at least {MIN_PIXELS}")
    return tuple(Instance(id=i.id, label=i.label, name=i.name, mask=masks[i.id]) for i in instances)


def _overlap(instances: Sequence[Instance]) -> bool:
    """Whether any pixel lies in two masks."""
    covered = np.zeros_like(instances[0].mask)
    for i in instances:
        if (covered & i.mask).any():
            return True
        covered |= i.mask
    return False


def _box(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First and last row, first and last column of a mask."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


def _meet(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] <= b[1] and b[0] <= a[1] and a[2] <= b[3] and b[2] <= a[3]


def ids_of_stems(folder: Path, stems: Sequence[str]) -> list[tuple[int, str]]:
    """Ids and labels from file stems: leading digits are the id, the rest the label. Raises InputError."""
    matches = [re.match(r"([0-9]+)(.*)", s, re.DOTALL) for s in stems]
    if not any(matches):
        return [(k, _label(s)) for k, s in enumerate(stems)]
    if not all(matches):
        without = [s for s, m in zip(stems, matches, strict=True) if not m]
        raise InputError(
            folder,
            found=f"names with and without an id ({without[0]}.png)",
            accepted="ids in all names, or in none",
        )
    if long := [s for s, m in zip(stems, matches, strict=True) if m and len(m.group(1).lstrip("0")) > MAX_ID_DIGITS]:
        raise InputError(folder, found=f"the id of {long[0]}.png", accepted=f"ids of at most {MAX_ID_DIGITS} digits")
    ids = [(int(m.group(1)), _label(m.group(2))) for m in matches if m]
    seen: dict[int, str] = {}
    for stem, (id, _) in zip(stems, ids, strict=True):
        if id in seen:
            raise InputError(folder, found=f"id {id} twice ({seen[id]}.png, {stem}.png)", accepted="unique ids")
        seen[id] = stem
    return ids


def _label(text: str) -> str:
    return re.sub(r"[_\s]+", " ", text).strip()
