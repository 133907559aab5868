"""Boxes whose outline touches the lines that a mask touches, and boxes cut by the cone of a mask."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.many_starts import BEHIND_CAMERA, refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import BOX_FACES, CORNERS, Solid, carved, common, finer, mirrored, subdivided

YAWS = 9
"""Turns of a box at which its fit starts, over a quarter turn."""
DEPTHS = (0.4, 1.0, 2.2)
"""Its depths there, over its width."""
EQUAL = 1.25
"""Inverse standard deviation of the logarithms of a box's edges: a factor of 2.2. Of boxes that look alike, the most
compact; seen from its height, a box hides its own depth."""
COMPACT = 4.0
"""The same for a box that is carved: the hull of legs and backs is no outline of a box, and a low camera reads metres
of depth from a few rows."""
SPARE = 0.1
"""Standard error [size of the mask] by which the box reaches beyond the hull: what is too much is cut."""
STARTS = 4
"""Starts that are refined, the best first."""
CUTS = 12
"""Edges of a carved box's faces along its longest side: textures are projected at their corners."""
COMPACT_MASK = 0.75
"""Share of its hull that a mask covers from which on nothing is gained by carving: legs and gaps cover less."""
SYMMETRY = 0.03
"""Loss of IoU up to which a carved box is cut by its mirror image: legs and wheels get their own depth. A chair's back
would be lost by the wrong plane."""
TURNS, SHIFTS = np.radians([-8, -4, 0, 4, 8]), (-0.06, 0.0, 0.06)
"""Turns [rad] and shifts [sides of the box] of its planes of symmetry that are tried: the box is of a convex hull."""


def fit_box(seen: Outlined, floor: float) -> FittedShape | None:
    """A box on the height ``floor`` [m]: its outline touches the lines that the mask's touches, in all directions."""
    fit = _fitted(seen, floor, EQUAL)
    return fit and replace(fit, solid=replace(subdivided(fit.solid), symmetry="box"))


def _fitted(seen: Outlined, floor: float, equal: float, spare: float = 0.0) -> FittedShape | None:
    """A box whose corners are in the order of CORNERS. ``equal`` is how alike its edges are before the outline tells:
    an inverse standard deviation, as EQUAL. Its outline may reach beyond the mask's above by ``spare`` [size of the
    mask], beside it by half of that, and not below it, where it stands."""
    anchor = anchored(seen, floor)
    if anchor is None:
        return None
    centre, size = anchor
    away = horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])
    directions, wanted, scatter = seen.support
    beyond = np.hypot(scatter, spare * math.sqrt(float(seen.mask.sum())) * (1 - directions[:, 1]) / 2)

    def corners(x: Array) -> Array:
        """(s, 8, 3) of boxes x (s, 6): shifts, logarithms of the edges, both in sizes, and yaw."""
        c, n = np.cos(x[:, 5, None]), np.sin(x[:, 5, None])
        u, v, w = np.moveaxis(CORNERS * np.exp(x[:, None, 2:5]), 2, 0)
        local = np.stack([c * u - n * v, n * u + c * v, w], 2)
        return centre + size * (local + (x[:, :1] * side + x[:, 1:2] * away)[:, None])

    def residuals(x: Array) -> Array:
        reached, depth = seen.reached(corners(x), directions)
        unequal = x[:, 2:5] - x[:, 2:5].mean(1, keepdims=True)
        off = reached - wanted
        off = off / np.where(off > 0, beyond, scatter)
        all_of_them = np.concatenate([off, equal * unequal], axis=1)
        return np.where((depth > 0.05 * size)[:, None], all_of_them, BEHIND_CAMERA)

    yaws = np.pi / 2 * np.arange(YAWS) / YAWS
    x = np.array([[0, 0.3, math.log(0.7), math.log(0.7 * d), math.log(0.5), yaw] for yaw in yaws for d in DEPTHS])
    x = _onto_bounds(seen, x, corners, size)
    for kept, iterations in ((STARTS, 8), (STARTS, 40)):
        x, costs = refined(residuals, x, iterations=iterations)
        x = x[np.argsort(costs, kind="stable")[:kept]]
    fitted = [Solid(vertices=points, faces=BOX_FACES) for points in corners(x)]
    overlaps = [seen.overlap(made.vertices, made.faces) for made in fitted]
    best = int(np.argmax(overlaps))
    return FittedShape(family="box", solid=fitted[best], overlap=overlaps[best])


def _onto_bounds(seen: Outlined, x: Array, corners: Callable[[Array], Array], size: float) -> Array:
    """Boxes x (s, 6) of given proportions and yaw, moved and scaled so that their pictures have the mask's bounds."""
    left, top, right, bottom = seen.bounds
    steep = abs(seen.camera.T_world_camera[2, 2]) + 0.05  # sine of the pitch: pixels up are metres away over it
    for _ in range(3):
        points = corners(x)
        pixels, depth = (a.reshape(*points.shape[:2], -1) for a in seen.camera.project(points.reshape(-1, 3)))
        west, north = np.moveaxis(pixels.min(1), 1, 0)
        east, south = np.moveaxis(pixels.max(1), 1, 0)
        metres = depth.mean((1, 2)) / seen.camera.K[0, 0] / size
        moved = x.copy()
        moved[:, 0] -= ((left + right) - (west + east)) / 2 * metres
        moved[:, 1] += (south - bottom) * metres / steep
        moved[:, 2:4] += np.log((right - left) / np.maximum(east - west, 1e-6))[:, None]
        higher = np.log((bottom - top) / np.maximum(south - north, 1e-6))
        moved[:, 4] = np.clip(x[:, 4] + 0.7 * higher, -3, 3)
        x = np.where(depth.min((1, 2))[:, None] > 0, moved, x)
    return x


def fit_carved(seen: Outlined, floor: float) -> FittedShape | None:
    """The box of the mask's convex hull, cut by the cone of the mask, and by its mirror images: a chair, a table."""
    hull = _fitted(replace(seen, mask=seen.convex), floor, COMPACT, SPARE)
    if hull is None:
        return None
    box = hull.solid.vertices
    solid = carved(hull.solid, seen.possible, seen.camera)
    if solid is None:
        return None
    fit = FittedShape.of("carved box", solid, seen)
    if seen.solidity < COMPACT_MASK:
        halves = [_mirror_symmetric(fit, box[k] - box[0], box.mean(0), seen) for k in (1, 2)]
        half = max(halves, key=lambda f: f.overlap)
        fit = half if half.overlap >= fit.overlap - SYMMETRY else fit
    return replace(fit, solid=finer(fit.solid, float(np.ptp(box, axis=0).max()) / CUTS))


def _mirror_symmetric(fit: FittedShape, axis: Array, middle: Array, seen: Outlined) -> FittedShape:
    """What a shape and its mirror image have in common, for the upright plane about ``middle`` (3,) across ``axis``
    (3,) that leaves most of the mask."""
    found = [replace(fit, overlap=0.0)]
    size, along = float(np.linalg.norm(axis)), math.atan2(axis[1], axis[0])
    for turn in TURNS:
        normal = np.array([math.cos(along + turn), math.sin(along + turn), 0.0])
        for shift in SHIFTS:
            solid = common(fit.solid, mirrored(fit.solid, normal, float(normal @ middle) + shift * size))
            found += [FittedShape.of(fit.family, solid, seen)] if solid else []
    return max(found, key=lambda f: f.overlap)
