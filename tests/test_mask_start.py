"""Where an object stands by its mask alone: on the mask's ray, of its size, at the distance that something tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.camera import Camera
from f3sr.core.transforms import pose, rotation_about
from f3sr.mesh_poses.mask_start import LEAST_DISTANCE, at_its_mask, seen_distance
from f3sr.scene import Geometry
from folders import photographed
from scenes import box

SCENE = photographed(box(0, at=(0.1, 0, 0.05)))
EYE = SCENE.camera


@pytest.mark.parametrize("factor", [0.01, 1.0, 50.0])
def test_an_object_of_any_size_and_place_comes_to_its_mask(factor: float) -> None:
    there = SCENE[0]
    far = there.moved(pose(t=np.array([3.0, -2.0, 0.4])), scale=factor, stage="test", reason="")
    found = at_its_mask(far, None, EYE, stage="test")
    assert np.allclose(found.T_world_object[:3, :3], there.T_world_object[:3, :3])
    assert found.size == pytest.approx(there.size, rel=0.5)
    (pixel, *_), _ = EYE.project(found.middle[None])
    assert np.linalg.norm(pixel - np.argwhere(there.mask).mean(0)[::-1]) < 0.1 * EYE.width


def test_the_distance_is_the_geometry_s_and_else_that_of_the_ground_below() -> None:
    mask = SCENE[0].mask
    points = np.ones((*mask.shape, 3), np.float32) * 0.7
    assert seen_distance(mask, Geometry(points=points, valid=np.ones_like(mask)), EYE) == pytest.approx(0.7)
    ground = seen_distance(mask, None, EYE)
    assert seen_distance(mask, Geometry(points=points, valid=np.zeros_like(mask)), EYE) == ground
    near = EYE.to_camera(SCENE[0].vertices_world)[:, 2].min()
    assert ground == pytest.approx(near, rel=0.1)


@pytest.mark.parametrize(
    "camera_that_sees_no_ground",
    [
        replace(EYE, T_world_camera=EYE.T_world_camera @ pose(rotation_about([1, 0, 0], np.pi / 2))),
        EYE.moved(pose(t=np.array([0, 0, -EYE.center[2] - 0.3])) @ EYE.T_world_camera),
        EYE.moved(pose(t=np.array([0, 0, -EYE.center[2]])) @ EYE.T_world_camera),
    ],
    ids=["looks up", "is under it", "is on it"],
)
def test_where_no_ground_is_in_front_the_distance_is_still_one(camera_that_sees_no_ground: Camera) -> None:
    assert seen_distance(SCENE[0].mask, None, camera_that_sees_no_ground) >= LEAST_DISTANCE
    found = at_its_mask(SCENE[0], None, camera_that_sees_no_ground, stage="test")
    assert camera_that_sees_no_ground.to_camera(found.middle[None])[0, 2] > 0
