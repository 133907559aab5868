"""Convex hulls in normalised units: their planes, their volume, and how far points lie outside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, area_vectors, qhull
from f3sr.core.transforms import Array

THINNEST = 1e-5
"""Volume over area of a hull that is more than a sheet [size]."""
FEW_PLANES = 300
"""Facets up to which all of them count."""
TURN = 0.1
"""Facets turned by less than about this [rad] are alike: a ball's are then .1% of its size too far out."""
MIXED = (1.0, 0.754877666246693, 0.569840290998053)
"""Shares of coordinates whose sum tells points apart: without a common ratio."""
SMALLEST_FACET = 1e-14
"""Twice the area of a facet whose normal is still trusted [squares of the size]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Hull:
    """The convex hull of some points: corners (n, 3), facets as triangles (m, 3, 3), volume and area.

    The planes ``normals . x <= offsets`` are those of its facets; of nearly parallel ones only the largest. So a round
    body has a few hundred planes instead of thousands, and they bound a slightly larger body."""

    corners: Array
    normals: Array
    offsets: Array
    triangles: Array
    volume: float
    area: float


def qhull_of(points: Array) -> Any:
    """scipy's hull of points (n, 3); None where they span no volume. Raises MemoryError when qhull does."""
    try:
        return qhull(points) if len(points) >= 4 else None
    except ValueError:
        return None


def hull_of(points: Array) -> Hull | None:
    """The hull of points (n, 3); None when they span hardly a volume."""
    hull = qhull_of(points)
    if hull is None or hull.volume < THINNEST * hull.area:
        return None
    planes = hull.equations[_of_each_turn(hull.equations, points[hull.simplices])]
    return Hull(
        corners=points[np.sort(hull.vertices)],
        normals=planes[:, :3],
        offsets=-planes[:, 3],
        triangles=points[hull.simplices],
        volume=float(hull.volume),
        area=float(hull.area),
    )


def _of_each_turn(equations: Array, triangles: Array) -> NDArray[np.int64]:
    """One of the facets in each plane; where they are many, of those whose normals lie in one cell of a grid the
    largest, in the order of the cells."""
    if len(equations) <= FEW_PLANES:
        return np.unique(distinct(equations[:, :3])[1], return_index=True)[1]
    order = np.argsort(-np.linalg.norm(area_vectors(triangles), axis=1), kind="stable")
    cells = np.round(equations[order, :3] / TURN).astype(np.int64) + round(1 / TURN)
    wide = 2 * round(1 / TURN) + 1
    return order[np.unique((cells[:, 0] * wide + cells[:, 1]) * wide + cells[:, 2], return_index=True)[1]]


def spread(count: int) -> Array:
    """Directions (count, 3) all around, evenly: a spiral of golden angles."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def outermost(points: Array, directions: Array) -> Array:
    """Those of points (n, 3) that lie outermost in one of the directions (m, 3); all where they are few."""
    if len(points) <= 2 * len(directions):
        return points
    return points[np.unique((points @ directions.T).argmax(0))]


def distinct(points: Array) -> tuple[Array, NDArray[np.int64]]:
    """Points (n, 3) without repetitions, and where each of the given ones is among them (n,).

    Sorted by a single number: equal points have the same one, and other points hardly ever."""
    x, y, z = points.T
    order = np.argsort(MIXED[0] * x + MIXED[1] * y + MIXED[2] * z)
    ordered = points[order]
    is_new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(1)])
    where = np.empty(len(points), np.int64)
    where[order] = np.cumsum(is_new) - 1
    return ordered[is_new], where


def bulk(points: Array, layer: float) -> float:
    """The volume of the hull of points (n, 3) with a layer around it; 0 where it has none."""
    hull = qhull_of(points)
    return 0.0 if hull is None else float(hull.volume + layer * hull.area)


def outside(parts: Sequence[ConvexPart], points: Array) -> Array:
    """Largest signed distance (n, parts) of points beyond a facet plane of each part; negative inside."""
    return np.stack([beyond(points, *planes(part)) for part in parts], axis=1)


def beyond(points: Array, normals: Array, offsets: Array) -> Array:
    """Largest signed distance (n,) of points beyond one of some planes."""
    blocks = np.array_split(points, max(1, points.shape[0] * len(offsets) // 4_000_000))
    return np.concatenate([(block @ normals.T - offsets).max(1) for block in blocks])


def planes(part: ConvexPart) -> tuple[Array, Array]:
    """Outward unit normals (m, 3) and offsets (m,) of a part's triangles."""
    triangles = part.vertices[part.faces]
    across = area_vectors(triangles)
    area = np.linalg.norm(across, axis=1)
    real = area > SMALLEST_FACET
    normals = across[real] / area[real, None]
    return normals, np.einsum("ij,ij->i", normals, triangles[real, 0])


def without_hidden(parts: Sequence[ConvexPart]) -> list[ConvexPart]:
    """Parts that do not lie inside another one, the first of equals kept."""
    kept: list[tuple[ConvexPart, Array, Array]] = []
    for part in sorted(parts, key=lambda p: -p.volume):
        if not any((beyond(part.vertices, n, o) <= 1e-9).all() for _, n, o in kept):
            kept.append((part, *planes(part)))
    return [part for part, *_ in kept]
