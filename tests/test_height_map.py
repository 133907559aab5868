"""Height maps of planes and boxes, at the middles of the cells."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.vision import height_map
from f3sr.vision.height_map import Grid
from scenes import box_mesh

SQUARE = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def test_a_slope_has_its_height_at_the_middle_of_every_cell() -> None:
    """z = .3 x - .2 y + 1 over a grid that is no square."""
    xy = np.array([[-1.0, -1], [3, -1], [3, 2], [-1, 2]])
    slope = np.column_stack([xy, xy @ [0.3, -0.2] + 1])
    grid = Grid.over(np.array([0.0, 0]), np.array([1.5, 0.8]), 0.1)
    assert (grid.rows, grid.columns) == (8, 15)
    for found in (height_map.upper(slope, SQUARE, grid), height_map.lower(slope, SQUARE, grid)):
        points = grid.points(found)
        assert len(points) == 120 and points[:, 2] == pytest.approx(points[:, :2] @ [0.3, -0.2] + 1, abs=2e-4)
        assert points[0, :2] == pytest.approx([0.05, 0.05]) and points[-1, :2] == pytest.approx([1.45, 0.75])


def test_a_box_has_a_top_a_bottom_and_nothing_beside() -> None:
    mesh = box_mesh((0.4, 0.2, 0.1))
    grid = Grid.over(np.array([-0.3, -0.3]), np.array([0.3, 0.3]), 0.02)
    upper, lower = height_map.upper(mesh.vertices, mesh.faces, grid), height_map.lower(mesh.vertices, mesh.faces, grid)
    seen = np.isfinite(upper)
    assert np.array_equal(seen, np.isfinite(lower)) and seen.sum() == 20 * 10
    assert upper[seen] == pytest.approx(0.05, abs=1e-5) and lower[seen] == pytest.approx(-0.05, abs=1e-5)
    x, y, _ = np.abs(grid.points(upper)).max(0)
    assert (x, y) == (pytest.approx(0.19), pytest.approx(0.09))
