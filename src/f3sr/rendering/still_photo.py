"""Frames that keep the photo's own pixels wherever nothing that moves is or was seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.core.srgb import srgb
from f3sr.core.transforms import Array
from f3sr.rendering.canvas import Canvas
from f3sr.rendering.ground import APART, DARK
from f3sr.rendering.textures import LINEAR
from f3sr.scene import Scene
from f3sr.vision.regions import Mask, distance_to, grown, smooth_step
from f3sr.vision.silhouette import union_of

BRIGHT_ENOUGH = 0.03
"""Linear light from which on a channel has a ratio of its own: ten levels of eight bits around it change it by a half.
"""
RATIOS = 0.05, 4.0
"""What drawn light may change of the photo's, and what drawn colours may be off: beyond, two surfaces are compared."""


VANISHED = 1e-6
"""Factor on the size of what moves for the picture without it and its shadows."""
BLENDED = 0.3, 0.7
"""Between what moves and what rests, as a share of the way, where the photo's ground goes over into the completed."""


def vanished(poses: Array) -> Array:
    """Poses (n, 4, 4) at which objects are too small to be seen, and so are their shadows."""
    small = poses.copy()
    small[:, :3, :3] *= VANISHED
    return small


@dataclass(frozen=True, eq=False)
class Continued:
    """How far the photo's colours are from those drawn of a resting object, spread over where the photo hides it.

    Each side of the object has its own: how wrong the light is depends on where a side faces."""

    index: int
    window: tuple[slice, slice]
    ratio: NDArray[np.float32]
    """(h, w, 3) of its window, in linear light."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StillPhoto:
    """The photo beside what moves, as in differential rendering (Debevec 1998), for one film.

    A pixel keeps the photo's colour if no moving object is seen there, now or in the photo. It is multiplied by the
    drawn light now over that at rest: shadows still come and go. What was hidden by a moving object is drawn, in the
    photo's colours of the same object around it. Where a drawn shadow leaves, a resting object gets no brighter than
    in those colours: the photo's own shadow was elsewhere, or weaker."""

    canvas: Canvas
    photo: NDArray[np.uint8]
    at_rest: NDArray[np.uint8]
    """(h, w, 3) the drawn picture at rest."""
    moving: tuple[int, ...]
    uncovered: Mask
    """(h, w) where the photo, or the picture at rest, shows what moves, and the mixed pixels around."""
    shed: NDArray[np.float32]
    """(h, w) share of the completed ground in what is shown: 1 beside what moves, 0 beside what rests, where the photo
    has shadows that may be of either."""
    shaded: Mask
    """(h, w) where what moves casts a drawn shadow at rest."""
    continued: tuple[Continued, ...]

    @classmethod
    def of(cls, canvas: Canvas, scene: Scene, moving: Mask) -> Self:
        """``moving`` (N,): which of the scene's objects move in the film."""
        poses = np.array([o.T_world_object for o in scene.objects]).reshape(-1, 4, 4)
        chosen = tuple(np.flatnonzero(moving).tolist())
        alone = poses.copy()
        alone[list(chosen)] = vanished(alone[list(chosen)])
        without = canvas.drawn(alone)
        sides = {k: canvas.sides(k) for k in range(len(poses)) if k not in chosen}
        at_rest = canvas.drawn(poses)
        shape = at_rest.shape[:2]
        theirs = union_of([scene.objects[k].mask for k in chosen], shape)
        others = union_of([o.mask for k, o in enumerate(scene.objects) if k not in chosen], shape)
        completed = (canvas.setting.background != scene.photo.rgb).any(2) & ~others
        uncovered = grown(theirs | (canvas.cover(chosen) > 0), APART)
        shed = np.where(completed & ~uncovered, _nearness(theirs, others), np.float32(0))
        still = cls(
            canvas=canvas,
            photo=scene.photo.rgb,
            at_rest=at_rest,
            moving=chosen,
            uncovered=uncovered,
            shed=shed,
            shaded=(without != at_rest).any(2),
            continued=(),
        )
        return replace(still, continued=tuple(still._continued(scene, sides, without)))

    def frame(self, poses: Array) -> NDArray[np.uint8]:
        """The picture (h, w, 3) with the objects at ``poses`` (N, 4, 4)."""
        drawn = self.canvas.drawn(poses)
        covered = self.uncovered | (self.canvas.cover(self.moving) > 0)
        changed = drawn ^ self.at_rest
        relit = (changed[..., 0] | changed[..., 1] | changed[..., 2]).astype(np.bool_) & ~covered
        picture = self.photo.copy()
        picture[covered] = drawn[covered]
        picture[relit] = _times(self.photo[relit], light_ratio(drawn[relit], self.at_rest[relit]))
        shed = (self.shed > 0) & ~covered
        share = self.shed[shed][:, None]
        picture[shed] = np.rint(picture[shed] + share * (drawn[shed].astype(np.float32) - picture[shed]))
        for part in self.continued:
            share = self.canvas.cover((part.index,))[part.window] / self.canvas.setting.config.samples**2
            seen = (share > 0) & covered[part.window]
            shown = picture[part.window]
            shown[seen] = _times(shown[seen], part.ratio[seen] ** share[seen][:, None])
            lit = (share == 1) & relit[part.window] & self.shaded[part.window]
            alike = _times(drawn[part.window][lit], part.ratio[lit])
            shown[lit] = np.minimum(shown[lit], np.maximum(self.photo[part.window][lit], alike))
        return picture

    def _continued(
        self, scene: Scene, sides: Mapping[int, NDArray[np.int32]], without: NDArray[np.uint8]
    ) -> Iterator[Continued]:
        """``sides`` (h, w): of every resting object in its window, -1 beside it; ``without`` (h, w, 3) is drawn. Both
        are without what moves."""
        whole = self.canvas.setting.config.samples**2
        for k, side in sides.items():
            window = self.canvas.window(k)
            photo, at_rest, left = self.photo[window], self.at_rest[window], without[window]
            seen = (self.canvas.cover((k,))[window] == whole) & scene.objects[k].mask[window]
            own, shaded = seen & ~self.uncovered[window], self.shaded[window]
            near = grown(own, 2 * APART) & (self.uncovered[window] | shaded) & (side >= 0)
            if not own.any() or not near.any():
                continue
            # Only where all of a side is in their shadow do the photo's shadow and the drawn one count.
            clear = own & ~(shaded & np.isin(side, side[own & ~shaded]))
            brightest = _times(left, _over_sides(_ratio(photo, at_rest), side, clear))
            relit = np.minimum(_times(photo, light_ratio(left, at_rest)), np.maximum(photo, brightest))
            yield Continued(k, window, _over_sides(_ratio(relit, left), side, own))


def _over_sides(ratio: Array, side: NDArray[np.int32], known: Mask) -> NDArray[np.float32]:
    """A ratio (h, w, 3) where it is ``known`` (h, w), spread over the rest of each ``side`` (h, w); 1 elsewhere."""
    logs, spread = np.log(ratio).astype(np.float32), np.zeros(ratio.shape, np.float32)
    for number in np.unique(side[known]):
        rows, columns = (np.flatnonzero((side == number).any(axis)) for axis in (1, 0))
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        here = side[box] == number
        told = known[box] & here
        spread[box][here] = membrane(logs[box] * told[..., None], told)[here]
    return np.exp(spread)


def _nearness(theirs: Mask, others: Mask) -> NDArray[np.float32]:
    """(h, w) 1 near the first mask, 0 near the second, and smooth between; 0 where the first is empty."""
    if not theirs.any():
        return np.zeros(theirs.shape, np.float32)
    if not others.any():
        return np.ones(theirs.shape, np.float32)
    to_theirs, to_others = distance_to(theirs), distance_to(others)
    share = (to_others / np.maximum(to_theirs + to_others, 1)).astype(np.float32)
    return smooth_step((share - BLENDED[0]) / (BLENDED[1] - BLENDED[0])).astype(np.float32)


def _ratio(now: NDArray[np.uint8], before: NDArray[np.uint8]) -> Array:
    """Linear light (..., 3) of one picture over that of another."""
    lit = LINEAR.clip(DARK)
    return (lit[now] / lit[before]).clip(*RATIOS)


def light_ratio(now: NDArray[np.uint8], before: NDArray[np.uint8]) -> Array:
    """The same of two pictures of one surface in different light.

    Of a dark channel eight bits tell little: it has nearly the ratio of all. Else a shadow on a red thing would take
    red alone, and so it would from the table where the model is larger than the thing."""
    whole = LINEAR[now].sum(-1, keepdims=True).clip(DARK) / LINEAR[before].sum(-1, keepdims=True).clip(DARK)
    told = (LINEAR[before] / BRIGHT_ENOUGH).clip(0, 1)
    return (told * _ratio(now, before) + (1 - told) * whole).clip(*RATIOS)


def _times(picture: NDArray[np.uint8], ratio: Array | NDArray[np.float32]) -> NDArray[np.uint8]:
    """A picture (..., 3) in sRGB under so many times its light."""
    return np.rint(255 * srgb((LINEAR[picture] * ratio).clip(0, 1))).astype(np.uint8)
