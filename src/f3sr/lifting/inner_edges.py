"""Where a photo shows the edges of a box inside its outline."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import UP, Array
from f3sr.lifting.outline_fit import SLIDE
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
"""Least distance of the corner from the outline [size of the mask]: nearer, one of three faces is hardly seen."""
SHOWN = 0.6
"""Least share of the edges that is not hidden."""
DARK = 8
"""Added to colours before their logarithm: below it is noise."""
PENALTY = 0.15
"""Share of the largest contrast that a corner one standard deviation off loses, times two."""
CONSISTENT = 0.6
"""Least length of the mean of the differences along the edges, over their root mean square: print differs in all
directions, and noise of one colour reaches .4."""
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
    colours = np.log(seen.colours.astype(float) + DARK)
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
    contrast, consistency = _contrast(seen.mask, colours, pixels[index] + offsets, ends)
    likely = contrast / max(1e-9, float(contrast.max())) - PENALTY * ((offsets / (EXPECTED * size)) ** 2).sum(1) / 2
    best = int(np.argmax(likely))
    if consistency[best] < CONSISTENT:
        return None
    return InnerCorner(index, pixels[index] + offsets[best])


def _inside(pixels: Array, index: int) -> float:
    """Distance [px] of one of the points (n, 2) from the convex outline of the others."""
    from scipy.spatial import ConvexHull

    sides = ConvexHull(np.delete(pixels, index, axis=0)).equations
    return float(-(sides[:, :2] @ pixels[index] + sides[:, 2]).max())


def _contrast(mask: NDArray[np.bool_], colours: Array, corners: Array, ends: Array) -> tuple[Array, Array]:
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
    low, high = (np.stack([interpolated(colours[..., k], side) for k in range(3)], axis=-1) for side in sides)
    difference = (high - low).reshape(*points.shape[:3], 3) * shown[..., None]
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
