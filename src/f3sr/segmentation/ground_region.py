"""The visible support surface of a photo: what has the colours of strokes on it, or of where objects stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Prompt
from f3sr.segmentation.box_cut import WindowEvidence, alike, refined, settled
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.object_window import ObjectWindow, object_window
from f3sr.vision.regions import grown

COARSE = 10_000
"""Pixels at which the surface is found: its border is long and plain."""
FINE = 100_000
"""Most pixels at which its border is cut again."""
FOOT = 0.03
"""Of the photo's longer side: how far around an object's lower half the ground is looked for."""


def ground_mask(rgb: NDArray[np.uint8], prompt: Prompt, objects: Sequence[Mask]) -> Mask:
    """The ground (h, w) of a photo (h, w, 3), without pixels of ``objects`` (h, w).

    Strokes of the prompt tell its colours. Without them, what is seen around the lower halves of objects does. Empty
    where there are neither.
    """
    things = np.zeros(rgb.shape[:2], np.bool_)
    for mask in objects:
        things |= mask
    box = (0.0, 0.0, float(rgb.shape[1]), float(rgb.shape[0]))
    coarse, fine = (object_window(rgb, box, pixels=count, margin=0.0) for count in (COARSE, FINE))
    evidence = _evidence(coarse, prompt, things)
    seeds = evidence.inside if prompt.inside else _feet(coarse, objects) & evidence.allowed
    if not seeds.any():
        return np.zeros_like(things)
    mask = coarse.raised(settled(evidence, alike(coarse, seeds, evidence.allowed)))
    near = 1.5 * fine.scale / coarse.scale + 1
    return fine.raised(refined(_evidence(fine, prompt, things), fine.lowered(mask), near)) & ~things


def _evidence(window: ObjectWindow, prompt: Prompt, things: Mask) -> WindowEvidence:
    rivals, outside = window.lowered(things), window.drawn(prompt.outside)
    inside = window.drawn(prompt.inside) & ~outside & ~rivals
    return WindowEvidence(
        window=window,
        allowed=~rivals & ~outside,
        inside=inside,
        outside=outside,
        rivals=rivals if rivals.any() else None,
    )


def _feet(window: ObjectWindow, objects: Sequence[Mask]) -> Mask:
    """Pixels (h, w) beside and below the lower halves of objects: things stand on the ground."""
    feet = np.zeros(window.shape, np.bool_)
    steps = max(1, round(FOOT * max(window.shape)))
    for mask in map(window.lowered, objects):
        rows = np.flatnonzero(mask.any(1))
        if len(rows):
            lower = mask.copy()
            lower[: (rows[0] + rows[-1]) // 2] = False
            around = grown(lower, steps)
            around[: (rows[0] + rows[-1]) // 2] = False
            feet |= around
    return feet
