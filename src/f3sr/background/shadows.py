"""Shadows of objects on the support: darker than the same material around, and joined to an object's outline.

No threshold is a grey level. The lit colour is estimated in the photo itself: the mean light of nearby pixels of the
same colour, by a bilateral grid (Chen et al., "Real-time edge-aware image processing with the bilateral grid", 2007).
Pixels near objects and pixels found darker have less weight in each iteration. The spread of the same difference far
from all objects separates shadow from texture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.background.patchmatch import Picture
from f3sr.core.transforms import Array
from f3sr.settings import settings
from f3sr.vision.regions import Mask, closed, distance_to, grown, opened, parts_of, without_holes

LOOKED_AT = 400
"""Pixels of the longer side that shadows are looked for at, at most twice this: they are soft."""
LIGHT_CELL = 0.05
"""Cell of the grid of light in the picture's plane [longer image sides]; the grid is blurred by a cell or two."""
COLOUR_CELL = 0.06
"""Cell of the grid of light, in colour [log of a ratio of channels]: light from the sky or the walls turns a shadow's
colour by less."""
BLUR = (1.5, 1.5, 0.7, 4.0)
"""Widths of the Gaussian over the grid, in its cells: row, column, colours alike and colours that are not."""
OTHERS = 0.05
"""Weight of pixels of other colours: they decide only where the like are few, as in shadows too dark for a colour."""
FEW = 1e-4
"""Blurred count of pixels below which a cell says nothing."""
EDGE = 1.5
"""Cells of colour by which neighbours differ where a material ends."""
COLOURS = 12
"""Cells from grey to the most saturated colours, either way."""
SHADED, BESIDE = 0.02, 0.05
"""Weights of a pixel found dark, and of one at an object's outline, among those that tell what is lit."""
ROUNDS = 4
"""Estimates of the light, each without what the one before found dark."""
TEXTURE = 0.006
"""Width of the Gaussian that evens out texture, in shares of the longer side."""
CERTAIN, POSSIBLE = 4.0, 3.0
"""Standard deviations by which a shadow is darker somewhere, and everywhere."""
RIM = 0.2
"""Where a shadow ends, in shares of its darkness at its object's outline: what fades on beyond looks like light."""
CLOSE, DARKEST = 0.2, 90.0
"""Shares of the reach within which a shadow is darkest, and the percentile there that is taken for it."""
LEAST = 0.015
"""Smallest standard deviation that is believed [log]: of 8 bits and of light that is not quite even."""


@settings
class PhotoShadowConfig:
    """Which darker pixels beside an object are its shadow."""

    reach: Annotated[float, Interval(ge=0, le=5)] = 1.0
    """Largest distance of a shadow from its mask [longer side of the mask]. At 0 no shadows are found."""
    margin: Annotated[float, Interval(ge=0, le=0.1)] = 0.012
    """Width by which shadows grow [share of the photo's longer side]. Their rims fade into the noise."""


@dataclass(frozen=True, eq=False)
class _SmallPhoto:
    """The photo at low resolution: ``light`` (h, w) and ``colour`` (h, w, 2) [log], pixels ``taken`` (h, w) by objects.

    ``base`` (h, w) are the lower halves of objects: behind an upper half there is seldom the support. ``distance``
    (h, w) is every pixel's distance to a base in shares of the reach, ``owner`` (h, w) that base's object."""

    light: Array
    colour: Array
    taken: Mask
    base: Mask
    distance: Array
    owner: NDArray[np.int64]

    @property
    def near(self) -> Mask:
        return self.distance <= 1


def find_shadows(
    picture: Picture, masks: Sequence[Mask], config: PhotoShadowConfig, support: Mask | None = None
) -> Mask:
    """Pixels (h, w) of ``picture`` (h, w, 3), logarithms of colour, in the shadow of a mask's object.

    All are on the ``support`` (h, w) if that is known."""
    shape = picture.shape[:2]
    if not masks or not config.reach:
        return np.zeros(shape, np.bool_)
    step = max(1, max(shape) // LOOKED_AT)
    view = _view(picture, masks, step, config.reach)
    darker, deviation = _darker(view)
    # Noise sets the least darkness, the owner's own shadow how far its fading rim counts.
    rim = np.maximum(POSSIBLE * deviation, RIM * _darkest(view, darker, len(masks))[view.owner])
    dark = (darker > rim) & view.near & ~view.taken
    if support is not None:
        dark &= support[::step, ::step]
    width = max(1, round(config.margin * max(dark.shape)))
    broad = opened((dark & ~_edges(view)) | view.taken, width) & dark  # joints and grain are thin
    found = _joined(broad, darker > CERTAIN * deviation, view.base)
    if not found.any():
        return np.zeros(shape, np.bool_)
    found = grown(found, 3 * width, within=dark)
    found |= closed(found | view.taken, 2 * width) & ~view.taken  # what is narrow between shadows is not lit either
    wide = grown(found, width)
    whole = without_holes(wide | view.taken) & (wide | view.near)
    large = np.repeat(np.repeat(whole & ~view.taken, step, 0), step, 1)
    large = large[: shape[0], : shape[1]]
    return large if support is None else large & support


def _view(picture: Picture, masks: Sequence[Mask], step: int, reach: float) -> _SmallPhoto:
    from scipy.ndimage import gaussian_filter

    small = _shrunk(picture, step)
    taken, base = np.zeros(small.shape[:2], np.bool_), np.zeros(small.shape[:2], np.bool_)
    distance = np.full(small.shape[:2], np.inf)
    owner = np.zeros(taken.shape, np.int64)
    for k, mask in enumerate(masks):
        if not mask.any():
            continue
        own = _shrunk(mask[..., None].astype(np.float32), step)[..., 0] > 0
        rows, columns = np.flatnonzero(own.any(1)), np.flatnonzero(own.any(0))
        length = reach * (1 + max(np.ptp(rows), np.ptp(columns)))
        to_own = distance_to(own) / length
        owner[to_own < distance] = k
        distance = np.minimum(distance, to_own)
        taken |= own
        # The mask's lower half in the picture.
        base |= own & (np.arange(len(own)) >= (rows[0] + rows[-1]) / 2)[:, None]
    weight = (~taken)[..., None].astype(np.float32)
    sigma = max(TEXTURE * max(taken.shape), 0.5)
    smooth = gaussian_filter(np.concatenate([small * weight, weight], 2), (sigma, sigma, 0))
    r, g, b = np.moveaxis(smooth[..., :3] / np.maximum(smooth[..., 3:], 1e-6), 2, 0)
    # Differences of logarithms: ratios of channels, which a grey shadow leaves as they are.
    colour = np.stack([r - g, (r + g) / 2 - b], axis=-1)
    return _SmallPhoto((r + g + b) / 3, colour, taken, base, distance, owner)


def _shrunk(values: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Means (h / step, w / step, c) of squares of ``step`` pixels; those at the far sides hold fewer."""
    h, w, c = values.shape
    pad = ((0, -h % step), (0, -w % step), (0, 0))
    padded = np.pad(values, pad, mode="edge")
    return padded.reshape(padded.shape[0] // step, step, -1, step, c).mean(axis=(1, 3))


def _darker(view: _SmallPhoto) -> tuple[Array, float]:
    """How much darker (h, w) [log] each pixel is than its material nearby, and the deviation of that far from
    objects."""
    free = ~view.taken
    away = free & ~view.near
    if np.count_nonzero(away) < 0.02 * away.size:  # objects everywhere: what is farthest from them must do
        away = free & (view.distance >= np.percentile(view.distance[free], 80)) if free.any() else free
    # Near an object a pixel may be in its shadow: it tells the less of what is lit.
    trust = np.where(free, np.clip(view.distance, BESIDE, 1), 0)
    lit = np.ones_like(trust)
    darker, deviation = np.zeros_like(trust), LEAST
    for _ in range(ROUNDS):
        darker = _light_around(view, trust * lit) - view.light
        values = darker[away]
        # 1.4826 MAD is the standard deviation of normal noise, whatever the tails.
        deviation = max(1.4826 * float(np.median(np.abs(values - np.median(values)))), LEAST) if values.size else LEAST
        lit = np.where(darker > deviation, SHADED, 1.0)
    return darker, deviation


def _light_around(view: _SmallPhoto, weight: Array) -> Array:
    """The mean light (h, w) of nearby pixels of the same colour; a pixel without any keeps its own.

    The mean residual is added, which follows gradients of light (twicing, Tukey 1977)."""
    from scipy.ndimage import gaussian_filter, map_coordinates

    h, w = view.light.shape
    cell = LIGHT_CELL * max(h, w)
    y, x = np.mgrid[:h, :w] / cell
    colours = np.clip(view.colour / COLOUR_CELL, -COLOURS, COLOURS) + COLOURS
    # The grid has the colours that the photo has: nothing is read beyond, and nothing would come from there.
    # An even first one: halves are rounded to even places.
    first, last = 2 * np.floor(colours.min((0, 1)) / 2), np.ceil(colours.max((0, 1)))
    # (4, h w): every pixel's place in the grid of row, column and two colours.
    at = np.stack([y.ravel(), x.ravel(), *(colours - first).reshape(-1, 2).T])
    shape = (int(h / cell) + 2, int(w / cell) + 2, *(last - first + 1).astype(int).tolist())
    flat = np.ravel_multi_index(tuple(np.rint(at).astype(int)), shape)

    def blurred(values: Array) -> Array:
        # Splat, blur, slice: the bilateral grid. Two widths in colour: the like decide, others only where these are
        # few.
        grid = np.bincount(flat, values.ravel(), minlength=int(np.prod(shape))).reshape(shape)
        near = gaussian_filter(grid, BLUR[:2], axes=(0, 1), mode="constant")
        narrow, wide = (gaussian_filter(near, c, axes=(2, 3), mode="constant") for c in BLUR[2:])
        return map_coordinates(narrow + OTHERS * wide, at, order=1).reshape(h, w)

    count = blurred(weight)
    there = count > FEW
    light = np.where(there, blurred(weight * view.light) / np.maximum(count, FEW), view.light)
    rest = np.where(there, blurred(weight * (view.light - light)) / np.maximum(count, FEW), 0)
    return light + rest


def _darkest(view: _SmallPhoto, darker: Array, masks: int) -> Array:
    """How dark (n,) [log] it is close around each mask."""
    close = ~view.taken & (view.distance <= CLOSE)
    owned = [darker[close & (view.owner == k)] for k in range(masks)]
    return np.array([float(np.percentile(d, DARKEST)) if d.size else 0.0 for d in owned])


def _edges(view: _SmallPhoto) -> Mask:
    """Pixels (h, w) across which the colour changes as that of a shadow does not: another material begins."""
    from scipy.ndimage import maximum_filter, minimum_filter

    size = (2 * max(1, round(TEXTURE * max(view.taken.shape))) + 1,) * 2
    # Objects count for neither extreme: minus infinity for the largest, plus infinity for the least.
    values = [np.where(view.taken, np.nan, c) for c in np.moveaxis(view.colour, 2, 0)]
    ranges = [
        maximum_filter(np.nan_to_num(v, nan=-np.inf), size) - minimum_filter(np.nan_to_num(v, nan=np.inf), size)
        for v in values
    ]
    return np.maximum(*ranges) > EDGE * COLOUR_CELL


def _joined(dark: Mask, certain: Mask, base: Mask) -> Mask:
    """Parts of ``dark`` that touch an object's base and are certain somewhere."""
    parts = parts_of(dark, diagonal=True)
    keep = np.intersect1d(parts[grown(base, 2)], parts[certain & dark])
    return np.isin(parts, keep[keep > 0])
