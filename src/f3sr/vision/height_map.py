"""Height maps: a mesh's upper or lower surface over a grid in the ground plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.vision import rasterizer

EYE_DISTANCE = 1e4
"""Distance of the virtual eye in units of the grid's extent: perspective shifts a point by less than 1e-4 of it."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Square cells over a rectangle of the xy plane: ``origin`` (x, y) of cell (0, 0)'s corner, ``cell`` [m]."""

    origin: tuple[float, float]
    cell: float
    rows: int
    columns: int

    @classmethod
    def over(cls, low: Array, high: Array, cell: float) -> Grid:
        """The grid that covers the box from ``low`` to ``high`` (their x and y)."""
        columns, rows = (max(1, int(np.ceil((high[k] - low[k]) / cell))) for k in (0, 1))
        return cls(origin=(float(low[0]), float(low[1])), cell=cell, rows=rows, columns=columns)

    def points(self, z: Array) -> Array:
        """The middles (n, 3) of the cells whose height (rows, columns) is finite."""
        row, column = np.nonzero(np.isfinite(z))
        x, y = (self.origin[k] + self.cell * (i + 0.5) for k, i in enumerate((column, row)))
        return np.column_stack([x, y, z[row, column]]).astype(np.float64)


def upper(vertices: Array, faces: NDArray[np.int32], grid: Grid) -> Array:
    """Height z (rows, columns) of the highest surface over each cell's middle, nan where there is none."""
    return _seen(vertices, faces, grid, sign=1.0)


def lower(vertices: Array, faces: NDArray[np.int32], grid: Grid) -> Array:
    """Height z (rows, columns) of the lowest surface over each cell's middle, nan where there is none."""
    return _seen(vertices, faces, grid, sign=-1.0)


def _seen(vertices: Array, faces: NDArray[np.int32], grid: Grid, *, sign: float) -> Array:
    """Depth from a very far eye above (sign 1) or below (-1): a z-buffer with nearly parallel rays."""
    extent = grid.cell * max(grid.rows, grid.columns)
    middle = np.array(grid.origin) + 0.5 * grid.cell * np.array([grid.columns, grid.rows])
    reference = float(vertices[:, 2].mean())
    eye = reference + sign * EYE_DISTANCE * extent
    # Image x runs along world x and image y along world y; the mirrored handedness does not matter to depth.
    points = np.column_stack([vertices[:, :2] - middle, sign * (eye - vertices[:, 2])])
    # At the mean height, EYE_DISTANCE extents away, a cell is one pixel.
    focal = EYE_DISTANCE * extent / grid.cell
    K = np.array([[focal, 0, grid.columns / 2], [0, focal, grid.rows / 2], [0, 0, 1]])
    ids = np.zeros(len(faces), np.int32)
    depth = rasterizer.rasterize(points, faces, ids, K, grid.columns, grid.rows).depth
    return np.where(np.isfinite(depth), eye - sign * depth, np.nan)
