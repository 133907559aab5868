"""GrabCut, the Segmenter without a network: boxes and strokes to masks, the objects of a photo against each other."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Prompt, Stroke
from f3sr.scene import Photo
from f3sr.segmentation.box_cut import WindowEvidence, cut_out, refined
from f3sr.segmentation.box_fill import inner
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.object_window import Box, ObjectWindow, object_window
from f3sr.segmentation.ownership import bounds, disjoint, none_vanished
from f3sr.vision.regions import shrunk

COARSE = 10_000
"""Pixels of a window in which starts compete: a cut takes 20 ms, and a handle is still wider than a pixel."""
FINE = 400_000
"""Most pixels of the window in which the border is cut again: any object of a 1 MP photo at its full resolution."""
BAND = 1.5
"""Half width of the border that is cut again, in pixels of the coarse window: what it cannot resolve."""
LEFT = 0.1
"""Least share of its pixels that an object keeps against others. With less, it is sought elsewhere in its box."""
REACH = 0.125
"""Of the photo's shorter side: how far an object without a box is looked for beyond its strokes at first."""
KEPT = 256
"""Most results that are kept, of the latest photos and prompts: a mask of a window each."""


@dataclass(eq=False)
class GrabCut:
    """Deterministic. What it found for a prompt and its rivals is kept, so that another stroke costs one object."""

    kept: dict[str, Mask] = field(default_factory=dict[str, Mask])

    def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Sequence[NDArray[np.bool_]]:
        """Masks (H, W) of the prompts, disjoint, in their order, which changes none of them."""
        views = _Views(photo.rgb, hashlib.sha256(photo.rgb.tobytes()).hexdigest(), self.kept)
        boxes = [views.box(prompt) for prompt in prompts]
        prompts = [_with_others(prompt, box, prompts) for prompt, box in zip(prompts, boxes, strict=True)]
        none = np.zeros(photo.rgb.shape[:2], np.bool_)
        masks = [views.cut(prompt, box, none, None) for prompt, box in zip(prompts, boxes, strict=True)]
        masks = _sought_again(views, photo.rgb, prompts, boxes, masks)
        masks = [
            views.refine(prompt, box, _others(masks, k), masks[k])
            for k, (prompt, box) in enumerate(zip(prompts, boxes, strict=True))
        ]
        masks = none_vanished(disjoint(photo.rgb, masks, boxes), masks)
        while len(self.kept) > KEPT:
            del self.kept[next(iter(self.kept))]
        return masks


def _sought_again(
    views: _Views, rgb: NDArray[np.uint8], prompts: Sequence[Prompt], boxes: Sequence[Box], masks: Sequence[Mask]
) -> tuple[Mask, ...]:
    """Masks (H, W) made disjoint; an object that lost nearly all to others is cut again where they are not."""
    apart = disjoint(rgb, masks, boxes)
    lost = [k for k, mask in enumerate(apart) if mask.sum() < LEFT * masks[k].sum()]
    if not lost:
        return apart
    again = list(apart)
    for k in lost:
        again[k] = views.cut(prompts[k], boxes[k], _others(apart, k), apart[k])
    return none_vanished(disjoint(rgb, again, boxes), again)


def _with_others(prompt: Prompt, box: Box, prompts: Sequence[Prompt]) -> Prompt:
    """A prompt that strokes inside of other objects, where they meet its box, are outside of."""
    theirs = sorted(
        stroke for other in prompts if other is not prompt for stroke in other.inside if _meets(stroke, box)
    )
    return replace(prompt, outside=(*prompt.outside, *theirs)) if theirs else prompt


def _meets(stroke: Stroke, box: Box) -> bool:
    """Whether a stroke's own box meets another."""
    (left, top), (right, bottom) = np.min(stroke, axis=0), np.max(stroke, axis=0)
    return bool(left <= box[2] and right >= box[0] and top <= box[3] and bottom >= box[1])


def _others(masks: Sequence[Mask], own: int) -> Mask:
    """Pixels (H, W) of all objects but one."""
    others = np.zeros_like(masks[own])
    for k, mask in enumerate(masks):
        if k != own:
            others |= mask
    return others


@dataclass(frozen=True, eq=False)
class _Views:
    """Windows of one photo, and what was found in them."""

    rgb: NDArray[np.uint8]
    digest: str
    kept: dict[str, Mask]

    def box(self, prompt: Prompt) -> Box:
        """The box of a prompt, or of what its strokes grow to."""
        if prompt.box is not None:
            return prompt.box
        rows, columns = self.rgb.shape[:2]
        points = np.array(list(chain.from_iterable(prompt.inside)))
        (left, top), (right, bottom) = points.min(0), points.max(0)
        reach = max(REACH * min(rows, columns), right - left, bottom - top)
        while True:
            box = (left - reach, top - reach, right + reach, bottom + reach)
            box = (max(0.0, box[0]), max(0.0, box[1]), min(float(columns), box[2]), min(float(rows), box[3]))
            mask = self.cut(prompt, box, np.zeros((rows, columns), np.bool_), None)
            around = bounds(mask)
            free = [abs(a - b) > 1 or b in (0, columns, rows) for a, b in zip(around, box, strict=True)]
            if all(free):
                slack = 0.05 * max(around[2] - around[0], around[3] - around[1])
                return (
                    max(0.0, around[0] - slack),
                    max(0.0, around[1] - slack),
                    min(float(columns), around[2] + slack),
                    min(float(rows), around[3] + slack),
                )
            reach *= 2

    def cut(self, prompt: Prompt, box: Box, rivals: Mask, mask: Mask | None) -> Mask:
        """The object (H, W), its border as sharp as the coarse window shows it."""
        window = object_window(self.rgb, box, pixels=COARSE)
        evidence = _evidence(window, prompt, box, window.lowered(rivals))
        if mask is not None:
            if not (evidence.rivals is not None and (evidence.rivals & inner(window.shape, window.inner(box))).any()):
                return mask
            evidence = replace(evidence, starts=(window.lowered(mask),))
        elif prompt.box is not None and (prompt.inside or prompt.outside):
            bare = self.cut(replace(prompt, inside=(), outside=()), box, rivals, None)
            evidence = replace(evidence, starts=(window.lowered(bare),))
        return window.raised(self._once("cut", prompt, evidence, lambda: cut_out(evidence)))

    def refine(self, prompt: Prompt, box: Box, rivals: Mask, mask: Mask) -> Mask:
        """The object (H, W) with its border cut again at the photo's resolution."""
        window = object_window(self.rgb, box, pixels=FINE)
        width = BAND * window.scale / _coarse_scale(window) + 1
        others = window.lowered(rivals)
        evidence = _evidence(window, prompt, box, shrunk(others, max(1, round(width))))
        evidence = replace(evidence, starts=(window.lowered(mask),))
        fine = self._once("refine", prompt, evidence, lambda: refined(evidence, evidence.starts[0], width))
        return window.raised(fine)

    def _once(self, what: str, prompt: Prompt, evidence: WindowEvidence, make: Callable[[], Mask]) -> Mask:
        hashed = hashlib.sha256(f"{self.digest} {what} {prompt} {evidence.window.place}".encode())
        for mask in (evidence.allowed, *evidence.starts):
            hashed.update(np.packbits(mask).tobytes())
        key = hashed.hexdigest()
        self.kept[key] = found = self.kept.pop(key) if key in self.kept else make()
        return found


def _coarse_scale(window: ObjectWindow) -> float:
    """Pixels of the coarse window a pixel of the photo."""
    left, top, right, bottom = window.place
    return min(1.0, math.sqrt(COARSE / ((right - left) * (bottom - top))))


def _evidence(window: ObjectWindow, prompt: Prompt, box: Box, rivals: Mask) -> WindowEvidence:
    outside = window.drawn(prompt.outside)
    inside = window.drawn(prompt.inside) & ~outside
    return WindowEvidence(
        window=window,
        allowed=(inner(window.shape, window.inner(box)) & ~rivals & ~outside) | inside,
        inside=inside,
        outside=outside,
        box=window.inner(box) if prompt.box is not None else None,
        rivals=rivals if rivals.any() else None,
    )
