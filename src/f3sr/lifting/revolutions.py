"""Solids of revolution: at each height the largest circle whose image lies in the mask, closed above and below."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import revolved
from f3sr.vision.regions import interpolated

LEVELS = 48
"""Heights of a solid of revolution."""
RADII = 28
"""Radii tried at each height, up to the largest; then refined between two."""
SLACK = 0.3
"""Step of how far circles may lie outside of the mask, in steps of the search for the axis."""
HIDDEN = 0.75
"""Distance from the picture's outermost circle within which another one counts as hidden by it [px of the window]."""
ROUND = 0.35
"""Slope of the side, radius over height, from which on the end that nobody sees goes on round; else it is flat."""
CAP = 5
"""Rings of a round end."""


def fit_revolution(seen: Outlined, floor: float, *, is_round: bool = False) -> FittedShape | None:
    """The symmetric hull of the mask about a vertical axis on the height ``floor`` [m]: at each height the largest
    circle whose image lies in the mask. The axis is where that covers most. ``is_round``: it has no flat underside."""
    anchor = anchored(seen, floor)
    if anchor is None:
        return None
    _, size = anchor
    centre = seen.on_plane(seen.widest[None], UP, floor)[0]
    if not np.isfinite(centre).all():
        return None
    away = horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])

    def axis(x: Array) -> Array:
        return centre + size * (x[0] * side + x[1] * away)

    def profile(x: Array) -> Array | None:
        widest = _profile(seen, axis(x), size, beyond=SLACK * x[2])
        return None if widest is None else _closed(seen, axis(x), widest, is_round=is_round)

    def loss(x: Array) -> float:
        around = profile(x)
        if around is None:
            return 1.0
        made = revolved(axis(x), around, sectors=20)
        return 1 - seen.overlap(made.vertices, made.faces)

    first = min((np.array([0.0, y, 0.0]) for y in np.linspace(-0.9, 0.3, 13)), key=loss)
    x = _lowered(loss, first, step=0.08, evaluations=60)
    around = profile(x)
    if around is None:
        return None
    return FittedShape.of("solid of revolution", replace(revolved(axis(x), around), symmetry="round"), seen)


def _closed(seen: Outlined, foot: Array, profile: Array, *, is_round: bool) -> Array:
    """A profile whose ends are what things have, not all that the outline allows.

    Above the circle that is highest in the picture, and below the lowest, the mask bounds only a cone of rays. Where
    the side arrives there upright, the end is flat; where it leans inward, it goes on round to the axis."""
    radii, heights = profile[1:-1].T
    away = horizontal(seen, foot)
    far, near = (
        seen.camera.project(foot + s * radii[:, None] * away + heights[:, None] * UP)[0][:, 1] for s in (1, -1)
    )
    top = int(np.argmax(far <= far.min() + HIDDEN))
    bottom = len(near) - 1 - int(np.argmax(near[::-1] >= near.max() - HIDDEN))
    if top - bottom < 2:
        return profile
    reach = max(2, (top - bottom) // 6)
    lower = (radii[bottom + reach] - radii[bottom]) / (heights[bottom + reach] - heights[bottom])
    upper = (radii[top - reach] - radii[top]) / (heights[top] - heights[top - reach])
    middle = np.column_stack([radii, heights])[bottom : top + 1]
    over = heights[top] + radii[top] * (math.sqrt(1 + upper**2) - upper)  # the top of the sphere that goes on
    head = _cap(middle[-1], upper, float(over)) if upper > ROUND else np.array([[0, heights[top]]])
    if lower > ROUND or is_round:
        foot_of = _cap(middle[0], max(lower, ROUND), 0.0)[::-1]
    else:
        foot_of = np.array([[0, 0], [radii[bottom], 0]])[: 2 if heights[bottom] > 0 else 1]
    return np.concatenate([foot_of, middle, head])


def _cap(edge: Array, slope: float, end: float) -> Array:
    """Radii and heights (n, 2) from after the ``edge`` (2,) to the axis at the height ``end``, round: a parabola that
    leaves the edge along the side's ``slope`` and arrives level."""
    corner = np.array([max(0.0, edge[0] - slope * abs(end - edge[1])), end])
    t = np.linspace(0, 1, CAP + 1)[1:, None]
    return (1 - t) ** 2 * edge + 2 * t * (1 - t) * corner + t**2 * np.array([0, end])


def _profile(seen: Outlined, foot: Array, size: float, *, beyond: float) -> Array | None:
    """Radii and heights (n, 2) of the largest circles about the vertical through ``foot`` whose images lie in the mask,
    or at most ``beyond`` [size of the mask] outside, from the axis below to the axis above. None where there are none.

    Where the camera's pitch is a little off, no circle has the mask's rim as its image: one is too narrow or wide."""
    pixels, _ = seen.camera.project(np.array([foot, foot + size * UP]))
    rise = pixels[0, 1] - pixels[1, 1]
    if not np.isfinite(rise) or rise <= 0:
        return None
    tallest = 1.3 * size * max(1.0, (pixels[0, 1] - seen.bounds[1]) / rise)
    heights = np.linspace(0, min(tallest, 4 * size), LEVELS)
    radii = size * np.linspace(0, 0.75, RADII + 1)[1:]
    angles = 2 * np.pi * np.arange(24) / 24
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(24)])
    points = foot + radii[None, :, None, None] * ring + heights[:, None, None, None] * UP
    uv, depth = seen.camera.project(points.reshape(-1, 3))
    depths = interpolated(seen.depth_inside, uv) + max(0.0, beyond) * math.sqrt(float(seen.mask.sum()))
    inside = np.where(depth > 0, depths, -1e3).reshape(LEVELS, RADII, 24).min(2)
    inside = np.concatenate([np.full((LEVELS, 1), 1e-3), inside], axis=1)
    first_out = np.argmax(np.concatenate([inside, np.full((LEVELS, 1), -1.0)], axis=1) < 0, axis=1)
    last = first_out - 1
    steps = np.concatenate([[0], radii, [radii[-1]]])
    rows = np.arange(LEVELS)
    a, b = inside[rows, last], np.concatenate([inside, np.full((LEVELS, 1), -1.0)], axis=1)[rows, first_out]
    radius = steps[last] + (steps[first_out] - steps[last]) * np.where(last > 0, a / np.maximum(a - b, 1e-9), 0)
    wide = radius > 0.02 * size
    if not wide.any():
        return None
    low = int(np.argmax(wide))
    high = low + int(np.argmin(np.append(wide[low:], False)))
    if high - low < 3:
        return None
    shown, levels = radius[low:high], heights[low:high] - heights[low]
    shown = ndimage.median_filter(shown, 3, mode="nearest")
    return np.concatenate([[[0, levels[0]]], np.column_stack([shown, levels]), [[0, levels[-1]]]])


def _lowered(loss: Callable[[Array], float], x: Array, *, step: float, evaluations: int) -> Array:
    simplex = np.vstack([x, x + step * np.eye(len(x))])
    found = minimize(loss, x, method="Nelder-Mead", options={"maxfev": evaluations, "initial_simplex": simplex})
    return np.asarray(found.x)
