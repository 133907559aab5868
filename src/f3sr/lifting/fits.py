"""The shape of each family that fits a mask best, standing or lying on its support."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.optimize import minimize

from f3sr.core.transforms import Array
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import Solid, box, inflated, revolved, subdivided

YAWS = 6
"""Turns of a box at which its fit starts, over a quarter turn."""
STARTS = 2
"""Starts that are refined, the best first."""
LEVELS = 48
"""Heights of a solid of revolution."""
RADII = 28
"""Radii tried at each height, up to the largest; then refined between two."""
GRID = 72
"""Cells of the longer side of an inflated silhouette."""
WALL = 0.06
"""Thickness of a hollow thing's wall, as a share of its largest radius."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """A shape of one family, and its overlap with the mask where that is valid (IoU)."""

    family: str
    solid: Solid
    overlap: float


def fit_box(seen: Outlined, floor: float) -> Fit | None:
    """A box on the height ``floor`` [m] of least 1 - IoU: six parameters, from several yaws (Nelder and Mead 1965)."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    centre, size = anchor

    def solid(x: Array) -> Solid:
        return box(centre + [x[0] * size, x[1] * size, 0], size * np.exp(x[2:5]), float(x[5]))

    def loss(x: Array) -> float:
        made = solid(x)
        return 1 - seen.overlap(made.vertices, made.faces) + 1e-3 * float((x[2:5] ** 2).sum())

    starts = list[Array]()
    for k in range(YAWS):
        for height in (0.3, 1.0):
            x = np.array([0, 0.35, math.log(0.7), math.log(0.7), math.log(height), k * np.pi / (2 * YAWS)])
            starts.append(_refined(loss, x, step=0.25, evaluations=60))
    starts.sort(key=loss)
    best = min((_refined(loss, x, step=0.08, evaluations=260) for x in starts[:STARTS]), key=loss)
    made = solid(best)
    return Fit(family="box", solid=subdivided(made), overlap=seen.overlap(made.vertices, made.faces))


def fit_revolution(seen: Outlined, floor: float, *, hollow: bool) -> Fit | None:
    """The symmetric hull of the mask about a vertical axis on the height ``floor`` [m]: at each height the largest
    circle whose image lies in the mask. The axis is where that covers most. ``hollow`` gives it an inside."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    centre, size = anchor
    away = _horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])

    def axis(x: Array) -> Array:
        return centre + size * (x[0] * side + x[1] * away)

    def loss(x: Array) -> float:
        profile = _profile(seen, axis(x), size)
        if profile is None:
            return 1.0
        made = revolved(axis(x), profile, sectors=20)
        return 1 - seen.overlap(made.vertices, made.faces)

    first = min((np.array([0, y]) for y in (0.0, 0.15, 0.3, 0.45, 0.6)), key=loss)
    x = _refined(loss, first, step=0.08, evaluations=50)
    profile = _profile(seen, axis(x), size)
    if profile is None:
        return None
    solid = revolved(axis(x), _hollowed(profile) if hollow else profile)
    return Fit(
        family="bowl or cup" if hollow else "solid of revolution",
        solid=solid,
        overlap=seen.overlap(solid.vertices, solid.faces),
    )


def fit_standing(seen: Outlined, floor: float) -> Fit | None:
    """The silhouette inflated about the vertical sheet that faces the camera."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    centre, size = anchor
    normal = -_horizontal(seen, centre)
    return _inflated(seen, "standing silhouette", normal, centre, floor)


def fit_lying(seen: Outlined, floor: float) -> Fit | None:
    """The silhouette inflated about the sheet through its long axis, which lies on the support."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    rows, columns = np.nonzero(seen.mask)
    pixels = np.column_stack([columns, rows]) + 0.5
    middle = pixels.mean(0)
    long = np.linalg.svd(np.cov((pixels - middle).T))[2][0]
    reach = 0.25 * math.sqrt(len(pixels))
    ends = seen.on_plane(np.array([middle - reach * long, middle + reach * long]), np.array([0, 0, 1.0]), floor)
    if not np.isfinite(ends).all():
        return None
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    towards = seen.camera.center - ends.mean(0)
    normal = towards - (towards @ axis) * axis
    return _inflated(seen, "lying silhouette", normal / np.linalg.norm(normal), ends.mean(0), floor)


def _anchor(seen: Outlined, floor: float) -> tuple[Array, float] | None:
    """Where the mask's foot is on the height ``floor``, and the object's size there [m]; None where that is beyond the
    horizon."""
    point = seen.on_plane(seen.foot[None], np.array([0, 0, 1.0]), floor)[0]
    if not np.isfinite(point).all():
        return None
    left, top, right, bottom = seen.bounds
    return point, seen.metres_per_pixel(point) * max(right - left, bottom - top)


def _horizontal(seen: Outlined, point: Array) -> Array:
    """The horizontal unit vector (3,) from the camera towards a point."""
    away = (point - seen.camera.center) * [1, 1, 0]
    return away / max(float(np.linalg.norm(away)), 1e-12)


def _refined(loss: Callable[[Array], float], x: Array, *, step: float, evaluations: int) -> Array:
    simplex = np.vstack([x, x + step * np.eye(len(x))])
    found = minimize(loss, x, method="Nelder-Mead", options={"maxfev": evaluations, "initial_simplex": simplex})
    return np.asarray(found.x)


def _profile(seen: Outlined, foot: Array, size: float) -> Array | None:
    """Radii and heights (n, 2) of the largest circles about the vertical through ``foot`` whose images lie in the mask,
    from the axis below to the axis above. None where there are none."""
    pixels, _ = seen.camera.project(np.array([foot, foot + [0, 0, size]]))
    rise = pixels[0, 1] - pixels[1, 1]
    if not np.isfinite(rise) or rise <= 0:
        return None
    tallest = 1.3 * size * max(1.0, (pixels[0, 1] - seen.bounds[1]) / rise)
    heights = np.linspace(0, min(tallest, 4 * size), LEVELS)
    radii = size * np.linspace(0, 0.75, RADII + 1)[1:]
    angles = 2 * np.pi * np.arange(24) / 24
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(24)])
    points = foot + radii[None, :, None, None] * ring + heights[:, None, None, None] * np.array([0, 0, 1.0])
    uv, depth = seen.camera.project(points.reshape(-1, 3))
    inside = np.where(depth > 0, _read(seen.depth_inside, uv), -1e3).reshape(LEVELS, RADII, 24).min(2)
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
    return np.concatenate(
        [[[0, levels[0]]], np.column_stack([shown, levels]), [[0, levels[-1]]]]
    )


def _hollowed(profile: Array) -> Array:
    """A profile with an inside: from its widest height, walls of one thickness, and a floor of that."""
    rim = int(np.argmax(profile[:, 0]))
    outer = profile[: rim + 1]
    wall = WALL * float(outer[-1, 0])
    inner = outer[1:][outer[1:, 1] > wall][::-1] - [wall, 0]
    inner = inner[inner[:, 0] > wall]
    if len(inner) < 2:
        return profile
    return np.concatenate([outer, inner, [[inner[-1, 0], wall], [0, wall]]])


def _inflated(seen: Outlined, family: str, normal: Array, through: Array, floor: float) -> Fit | None:
    """The mask on the sheet of ``normal`` (3,), inflated by half its local width to both sides, and set on ``floor``."""
    left, top, right, bottom = seen.bounds
    step = max(right - left, bottom - top) / GRID
    columns, rows = (np.arange(a - 2 * step, b + 2 * step, step) for a, b in ((left, right), (top, bottom)))
    x, y = np.meshgrid(columns, rows)
    grid = np.stack([x, y], -1)
    shown = ndimage.binary_fill_holes(seen.mask)
    signed = np.where(
        shown, ndimage.distance_transform_edt(shown) - 0.5, 0.5 - ndimage.distance_transform_edt(~shown)
    )
    depth = _read(signed, grid.reshape(-1, 2)).reshape(x.shape)
    inside = depth > -0.5 * step
    labels, count = ndimage.label(inside)
    if not count:
        return None
    inside = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    slope = np.stack(np.gradient(ndimage.gaussian_filter(depth, 1.0), step)[::-1], -1)
    steep = np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 0.3)
    rim = inside & (depth < 0.9 * step)
    grid = np.where(rim[..., None], grid - np.clip(depth, -step, step)[..., None] * slope / steep**2, grid)
    sheet = seen.on_plane(grid.reshape(-1, 2), normal, float(normal @ through)).reshape(*grid.shape[:2], 3)
    if not np.isfinite(sheet[inside]).all():
        return None
    widest = _local_maximum(np.where(inside, np.maximum(depth, 0), 0), step)
    half = np.sqrt(np.maximum(0, depth * (2 * widest - depth))) * inside
    half = np.maximum(half, 0.1 * step) * seen.metres_per_pixel(through)
    offset = half[..., None] * normal
    solid = inflated(sheet + offset, sheet - offset, inside)
    if len(solid.faces) < 8:
        return None
    # The silhouette stays: a homothety about the camera sets the lowest point on the floor.
    centre = seen.camera.center
    lowest = float(solid.vertices[:, 2].min())
    k = (floor - centre[2]) / (lowest - centre[2]) if lowest < centre[2] else 1.0
    vertices = centre + k * (solid.vertices - centre)
    return Fit(
        family=family,
        solid=Solid(vertices=vertices, faces=solid.faces),
        overlap=seen.overlap(vertices, solid.faces),
    )


def _local_maximum(depth: Array, step: float) -> Array:
    """The radius of the largest disk in the mask that covers each cell (h, w), for distances ``depth`` to the outline."""
    radius = np.zeros_like(depth)
    rows, columns = np.indices(depth.shape)
    ridge = depth >= ndimage.maximum_filter(depth, 3) - 1e-9
    for r, c in zip(*np.nonzero(ridge & (depth > 0)), strict=True):
        near = (rows - r) ** 2 + (columns - c) ** 2 <= (depth[r, c] / step) ** 2
        np.maximum(radius, np.where(near, depth[r, c], 0), out=radius)
    return np.maximum(ndimage.gaussian_filter(radius, 1.0), depth)


def _read(image: Array, pixels: Array) -> Array:
    """Values at pixels (n, 2), bilinear, of the nearest border beyond."""
    return np.asarray(
        ndimage.map_coordinates(image, [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5], order=1, mode="nearest")
    )
