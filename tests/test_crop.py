"""Windows of the photo: what they show is what the photo shows there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.vision.crop import MARGIN, sampled, window_around
from scenes import box, scene_of

CAMERA = Camera(width=24, height=18, K=np.array([[30.0, 0, 11], [0, 30, 10], [0, 0, 1]]), T_world_camera=np.eye(4))
IMAGE = np.arange(18 * 24).reshape(18, 24)


def test_a_window_of_the_same_pixels_shows_them_and_the_fill_beyond() -> None:
    shown = sampled(IMAGE, CAMERA, CAMERA.cropped(-2, 5, 20, 15), fill=-1)
    assert np.array_equal(shown[:13, 2:], IMAGE[5:, :18])
    assert (shown[:, :2] == -1).all() and (shown[13:] == -1).all()


def test_a_window_a_third_as_fine_shows_the_middle_of_three_pixels() -> None:
    assert np.array_equal(sampled(IMAGE, CAMERA, CAMERA.resized(8, 6), fill=-1), IMAGE[1::3, 1::3])


def test_an_image_of_another_resolution_covers_the_same_view() -> None:
    coarse = IMAGE[::2, ::2]
    assert np.array_equal(sampled(coarse, CAMERA, CAMERA, fill=-1), np.kron(coarse, np.ones((2, 2), int)))


def test_a_window_holds_mask_and_render_with_a_margin() -> None:
    scene = scene_of(box(0, at=(0.2, 0, 0.3)))
    window = window_around(scene[0], scene.camera, 512)
    pixels, _ = window.project(scene[0].vertices_world)
    longest = max(window.width, window.height)
    room = np.minimum(pixels.min(0), [window.width, window.height] - pixels.max(0)).min()
    assert room >= MARGIN * longest / (1 + 2 * MARGIN) - 1
    assert sampled(scene[0].mask, scene.camera, window, fill=False).sum() == scene[0].mask.sum()


def test_an_object_without_a_pixel_in_its_mask_has_the_window_of_its_render() -> None:
    scene = scene_of(box(0, at=(0.2, 0, 0.3)))
    unseen = replace(scene[0], mask=np.zeros_like(scene[0].mask))
    window = window_around(unseen, scene.camera, 512)
    pixels, _ = window.project(unseen.vertices_world)
    assert (pixels > 0).all() and (pixels < [window.width, window.height]).all()
