"""Laws of the alignment benchmark's own parts: starts are as far off as they say, and errors are what was turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import basin
import poses
from f3sr.core.transforms import rotation_about, rotation_angle
from f3sr.metrics.measures import full_silhouette
from f3sr.stages.align import AlignConfig
from scenes import box_mesh

MESH = box_mesh((0.3, 0.2, 0.1))


@pytest.mark.parametrize("kind", basin.KINDS, ids=lambda k: k.key)
@pytest.mark.parametrize("seed", range(4))
def test_a_start_is_as_far_off_as_it_says(kind, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera, truth = basin.placed(MESH, rng)
    start, _ = basin.disturbed(truth, kind, camera, rng, AlignConfig())
    (a, b), _ = camera.project(np.stack([truth.middle, _middle_of(start, truth)]))
    assert np.linalg.norm(a - b) == pytest.approx(kind.shift, rel=1e-6)
    assert rotation_angle(start.T_world_object[:3, :3] @ truth.T_world_object[:3, :3].T) <= kind.yaw
    assert abs(start.scale / truth.scale - 1) <= kind.scale


def _middle_of(moved, original) -> np.ndarray:
    """Where the middle of an object's box went."""
    inverse = np.linalg.inv(original.T_world_asset)
    return (moved.T_world_asset @ inverse @ [*original.middle, 1])[:3]


def test_an_object_rests_in_the_middle_of_its_picture() -> None:
    camera, truth = basin.placed(MESH, np.random.default_rng(0))
    silhouette = full_silhouette(truth, camera)
    assert silhouette.any() and not silhouette[[0, -1]].any() and not silhouette[:, [0, -1]].any()
    assert truth.bounds_world[0, 2] == pytest.approx(0, abs=1e-9)
    assert np.ptp(truth.bounds_world[:, 2]) == pytest.approx(0.1), "it lies on its largest side"


def test_a_card_hides_the_share_it_should() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        camera, truth = basin.placed(MESH, rng)
        mask = full_silhouette(truth, camera)
        (card,) = basin._hiding(truth, mask, camera, 0.3, rng)
        assert np.count_nonzero(mask & card.mask) == pytest.approx(0.3 * np.count_nonzero(mask), rel=0.05)


def test_shifts_beyond_the_bounds_are_told() -> None:
    rng = np.random.default_rng(0)
    camera, truth = basin.placed(MESH, rng)
    beyond = replace(basin.KINDS[0], shift=0.5 * basin.DIAGONAL)
    assert basin.disturbed(truth, basin.KINDS[0], camera, rng, AlignConfig())[1]
    assert not basin.disturbed(truth, beyond, camera, rng, AlignConfig())[1]


@pytest.mark.parametrize("degrees", [-170.0, -20.0, 0.0, 90.0, 179.0])
def test_the_turn_about_the_vertical_is_told_from_a_tilt(degrees: float) -> None:
    axis = np.array([0.0, 0.6, 0.8])
    R = rotation_about(axis, np.radians(degrees))
    assert poses._twist(R, axis) == pytest.approx(abs(degrees), abs=1e-6)
    assert poses._twist(rotation_about([1, 0, 0], 0.1) @ R, axis) == pytest.approx(abs(degrees), abs=1e-6)


def test_the_turn_of_a_bent_copy_is_found() -> None:
    rng = np.random.default_rng(0)
    true = rng.normal(size=(200, 3)) * [1, 2, 3]
    R = rotation_about([1, 2, 3], 2.0)
    asset = 0.3 * (true + 0.02 * rng.normal(size=true.shape)) @ R + 5
    assert rotation_angle(poses.similarity(asset, true)[0] @ R.T) < 0.02
