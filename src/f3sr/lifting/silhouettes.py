"""Masks inflated about a sheet: what stands facing the camera, what lies along its long axis, what hangs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import Solid, clipped, inflated, is_stable
from f3sr.vision.regions import depth_inside, grown, interpolated, parts_of, smoothed, without_small_holes

GRID = 72
"""Cells of the longer side of an inflated silhouette."""
SMOOTHINGS = 6
"""Passes of Taubin's filter, inwards and outwards in turn: more eat thin handles."""
ROWS_ALIKE = (1.5, 0.5)
"""Widths of the Gaussian over the rows and columns of cells whose widths tell the thickness: outlines are rough."""
HOLE = 0.02
"""Share of a mask below which a hole in it is a flaw of the mask: the ring of a handle is larger."""
PART = 0.02
"""Share of a mask from which on a part apart is the same body's: things before the object cut it in two."""
REACHES = 0.02
"""Largest gap below what stands, as a share of its height: what ends higher would fall."""
FLAT = (0.08, 0.16, 0.24, 0.32, 0.4)
"""Shares of a lying body's height that are cut off below until it rests: real things lie on more than a line."""


def fit_standing(seen: Outlined, floor: float) -> FittedShape | None:
    """The silhouette inflated about the vertical sheet that faces the camera, every row by half its width, cut at the
    floor. The sheet stands behind the mask's foot by half the foot's width. None if nothing of it reaches the floor."""
    anchor = anchored(seen, floor)
    if anchor is None:
        return None
    centre, _ = anchor
    away = horizontal(seen, centre)
    radius = 0.5 * seen.foot_width * seen.metres_per_pixel(centre)
    through = centre + radius * away
    solid = inflated_mask(seen, -away, through, by_rows=True)
    solid = solid and clipped(solid, floor)
    if solid is None or _gap(solid, floor) > REACHES:
        return None
    return FittedShape.of("standing silhouette", solid, seen)


def _gap(solid: Solid, floor: float) -> float:
    """How far it ends above the ``floor`` [its height]."""
    heights = solid.vertices[:, 2]
    return float((heights.min() - floor) / max(np.ptp(heights), 1e-12))


def fit_lying(seen: Outlined, floor: float) -> FittedShape | None:
    """The silhouette inflated about the sheet through its long axis, which lies on the support."""
    anchor = anchored(seen, floor)
    if anchor is None:
        return None
    axis = _long_axis(seen, floor)
    if axis is None:
        return None
    ends, normal = axis
    solid = inflated_mask(seen, normal, ends.mean(0))
    solid = solid and _set_down(seen, solid, floor)
    return solid and FittedShape.of("lying silhouette", solid, seen)


def fit_hanging(seen: Outlined, distance: float) -> FittedShape:
    """The silhouette inflated about the vertical sheet that faces the camera, ``distance`` [m] away.

    Raises ValueError for a mask in which no shape of any size is left."""
    left, top, right, bottom = seen.bounds
    ray = seen.rays(np.array([[(left + right) / 2, (top + bottom) / 2]]))[0]
    through = seen.camera.center + ray * distance
    solid = inflated_mask(seen, -horizontal(seen, through), through)
    if solid is None:
        raise ValueError("a mask too thin for a shape")
    return FittedShape.of("hanging silhouette", solid, seen)


def _long_axis(seen: Outlined, height: float) -> tuple[Array, Array] | None:
    """Two points (2, 3) of the mask's long axis laid down at a height [m], and the unit normal of the sheet through it
    that faces the camera most. None beyond the horizon."""
    rows, columns = np.nonzero(seen.mask)
    pixels = np.column_stack([columns, rows]) + 0.5
    middle = pixels.mean(0)
    long = np.linalg.svd(np.cov((pixels - middle).T))[2][0]
    reach = 0.25 * math.sqrt(len(pixels))
    ends = seen.on_plane(np.array([middle - reach * long, middle + reach * long]), UP, height)
    if not np.isfinite(ends).all():
        return None
    axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    towards = seen.camera.center - ends.mean(0)
    normal = towards - (towards @ axis) * axis
    return ends, normal / np.linalg.norm(normal)


def lying_at(seen: Outlined, point: Array) -> Solid | None:
    """The mask inflated about the sheet through its long axis, which is level with ``point`` (3,)."""
    axis = _long_axis(seen, float(point[2]))
    if axis is None:
        return None
    ends, normal = axis
    return inflated_mask(seen, normal, ends.mean(0))


def inflated_mask(seen: Outlined, normal: Array, through: Array, *, by_rows: bool = False) -> Solid | None:
    """The mask, all its parts, on the sheet of ``normal`` (3,), inflated by half its local width to both sides."""
    left, top, right, bottom = seen.bounds
    shape = without_small_holes(seen.mask, HOLE)
    signed = depth_inside(shape)
    step = float(np.clip(signed[shape].mean(), 1.0, max(right - left, bottom - top) / GRID))
    columns, rows = (np.arange(a - 2 * step, b + 2 * step, step) for a, b in ((left, right), (top, bottom)))
    x, y = np.meshgrid(columns, rows)
    grid = np.stack([x, y], -1)
    depth = interpolated(signed, grid.reshape(-1, 2)).reshape(x.shape)
    inside = depth > -0.5 * step
    labels = parts_of(inside)
    if not labels.any():
        return None
    inside &= (np.bincount(labels.ravel()) >= PART * inside.sum())[labels]
    down, right = (np.asarray(g) for g in np.gradient(smoothed(signed, 1.0)))
    slope = np.stack([interpolated(g, grid.reshape(-1, 2)).reshape(x.shape) for g in (right, down)], -1)
    steep = np.maximum(np.linalg.norm(slope, axis=2, keepdims=True), 0.3)
    to_rim = np.where(inside & grown(~inside, 1), np.clip(depth, -step, step), 0)
    grid = grid - to_rim[..., None] * slope / steep**2
    sheet = seen.on_plane(grid.reshape(-1, 2), normal, float(normal @ through)).reshape(*grid.shape[:2], 3)
    if not np.isfinite(sheet[inside]).all():
        return None
    if by_rows:
        rows_alike = smoothed(depth / step, ROWS_ALIKE)
        half = _half_widths(inside, rows_alike, (grid[..., 0] - columns[0]) / step) * step
    else:
        half = _half_thickness(np.where(inside, np.maximum(depth, 0), 0), step, depth - to_rim)
    half = np.maximum(half, 0.1 * step) * seen.metres_per_pixel(through)
    offset = half[..., None] * normal
    solid = inflated(sheet + offset, sheet - offset, inside)
    return _without_ripples(solid) if len(solid.faces) >= 8 else None


def _without_ripples(solid: Solid) -> Solid:
    """Smoothed without shrinking (Taubin 1995): cells of the grid show as steps where front and back meet."""
    import trimesh

    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    smooth = trimesh.smoothing.filter_taubin(mesh, iterations=SMOOTHINGS)
    return replace(solid, vertices=np.asarray(smooth.vertices, float))


def _set_down(seen: Outlined, solid: Solid, floor: float) -> Solid | None:
    """A solid with a flat underside on ``floor``, large enough to rest on: a homothety about the camera, which keeps
    its silhouette."""
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


def _half_widths(inside: NDArray[np.bool_], depth: Array, x: Array) -> Array:
    """Half the thickness (h, w) of a body whose every row of a grid is round, at places ``x`` (h, w) along it.

    A row ends where ``depth``, the distance to the outline, is none: between the cells. All in cells."""
    half = np.zeros(inside.shape)
    for row, far, place, out in zip(inside, depth, x, half, strict=True):
        ends = np.flatnonzero(np.diff(np.pad(row, 1).astype(np.int8)))
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            left, right = a - _beyond(far[a], far[a - 1]), b - 1 + _beyond(far[b - 1], far[b])
            out[a:b] = np.sqrt(np.maximum((place[a:b] - left) * (right - place[a:b]), 0))
    return half


def _beyond(last: float, next: float) -> float:
    """How far beyond the last cell of a row its outline lies [cells], from the depths there and in the next one."""
    return float(np.clip(last / max(last - next, 0.3), -1, 1))


def _half_thickness(depth: Array, step: float, left: Array) -> Array:
    """Half the thickness (h, w) of a body with round cross-sections, for distances ``depth`` to its outline.

    ``left`` (h, w) are those that are left after what is near the outline was moved onto it."""
    widest = _local_maximum(depth, step)
    left = np.maximum(left, 0)
    return np.sqrt(np.maximum(0, left * (2 * widest - left)))


def _local_maximum(depth: Array, step: float) -> Array:
    """The radius of the largest disk in the mask over each cell (h, w), for distances ``depth`` to the outline."""
    radius = np.zeros_like(depth)
    rows, columns = np.indices(depth.shape)
    ridge = depth >= ndimage.maximum_filter(depth, 3) - 1e-9
    for r, c in zip(*np.nonzero(ridge & (depth > 0)), strict=True):
        near = (rows - r) ** 2 + (columns - c) ** 2 <= (depth[r, c] / step) ** 2
        np.maximum(radius, np.where(near, depth[r, c], 0), out=radius)
    return np.maximum(smoothed(radius, 1.0), depth)
