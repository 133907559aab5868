"""Edge points of a photo to a fraction of a pixel, and the straight segments that they form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.vision.regions import parts_of

BLUR = 1.0
"""Standard deviation of the Gaussian whose derivatives are the gradient [px]: smaller doubles edges by noise."""
LEAST_GRADIENT = 1.5
"""Least gradient of an edge [grey levels per pixel]."""
OVER_MEDIAN = 3.0
"""Least gradient of an edge, in medians of all gradients: what noise and texture leave behind."""
FARTHEST = 0.7
"""Largest offset of an edge point from its pixel's centre [px]."""
DIRECTIONS = 16
"""Bins of gradient directions. Two sets of bins, half a bin apart, so that no edge is cut by a bin's border."""
SHORTEST = 0.014
"""Least length of a segment [longer image sides], and no less than ``SHORTEST_PX``."""
SHORTEST_PX = 12.0
DENSITY = 0.6
"""Least number of edge points per pixel of a segment."""
STRAIGHT, BENT = 0.5, 1.5
"""Largest root mean square and largest distance of a segment's points from its line [px]."""
SPLITS = 6
"""Most times that a bent chain of edge points is split."""
SHARED = 0.4
"""Share of its points that a segment may have in common with a longer one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EdgePoints:
    """``points`` (n, 2) [px]; ``normals`` (n, 2), unit gradients; ``pixels`` (n, 2) int, columns and rows."""

    points: Array
    normals: Array
    pixels: NDArray[np.int64]
    shape: tuple[int, int]
    """Of the photo (height, width)."""


def edge_points(rgb: NDArray[np.uint8]) -> EdgePoints:
    """Local maxima of the gradient along itself, in the channel where it is largest (Canny 1986, without hysteresis);
    a parabola through three values gives the place."""
    from scipy import ndimage

    gx, gy, size = _gradient(rgb)
    rows, columns = np.nonzero(size > max(LEAST_GRADIENT, OVER_MEDIAN * float(np.median(size))))
    here = size[rows, columns]
    nx, ny = gx[rows, columns] / here, gy[rows, columns] / here
    before, after = (
        ndimage.map_coordinates(size, [rows + s * ny, columns + s * nx], order=1, mode="nearest") for s in (-1, 1)
    )
    kept = (here >= before) & (here > after)
    rows, columns, nx, ny, here, before, after = (a[kept] for a in (rows, columns, nx, ny, here, before, after))
    bend = before - 2 * here + after
    offset = np.divide(0.5 * (before - after), bend, out=np.zeros_like(bend), where=bend < -1e-6)
    offset = np.clip(offset, -FARTHEST, FARTHEST)
    normals = np.column_stack([nx, ny]).astype(float)
    centres = np.column_stack([columns, rows]) + 0.5
    return EdgePoints(
        points=(centres + offset[:, None] * normals).astype(float),
        normals=normals,
        pixels=np.column_stack([columns, rows]).astype(np.int64),
        shape=size.shape,
    )


def line_segments(edges: EdgePoints) -> Array:
    """Straight segments (n, 4), x0, y0, x1, y1 [px], longest first: connected edge points of like gradient directions,
    split where they bend, each with its least squares line."""
    least = max(SHORTEST_PX, SHORTEST * max(edges.shape))
    found = list[_Chain]()
    angle = np.arctan2(edges.normals[:, 1], edges.normals[:, 0]) / (2 * np.pi) * DIRECTIONS
    for shift in (0.0, 0.5):
        bins = np.floor(angle + shift).astype(int) % DIRECTIONS
        for k in range(DIRECTIONS):
            for chain in _connected(edges, np.flatnonzero(bins == k)):
                found += _straight(edges.points, chain, least, SPLITS)
    taken = np.zeros(len(edges.points), bool)
    segments = list[Array]()
    for chain in sorted(found, key=lambda chain: -chain.length):
        if taken[chain.members].mean() <= SHARED:
            taken[chain.members] = True
            segments.append(chain.ends)
    return np.array(segments).reshape(-1, 4)


@dataclass(frozen=True, eq=False)
class _Chain:
    """A straight segment: its edge points by index, its ends (4,) and its length [px]."""

    members: NDArray[np.int64]
    ends: Array
    length: float


def _gradient(rgb: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
    """Of the channel where it is largest: along x, along y and its size, each (h, w)."""
    from scipy import ndimage

    best: tuple[NDArray[Any], ...] | None = None
    for channel in range(3):
        values = rgb[..., channel].astype(np.float32)
        gx, gy = (np.asarray(cast(Any, ndimage).gaussian_filter(values, BLUR, order=o)) for o in ((0, 1), (1, 0)))
        size = np.hypot(gx, gy)
        if best is None:
            best = gx, gy, size
        else:
            larger = size > best[2]
            best = tuple(np.where(larger, new, old) for new, old in zip((gx, gy, size), best, strict=True))
    assert best is not None
    return best


def _connected(edges: EdgePoints, chosen: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Groups of chosen edge points whose pixels touch."""
    if not len(chosen):
        return []
    image = np.zeros(edges.shape, bool)
    columns, rows = edges.pixels[chosen].T
    image[rows, columns] = True
    labels = parts_of(image, diagonal=True)[rows, columns]
    order = np.argsort(labels, kind="stable")
    return np.split(chosen[order], np.flatnonzero(np.diff(labels[order])) + 1)


def _straight(points: Array, members: NDArray[np.int64], least: float, splits: int) -> list[_Chain]:
    """The straight pieces of a chain: it is split at the point farthest from the chord until all are straight."""
    if len(members) < DENSITY * least:
        return []
    own = points[members]
    centre = own.mean(0)
    along, across = np.linalg.svd(np.cov((own - centre).T))[2]
    t, off = (own - centre) @ along, (own - centre) @ across
    length = float(np.ptp(t))
    if length < least or len(members) < DENSITY * length:
        return []
    if np.sqrt(np.mean(off**2)) <= STRAIGHT and np.abs(off).max() <= BENT:
        ends = np.concatenate([centre + t.min() * along, centre + t.max() * along])
        return [_Chain(members, ends, length)]
    if not splits:
        return []
    first, last = own[np.argmin(t)], own[np.argmax(t)]
    chord = (last - first) / np.linalg.norm(last - first)
    bulge = np.abs((own - first) @ np.array([-chord[1], chord[0]]))
    bulge[(t < t.min() + 0.1 * length) | (t > t.max() - 0.1 * length)] = 0
    cut = t[np.argmax(bulge)]
    return [c for side in (t < cut, t >= cut) for c in _straight(points, members[side], least, splits - 1)]
