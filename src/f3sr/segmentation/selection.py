"""What a user points at in a photo, and the masks that come of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Prompt, Segmenter, Stroke
from f3sr.backends.registry import Backend
from f3sr.errors import InputError
from f3sr.files.bounds import MAX_LABEL, MAX_OBJECTS
from f3sr.io.answers import checked_masks
from f3sr.scene import Photo
from f3sr.segmentation.ground_region import ground_mask
from f3sr.segmentation.object_window import Box
from f3sr.segmentation.ownership import bounds, disjoint, none_vanished

MIN_BOX = 4.0
"""Shortest side of a box [px]: four by four pixels are the smallest mask that an input folder may hold."""
MAX_POINTS = 100_000
"""Most points of all strokes: an hour of drawing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection:
    """A prompt for every object, and what points at the ground: its box is not used, its strokes may be none."""

    prompts: tuple[Prompt, ...]
    ground: Prompt = field(default_factory=Prompt)
    made_by: str = ""
    """Who found the boxes and cut the masks, where models did."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Outlines:
    """Masks (H, W) in the order of the prompts, disjoint; ``ground`` (H, W) is the visible support surface."""

    masks: tuple[NDArray[np.bool_], ...]
    ground: NDArray[np.bool_]


def outlined(photo: Photo, selection: Selection, segmenter: Backend[Segmenter]) -> Outlines:
    """The masks of what a user points at, and of what it stands on.

    A pixel that several masks claim goes to one of them, by the rule of ``ownership.disjoint``. The built-in segmenter
    keeps what it found: the same ``segmenter``, asked again, cuts only what changed. Raises InputError for prompts
    that the photo cannot have and for answers that are no masks, BackendError where the segmenter raises.
    """
    masks = object_masks(photo, selection, segmenter)
    return Outlines(masks=masks, ground=ground_mask(photo.rgb, selection.ground, masks))


def object_masks(photo: Photo, selection: Selection, segmenter: Backend[Segmenter]) -> tuple[NDArray[np.bool_], ...]:
    """The masks (H, W) of ``outlined`` alone: who waits for them need not wait for the ground too."""
    require_prompts(photo, selection)
    prompts = selection.prompts
    answer = segmenter.asked(lambda s: s.segment(photo, prompts)) if prompts else ()
    return _apart(photo, checked_masks(str(segmenter), answer, photo, len(prompts)), selection)


def told_apart(photo: Photo, masks: Sequence[NDArray[np.bool_]], selection: Selection) -> Outlines:
    """Masks (H, W) made disjoint, and the ground beside them. Boxes and strokes that are known help."""
    apart = _apart(photo, masks, selection)
    return Outlines(masks=apart, ground=ground_mask(photo.rgb, selection.ground, apart))


def _apart(photo: Photo, masks: Sequence[NDArray[np.bool_]], selection: Selection) -> tuple[NDArray[np.bool_], ...]:
    boxes = [_box(selection, k) or bounds(mask) for k, mask in enumerate(masks)]
    return none_vanished(disjoint(photo.rgb, masks, boxes), masks)


def _box(selection: Selection, number: int) -> Box | None:
    return selection.prompts[number].box if number < len(selection.prompts) else None


def require_prompts(photo: Photo, selection: Selection) -> None:
    """Raises InputError for the first prompt that the photo cannot have."""
    if len(selection.prompts) > MAX_OBJECTS:
        raise InputError("prompts", found=f"{len(selection.prompts)} objects", accepted=f"at most {MAX_OBJECTS}")
    every = [*((_name(k, p), p) for k, p in enumerate(selection.prompts)), ("the ground", selection.ground)]
    points = sum(len(stroke) for _, p in every for stroke in (*p.inside, *p.outside))
    if points > MAX_POINTS:
        raise InputError("prompts", found=f"strokes of {points:,} points", accepted=f"at most {MAX_POINTS:,}")
    for where, prompt in every:
        if prompt is not selection.ground and prompt.box is None and not prompt.inside:
            raise InputError(where, found="neither a box nor a stroke inside", accepted="one of the two, or both")
        if len(prompt.label) > MAX_LABEL or not prompt.label.isprintable():
            accepted = f"at most {MAX_LABEL} printable characters"
            raise InputError(where, found=f"the label {prompt.label!r:.60}", accepted=accepted)
        if prompt.box is not None:
            _require_box(where, photo, prompt.box)
        for stroke in (*prompt.inside, *prompt.outside):
            _require_stroke(where, photo, stroke)


def _name(number: int, prompt: Prompt) -> str:
    return f"prompt {number}" + (f" ({prompt.label:.40})" if prompt.label else "")


def _require_box(where: str, photo: Photo, box: Box) -> None:
    left, top, right, bottom = box
    found = f"the box {', '.join(f'{x:g}' for x in box)}"
    if not all(map(math.isfinite, box)) or left < 0 or top < 0 or right > photo.width or bottom > photo.height:
        accepted = f"left, top, right, bottom within the photo's {photo.width}x{photo.height} pixels"
        raise InputError(where, found=found, accepted=accepted)
    if right - left < MIN_BOX or bottom - top < MIN_BOX:
        accepted = f"left, top, right, bottom, with sides of at least {MIN_BOX:g} pixels"
        raise InputError(where, found=found, accepted=accepted)


def _require_stroke(where: str, photo: Photo, stroke: Stroke) -> None:
    if not stroke:
        raise InputError(where, found="a stroke without a point", accepted="at least one x,y")
    for x, y in stroke:
        if not (0 <= x <= photo.width and 0 <= y <= photo.height):  # false for NaN too
            accepted = f"points within the photo's {photo.width}x{photo.height} pixels"
            raise InputError(where, found=f"a stroke through {x:g}, {y:g}", accepted=accepted)
