"""The photo's camera over its ground, where that is seen and where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import f3sr
from f3sr.backends.protocols import PromptedImage
from f3sr.scene import Geometry
from f3sr.vision.ground_camera import camera_over_ground
from folders import boxes, camera, photographed


def prompted(*, whole: bool) -> tuple[PromptedImage, Geometry]:
    """Three boxes; ``whole``: the first one's mask covers all that the others do not."""
    scene = photographed(*boxes(), on_ground=True)
    taken = np.any([o.mask for o in scene.objects[1:]], axis=0)
    masks = [~taken if whole and k == 0 else o.mask for k, o in enumerate(scene)]
    instances = tuple(
        f3sr.scene.Instance(id=o.id, label=o.label, name=o.mask_name, mask=m) for o, m in zip(scene, masks, strict=True)
    )
    assert scene.geometry
    return PromptedImage(photo=scene.photo, instances=instances, ground_mask=None), scene.geometry


def test_a_ground_that_is_seen_is_where_it_is() -> None:
    image, geometry = prompted(whole=False)
    found, true = camera_over_ground(image, geometry, camera().K), camera()
    assert abs(found.center[2] - true.center[2]) < 0.01
    assert found.T_world_camera[2, :3] @ true.T_world_camera[2, :3] > 0.9999


def test_a_ground_that_no_pixel_shows_is_as_low_as_the_objects_and_the_camera_level() -> None:
    image, geometry = prompted(whole=True)
    found = camera_over_ground(image, geometry, camera().K)
    assert found.T_world_camera[2, 1] == -1
    assert found.center[2] == np.float32(geometry.points[geometry.valid][:, 1].max())
    above = replace(geometry, points=geometry.points - np.array([0, 9, 0], np.float32))
    assert camera_over_ground(image, above, camera().K).center[2] > 0
