"""Lengths that a depth sensor tells: of boxes of which it sees two faces, and without pixels between two surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.core.transforms import Array
from scale_of_photo import measured_length, sensor_points

UP = np.array([0.0, -0.8, -0.6])
PLANE = {"normal_up": UP, "offset_m": 0.7}
K = np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])


def surface(width: float, height: float, depth: float) -> Array:
    """Points (n, 3) of the front and the top of an upright box on the plane, in camera axes."""
    x, y = np.linspace(-width / 2, width / 2, 20), np.linspace(0, 1, 20)
    front = np.array([[a, 0, b * height] for a in x for b in y])
    top = np.array([[a, b * depth, height] for a in x for b in y])
    away = np.array([0.0, -0.6, 0.8])
    foot = -0.7 * UP + 0.6 * away  # on the plane
    return foot + np.concatenate([front, top]) @ np.array([[1.0, 0, 0], away, UP])


@pytest.mark.parametrize(("size", "longest"), [((0.1, 0.3, 0.1), 0.3), ((0.3, 0.1, 0.1), 0.3), ((0.1, 0.1, 0.3), 0.3)])
def test_two_faces_tell_the_longest_side_of_a_box(size: tuple[float, float, float], longest: float) -> None:
    assert measured_length(surface(*size), PLANE) == pytest.approx(longest, rel=1e-6)


def test_a_foot_that_something_hides_counts_down_to_the_plane() -> None:
    points = surface(0.1, 0.3, 0.1)
    heights = points @ UP + 0.7
    assert measured_length(points[heights > 0.1], PLANE) == pytest.approx(0.3, rel=1e-6)


def test_pixels_between_two_surfaces_are_no_points() -> None:
    depth = np.full((240, 320), 2.0)
    depth[60:180, 100:220] = 1.0
    mask = depth == 1
    smeared = depth.copy()
    smeared[:, 100:103], smeared[:, 217:220] = 1.2, 1.5
    width = np.ptp(sensor_points(depth, mask, K)[:, 0])
    assert width == pytest.approx(117 / 500, rel=1e-6)  # the outermost pixels have neighbours beyond
    assert np.ptp(sensor_points(smeared, mask, K)[:, 0]) < width


def test_a_mask_without_depth_has_no_points() -> None:
    assert not len(sensor_points(np.zeros((240, 320)), np.ones((240, 320), bool), K))
