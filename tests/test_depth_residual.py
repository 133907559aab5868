"""The residual of depth of an object that is pushed back along its viewing rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.levenberg_marquardt import Local
from f3sr.core.transforms import Array, rotation_about, transform
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Geometry, Scene
from f3sr.vision import rasterizer
from f3sr.vision.depth_residual import BEFORE, DepthEvidence
from f3sr.vision.motion_params import ObjectFreedom
from scenes import box, scene_of


def evidence(scene: Scene) -> DepthEvidence:
    """A geometry that shows object 1 where it is."""
    depth = rasterizer.render(scene.objects, scene.camera).depth
    valid = np.isfinite(depth)
    points = np.zeros((*depth.shape, 3), np.float32)
    points[..., 2] = np.where(valid, depth, 0)
    shown = full_silhouette(scene[1], scene.camera)
    return DepthEvidence.of(Geometry(points=points, valid=valid), scene.camera, scene.camera, shown)


@pytest.mark.parametrize("k", [1.0, 1.25, 0.8])
def test_the_median_is_the_logarithm_of_the_factor(k: float) -> None:
    scene = scene_of(box(1, size=(0.3, 0.3, 0.3), at=(0, 0, 0.3)))
    o = scene[1]
    T = scene.camera.homothety(k) @ np.diag([k, k, k, 1.0])
    pushed = replace(o, mesh=o.mesh.with_vertices(transform(T, o.vertices_world)), T_world_object=np.eye(4))
    found = evidence(scene).residual(pushed)
    assert found.median == pytest.approx(np.log(k), abs=1e-5) and found.size == pytest.approx(abs(np.log(k)), abs=1e-5)
    assert found.spread < 1e-5 and found.pixels > 100


@pytest.mark.parametrize(("nearer", "share"), [(0.5 * BEFORE, 0.0), (2 * BEFORE, 1.0)])
def test_what_stands_before_all_that_may_hide_it_is_told_by_its_share(nearer: float, share: float) -> None:
    """A box, of which the photo shows the left half, stands before a plane that is seen where its right half is."""
    o = box(1, size=(0.3, 0.3, 0.3), at=(0, 0, 0.3))
    scene = scene_of(o)
    depth = rasterizer.render([o], scene.camera).depth
    covered = np.isfinite(depth)
    left = covered & (np.arange(covered.shape[1]) < scene.camera.width / 2)
    points = np.zeros((*depth.shape, 3), np.float32)
    points[..., 2] = np.where(left, depth, np.where(covered, depth + nearer * o.size, 0))
    geometry = Geometry(points=points, valid=covered)
    of_both = DepthEvidence.of(geometry, scene.camera, scene.camera, left, covered & ~left).residual(o)
    right = np.count_nonzero(covered & ~left) / np.count_nonzero(covered)
    assert of_both.before == pytest.approx(share * right) and of_both.size < 1e-6
    assert DepthEvidence.of(geometry, scene.camera, scene.camera, left).residual(o).before == 0


def test_nothing_in_common_is_no_evidence() -> None:
    scene = scene_of(box(1, at=(0, 0, 0.3)))
    found = evidence(scene).residual(box(1, at=(0.4, 0, 0.3)))
    assert found.pixels == 0 and found.size == np.inf


def test_the_mismatch_has_the_derivatives_of_its_value() -> None:
    """Of a box that the geometry sees turned otherwise: turns and growth, against differences."""
    scene = scene_of(box(1, size=(0.3, 0.3, 0.3), at=(0, 0, 0.3), R=rotation_about([0.1, 0.2, 1], 0.2)))
    seen = evidence(scene)
    o = box(1, size=(0.3, 0.3, 0.3), at=(0, 0, 0.3))
    middle = o.bounds_world.mean(0)
    free = ObjectFreedom(anchor=middle, basis=scene.camera.T_world_camera[:3, :2], reach=np.ones(6))

    def at(u: Array) -> Local:
        T, s = free.similarity(u)
        moved = o.moved(T, scale=s, stage="test", reason="")
        return seen.mismatch(moved, free.velocities(u, scene.camera), most=1.0)

    here, step = at(np.zeros(6)), 2e-3
    for k in (2, 3, 4):
        u = step * np.eye(6)[k]
        difference = (at(u).value - at(-u).value) / (2 * step)
        assert here.gradient[k] == pytest.approx(difference, rel=0.15, abs=2e-3)
    assert np.linalg.eigvalsh(here.curvature).min() > -1e-9
    true = seen.mismatch(scene[1], free.velocities(np.zeros(6), scene.camera), most=1.0)
    assert true.value < 1e-4 < here.value
