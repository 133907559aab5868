"""The camera against the union of all masks (equation 7), guarded by the instances and by the geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.core.transforms import transform
from f3sr.report import Decision
from f3sr.scene import Geometry, Scene
from f3sr.stages.align.config import AlignConfig
from f3sr.vision.crop import sampled
from f3sr.vision.depth_residual import DepthEvidence
from f3sr.vision.ground_plane import POSE_LEAN
from f3sr.vision.motion_params import CameraFreedom
from f3sr.vision.silhouette import LossWeights, Surface, Target, union_of
from f3sr.vision.silhouette_fit import CameraFit

ITERATIONS = 25
"""Most steps of the search for the camera."""
PRIOR = 0.01
"""Quadratic prior on the camera's motion over its bounds: masks without evidence leave the camera where it is."""
FOCAL_RANGE = 0.1
"""Largest change of the logarithm of the focal length."""
EVIDENCE = 192
"""Longer side [px] of the image in which depths are compared with the geometry."""

Score = Callable[[Scene], float]


def align_camera(scene: Scene, config: AlignConfig, *, score: Score) -> tuple[Scene, list[Decision]]:
    """Six degrees of freedom about the scene's centre, then, where that is wanted, the focal length with them.

    Tilt is free only where the ground is less sure of it than the objects together: their poses lean, each on its own.
    Each step is kept on two conditions. ``score``, the mIoU of the instances, does not drop. The geometry, which is
    fixed to the camera, fits the objects no worse than before; for the focal length, the ground too.
    """
    moved = _with(scene, _fitted(scene, config, focal=False))
    scene, decision = _judged(scene, moved, score, focal=False)
    if not config.camera_step.focal:
        return scene, [decision]
    zoomed = _with(scene, _fitted(scene, config, focal=True))
    scene, focal = _judged(scene, zoomed, score, focal=True)
    return scene, [decision, focal]


def _fitted(scene: Scene, config: AlignConfig, *, focal: bool) -> Camera:
    step = config.camera_step
    small = scene.camera.limited(config.resolution)
    masks = (resample(o.mask, small.width, small.height) for o in scene)
    union = union_of(masks, (small.height, small.width))
    center = small.to_camera(np.mean([o.middle for o in scene], axis=0)[None])[0]
    shift = step.translation * float(np.linalg.norm(center))
    ground, by_objects = scene.ground, POSE_LEAN / np.sqrt(len(scene.objects))
    tilt = min(step.rotation, ground.tilt_error) if ground.tilt_error > 2 * by_objects else 0.0
    height = min(shift, ground.height_error)
    reach = [tilt, tilt, step.rotation, shift, shift, height] + [FOCAL_RANGE] * focal
    fit = CameraFit(
        surface=Surface.of([(o.vertices_world, o.mesh.faces) for o in scene]),
        target=Target.of(union, weights=LossWeights(centroid=0.0, area=0.0)),
        freedom=CameraFreedom(camera=small, center=center, reach=np.array(reach), axes=small.T_camera_world[:3, :3]),
        prior=PRIOR,
    )
    return fit.best(iterations=ITERATIONS).resized(scene.camera.width, scene.camera.height)


def _with(scene: Scene, camera: Camera) -> Scene:
    """The scene seen by another camera; its geometry keeps its depths and goes with the focal length."""
    zoom = camera.K[0, 0] / scene.camera.K[0, 0]
    geometry = scene.geometry.zoomed(zoom) if scene.geometry and zoom != 1 else scene.geometry
    return replace(scene, camera=camera, geometry=geometry)


@dataclass(frozen=True, kw_only=True)
class _Agreement:
    """The instances' mean IoU, and how far the geometry is off: depths of objects as a share of the distance, its
    ground from z = 0 [m]; 0 where nothing is known."""

    iou: float
    depth: float
    ground: float


def _judged(scene: Scene, moved: Scene, score: Score, *, focal: bool) -> tuple[Scene, Decision]:
    """The better of two scenes; a ``focal`` length must gain, and leave the ground where it is."""
    was, now = (_Agreement(iou=score(s), depth=_depth_residual(s), ground=_ground_residual(s)) for s in (scene, moved))
    is_better = now.iou >= was.iou and now.depth <= was.depth
    if focal:
        is_better = is_better and now.iou > was.iou and now.ground <= was.ground
    decision = Decision(
        choice=f"{'focal length' if focal else 'camera'}: {'accepted' if is_better else 'rolled back'}",
        reason=f"mean mask IoU {was.iou:.4f} -> {now.iou:.4f}, median depth residual {was.depth:.4f} -> {now.depth:.4f}"
        f" of the distance, ground {1000 * was.ground:.1f} -> {1000 * now.ground:.1f} mm off",
    )
    return (moved if is_better else scene), decision


def _depth_residual(scene: Scene) -> float:
    """The median over objects of how far their depths are from the geometry's."""
    if not scene.geometry:
        return 0.0
    small = scene.camera.limited(EVIDENCE)
    sizes: list[float] = []
    for o in scene:
        shown = sampled(o.mask, scene.camera, small, fill=False)
        sizes.append(DepthEvidence.of(scene.geometry, scene.camera, small, shown).residual(o).size)
    known = [size for size in sizes if np.isfinite(size)]
    return float(np.median(known)) if known else 0.0


def _ground_residual(scene: Scene) -> float:
    """The median distance of the geometry's ground points from z = 0 [m]."""
    geometry: Geometry | None = scene.geometry
    if not geometry or scene.ground_mask is None:
        return 0.0
    points = geometry.points[geometry.inside(scene.ground_mask)].astype(float)
    return float(np.median(np.abs(transform(scene.camera.T_world_camera, points)[:, 2]))) if len(points) else 0.0
