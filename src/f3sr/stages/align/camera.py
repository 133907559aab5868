"""The camera against the union of all masks (equation 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from f3sr.freedom import CameraFreedom
from f3sr.report import Decision, keep_better
from f3sr.scene import Scene
from f3sr.silhouette import Surface, Target, resample, union_of
from f3sr.silhouette_fit import CameraFit
from f3sr.stages.align.config import AlignConfig


def align_camera(scene: Scene, config: AlignConfig, *, score: Callable[[Scene], float]) -> tuple[Scene, Decision]:
    """Six degrees of freedom about the scene's centre, intrinsics fixed, accepted on ``score``, the instances' mIoU."""
    step = config.camera_step
    small = scene.camera.limited(config.resolution)
    masks = (resample(o.mask, small.width, small.height) for o in scene)
    union = union_of(masks, (small.height, small.width))
    center = small.to_camera(np.mean([o.bounds_world.mean(0) for o in scene], axis=0)[None])[0]
    distance = float(np.linalg.norm(center))
    fit = CameraFit(
        surface=Surface.of([(o.vertices_world, o.mesh.faces) for o in scene]),
        target=Target.of(union, weights=replace(config.weights, centroid=0.0, area=0.0)),
        freedom=CameraFreedom(
            camera=small, center=center, reach=np.array([step.rotation] * 3 + [step.translation * distance] * 3)
        ),
        prior=step.prior,
    )
    found = fit.best(iterations=step.iterations)
    moved = replace(scene, camera=scene.camera.moved(found.T_world_camera))
    return keep_better(
        scene, moved, score=score, step="camera", measure="mean mask IoU", tolerance=config.iou_tolerance
    )
