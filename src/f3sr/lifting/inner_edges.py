"""Where a photo shows edges inside an outline: those of a box, and the near rim of what is hollow."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import SLIDE
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import CORNERS
from f3sr.vision.regions import interpolated

EXPECTED = 0.04
"""Standard deviation of the corner about where the outline's box has it [size of the mask]: the camera's error."""
FARTHEST = 2.5
"""Reach of the search [standard deviations]."""
STEP = 0.75
"""Largest step of the search [px]."""
BESIDE = 1.5
"""Distance from an edge of the pixels on both sides that are compared [px]."""
SAMPLES = 24
"""Points along an edge."""
INSIDE = 0.04
"""Least distance of an edge from the outline [size of the mask]: nearer, a face beyond it is hardly seen."""
SHOWN = 0.6
"""Least share of the edges that is not hidden."""
DARK = 8
"""Added to colours before their logarithm: below it is noise."""
PENALTY = 0.15
"""Share of the largest contrast that a corner one standard deviation off loses, times two."""
CONSISTENT = 0.6
"""Least length of the mean of the differences along the edges, over their root mean square: print differs in all
directions, and noise of one colour reaches .4."""
NEAR = 0.3
"""Least height below its middle, over half its height in the picture, from which on a rim counts as near: at its sides
it is the outline."""
SIGMA = 1.0
"""Standard error of the corner [px]."""


@dataclass(frozen=True, eq=False)
class InnerCorner:
    """The corner of a box inside its outline, where three faces meet."""

    index: int
    """In the order of CORNERS."""
    pixel: Array
    """(2,) [px of the window], with the standard error ``SIGMA``."""

    def moved(self, box: Array, seen: Outlined) -> Array:
        """A ``box`` (8, 3) whose corner moved in its level face to where the photo has it, as far as that is near."""
        corner = box[self.index]
        pixel = seen.camera.project(corner[None])[0][0]
        across = np.linalg.norm(self.pixel - pixel) * seen.metres_per_pixel(corner)
        shift = seen.on_plane(self.pixel[None], UP, float(corner[2]))[0] - corner
        length = float(np.linalg.norm(shift))
        if not math.isfinite(length) or length == 0:
            return box
        moved = box.copy()
        moved[self.index] += shift * min(1.0, SLIDE * across / length)
        return moved


def inner_corner(seen: Outlined, box: Array) -> InnerCorner | None:
    """Where the photo has the corner at which the three visible faces of a ``box`` (8, 3) meet; None where it shows no
    such corner distinctly.

    Its three edges end at corners on the outline, which the mask tells. So two numbers are searched: for them the mean
    difference of the colours across the edges is largest, weighed by how far from the outline's box it is."""
    if seen.colours is None:
        return None
    pixels, depth = seen.camera.project(box)
    size = math.sqrt(float(seen.mask.sum()))
    top = np.flatnonzero(CORNERS[:, 2] == 1)
    index = int(top[np.argmin(depth[top])])
    if (depth <= 0).any() or _inside(pixels, index) < INSIDE * size:
        return None
    ends = pixels[np.flatnonzero(np.abs(CORNERS - CORNERS[index]).sum(1) == 1)]
    reach = max(2.0, FARTHEST * EXPECTED * size)
    steps = np.linspace(-reach, reach, 2 * math.ceil(reach / STEP) + 1)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.hypot(*offsets.T) <= reach]
    contrast, consistency = _contrast(seen.mask, seen.colours, pixels[index] + offsets, ends)
    likely = contrast / max(1e-9, float(contrast.max())) - PENALTY * ((offsets / (EXPECTED * size)) ** 2).sum(1) / 2
    best = int(np.argmax(likely))
    if consistency[best] < CONSISTENT:
        return None
    return InnerCorner(index, pixels[index] + offsets[best])


@dataclass(frozen=True, eq=False)
class NearRim:
    """Where the photo has points of a rim, on its side towards the camera."""

    along: Array
    """(n,) the points' places along the rim's corners, in order."""
    pixels: Array
    """(n, 2) [px of the window]."""

    def residuals(self, rim: Array, seen: Outlined) -> tuple[Array, Array]:
        """The points (n, 2) of a ``rim`` (m, 3) in the picture, and from these to where the photo has them (n, 2)."""
        here = _along(seen.camera.project(rim)[0], self.along)
        return here, self.pixels - here


def near_rim(seen: Outlined, rim: Array) -> NearRim | None:
    """Where colours differ most, and alike, across the near half of a ``rim`` (n, 3). None where no edge is seen, or
    only the outline. The rim is moved down or up in the picture, its ends less.

    No outline tells that: below the near rim the mask goes on with the outside of the wall."""
    if seen.colours is None:
        return None
    corners = seen.camera.project(rim)[0]
    lengths = np.linalg.norm(np.diff(corners, axis=0, append=corners[:1]), axis=1)
    counts = np.maximum(1, lengths.astype(int))  # one a pixel
    along = np.concatenate([corner + np.arange(n) / n for corner, n in enumerate(counts)])
    pixels = _along(corners, along)
    tangents = np.gradient(pixels, axis=0)
    low, high = float(corners[:, 1].min()), float(corners[:, 1].max())
    share = 2 * (pixels[:, 1] - low) / max(high - low, 1e-9) - 1
    near = share > NEAR
    along, pixels, share, tangents = along[near], pixels[near], share[near], tangents[near]
    if len(along) < SAMPLES:
        return None
    across = np.column_stack([-tangents[:, 1], tangents[:, 0]]) / np.linalg.norm(tangents, axis=1, keepdims=True)
    size = math.sqrt(float(seen.mask.sum()))
    reach = FARTHEST * EXPECTED * size
    shifts = np.linspace(-reach, reach, 2 * math.ceil(reach / STEP) + 1)
    points = pixels + (shifts[:, None] * share)[..., None] * [0, 1]
    difference = _differences(seen.colours, points, across)
    contrast = np.linalg.norm(difference.mean(1), axis=1)
    likely = contrast / max(1e-9, float(contrast.max())) - PENALTY * (shifts / (EXPECTED * size)) ** 2 / 2
    best = int(np.argmax(likely))
    spread = math.sqrt(float((difference[best] ** 2).sum(1).mean()))
    inside = float(np.median(interpolated(seen.depth_inside, points[best]))) >= INSIDE * size
    return NearRim(along, points[best]) if inside and contrast[best] >= CONSISTENT * spread > 0 else None


def _along(corners: Array, places: Array) -> Array:
    """Points (n, 2) at ``places`` (n,) along a closed line with ``corners`` (m, 2)."""
    closed, index = np.concatenate([corners, corners[:1]]), np.arange(len(corners) + 1)
    return np.column_stack([np.interp(places, index, closed[:, k]) for k in (0, 1)])


def _inside(pixels: Array, index: int) -> float:
    """Distance [px] of one of the points (n, 2) from the convex outline of the others."""
    from scipy.spatial import ConvexHull

    sides = ConvexHull(np.delete(pixels, index, axis=0)).equations
    return float(-(sides[:, :2] @ pixels[index] + sides[:, 2]).max())


def _differences(colours: NDArray[np.uint8], points: Array, across: Array) -> Array:
    """Of the logarithms of ``colours`` (h, w, 3) across edges: (..., 3) at points (..., 2), ``across`` unit vectors
    (..., 2)."""
    logs = np.log(colours.astype(float) + DARK)
    low, high = ((points + s * BESIDE * across).reshape(-1, 2) for s in (-1, 1))
    of_each = [interpolated(logs[..., k], high) - interpolated(logs[..., k], low) for k in range(3)]
    return np.stack(of_each, axis=-1).reshape(*points.shape[:-1], 3)


def _contrast(mask: NDArray[np.bool_], colours: NDArray[np.uint8], corners: Array, ends: Array) -> tuple[Array, Array]:
    """Length (n,) of the mean difference of ``colours`` (h, w, 3) across the edges from each of the ``corners`` (n, 2)
    to the ``ends`` (3, 2), in the ``mask`` (h, w), and that over the differences' root mean square. Both are 0 where
    too much of the edges is hidden."""
    t = (np.arange(SAMPLES) + 0.5) / SAMPLES
    along = ends[None] - corners[:, None]
    lengths = np.linalg.norm(along, axis=2)
    across = np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.maximum(lengths, 1e-9)[..., None]
    points = corners[:, None, None] + t[:, None] * along[:, :, None]
    sides = [(points + s * BESIDE * across[:, :, None]).reshape(-1, 2) for s in (-1, 1)]
    shown = np.logical_and.reduce([_at(mask, side) for side in sides]).reshape(points.shape[:3])
    difference = _differences(colours, points, across[:, :, None]) * shown[..., None]
    counts = np.maximum(shown.sum(2), 1)
    means = np.linalg.norm(difference.sum(2) / counts[..., None], axis=-1)
    sizes = np.sqrt((difference**2).sum((2, 3)) / counts)
    mean, size = ((lengths * edges).sum(1) / np.maximum(lengths.sum(1), 1e-9) for edges in (means, sizes))
    enough = shown.mean((1, 2)) >= SHOWN
    return np.where(enough, mean, 0.0), np.where(enough, mean / np.maximum(size, 1e-9), 0.0)


def _at(mask: NDArray[np.bool_], pixels: Array) -> NDArray[np.bool_]:
    """Values (n,) of a mask (h, w) at points (n, 2) of the picture."""
    x, y = np.clip(pixels.astype(int), 0, [mask.shape[1] - 1, mask.shape[0] - 1]).T
    return mask[y, x]
