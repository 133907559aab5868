"""What every object shows from above and from below, as height maps in one plan of the scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, bounds_of, pose
from f3sr.scene import Scene
from f3sr.vision import height_map
from f3sr.vision.height_map import Grid

STEEPEST = 0.1
"""Least cosine of a slope: steeper cells are walls, whose distance is their horizontal one, in a grid of cells."""


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """Level axes below the camera, x along the picture's: no relation depends on where the world's own axes lie."""

    R: Array
    origin: Array
    eye: float
    """Height of the camera's centre over the ground [m]."""

    @classmethod
    def of(cls, camera: Camera) -> FloorPlan:
        right = camera.T_world_camera[:2, int(np.linalg.norm(camera.T_world_camera[:2, 0]) < 0.5)]  # x, or y if upright
        c, s = right / np.linalg.norm(right)
        x, y, z = camera.center
        return cls(R=np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), origin=np.array([x, y, 0]), eye=float(z))

    @property
    def T_plan_world(self) -> Array:
        """(4, 4)"""
        return pose(self.R, -self.R @ self.origin)

    def points(self, world: Array) -> Array:
        """World points (n, 3) in the plan's axes; heights stay."""
        return (world - self.origin) @ self.R.T

    def along_rays(self, points: Array, k: Array | float) -> Array:
        """Points (n, 3) of the plan under the homothety by k about the camera's centre."""
        eye = np.array([0, 0, self.eye])
        return eye + np.asarray(k)[..., None, None] * (points - eye)


@dataclass(frozen=True, eq=False, kw_only=True)
class Surfaces:
    """Top and underside of one object over a grid of its own, in the plan.

    ``high`` and ``low`` (rows, columns) [m], nan beside the object.
    """

    id: int
    size: float
    vertices: Array
    faces: NDArray[np.int32]
    grid: Grid
    high: Array
    low: Array

    @classmethod
    def of(cls, id: int, vertices: Array, faces: NDArray[np.int32], cells: int) -> Surfaces:
        first, last = bounds_of(vertices)
        size = float(np.linalg.norm(last - first))
        grid = Grid.over(first, last, max(float((last - first)[:2].max()), 1e-3 * size) / cells)
        high, low = height_map.upper(vertices, faces, grid), height_map.lower(vertices, faces, grid)
        if not np.any(np.isfinite(high) & np.isfinite(low)):
            high, low = _of_vertices(vertices, grid)
        return cls(id=id, size=size, vertices=vertices, faces=faces, grid=grid, high=high, low=low)

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) lowest and highest corner."""
        return bounds_of(self.vertices)

    @property
    def lowest(self) -> float:
        return float(self.bounds[0, 2])

    @property
    def height(self) -> float:
        return float(self.bounds[1, 2] - self.bounds[0, 2])

    @cached_property
    def footprint(self) -> NDArray[np.bool_]:
        """Cells (rows, columns) that the object covers."""
        return np.isfinite(self.low) & np.isfinite(self.high)

    @cached_property
    def underside(self) -> Array:
        """Points (n, 3) of the underside, one per covered cell."""
        return self._points(self.low)

    @cached_property
    def roof(self) -> Array:
        """Heights (n,) of the top over the same cells."""
        return self.high[self.footprint]

    @cached_property
    def underside_level(self) -> Array:
        """Cosine (n,) of the underside's slope over the same cells."""
        return levelness(self.low, self.grid.cell)[self.footprint]

    @cached_property
    def top_level(self) -> Array:
        """Cosine (rows, columns) of the top's slope."""
        return levelness(self.high, self.grid.cell)

    @cached_property
    def sides(self) -> tuple[float, float, float]:
        """Length and width of the least upright box in plan, to a cell, and height [m]."""
        turns = np.linspace(0, np.pi / 2, 30, endpoint=False)
        axes = np.stack([np.cos(turns), np.sin(turns)])
        xy = self._outline
        across = np.ptp(xy @ axes, axis=0), np.ptp(xy @ np.stack([-axes[1], axes[0]]), axis=0)
        best = int(np.argmin(across[0] * across[1]))
        width, length = sorted((float(across[0][best]), float(across[1][best])))
        return length + self.grid.cell, width + self.grid.cell, self.height

    @property
    def _outline(self) -> Array:
        """Middles (n, 2) of the first and the last covered cell of every row: all others lie between two of them."""
        covered = self.footprint[self.footprint.any(1)]
        count = covered.sum(1)
        last = np.cumsum(count) - 1
        return self.underside[np.concatenate([last - count + 1, last]), :2]

    @cached_property
    def middle(self) -> Array:
        """The footprint's middle (2,)."""
        return self.underside[:, :2].mean(0)

    @cached_property
    def weights(self) -> Array:
        """Shares (n,) of the mass over the same cells: what is between underside and top."""
        thickness = np.maximum(self.roof - self.underside[:, 2], 1e-6 * self.size)
        return thickness / thickness.sum()

    @cached_property
    def middle_of_mass(self) -> Array:
        """(2,)"""
        return self.weights @ self.underside[:, :2]

    def base(self, reach: float) -> NDArray[np.bool_]:
        """Which cells (n,) of the underside lie within ``reach`` [m] of its lowest."""
        return self.underside[:, 2] <= self.underside[:, 2].min() + reach

    def below(self, limit: float) -> Surfaces:
        """The object without what lies above ``limit`` [m] as a whole: a shelf without the boards over a jar."""
        under = self.vertices[self.faces][:, :, 2].min(1) <= limit
        if under.all():
            return self
        faces = self.faces[under]
        return Surfaces(
            id=self.id,
            size=self.size,
            vertices=self.vertices,
            faces=faces,
            grid=self.grid,
            high=height_map.upper(self.vertices, faces, self.grid),
            low=self.low,
        )

    def indices(self, xy: Array) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Row and column of the cells under points (..., 2), and which of them lie on the grid."""
        at = np.floor((xy - np.array(self.grid.origin)) / self.grid.cell).astype(np.intp)
        column, row = at[..., 0], at[..., 1]
        on = (column >= 0) & (row >= 0) & (column < self.grid.columns) & (row < self.grid.rows)
        return np.where(on, row, 0), np.where(on, column, 0), on

    def top_at(self, xy: Array) -> tuple[Array, Array]:
        """Height and levelness of the top under points (..., 2), nan beside the object."""
        row, column, on = self.indices(xy)
        return np.where(on, self.high[row, column], np.nan), self.top_level[row, column]

    def low_at(self, xy: Array) -> Array:
        """Height of the underside over points (..., 2), nan beside the object."""
        row, column, on = self.indices(xy)
        return np.where(on, self.low[row, column], np.nan)

    def _points(self, z: Array) -> Array:
        return self.grid.points(np.where(self.footprint, z, np.nan))


def surfaces_of(scene: Scene, plan: FloorPlan, cells: int) -> Mapping[int, Surfaces]:
    """The surfaces of every object, by id."""
    return {o.id: Surfaces.of(o.id, plan.points(o.vertices_world), o.mesh.faces, cells) for o in scene}


def _of_vertices(vertices: Array, grid: Grid) -> tuple[Array, Array]:
    """Highest and lowest vertex in every cell, nan where there is none: of sheets on edge, which no ray meets."""
    at = np.floor((vertices[:, :2] - np.array(grid.origin)) / grid.cell).astype(np.intp)
    column, row = np.clip(at, 0, [grid.columns - 1, grid.rows - 1]).T
    high, low = np.full((grid.rows, grid.columns), -np.inf), np.full((grid.rows, grid.columns), np.inf)
    np.maximum.at(high, (row, column), vertices[:, 2])
    np.minimum.at(low, (row, column), vertices[:, 2])
    return np.where(np.isfinite(high), high, np.nan), np.where(np.isfinite(low), low, np.nan)


def levelness(z: Array, cell: float) -> Array:
    """Cosine of the steepest slope to a neighbouring cell, at least ``STEEPEST``; 1 where there is none."""
    slope: Array = np.zeros(z.shape)
    for axis in (0, 1):
        step = np.abs(np.diff(z, axis=axis)) / cell
        step = np.where(np.isfinite(step), step, 0.0)
        first, last = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        first[axis], last[axis] = (1, 0), (0, 1)
        slope = np.maximum(slope, np.maximum(np.pad(step, first), np.pad(step, last)))
    cosine: Array = 1 / np.sqrt(1 + slope * slope)
    return np.maximum(cosine, STEEPEST)


def near_in_plan(surfaces: Iterable[Surfaces], reach: float) -> set[tuple[int, int]]:
    """Ordered pairs of ids whose boxes come within ``reach`` of the smaller one's size of each other in plan."""
    known = list(surfaces)
    low, high = (np.array([s.bounds[k, :2] for s in known]) for k in (0, 1))
    size = np.array([s.size for s in known])
    slack = reach * np.minimum(size[:, None], size[None, :])
    apart = np.maximum(low[:, None] - high[None], low[None] - high[:, None]).max(-1)
    return {(known[i].id, known[j].id) for i, j in np.argwhere(apart <= slack) if i != j}
