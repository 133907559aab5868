"""Ellipses in the outlines of objects: horizontal rims of plates, pans, cups and cans tell where gravity points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.metrology.edges import EdgePoints
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
    """For every mask the ellipse that edges cover most, if they cover ``COVERED`` of it and it is not nearly round."""
    rng = np.random.default_rng(SEED)
    occupied = np.sum(masks, axis=0, dtype=np.int64) if len(masks) else np.zeros(edges.shape, np.int64)
    found = [_rim(mask, (occupied - mask) > 0, edges, rng) for mask in masks]
    return [e for e in found if e and e.coverage >= COVERED and e.minor < ROUND * e.major]


def fit_ellipse(points: Array) -> Ellipse | None:
    """The least squares ellipse of points (n, 2) (Halir and Flusser 1998); None where they have none."""
    centre = points.mean(0)
    size = float(np.abs(points - centre).mean()) + 1e-9
    x, y = ((points - centre) / size).T
    quadratic, linear = np.column_stack([x * x, x * y, y * y]), np.column_stack([x, y, np.ones_like(x)])
    try:
        T = -np.linalg.solve(linear.T @ linear, linear.T @ quadratic)
    except np.linalg.LinAlgError:
        return None
    M = quadratic.T @ quadratic + (quadratic.T @ linear) @ T
    vectors = np.real(np.linalg.eig(np.stack([M[2] / 2, -M[1], M[0] / 2]))[1])
    elliptic = np.flatnonzero(4 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0)
    if not len(elliptic):
        return None
    a, b, c = vectors[:, elliptic[0]]
    d, e, f = T @ [a, b, c]
    N = np.array([[1 / size, 0, -centre[0] / size], [0, 1 / size, -centre[1] / size], [0, 0, 1]])
    return _ellipse(N.T @ np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, f]]) @ N)


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
    best, members = None, np.zeros(0, np.int64)
    for _ in range(ARCS):
        start, length = int(rng.integers(len(outline))), int(len(outline) * rng.uniform(*ARC))
        arc = (start + np.sort(rng.integers(0, max(2, length), ARC_POINTS))) % len(outline)
        found = _covered(fit_ellipse(outline[arc]), points, normals, near_px, size)
        if found and (best is None or found[0].coverage > best.coverage):
            best, members = found
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
    if ellipse is None or ellipse.minor < SMALLEST or not EXTENT[0] * size < ellipse.major < EXTENT[1] * size:
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
