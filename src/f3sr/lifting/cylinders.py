"""Cylinders and cones cut short, upright, whose outline touches the lines that a mask touches: cans, jars, glasses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.many_starts import BEHIND_CAMERA, refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import revolved

HEIGHTS = (0.5, 1.2, 2.5)
"""Heights at which fits start, over the width."""
ALIKE = 1.25
"""Inverse standard deviation of the logarithm of height over width: a factor of 2.2, as for the edges of a box."""
UPRIGHT = 10.0
"""Inverse standard deviation of the logarithm of the upper radius over the lower: most sides are upright."""
RING = 2 * np.pi * np.arange(24) / 24
ROWS = 8
"""Rings of the side: textures are projected at their corners."""


def fit_cylinder(seen: Outlined, floor: float) -> FittedShape | None:
    """A cylinder, or a cone cut short, on the height ``floor`` [m], by the support functions of its outline and of the
    mask's. Where a mask is hidden, its sides go on as they are seen."""
    if anchored(seen, floor) is None:
        return None
    centre = seen.on_plane(seen.widest[None], UP, floor)[0]
    if not np.isfinite(centre).all():
        return None
    size = seen.apparent_size(centre)
    away = horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])
    directions, wanted, scatter = seen.support
    ring = np.cos(RING)[:, None] * side + np.sin(RING)[:, None] * away

    def rings(x: Array) -> Array:
        """(s, 48, 3) of cylinders x (s, 5): shifts, logarithms of radius and of height over width, both in sizes, and
        of the upper radius over the lower."""
        radius = size * np.exp(x[:, 2])
        height = 2 * radius * np.exp(x[:, 3])
        foot = centre + size * (x[:, :1] * side + x[:, 1:2] * away)
        ends = [(radius * np.exp(s * x[:, 4] / 2), z) for s, z in ((-1, 0 * height), (1, height))]
        return np.concatenate(
            [foot[:, None] + r[:, None, None] * ring + z[:, None, None] * UP for r, z in ends], axis=1
        )

    def residuals(x: Array) -> Array:
        reached, depth = seen.reached(rings(x), directions)
        unlikely = np.column_stack([ALIKE * x[:, 3], UPRIGHT * x[:, 4]])
        all_of_them = np.concatenate([(reached - wanted) / scatter, unlikely], axis=1)
        return np.where((depth > 0.05 * size)[:, None], all_of_them, BEHIND_CAMERA)

    starts = np.array([[0.0, y, math.log(0.35), math.log(h), 0.0] for h in HEIGHTS for y in (-0.4, 0.0)])
    found, costs = refined(residuals, starts, iterations=40)
    x = found[int(np.argmin(costs))]
    foot = centre + size * (x[0] * side + x[1] * away)
    radius = size * math.exp(x[2])
    share = np.linspace(0, 1, ROWS)
    outside = radius * np.exp((2 * share - 1) * x[4] / 2)  # between the two radii, as straight as a taper is small
    height = 2 * radius * math.exp(x[3])
    profile = np.concatenate([[[0, 0]], np.column_stack([outside, height * share]), [[0, height]]])
    return FittedShape.of("cylinder", replace(revolved(foot, profile), symmetry="round"), seen)
