"""Ellipses in the outlines of objects: horizontal rims of plates, pans, cups and cans tell where gravity points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.metrology.edges import EdgePoints
from f3sr.runtime.kernels import kernel
from f3sr.vision.regions import grown

SEED = 0
"""Of the random choice of arcs."""
ARCS = 300
"""Arcs of an outline to which an ellipse is fitted."""
ARC_POINTS = 12
"""Points of an arc that are used."""
ARC = (0.15, 0.7)
"""Least and largest arc, as a share of the outline."""
SECTORS = 72
"""Sectors of an ellipse, of 5 degrees each, that edges may cover."""
COVERED = 0.75
"""Least share of sectors with an edge on the ellipse. A side of a box covers .6, a rim .8 to 1."""
NEAR = 1.2
"""Largest distance of an edge point from the ellipse [px], or ``NEAR_SHARE`` of the mask's size."""
NEAR_SHARE = 0.006
ALONG = math.cos(math.radians(15))
"""Least cosine between an edge's gradient and the ellipse's normal."""
SMALLEST = 4.0
"""Least semi-minor axis [px]: of a smaller one the ratio of the axes is noise."""
EXTENT = (0.25, 3.0)
"""Least and largest semi-major axis, in sizes of the mask (the square root of its area)."""
ROUND = 0.93
"""Ratio of the axes from which on an ellipse may be a ball's outline, which tells nothing of gravity."""
FLAT = 1e-9
"""Least determinant of the points' moments, of unit size: points on a line have no ellipse."""
BORDER = 3
"""Distance to other masks and to the photo's border within which an outline is not the object's own [px]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Ellipse:
    """``conic`` Q (3, 3) with p' Q p = 0 for points p = (x, y, 1) [px]; semi-axes ``minor``, ``major`` [px]."""

    conic: Array
    centre: Array
    axes: Array
    """(2, 2): unit vectors along the minor and the major axis, as columns."""
    minor: float
    major: float
    coverage: float = 0.0
    """Share of its sectors where the photo has an edge."""


def rims(masks: Sequence[NDArray[np.bool_]], edges: EdgePoints) -> list[Ellipse]:
    """For every mask the ellipse that edges cover most. They cover ``COVERED`` of it, and it is not nearly round."""
    rng = np.random.default_rng(SEED)
    occupied = np.sum(masks, axis=0, dtype=np.int64) if len(masks) else np.zeros(edges.shape, np.int64)
    found = [_rim(mask, (occupied - mask) > 0, edges, rng) for mask in masks]
    return [e for e in found if e and e.coverage >= COVERED and e.minor < ROUND * e.major]


def fit_ellipse(points: Array) -> Ellipse | None:
    """The least squares ellipse of points (n, 2) (Halir and Flusser 1998); None where they have none."""
    return fit_ellipses(points[None])[0]


def fit_ellipses(points: Array) -> list[Ellipse | None]:
    """The least squares ellipse of each of many sets of points (t, n, 2)."""
    centre = points.mean(1, keepdims=True)
    size = np.abs(points - centre).mean((1, 2)) + 1e-9
    x, y = np.moveaxis((points - centre) / size[:, None, None], 2, 0)
    quadratic, linear = np.stack([x * x, x * y, y * y], -1), np.stack([x, y, np.ones_like(x)], -1)
    across = linear.swapaxes(1, 2)
    square = across @ linear
    flat = np.abs(np.linalg.det(square)) < FLAT * points.shape[1] ** 3
    square[flat] = np.eye(3)
    T = -np.linalg.solve(square, across @ quadratic)
    M = quadratic.swapaxes(1, 2) @ (quadratic + linear @ T)
    vectors = np.real(np.linalg.eig(np.stack([M[:, 2] / 2, -M[:, 1], M[:, 0] / 2], 1))[1])
    elliptic = 4 * vectors[:, 0] * vectors[:, 2] - vectors[:, 1] ** 2 > 0
    which = np.argmax(elliptic, axis=1)
    one = np.take_along_axis(vectors, which[:, None, None], axis=2)[..., 0]
    a, b, c = one.T
    d, e, f = (T @ one[..., None])[..., 0].T
    Q = np.stack([a, b / 2, d / 2, b / 2, c, e / 2, d / 2, e / 2, f], -1).reshape(-1, 3, 3)
    N = np.zeros_like(Q)
    N[:, 0, 0] = N[:, 1, 1] = 1 / size
    N[:, :2, 2], N[:, 2, 2] = -centre[:, 0] / size[:, None], 1
    usable = elliptic.any(1) & ~flat
    return [_ellipse(q) if ok else None for q, ok in zip(N.swapaxes(1, 2) @ Q @ N, usable, strict=True)]


def _ellipse(Q: Array) -> Ellipse | None:
    A = Q[:2, :2]
    if abs(np.linalg.det(A)) < 1e-300:
        return None
    centre = -np.linalg.solve(A, Q[:2, 2])
    level = float(Q[2, 2] + Q[:2, 2] @ centre)
    if level == 0:
        return None
    curvatures, axes = np.linalg.eigh(-A / level)
    if not (curvatures > 0).all():
        return None
    major, minor = 1 / np.sqrt(curvatures)
    return Ellipse(
        conic=Q, centre=np.asarray(centre, float), axes=axes[:, ::-1], minor=float(minor), major=float(major)
    )


def _rim(
    mask: NDArray[np.bool_], others: NDArray[np.bool_], edges: EdgePoints, rng: np.random.Generator
) -> Ellipse | None:
    columns, rows = edges.pixels.T
    near = grown(mask, BORDER)[rows, columns]
    points, normals = edges.points[near], edges.normals[near]
    outline = _own_outline(mask, others)
    if len(points) < 2 * ARC_POINTS or len(outline) < 2 * ARC_POINTS:
        return None
    size = math.sqrt(float(mask.sum()))
    near_px = max(NEAR, NEAR_SHARE * size)
    starts, lengths = rng.integers(len(outline), size=ARCS), (len(outline) * rng.uniform(*ARC, size=ARCS)).astype(int)
    along = np.sort((rng.random((ARCS, ARC_POINTS)) * np.maximum(2, lengths)[:, None]).astype(int), axis=1)
    fits = [e for e in fit_ellipses(outline[(starts[:, None] + along) % len(outline)]) if e and _plausible(e, size)]
    if not fits:
        return None
    covered = _coverages(fits, points, normals, near_px)
    first = _covered(fits[int(np.argmax(covered))], points, normals, near_px, size)
    best, members = first or (None, np.zeros(0, np.int64))
    for _ in range(3):
        if best is None or len(members) < ARC_POINTS:
            break
        found = _covered(fit_ellipse(points[members]), points, normals, near_px, size)
        if found is None or found[0].coverage < best.coverage - 0.01:
            break
        best, members = found
    return best


def _own_outline(mask: NDArray[np.bool_], others: NDArray[np.bool_]) -> Array:
    """Points (n, 2) between pixels of a mask and pixels of no mask, by angle about their mean."""
    h, w = mask.shape
    padded = np.pad(mask, 1)
    rows, columns = np.nonzero(padded[:, 1:] != padded[:, :-1])
    upright = np.column_stack([columns, rows - 0.5])
    rows, columns = np.nonzero(padded[1:] != padded[:-1])
    points = np.concatenate([upright, np.column_stack([columns - 0.5, rows])]).astype(float)
    hidden = grown(others, BORDER)
    x, y = np.clip(points.astype(int), 0, [w - 1, h - 1]).T
    inside = (points > BORDER - 1).all(1) & (points < np.array([w, h]) - BORDER + 1).all(1)
    points = points[inside & ~hidden[y, x]]
    if not len(points):
        return points
    dx, dy = (points - points.mean(0)).T
    return points[np.argsort(np.arctan2(dy, dx), kind="stable")]


def _covered(
    ellipse: Ellipse | None, points: Array, normals: Array, near: float, size: float
) -> tuple[Ellipse, NDArray[np.int64]] | None:
    """The ellipse with its coverage, and the edge points on it by index; None where it is no rim of this object."""
    if ellipse is None or not _plausible(ellipse, size):
        return None
    homogeneous = np.column_stack([points, np.ones(len(points))])
    image = homogeneous @ ellipse.conic
    slope = 2 * image[:, :2]
    steep = np.linalg.norm(slope, axis=1) + 1e-12
    on = np.abs((image * homogeneous).sum(1)) < near * steep  # Sampson's distance
    on &= np.abs((slope * normals).sum(1)) > ALONG * steep
    members = np.flatnonzero(on)
    if not len(members):
        return None
    u, v = ((points[members] - ellipse.centre) @ ellipse.axes / [ellipse.minor, ellipse.major]).T
    sectors = ((np.arctan2(v, u) / (2 * np.pi) + 0.5) * SECTORS).astype(int)
    coverage = len(np.unique(np.clip(sectors, 0, SECTORS - 1))) / SECTORS
    return replace(ellipse, coverage=coverage), members


def _plausible(ellipse: Ellipse, size: float) -> bool:
    return ellipse.minor >= SMALLEST and EXTENT[0] * size < ellipse.major < EXTENT[1] * size


def _coverages(ellipses: Sequence[Ellipse], points: Array, normals: Array, near: float) -> NDArray[np.int64]:
    """The number (t,) of sectors of each ellipse with an edge point on it, as ``_covered`` counts."""
    out = np.zeros(len(ellipses), np.int64)
    axes = np.array([e.axes / [e.minor, e.major] for e in ellipses])
    centres = np.array([e.centre for e in ellipses])
    _count_sectors(np.array([e.conic for e in ellipses]), centres, axes, points, normals, near, out)
    return out


def warm_up() -> None:
    """Call every kernel once, with the types that the product uses."""
    circle = Ellipse(conic=np.diag([1.0, 1, -1]), centre=np.zeros(2), axes=np.eye(2), minor=1.0, major=1.0)
    _coverages([circle], np.ones((1, 2)), np.ones((1, 2)), 1.0)


@kernel
def _count_sectors(
    conics: Array, centres: Array, axes: Array, points: Array, normals: Array, near: float, out: NDArray[np.int64]
) -> None:
    hit = np.zeros(SECTORS, np.bool_)
    for t in range(len(conics)):
        Q, A = conics[t], axes[t]
        hit[:] = False
        for k in range(len(points)):
            x, y = points[k]
            u = Q[0, 0] * x + Q[0, 1] * y + Q[0, 2]
            v = Q[1, 0] * x + Q[1, 1] * y + Q[1, 2]
            value = u * x + v * y + Q[2, 0] * x + Q[2, 1] * y + Q[2, 2]
            steep = 2 * math.sqrt(u * u + v * v) + 1e-12
            aligned = abs(2 * (u * normals[k, 0] + v * normals[k, 1])) > ALONG * steep
            if aligned and abs(value) < near * steep:
                x, y = x - centres[t, 0], y - centres[t, 1]
                angle = math.atan2(x * A[0, 1] + y * A[1, 1], x * A[0, 0] + y * A[1, 0])
                hit[min(SECTORS - 1, int((angle / (2 * np.pi) + 0.5) * SECTORS))] = True
        out[t] = hit.sum()
