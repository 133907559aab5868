"""The photo without its objects: what lies behind them and their shadows, completed from the rest of the photo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.background.completion import CompletionConfig, complete
from f3sr.background.membrane import membrane
from f3sr.background.regions import Mask, distance_to, parts_of
from f3sr.background.shadows import ShadowConfig, find_shadows
from f3sr.patchmatch import Picture
from f3sr.report import Decision
from f3sr.scene import Photo
from f3sr.settings import settings
from f3sr.silhouette import union_of

DARK = 0.03
"""Added to colours in [0, 1] before their logarithm: noise of eight bits in the dark is not detail."""
ISLAND = 0.01
"""Share of the photo below which what is left between objects and shadows is replaced too: a gap between two boxes
shows shadow, and the masks' own errors."""


@settings
class BackgroundConfig:
    """The photo completed behind its objects."""

    margin: Annotated[float, Interval(ge=0, le=0.1)] = 0.01
    """By how much masks are widened, in shares of the photo's longer side: their borders hold mixed colours, and masks
    are seldom exact to the pixel."""
    shadows: ShadowConfig = field(default_factory=ShadowConfig)
    completion: CompletionConfig = field(default_factory=CompletionConfig)


@dataclass(frozen=True, eq=False, kw_only=True)
class Background:
    """``rgb`` (h, w, 3) uint8 sRGB, the photo's bytes but where ``replaced`` (h, w); ``shadows`` (h, w) is the part of
    that which is a shadow only."""

    rgb: NDArray[np.uint8]
    replaced: Mask
    shadows: Mask
    decisions: tuple[Decision, ...] = ()


def complete_background(
    photo: Photo, masks: Sequence[Mask], config: BackgroundConfig | None = None, *, support: Mask | None = None
) -> Background:
    """The photo behind the objects of some ``masks`` (h, w) each, pixel for pixel in its place. Shadows are looked for
    on the ``support`` (h, w) only, where that is known.

    The same bytes for the same photo, masks and seed. Where no patch of the photo is free of objects, light is spread
    smoothly from what is left, and a Decision says so.
    """
    config = config or BackgroundConfig()
    h, w = photo.height, photo.width
    picture = _logarithms(photo.rgb)
    taken = distance_to(union_of(masks, (h, w))) <= round(config.margin * max(h, w))
    shadows = find_shadows(picture, masks, config.shadows, support) & ~taken
    hole = _without_islands(taken | shadows)
    if not hole.any():
        return Background(rgb=photo.rgb, replaced=hole, shadows=shadows)
    filled, decisions = _filled(picture, hole, config)
    rgb = np.where(hole[..., None], _colours(filled), photo.rgb)
    return Background(rgb=rgb, replaced=hole, shadows=shadows, decisions=decisions)


def _filled(picture: Picture, hole: Mask, config: BackgroundConfig) -> tuple[Picture, tuple[Decision, ...]]:
    filled = complete(picture, hole, config.completion)
    if filled is not None:
        return filled, ()
    if hole.all():
        choice, filled = "one even colour", np.broadcast_to(picture.mean((0, 1)), picture.shape)
    else:
        choice, filled = "smoothly, without texture", membrane(picture, ~hole)
    reason = f"objects and shadows take {100 * hole.mean():.0f}% of the photo and leave no patch to copy"
    return filled, (Decision(choice=f"background: completed {choice}", reason=reason, fallback=True),)


def _without_islands(hole: Mask) -> Mask:
    """With the small parts of the rest in it that it surrounds."""
    parts = parts_of(~hole)
    sizes = np.bincount(parts.ravel())
    small = sizes < ISLAND * hole.size
    small[0] = True
    return small[parts]


def _logarithms(rgb: NDArray[np.uint8]) -> Picture:
    return np.log(np.arange(256, dtype=np.float32) / 255 + np.float32(DARK))[rgb]


def _colours(picture: Picture) -> NDArray[np.uint8]:
    return np.clip(np.rint((np.exp(picture) - DARK) * 255), 0, 255).astype(np.uint8)
