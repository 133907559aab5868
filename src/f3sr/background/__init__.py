"""The photo without its objects: what lies behind them and their shadows, completed from the rest of the photo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.background.completion import CompletionConfig, complete
from f3sr.background.membrane import membrane
from f3sr.background.patchmatch import Picture
from f3sr.background.shadows import PhotoShadowConfig, find_shadows
from f3sr.report import Decision
from f3sr.scene import Photo
from f3sr.settings import settings
from f3sr.vision.regions import Mask, closed, distance_to, grown, parts_of
from f3sr.vision.silhouette import union_of

DARK = 0.03
"""Added to colours in [0, 1] before their logarithm: noise of eight bits in the dark is not detail."""
ISLAND = 0.01
"""Share of the photo below which what is left between objects and shadows is replaced too: a gap between two boxes
shows shadow, and the masks' own errors."""
BETWEEN = 0.02
"""Half the width of gaps between objects and shadows that are replaced too, in shares of the photo's longer side."""
SEAM = 0.004
"""Width on both sides of the border between support and rest that belongs to neither [longer image sides].

Geometry gives that border to a few pixels."""
MIXED = 1
"""Pixels on both sides of that border over which what was completed is mixed, as the photo's own edges are."""


Fill = Callable[[Photo, Mask, Mask | None], NDArray[np.uint8]]
"""What ``BackgroundCompleter.complete`` does, checked."""


@settings
class BackgroundConfig:
    """The photo completed behind its objects."""

    margin: Annotated[float, Interval(ge=0, le=0.1)] = 0.01
    """Width by which masks grow [share of the photo's longer side]. Their borders hold mixed colours."""
    shadows: PhotoShadowConfig = field(default_factory=PhotoShadowConfig)
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
    photo: Photo,
    masks: Sequence[Mask],
    config: BackgroundConfig | None = None,
    *,
    support: Mask | None = None,
    filled: Fill | None = None,
) -> Background:
    """The photo (h, w, 3) completed behind the objects of some ``masks`` (h, w) and their shadows.

    With ``support`` (h, w), the support surface including its hidden part, shadows are searched on it only. Support and
    rest are then completed each from itself, so the edge of a table goes on straight. ``filled`` completes the hole in
    place of patches: of the photo (h, w, 3) that it gives only the hole is used. Deterministic. If no patch of the
    photo is free of objects, light is spread smoothly from the rest, and a Decision says so.

    The last result without ``filled`` is known as long as the photo is held: lifting and pictures ask for the same.
    """
    asked = _AskedCompletion(masks=tuple(masks), config=config or BackgroundConfig(), support=support)
    if filled is not None:
        return _completed(photo, asked, filled)
    last = _LAST.get(photo)
    if last is None or not last[0].equals(asked):
        _LAST[photo] = last = asked, _completed(photo, asked, None)
    return last[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class _AskedCompletion:
    """What the background of a photo depends on."""

    masks: tuple[Mask, ...]
    config: BackgroundConfig
    support: Mask | None

    def equals(self, other: _AskedCompletion) -> bool:
        """Whether both have one answer."""
        if self.config != other.config or len(self.masks) != len(other.masks):
            return False
        if self.support is None or other.support is None:
            alike = self.support is other.support
        else:
            alike = np.array_equal(self.support, other.support)
        return alike and all(map(np.array_equal, self.masks, other.masks))


_LAST: WeakKeyDictionary[Photo, tuple[_AskedCompletion, Background]] = WeakKeyDictionary()


def _completed(photo: Photo, asked: _AskedCompletion, filled: Fill | None) -> Background:
    masks, config, support = asked.masks, asked.config, asked.support
    h, w = photo.height, photo.width
    picture = _logarithms(photo.rgb)
    taken = widened(masks, config.margin) if masks else np.zeros((h, w), np.bool_)
    shadows = find_shadows(picture, masks, config.shadows, support) & ~taken
    hole = _without_islands(closed(taken | shadows, round(BETWEEN * max(h, w))))
    if not hole.any():
        return Background(rgb=photo.rgb, replaced=hole, shadows=shadows)
    decisions: tuple[Decision, ...] = ()
    if filled is None:
        completed, decisions = _layered(picture, hole, config.completion, support)
        inside = _colours(completed[hole])
    else:
        inside = filled(photo, hole, support)[hole]
    rgb = photo.rgb.copy()
    rgb[hole] = inside
    return Background(rgb=rgb, replaced=hole, shadows=shadows, decisions=decisions)


class PatchMatch:
    """The ``BackgroundCompleter`` of f3sr, with its default settings: from patches of the photo."""

    def complete(self, photo: Photo, hole: Mask, support: Mask | None) -> NDArray[np.uint8]:
        """The photo (h, w, 3) sRGB with its ``hole`` (h, w) filled; ``support`` (h, w) as in
        ``complete_background``."""
        rgb = photo.rgb.copy()
        if hole.any():
            completed, _ = _layered(_logarithms(photo.rgb), hole, CompletionConfig(), support)
            rgb[hole] = _colours(completed[hole])
        return rgb


def from_patches(rgb: NDArray[np.uint8], hole: Mask, *, apart: Mask) -> NDArray[np.uint8] | None:
    """A picture (h, w, 3) sRGB with its ``hole`` (h, w) filled from the rest, but for what is ``apart`` (h, w); None
    where that has no whole patch."""
    completed = complete(_logarithms(rgb), hole, CompletionConfig(), apart=apart)
    if completed is None:
        return None
    filled = rgb.copy()
    filled[hole] = _colours(completed[hole])
    return filled


def widened(masks: Sequence[Mask], margin: float) -> Mask:
    """All masks (h, w), at least one, and what is as near as a share of the longer side."""
    shape = masks[0].shape
    return distance_to(union_of(masks, shape)) <= round(margin * max(shape))


def _layered(
    picture: Picture, hole: Mask, config: CompletionConfig, support: Mask | None
) -> tuple[Picture, tuple[Decision, ...]]:
    """Fill the hole, support and rest each without the other; they meet over a pixel or two."""
    if support is None or not (support & hole).any() or not (~support & hole).any():
        return _filled(picture, hole, config, None)
    seam = max(1, round(SEAM * max(hole.shape)))
    layers, decisions = list[Picture](), list[Decision]()
    for layer in (support, ~support):
        own = hole & grown(layer, MIXED)
        # Neither filled nor copied: the other layer, and the strip along the border where nobody knows whose a pixel
        # is.
        apart = grown(~layer, seam) & ~own
        filled, told = _filled(picture, own, config, apart)
        layers.append(filled)
        decisions += told
    share = _softened(support)[..., None]
    return (share * layers[0] + (1 - share) * layers[1]).astype(np.float32), tuple(decisions)


def _softened(mask: Mask) -> NDArray[np.float32]:
    """A mask (h, w) whose border goes from 0 to 1 over ``MIXED`` pixels on both sides."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(mask.astype(np.float32), 2 * MIXED + 1), np.float32)


def _filled(
    picture: Picture, hole: Mask, config: CompletionConfig, apart: Mask | None
) -> tuple[Picture, tuple[Decision, ...]]:
    filled = complete(picture, hole, config, apart=apart)
    if filled is not None:
        return filled, ()
    known = ~hole if apart is None else ~(hole | apart)
    if not known.any():
        choice, filled = "one even colour", np.broadcast_to(picture.mean((0, 1)), picture.shape)
    else:
        choice, filled = "smoothly, without texture", membrane(picture, known)
    reason = f"objects and shadows take {100 * hole.mean():.0f}% of the photo and leave no patch to copy"
    return filled, (Decision(choice=f"background: completed {choice}", reason=reason, fallback=True),)


def _without_islands(hole: Mask) -> Mask:
    """With the small parts of the rest in it that it surrounds."""
    parts = parts_of(~hole)
    sizes = np.bincount(parts.ravel())
    # A table by part number: part 0 is the hole itself.
    small = sizes < ISLAND * hole.size
    small[0] = True
    return small[parts]


def _logarithms(rgb: NDArray[np.uint8]) -> Picture:
    # A table of 256 logarithms, looked up per byte.
    return np.log(np.arange(256, dtype=np.float32) / 255 + np.float32(DARK))[rgb]


def _colours(picture: Picture) -> NDArray[np.uint8]:
    return np.clip(np.rint((np.exp(picture) - DARK) * 255), 0, 255).astype(np.uint8)
