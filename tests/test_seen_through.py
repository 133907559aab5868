"""Depth that shows the ground through an object is not taken for the object's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.transforms import pose
from f3sr.scene import Scene
from f3sr.stages.level import level
from f3sr.vision.depth_prior import ASSET_SIGMA, sigmas
from f3sr.vision.seen_through import seen_through, without_depth_of
from folders import photographed
from scenes import box

NOISE = 0.002
"""[m]"""


def with_glass(*, height: float = 0.1) -> Scene:
    """Two boxes; through the second, of that height, the geometry shows the ground."""
    glass = box(1, size=(0.08, 0.08, height), at=(0.12, 0, height / 2))
    scene, empty = (
        photographed(*objects, on_ground=True) for objects in ((box(0, at=(-0.1, 0, 0.05)), glass), (box(0),))
    )
    seen, behind = scene.geometry, empty.geometry
    assert seen and behind
    points = np.where(scene[1].mask[..., None], behind.points, seen.points)
    noise = np.random.default_rng(0).normal(1, 0.002, points.shape[:2])[..., None]
    return replace(scene, geometry=replace(seen, points=(noise * points).astype(np.float32)))


def test_only_what_the_ground_is_seen_through_is_found():
    scene = with_glass()
    assert [*seen_through(scene, NOISE)] == [1]
    opaque = photographed(*scene.objects, on_ground=True)
    assert not seen_through(opaque, NOISE)


def test_what_is_as_thin_as_the_ground_is_rough_or_may_be_thinner_than_its_solid_is_left_alone():
    assert not seen_through(with_glass(height=0.008), NOISE)
    scene = with_glass()
    assert not seen_through(scene.with_objects(replace(scene[1], lifted=True)), NOISE)
    assert not seen_through(replace(scene, geometry=None), NOISE)


def test_the_geometry_then_knows_nothing_of_it_and_its_distance_is_as_sure_as_it_came():
    scene = with_glass()
    found = without_depth_of(scene, seen_through(scene, NOISE))
    assert scene.geometry and found.geometry
    assert np.array_equal(found.geometry.valid, scene.geometry.valid & ~scene[1].mask)
    assert sigmas(found)[1] == ASSET_SIGMA > sigmas(found)[0] == sigmas(scene)[1]
    assert without_depth_of(scene, {}) is scene


@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_level_leaves_that_depth_out_and_says_so(tilt: float):
    scene = with_glass()
    T = pose(np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]))
    turned = replace(scene, camera=scene.camera.moved(T @ scene.camera.T_world_camera))
    turned = turned.with_objects(*(o.moved(T, stage="test", reason="") for o in scene))
    ground = ~scene[0].mask & ~scene[1].mask
    found, outcome = level(replace(turned, ground_mask=ground))
    told = [d for d in outcome.report.decisions if d.about is not None]
    assert [(d.about, d.fallback, d.choice) for d in told] == [(1, True, "its depth is left out")]
    assert found.geometry and not found.geometry.inside(scene[1].mask).any()
    assert found.geometry.inside(scene[0].mask).any()
