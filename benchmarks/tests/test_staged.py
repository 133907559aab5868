"""Laws of the report's staged search: it goes back to a mask, stays in its bounds and undoes what loses."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

import staged
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.transforms import Array, pose, rotation_about
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Photo, Scene, SceneObject
from f3sr.stages.align import AlignConfig
from f3sr.vision.silhouette import iou
from scenes import box, scene_of

RESOLUTION = 128


def scene() -> Scene:
    """A turned box, with its silhouette as its mask."""
    o = box(0, size=(0.2, 0.1, 0.15), at=(0, 0, 0.2), R=rotation_about([0, 0, 1], 0.5))
    camera = scene_of().camera.resized(256, 192)
    o = replace(o, mask=full_silhouette(o, camera))
    return Scene(photo=Photo(rgb=np.zeros((192, 256, 3), np.uint8)), camera=camera, objects=(o,))


def disturbed(o: SceneObject, *, shift: Array, yaw: float, scale: float) -> SceneObject:
    middle, R = o.middle, rotation_about([0, 0, 1], yaw)
    return o.moved(pose(R, middle + shift - R @ (scale * middle)), scale=scale, stage="test", reason="disturbed")


def aligned(o: SceneObject, scene: Scene):
    return staged.align_object(o, scene.camera, resolution=RESOLUTION)


def test_a_disturbed_object_comes_nearer_to_its_mask() -> None:
    s = scene()
    start = disturbed(s[0], shift=np.array([0.03, 0.0, 0.02]), yaw=math.radians(10), scale=1.1)
    end, decisions = aligned(start, s)
    before, after = (iou(full_silhouette(o, s.camera), s[0].mask) for o in (start, end))
    assert after > before + 0.1
    assert [d.choice.split(":")[0] for d in decisions] == ["translation", "yaw", "scale", "object"]
    assert end.motion[-1].stage == "align"


def test_an_object_that_fits_stays() -> None:
    s = scene()
    end, _ = aligned(s[0], s)
    assert iou(full_silhouette(end, s.camera), s[0].mask) >= iou(full_silhouette(s[0], s.camera), s[0].mask)


def test_what_no_search_can_reach_stays_within_the_bounds() -> None:
    """The mask lies one and a half sizes away."""
    s = scene()
    far = disturbed(s[0], shift=np.array([1.5 * s[0].size, 0, 0]), yaw=0.0, scale=1.0)
    end, _ = aligned(replace(s[0], mask=full_silhouette(far, s.camera)), s)
    moved = np.linalg.norm(end.middle - s[0].middle)
    assert moved <= math.sqrt(2) * staged.SHIFT * s[0].size + 1e-9
    assert abs(end.scale / s[0].scale - 1) <= staged.SCALE + 1e-9


def test_a_phase_that_loses_is_undone_and_earlier_ones_are_kept() -> None:
    """A second phase that must turn to the bound, on an object that needs no turn."""
    s = scene()
    start = disturbed(s[0], shift=np.array([0.05, 0.0, 0.0]), yaw=0.0, scale=1.0)
    fit = staged.staged_fit(start, s.camera, resolution=RESOLUTION)
    away = staged.Phase(name="away", freedoms=(2,), seeds=1, steps=1, rate=0.0)
    u, decisions = staged.staged(fit, phases=(staged.PHASES[0], away))
    assert "accepted" in decisions[0].choice and "rolled back" in decisions[1].choice
    assert u[:2].any() and u[2] == 0


def test_adam_finds_the_middle_of_a_bowl_and_the_best_of_a_box() -> None:
    ones = np.ones(2)
    for middle, expected in (([0.3, -0.2], [0.3, -0.2]), ([2.0, -3.0], [1.0, -1.0])):
        objective = partial(bowl, np.array(middle))
        found = staged.adam(objective, 0 * ones, bounds=(-ones, ones), rate=0.05 * ones, steps=200)
        assert np.allclose(found.x, expected, atol=1e-2)


def bowl(middle: Array, x: Array) -> Local:
    return Local(value=float((x - middle) @ (x - middle)), gradient=2 * (x - middle), curvature=2 * np.eye(2))


def test_the_stage_goes_back_to_the_mask_and_keeps_the_mesh() -> None:
    s = scene()
    start = disturbed(s[0], shift=np.array([0.03, 0.0, 0.02]), yaw=math.radians(10), scale=1.1)
    end, outcome = staged.align(s.with_objects(start), AlignConfig(camera=False))
    assert end[0].mesh is start.mesh
    assert iou(full_silhouette(end[0], s.camera), s[0].mask) > iou(full_silhouette(start, s.camera), s[0].mask) + 0.1
    assert [d.choice.split(":")[0] for d in outcome.decisions[-4:]] == ["translation", "yaw", "scale", "object"]
