"""The shape of each family that fits a mask best, standing or lying on its support."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import minimize

from f3sr.core.transforms import UP, Array
from f3sr.lifting.many_starts import refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import (
    BOX_FACES,
    CORNERS,
    Solid,
    carved,
    clipped,
    inflated,
    is_stable,
    joined,
    revolved,
    subdivided,
)
from f3sr.vision.regions import depth_inside, grown, interpolated, parts_of, smoothed, without_holes

YAWS = 9
"""Turns of a box at which its fit starts, over a quarter turn."""
DEPTHS = (0.4, 1.0, 2.2)
"""Its depths there, over its width."""
EQUAL = 0.3
"""Inverse standard deviation of the logarithms of a box's edges: of boxes that look alike, the most compact."""
BEHIND_CAMERA = 1e3
"""Residual of a shape that reaches behind the camera."""
STARTS = 4
"""Starts that are refined, the best first."""
LEVELS = 48
"""Heights of a solid of revolution."""
RADII = 28
"""Radii tried at each height, up to the largest; then refined between two."""
GRID = 72
"""Cells of the longer side of an inflated silhouette."""
FLAT = (0.08, 0.16, 0.24, 0.32, 0.4)
"""Shares of a lying body's height that are cut off below until it rests: real things lie on more than a line."""
HANDLE = 0.03
"""Least share of the mask that a solid of revolution leaves uncovered for it to have a handle."""
ROOT = 6
"""Length of a handle's root within the body [px of the window]."""
SLACK = 0.3
"""Step of how far circles may lie outside of the mask, in steps of the search for the axis."""
RINGS = 8
"""Rings of a bowl's outside."""
BOWL, BOWL_SPREAD = (0.2, 0.4), (0.6, 0.8, 0.4)
"""Shape of a bowl before its picture tells: the logit of its base's radius over the rim's and the logarithm of the power
by which it widens; and standard deviations, that of the logarithm of height over radius first."""
WALL = 0.06
"""Thickness of a hollow thing's wall, as a share of its largest radius."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """A shape of one family, and its overlap with the mask where that is valid (IoU)."""

    family: str
    solid: Solid
    overlap: float


def fit_box(seen: Outlined, floor: float) -> Fit | None:
    """A box on the height ``floor`` [m]: its outline touches the lines that the mask's touches, in all directions."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    centre, size = anchor
    away = _horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])
    directions, wanted, scatter = seen.support

    def corners(x: Array) -> Array:
        """(s, 8, 3) of boxes x (s, 6): shifts, logarithms of the edges, both in sizes, and yaw."""
        c, n = np.cos(x[:, 5, None]), np.sin(x[:, 5, None])
        u, v, w = np.moveaxis(CORNERS * np.exp(x[:, None, 2:5]), 2, 0)
        local = np.stack([c * u - n * v, n * u + c * v, w], 2)
        return centre + size * (local + (x[:, :1] * side + x[:, 1:2] * away)[:, None])

    def residuals(x: Array) -> Array:
        points = corners(x)
        pixels, depth = seen.camera.project(points.reshape(-1, 3))
        reached = (pixels.reshape(*points.shape[:2], 2) @ directions.T).max(1)
        unequal = x[:, 2:5] - x[:, 2:5].mean(1, keepdims=True)
        all_of_them = np.concatenate([(reached - wanted) / scatter, EQUAL * unequal], axis=1)
        before = depth.reshape(points.shape[:2]).min(1) > 0.05 * size
        return np.where(before[:, None], all_of_them, BEHIND_CAMERA)

    yaws = np.pi / 2 * np.arange(YAWS) / YAWS
    x = np.array([[0, 0.3, math.log(0.7), math.log(0.7 * d), math.log(0.5), yaw] for yaw in yaws for d in DEPTHS])
    x = _onto_bounds(seen, x, corners, size)
    for kept, iterations in ((STARTS, 8), (STARTS, 40)):
        x, costs = refined(residuals, x, iterations=iterations)
        x = x[np.argsort(costs, kind="stable")[:kept]]
    fitted = [Solid(vertices=points, faces=BOX_FACES) for points in corners(x)]
    overlaps = [seen.overlap(made.vertices, made.faces) for made in fitted]
    best = int(np.argmax(overlaps))
    return Fit(family="box", solid=subdivided(fitted[best]), overlap=overlaps[best])


def _onto_bounds(seen: Outlined, x: Array, corners: Callable[[Array], Array], size: float) -> Array:
    """Boxes x (s, 6) of given proportions and yaw, moved and scaled so that their pictures have the bounds of the mask."""
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
        x = np.where((depth > 0).all((1, 2))[:, None], moved, x)
    return x


def fit_revolution(seen: Outlined, floor: float) -> Fit | None:
    """The symmetric hull of the mask about a vertical axis on the height ``floor`` [m]: at each height the largest
    circle whose image lies in the mask. The axis is where that covers most."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    _, size = anchor
    centre = seen.on_plane(seen.widest[None], UP, floor)[0]
    if not np.isfinite(centre).all():
        return None
    away = _horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])

    def axis(x: Array) -> Array:
        return centre + size * (x[0] * side + x[1] * away)

    def loss(x: Array) -> float:
        profile = _profile(seen, axis(x), size, beyond=SLACK * x[2])
        if profile is None:
            return 1.0
        made = revolved(axis(x), profile, sectors=20)
        return 1 - seen.overlap(made.vertices, made.faces)

    first = min((np.array([0.0, y, 0.0]) for y in np.linspace(-0.9, 0.3, 13)), key=loss)
    x = _refined(loss, first, step=0.08, evaluations=60)
    profile = _profile(seen, axis(x), size, beyond=SLACK * x[2])
    if profile is None:
        return None
    solid = revolved(axis(x), profile)
    return Fit(family="solid of revolution", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def fit_hollow(seen: Outlined, floor: float, *, aspect: float) -> Fit | None:
    """A bowl, plate, pan or cup on the height ``floor`` [m], with handles: its outline touches the lines that the mask's
    touches, in all directions. ``aspect`` is the usual ratio of its height to the radius of its rim."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    handles = seen.handles
    body = replace(seen, mask=seen.mask & ~handles, valid=seen.valid & ~grown(handles, 1))
    _, size = anchor
    centre = seen.on_plane(body.widest[None], UP, floor)[0]
    if not np.isfinite(centre).all():
        return None
    away = _horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])
    directions, wanted, scatter = body.support
    middle, spread = np.array([math.log(aspect), *BOWL]), np.array(BOWL_SPREAD)

    def foot(x: Array) -> Array:
        return centre + size * (x[0] * side + x[1] * away)

    def profile(x: Array) -> Array:
        rim = size * math.exp(x[2])
        return _bowl(rim, rim * math.exp(x[3]), float(1 / (1 + math.exp(-x[4]))), math.exp(x[5]))

    def residual(x: Array) -> Array:
        made = revolved(foot(x), profile(x), sectors=24)
        pixels, depth = seen.camera.project(made.vertices)
        if not (depth > 0.05 * size).all():
            return np.full(len(wanted) + 3, BEHIND_CAMERA)
        return np.concatenate([((pixels @ directions.T).max(0) - wanted) / scatter, (x[3:] - middle) / spread])

    start = np.array([[0.0, -0.3, math.log(0.5), *middle]])
    x = refined(lambda x: np.array([residual(one) for one in x]), start, iterations=40)[0][0]
    outer = profile(x)
    solid = revolved(foot(x), _hollowed(outer))
    solid = _with_handles(seen, handles, solid, foot(x), outer)
    return Fit(family="bowl or cup", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def _bowl(rim: float, height: float, base: float, power: float) -> Array:
    """Radii and heights (n, 2) of a bowl's outside, from the axis below to the axis above [m]: from a flat ``base``
    [radius of the ``rim``] it widens as a power of the height."""
    t = np.linspace(0, 1, RINGS)
    radii = rim * (base + (1 - base) * t ** (1 / power))
    return np.concatenate([[[0, 0]], np.column_stack([radii, height * t]), [[0, height]]])


def fit_carved(seen: Outlined, floor: float) -> Fit | None:
    """The box of the mask's convex hull, cut by the cone of the mask: a chair, a table, a bench."""
    hull = fit_box(replace(seen, mask=seen.convex), floor)
    if hull is None:
        return None
    cell = float(np.ptp(hull.solid.vertices, axis=0).max()) / 12
    solid = carved(hull.solid, seen.possible, seen.camera, cell=cell)
    return solid and Fit(family="carved box", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def fit_standing(seen: Outlined, floor: float) -> Fit | None:
    """The silhouette inflated about the vertical sheet that faces the camera, every row by half its width, cut at the
    floor. The sheet stands behind the mask's foot by half the foot's width."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    centre, _ = anchor
    away = _horizontal(seen, centre)
    radius = 0.5 * seen.foot_width * seen.metres_per_pixel(centre)
    through = centre + radius * away
    solid = _inflated(seen, -away, through, by_rows=True)
    solid = solid and clipped(solid, floor)
    return solid and Fit(family="standing silhouette", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def fit_lying(seen: Outlined, floor: float) -> Fit | None:
    """The silhouette inflated about the sheet through its long axis, which lies on the support."""
    anchor = _anchor(seen, floor)
    if anchor is None:
        return None
    axis = _long_axis(seen, floor)
    if axis is None:
        return None
    ends, normal = axis
    solid = _inflated(seen, normal, ends.mean(0))
    solid = solid and _set_down(seen, solid, floor)
    return solid and Fit(family="lying silhouette", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def fit_hanging(seen: Outlined, distance: float) -> Fit:
    """The silhouette inflated about the vertical sheet that faces the camera, ``distance`` [m] away.

    Raises ValueError for a mask in which no shape of any size is left."""
    left, top, right, bottom = seen.bounds
    ray = seen.rays(np.array([[(left + right) / 2, (top + bottom) / 2]]))[0]
    through = seen.camera.center + ray * distance
    solid = _inflated(seen, -_horizontal(seen, through), through)
    if solid is None:
        raise ValueError("a mask too thin for a shape")
    return Fit(family="hanging silhouette", solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def _anchor(seen: Outlined, floor: float) -> tuple[Array, float] | None:
    """Where the mask's foot is on the height ``floor``, and the object's size there [m]; None where that is beyond the
    horizon."""
    point = seen.on_plane(seen.foot[None], np.array([0, 0, 1.0]), floor)[0]
    if not np.isfinite(point).all():
        return None
    left, top, right, bottom = seen.bounds
    return point, seen.metres_per_pixel(point) * max(right - left, bottom - top)


def _long_axis(seen: Outlined, height: float) -> tuple[Array, Array] | None:
    """Two points (2, 3) of the mask's long axis laid down at a height [m], and the unit normal of the sheet through it
    that faces the camera most. None beyond the horizon."""
    rows, columns = np.nonzero(seen.mask)
    pixels = np.column_stack([columns, rows]) + 0.5
    middle = pixels.mean(0)
    long = np.linalg.svd(np.cov((pixels - middle).T))[2][0]
    reach = 0.25 * math.sqrt(len(pixels))
    ends = seen.on_plane(np.array([middle - reach * long, middle + reach * long]), np.array([0, 0, 1.0]), height)
    if not np.isfinite(ends).all():
        return None
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    towards = seen.camera.center - ends.mean(0)
    normal = towards - (towards @ axis) * axis
    return ends, normal / np.linalg.norm(normal)


def _horizontal(seen: Outlined, point: Array) -> Array:
    """The horizontal unit vector (3,) from the camera towards a point."""
    away = (point - seen.camera.center) * [1, 1, 0]
    return away / max(float(np.linalg.norm(away)), 1e-12)


def _refined(loss: Callable[[Array], float], x: Array, *, step: float, evaluations: int) -> Array:
    simplex = np.vstack([x, x + step * np.eye(len(x))])
    found = minimize(loss, x, method="Nelder-Mead", options={"maxfev": evaluations, "initial_simplex": simplex})
    return np.asarray(found.x)


def _profile(seen: Outlined, foot: Array, size: float, *, beyond: float) -> Array | None:
    """Radii and heights (n, 2) of the largest circles about the vertical through ``foot`` whose images lie in the mask,
    or at most ``beyond`` [size of the mask] outside, from the axis below to the axis above. None where there are none.

    Where the camera's pitch is a little off, no circle has the mask's rim as its image: it is too narrow or too wide."""
    pixels, _ = seen.camera.project(np.array([foot, foot + size * UP]))
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


def _with_handles(seen: Outlined, handles: NDArray[np.bool_], body: Solid, foot: Array, profile: Array) -> Solid:
    """A solid of revolution with the ``handles`` (h, w) beside it: at the height of the rim where it is flat, else about
    the vertical sheet through its axis."""
    labels = parts_of(handles)
    flat = profile[:, 1].max() < profile[:, 0].max()
    for k in range(1, int(labels.max()) + 1):
        part = labels == k
        if part.sum() < HANDLE * seen.mask.sum():
            continue
        handle = replace(seen, mask=grown(part, ROOT) & seen.mask)
        if flat:
            rim = foot + float(profile[np.argmax(profile[:, 0]), 1]) * UP
            made = _lying_at(handle, rim)
        else:
            made = _inflated(handle, -_horizontal(seen, foot), foot)
        both = made and joined(body, made)
        whole = both and clipped(both, float(foot[2]))
        body = whole or body
    return body


def _lying_at(seen: Outlined, point: Array) -> Solid | None:
    """The mask inflated about the sheet through its long axis, which is level with ``point`` (3,)."""
    axis = _long_axis(seen, float(point[2]))
    if axis is None:
        return None
    ends, normal = axis
    return _inflated(seen, normal, ends.mean(0))


def _inflated(seen: Outlined, normal: Array, through: Array, *, by_rows: bool = False) -> Solid | None:
    """The mask on the sheet of ``normal`` (3,), inflated by half its local width to both sides."""
    left, top, right, bottom = seen.bounds
    step = max(right - left, bottom - top) / GRID
    columns, rows = (np.arange(a - 2 * step, b + 2 * step, step) for a, b in ((left, right), (top, bottom)))
    x, y = np.meshgrid(columns, rows)
    grid = np.stack([x, y], -1)
    signed = depth_inside(without_holes(seen.mask))
    depth = interpolated(signed, grid.reshape(-1, 2)).reshape(x.shape)
    inside = depth > -0.5 * step
    labels = parts_of(inside)
    if not labels.any():
        return None
    inside = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    down, right = (np.asarray(g) for g in np.gradient(smoothed(depth, 1.0), step))
    slope = np.stack([right, down], -1)
    steep = np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 0.3)
    rim = inside & (depth < 0.9 * step)
    grid = np.where(rim[..., None], grid - np.clip(depth, -step, step)[..., None] * slope / steep**2, grid)
    sheet = seen.on_plane(grid.reshape(-1, 2), normal, float(normal @ through)).reshape(*grid.shape[:2], 3)
    if not np.isfinite(sheet[inside]).all():
        return None
    half = _half_widths(inside) * step if by_rows else _half_thickness(np.where(inside, np.maximum(depth, 0), 0), step)
    half = np.maximum(half, 0.1 * step) * seen.metres_per_pixel(through)
    offset = half[..., None] * normal
    solid = inflated(sheet + offset, sheet - offset, inside)
    return solid if len(solid.faces) >= 8 else None


def _set_down(seen: Outlined, solid: Solid, floor: float) -> Solid | None:
    """A solid with a flat underside on ``floor``, large enough to rest on: a homothety about the camera, which keeps its
    silhouette."""
    low, high = float(solid.vertices[:, 2].min()), float(solid.vertices[:, 2].max())
    height = seen.camera.center[2]
    flat, cut = None, low
    for share in FLAT:
        cut = low + share * (high - low)
        flat = clipped(solid, cut)
        if flat is None or cut >= height:
            return None
        if is_stable(flat):
            break
    assert flat is not None
    k = (floor - height) / (cut - height)
    return Solid(vertices=seen.camera.center + k * (flat.vertices - seen.camera.center), faces=flat.faces)


def _half_widths(inside: NDArray[np.bool_]) -> Array:
    """Half the thickness (h, w) of a body whose every row of a grid is round, in cells."""
    half = np.zeros(inside.shape)
    for row, out in zip(inside, half, strict=True):
        ends = np.flatnonzero(np.diff(np.pad(row, 1).astype(np.int8)))
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            x = np.arange(a, b)
            out[a:b] = np.sqrt((x - a + 0.5) * (b - 0.5 - x))
    return np.where(inside, smoothed(half, (1.5, 0.5)), 0)


def _half_thickness(depth: Array, step: float) -> Array:
    """Half the thickness (h, w) of a body with round cross-sections, for distances ``depth`` to its outline."""
    widest = _local_maximum(depth, step)
    return np.sqrt(np.maximum(0, depth * (2 * widest - depth)))


def _local_maximum(depth: Array, step: float) -> Array:
    """The radius of the largest disk in the mask over each cell (h, w), for distances ``depth`` to the outline."""
    radius = np.zeros_like(depth)
    rows, columns = np.indices(depth.shape)
    ridge = depth >= ndimage.maximum_filter(depth, 3) - 1e-9
    for r, c in zip(*np.nonzero(ridge & (depth > 0)), strict=True):
        near = (rows - r) ** 2 + (columns - c) ** 2 <= (depth[r, c] / step) ** 2
        np.maximum(radius, np.where(near, depth[r, c], 0), out=radius)
    return np.maximum(smoothed(radius, 1.0), depth)
