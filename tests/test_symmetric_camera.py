"""The nearest camera with its axis in the middle: exact where that is so, and its error told where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.camera import Camera
from f3sr.core.transforms import pose, rotation_about
from f3sr.exporters.symmetric_camera import symmetric

POSE = pose(rotation_about([1.0, 2, 0.5], 0.8), [0.3, -1, 0.9])


def camera(cx: float = 400.0, cy: float = 300.0, *, fy: float = 700.0, skew: float = 0.0) -> Camera:
    K = np.array([[700.0, skew, cx], [0, fy, cy], [0, 0, 1]])
    return Camera(width=800, height=600, K=K, T_world_camera=POSE)


@pytest.mark.parametrize("fy", [700.0, 500.0])
def test_a_symmetric_camera_stays_as_it_is(fy: float) -> None:
    found = symmetric(camera(fy=fy))
    assert np.allclose(found.camera.K, camera(fy=fy).K) and np.allclose(found.camera.T_world_camera, POSE)
    assert found.farthest == 0
    assert found.yfov == pytest.approx(2 * np.arctan(300 / fy)) and found.aspect == pytest.approx(800 / 600 * fy / 700)


@pytest.mark.parametrize(("shift", "skew"), [((40.0, -25.0), 0.0), ((0.0, 0.0), 6.0), ((250.0, 100.0), 3.0)])
def test_the_error_is_the_one_that_projection_shows(shift: tuple[float, float], skew: float) -> None:
    given = camera(400 + shift[0], 300 + shift[1], skew=skew)
    found = symmetric(given)
    x, y = np.meshgrid(np.linspace(0, 800, 9), np.linspace(0, 600, 9))
    pixels = np.column_stack([x.ravel(), y.ravel(), np.ones(81)])
    points = given.center + 2 * (pixels @ np.linalg.inv(given.K).T) @ given.T_world_camera[:3, :3].T
    error = np.linalg.norm(found.camera.project(points)[0] - pixels[:, :2], axis=1)
    assert found.farthest == pytest.approx(error.max(), abs=1e-5) and error.max() > 1e-3
    assert np.allclose(found.camera.center, given.center)
    if any(shift):  # to keep the axis would be wrong by the whole offset, everywhere
        assert found.farthest < np.hypot(*shift)


def test_a_narrow_view_leaves_less_of_the_offset() -> None:
    """The keystone is the offset times the square of half the view's angle; to keep the axis leaves all of it."""
    wide = symmetric(camera(410)).farthest
    K = camera(410).K * [[4], [4], [1]] - np.array([[0, 0, 3 * 410.0], [0, 0, 900], [0, 0, 0]])
    narrow = symmetric(replace(camera(), K=K)).farthest
    assert wide < 5 and wide / narrow == pytest.approx(16, rel=0.05)
