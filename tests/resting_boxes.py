"""A package of four boxes at rest, which the photo shows: small enough to be edited in every test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.scene import Support
from f3sr.scene_package.package import Package, read_package, write_package
from f3sr.stages.settle import settle
from f3sr.vision import rasterizer
from scenes import box, scene_of

MARGIN = 3.2e-4
"""[m] between bodies at rest."""


def resting_boxes(folder: Path) -> Package:
    """A box (1) on a box (0), one (2) far from both, and one (3) beside them, at rest; the photo shows them."""
    objects = (
        box(0, size=(0.12, 0.12, 0.08), at=(0, 0, 0.04 + MARGIN), label="crate"),
        replace(
            box(1, size=(0.06, 0.06, 0.06), at=(0.01, 0, 0.11 + 2 * MARGIN), label="cube"),
            supports=(Support(id=0),),
            supported_by=0,
        ),
        box(2, size=(0.1, 0.06, 0.05), at=(0.3, 0.1, 0.025 + MARGIN), label="brick"),
        box(3, size=(0.05, 0.05, 0.09), at=(-0.2, 0, 0.045 + MARGIN), label="tall box"),
    )
    scene, rested = settle(scene_of(*objects))
    assert rested.at_rest
    camera = replace(scene.camera.resized(320, 240), T_world_camera=scene.camera.T_world_camera)
    photo = replace(scene.photo, rgb=np.zeros((240, 320, 3), np.uint8))
    seen = rasterizer.render(scene.objects, camera)
    scene = replace(scene, camera=camera, photo=photo, objects=tuple(replace(o, mask=seen.ids == o.id) for o in scene))
    known = {o.id: PoseUncertainty.of(np.eye(7) * 1e-6, np.eye(7) * 1e-6, np.array([0.0, 1, 0])) for o in scene}
    return read_package(write_package(scene, folder, uncertainty=known, metrics={"mIoU": 0.5}))
