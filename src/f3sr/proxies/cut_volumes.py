"""The volumes of the hulls on both sides of planes through a piece: exactly for one plane, at a first look for many.

The first look builds no hull, which takes most of the time for so few points. It takes the outermost points in fixed
directions. These directions are the corners of a triangulated sphere. So their outermost points are the corners of a
closed surface within the hull; of a polytope of few corners it is the hull's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, cross
from f3sr.proxies.hulls import bulk, distinct, outermost, spread

LAYER = 0.003
"""A hull counts as much thicker, on all sides [size]: slices across a bowl save what is below its rim, but they are
full discs, each to be cut again."""
DIRECTIONS = 128
"""Directions of a first look. The best of the eight cuts it puts first is .01 % worse than the best of all."""
FLATTEST = 1e-4
"""Least spread of points by which directions are stretched [size]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SimplifiedSurface:
    """Corners (n, 3), edges (m, 2) and triangles (k, 3, 3) of a simplified surface on which cuts are compared."""

    triangles: Array
    corners: Array
    edges: NDArray[np.int64]

    @classmethod
    def of(cls, triangles: Array) -> SimplifiedSurface:
        corners, inverse = distinct(triangles.reshape(-1, 3))
        edges = np.sort(inverse.reshape(-1, 3)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        first, second = np.divmod(np.unique(edges[:, 0] * len(corners) + edges[:, 1]), len(corners))
        return cls(triangles=triangles, corners=corners, edges=np.stack([first, second], axis=1))

    def crossings(self, height: Array, offsets: Array) -> tuple[NDArray[np.int64], Array]:
        """Where edges cross planes at ``offsets`` above which corners have a ``height`` (n,): the planes' numbers (k,)
        and the points (k, 3)."""
        below = height < offsets[:, None]
        plane, edge = np.nonzero(below[:, self.edges[:, 0]] != below[:, self.edges[:, 1]])
        first, second = self.edges[edge].T
        t = (offsets[plane] - height[first]) / (height[second] - height[first])
        return plane, self.corners[first] + t[:, None] * (self.corners[second] - self.corners[first])


def parted(core: Array, u: Array, offset: float, reach: float) -> tuple[Array, Array]:
    """The core below and above a cut, both with its points next to the cut moved onto it."""
    height = core @ u - offset
    near = np.abs(height) <= reach
    moved = core[near] - height[near, None] * u
    return np.concatenate([core[height <= 0], moved]), np.concatenate([core[height >= 0], moved])


def bulk_of_sides(
    outline: SimplifiedSurface, core: Array, u: Array, offset: float, reach: float, *, around: Array | None = None
) -> float:
    """Volume of the hulls of both sides of a plane together, with their layers.

    With ``around`` (m, 3), of the hulls of the points that are outermost in these directions."""
    height = outline.corners @ u
    _, crossed = outline.crossings(height, np.array([offset]))
    sides = outline.corners[height <= offset], outline.corners[height >= offset]
    cores = parted(core, u, offset, reach)
    bodies = (np.concatenate([side, crossed, c]) for side, c in zip(sides, cores, strict=True))
    return sum(bulk(body if around is None else outermost(body, around), LAYER) for body in bodies)


@dataclass(frozen=True, eq=False, kw_only=True)
class FirstLook:
    """A piece's outline and core, whose points next to a plane, up to ``reach``, are moved onto it.

    ``heights`` (m, n) are those of all points along the directions (m, 3)."""

    outline: SimplifiedSurface
    core: Array
    reach: float
    points: Array
    directions: Array
    heights: Array

    @classmethod
    def at(cls, outline: SimplifiedSurface, core: Array, reach: float) -> FirstLook:
        points = np.concatenate([outline.corners, core])
        # As if the points had the same spread all around: in even directions, a needle's outermost points are its ends.
        squares, axes = np.linalg.eigh(np.cov(points.T, ddof=min(1, len(points) - 1)))
        directions = _sphere()[0] @ (axes / np.sqrt(np.maximum(squares, FLATTEST**2))) @ axes.T
        return cls(
            outline=outline,
            core=core,
            reach=reach,
            points=points,
            directions=directions,
            heights=directions @ points.T,
        )

    @property
    def whole(self) -> float:
        """Volume of the hull of all, with its layer."""
        return float(self._bulks(self.points[self.heights.argmax(1)][None])[0])

    def bulks(self, u: Array, offsets: Array) -> Array:
        """Volumes (k,) of the hulls of both sides together, with their layers, for planes ``u . x = offset``."""
        if not len(offsets):
            return np.zeros(0)
        height = self.points @ u
        slabs = self._outermost_of_slabs(height, offsets)
        most, met = self._outermost_at_planes(u, height, offsets)
        # Slab k lies below plane k, slab k + 1 above it.
        below = _farthest_so_far(*(x[:-1] for x in slabs))
        above = _farthest_so_far(*(x[:0:-1] for x in slabs))
        total = np.zeros(len(offsets))
        for far, points in (below, tuple(x[::-1] for x in above)):
            total += self._bulks(np.where((most >= far)[..., None], met, points))
        return total

    def _outermost_of_slabs(self, height: Array, offsets: Array) -> tuple[Array, Array]:
        """Heights (k + 1, m) and places (k + 1, m, 3) of the outermost points between two planes."""
        order = np.argsort(height)
        ends = [0, *np.searchsorted(height[order], offsets, side="right"), len(order)]
        heights = self.heights[:, order]
        rows = np.arange(len(heights))
        far = np.full((len(ends) - 1, len(rows)), -np.inf)
        which = np.zeros(far.shape, np.int64)
        for k, (start, end) in enumerate(pairwise(ends)):
            if start < end:
                which[k] = start + heights[:, start:end].argmax(1)
                far[k] = heights[rows, which[k]]
        return far, self.points[order[which]]

    def _outermost_at_planes(self, u: Array, height: Array, offsets: Array) -> tuple[Array, Array]:
        """Heights (k, m) and places (k, m, 3) of the outermost points in every plane: crossed edges and moved core."""
        plane, crossed = self.outline.crossings(height[: len(self.outline.corners)], offsets)
        off = height[len(self.outline.corners) :] - offsets[:, None]
        plane_2, near = np.nonzero(np.abs(off) <= self.reach)
        planes = np.concatenate([plane, plane_2])
        points = np.concatenate([crossed, self.core[near] - off[plane_2, near, None] * u])
        order = np.argsort(planes, kind="stable")
        counts = np.bincount(planes, minlength=len(offsets))
        place = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
        table = np.zeros((len(offsets), max(1, counts.max()), 3))
        table[planes[order], place] = points[order]
        heights = self.directions @ table.transpose(0, 2, 1)
        heights += np.where(np.arange(table.shape[1]) < counts[:, None], 0, -np.inf)[:, None]
        best = heights.argmax(2)[..., None]
        return np.take_along_axis(heights, best, 2)[..., 0], np.take_along_axis(table, best, 1)

    def _bulks(self, outer: Array) -> Array:
        """Of surfaces (k,) over the sphere with corners (k, m, 3)."""
        triangles = _sphere()[1]
        a, b, c = (np.moveaxis(outer, 2, 0)[:, :, triangles[:, k]] for k in range(3))
        (ux, uy, uz), (vx, vy, vz) = b - a, c - a
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        volume = (a[0] * x + a[1] * y + a[2] * z).sum(1) / 6
        # Triangles that are turned over, where the surface is folded, count against the others.
        fx, fy, fz = self.directions[triangles].sum(1).T
        area = np.copysign(np.sqrt(x * x + y * y + z * z), x * fx + y * fy + z * fz).sum(1) / 2
        return volume + LAYER * area


def _farthest_so_far(far: Array, points: Array) -> tuple[Array, Array]:
    """The farthest of the first k + 1 slabs: heights (k + 1, m) and places (k + 1, m, 3)."""
    most = np.maximum.accumulate(far, axis=0)
    slab = np.maximum.accumulate(np.where(far == most, np.arange(len(far))[:, None], 0), axis=0)
    return most, np.take_along_axis(points, slab[..., None], 0)


@cache
def _sphere() -> tuple[Array, NDArray[np.int64]]:
    """Directions (m, 3) all around and the triangles (k, 3) between them, seen from outside counterclockwise."""
    from scipy.spatial import ConvexHull

    directions = spread(DIRECTIONS)
    triangles = np.asarray(ConvexHull(directions).simplices, np.int64)
    a, b, c = (directions[triangles[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return directions, triangles
