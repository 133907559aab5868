"""Where alignments start: in closed form, or at the shift of all that covers the visible mask best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Scene, SceneObject
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.silhouette import LossWeights
from f3sr.vision.silhouette_fit import ObjectFit, object_fit
from scenes import box, scene_of

REACH = np.array([0.3, 0.3, 1.0, 0, 0, 0.5])


def shown() -> Scene:
    scene = scene_of(box(0, size=(0.2, 0.15, 0.25), at=(0, 0.2, 0.3)))
    return replace(scene, camera=scene.camera.resized(640, 480))


def freedom(scene: Scene, o: SceneObject) -> ObjectFreedom:
    basis = scene.camera.T_world_camera[:3, :2]
    return ObjectFreedom(anchor=o.bounds_world.mean(0), basis=basis, reach=REACH)


def fit_to(u: np.ndarray, *, hidden: tuple[slice, ...] = ()) -> ObjectFit:
    """The box against the mask of itself, moved by ``u``; pixels that are ``hidden`` are not compared."""
    scene = shown()
    o = scene[0]
    T, s = freedom(scene, o).similarity(u)
    mask = full_silhouette(o.moved(T, scale=s, stage="test", reason=""), scene.camera)
    o = replace(o, mask=mask)
    valid = np.ones_like(mask)
    if hidden:
        valid[hidden] = False
    return object_fit(
        o, valid, scene.camera, freedom(scene, o), resolution=256, weights=LossWeights(), prior=np.zeros(6)
    )


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.3])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.1, -0.05)])
def test_the_seed_finds_shift_and_scale(scale: float, shift: tuple[float, float]) -> None:
    u = np.array([*shift, 0, 0, 0, scale - 1]) / np.where(REACH, REACH, 1)
    fit = fit_to(u)
    assert REACH * fit.seed(0.0) == pytest.approx(REACH * u, abs=0.01)
    assert fit.iou(fit.seed(0.0)) > 0.95


def test_the_seed_has_the_yaw_it_was_given_and_stays_in_the_box() -> None:
    fit = fit_to(np.array([1.0, 1.0, 0, 0, 0, 1.0]))
    far = replace(fit, freedom=replace(fit.freedom, reach=np.array([0.1, 0.1, 1.0, 0, 0, 0.1])))
    assert fit.seed(0.3)[2] == pytest.approx(0.3)
    assert np.abs(far.seed(0.0)).max() == 1.0


@pytest.mark.parametrize("hidden", [np.s_[:, :350], np.s_[240:, :], np.s_[::40]], ids=["left", "below", "stripes"])
def test_where_part_of_the_mask_is_hidden_the_overlap_finds_the_shift(hidden: tuple[slice, ...]) -> None:
    """Centroid and area of what shows are not the object's. The silhouette is a pixel, 2 mm, off."""
    u = np.array([0.1, -0.05, 0, 0, 0, 0.1]) / np.where(REACH, REACH, 1)
    fit = fit_to(u, hidden=hidden)
    visible = fit.target.mask & fit.target.valid
    assert 0.3 < np.count_nonzero(visible) / np.count_nonzero(fit.target.mask) < 1
    (found,) = fit.seeds_by_overlap([0.0], [1.1])
    assert REACH * found == pytest.approx(REACH * u, abs=0.004)
    assert fit.iou(found) > 0.95


def test_no_shift_by_whole_pixels_costs_less_than_that_of_the_overlap() -> None:
    fit = fit_to(np.array([0.2, 0.1, 0.1, 0, 0, -0.2]), hidden=np.s_[200:260, 280:])
    shown, cost = fit.silhouette(np.array([0, 0, 0.1, 0, 0, -0.2])), fit.target.fields.mismatch
    padded = np.pad(cost, max(cost.shape), constant_values=1.0)
    windows = np.lib.stride_tricks.sliding_window_view(padded, cost.shape)
    least = min(float((w * shown).sum()) for row in windows[::4] for w in row[::4])
    (u,) = fit.seeds_by_overlap([0.1 * REACH[2]], [1 - 0.2 * REACH[5]])
    assert float((cost * fit.silhouette(u)).sum()) <= least + 0.02 * np.count_nonzero(shown)


def test_the_overlap_keeps_within_bounds() -> None:
    fit = fit_to(np.array([1.0, 1.0, 0, 0, 0, 1.0]))
    near = replace(fit, freedom=replace(fit.freedom, reach=np.array([0.1, 0.1, 1.0, 0, 0, 0.1])))
    seeds = near.seeds_by_overlap([2.0, 0.3], [3.0, 1.0])
    assert np.abs(seeds).max() <= 1.0
    assert [u[2] for u in seeds] == pytest.approx([1.0, 1.0, 0.3, 0.3])


def test_distances_to_the_mask_are_found_for_a_search_only_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found, measure = list[np.ndarray](), ndimage.distance_transform_edt

    def noted(mask: np.ndarray) -> np.ndarray:
        found.append(mask)
        return measure(mask)

    monkeypatch.setattr(ndimage, "distance_transform_edt", noted)
    fit = fit_to(np.zeros(6))
    assert fit.iou(np.zeros(6)) > 0.98 and not found
    near = replace(fit, target=replace(fit.target, pulls=False))
    for _ in range(2):
        far, flat = fit.target.fields, near.target.fields
    assert len(found) == 2, "inside and outside, for both"
    outside = ~fit.target.mask
    assert (far.mismatch[outside] > 1).all() and (flat.mismatch[outside] == 1).all()
    assert np.array_equal(far.stiffness, flat.stiffness)
    assert np.array_equal(far.mismatch[~outside], flat.mismatch[~outside])
