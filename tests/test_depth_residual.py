"""The residual of depth of an object that is pushed back along its viewing rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.transforms import transform
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Geometry, Scene
from f3sr.vision import rasterizer
from f3sr.vision.depth_residual import DepthEvidence
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


def test_nothing_in_common_is_no_evidence() -> None:
    scene = scene_of(box(1, at=(0, 0, 0.3)))
    found = evidence(scene).residual(box(1, at=(0.4, 0, 0.3)))
    assert found.pixels == 0 and found.size == np.inf
