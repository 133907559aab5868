"""What the picture feels of a shift, against pictures."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.core.camera import Camera
from f3sr.core.transforms import pose
from f3sr.vision import rasterizer
from f3sr.vision.iou_sensitivity import loss_matrix, loss_per_pixel
from f3sr.vision.silhouette import iou
from scenes import box, scene_of


def test_a_rectangle_loses_two_of_its_sides():
    mask = np.zeros((100, 200), bool)
    mask[20:60, 50:150] = True
    assert loss_per_pixel(mask) == pytest.approx([2 / 100, 2 / 40])
    shifted = np.roll(mask, 1, axis=1)
    assert 1 - iou(mask, shifted) == pytest.approx(loss_per_pixel(mask)[0], rel=0.02)


@pytest.mark.parametrize("shift", [(0, 0, 0.004), (0.004, 0, 0), (0, 0.01, 0)])
def test_the_loss_of_a_shift_is_that_of_its_rendered_silhouette(shift: tuple[float, float, float]):
    scene = scene_of(box(0))
    camera = scene.camera.zoomed(1).resized(1024, 768)
    o = scene[0]

    def silhouette(t: tuple[float, float, float]) -> np.ndarray:
        points = camera.to_camera(o.vertices_world + np.array(t))
        return rasterizer.silhouette(points, o.mesh.faces, camera.K, camera.width, camera.height)

    mask = silhouette((0, 0, 0))
    W = loss_matrix(mask, camera, o.bounds_world.mean(0))
    d = np.array(shift)
    assert np.sqrt(d @ W @ d) == pytest.approx(1 - iou(mask, silhouette(shift)), rel=0.3)


def test_nothing_is_felt_along_the_viewing_ray_or_behind_the_camera():
    camera = Camera(width=64, height=48, K=np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), T_world_camera=pose())
    mask = np.zeros((48, 64), bool)
    mask[10:20, 10:20] = True
    point = np.array([0.1, 0.2, 1.5])
    ray = point / np.linalg.norm(point)
    assert ray @ loss_matrix(mask, camera, point) @ ray == pytest.approx(0, abs=1e-9)
    assert not loss_matrix(mask, camera, -point).any()
