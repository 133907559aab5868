"""A camera of its own for a scene that f3sr did not align: fitted inside bounds to the scene's mean mask IoU."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local, minimise
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array, rotation_angle
from f3sr.metrics.measures import full_silhouette
from f3sr.report import Decision
from f3sr.scene import Scene
from f3sr.settings import settings
from f3sr.vision.decimated import outlined
from f3sr.vision.motion_params import CameraFreedom
from f3sr.vision.silhouette import Surface, Target, iou, loss
from f3sr.vision.silhouette_integrals import AREA, MISMATCH, Integrals

Term = Callable[[Integrals, Target], Local]
"""What one object adds to the objective."""


MAX_FACES = 40_000
"""Most faces of a mesh in the search; larger meshes are simplified."""
ITERATIONS = 40
"""Most steps of each of the two searches."""


@settings
class ForeignCameraConfig:
    """Bounds of the search for a camera of a scene that f3sr did not align."""

    max_rotation: Annotated[float, Interval(gt=0, le=np.pi / 4)] = math.radians(10)
    """Largest turn of the camera about the scene's middle, per axis [rad]. Twelve raw scenes asked for at most .08."""
    max_translation: Annotated[float, Interval(gt=0, le=0.5)] = 0.2
    """Largest move of the camera per axis [share of its distance]. Twelve raw scenes asked for at most .04."""
    resolution: Annotated[int, Interval(ge=64, le=4096)] = 512
    """Longer side of the image of the search [px]. The result is judged at the photo's own resolution."""


def fitted_camera(
    scene: Scene, config: ForeignCameraConfig | None = None, *, max_faces: int = MAX_FACES
) -> tuple[Camera, Decision]:
    """The camera that fits the scene's objects to their masks best, inside bounds around its own, and a Decision.

    Intrinsics are fixed. A camera with a lower mean IoU of full silhouettes (at the photo's pixel centres) is rejected.

    First every object's loss (equation 9 without priors), which pulls from afar, then 1 - IoU itself.
    """
    config = config or ForeignCameraConfig()
    fit = _fit(scene, config, max_faces)
    if not fit.targets:
        return scene.camera, Decision(
            choice="camera as given", reason="no object has a mask to fit it to", fallback=True
        )
    given = np.zeros(6)
    pulled = fit.best(given, loss, iterations=ITERATIONS)
    # 1 - IoU is flat where silhouette and mask are apart: the first search brings them together.
    near = fit.without_distances()
    start = min((given, pulled), key=lambda u: near.objective(u, iou_loss).value)
    polished = near.best(start, iou_loss, iterations=ITERATIONS)
    cameras = [scene.camera, *(scene.camera.moved(fit.freedom.at(u).T_world_camera) for u in (pulled, polished))]
    scores = [mean_iou(scene, camera) for camera in cameras]
    best = int(np.argmax(scores))
    reason = f"mIoU {scores[0]:.4f} -> {max(scores[1:]):.4f}"
    if best == 0:
        return scene.camera, Decision(choice="camera as given", reason=f"{reason}, fitted")
    return cameras[best], Decision(
        choice="camera fitted", reason=f"{reason}, {_way(scene, cameras[best], fit.freedom)}"
    )


def mean_iou(scene: Scene, camera: Camera) -> float:
    """Mean IoU of full silhouettes with the masks, as ``camera`` sees the scene; an excluded mask counts 0."""
    return sum(iou(full_silhouette(o, camera), o.mask) for o in scene) / (len(scene.objects) + len(scene.excluded))


@dataclass(frozen=True, eq=False, kw_only=True)
class InstancesFit:
    """Every object against its own mask, the mean over objects, over the parameters u (6,) of a camera's freedom."""

    surfaces: tuple[Surface, ...]
    targets: tuple[Target, ...]
    freedom: CameraFreedom

    def without_distances(self) -> InstancesFit:
        """The same where a silhouette pays alike for every pixel outside its mask, near or far."""
        return replace(self, targets=tuple(replace(t, pulls=False) for t in self.targets))

    def objective(self, u: Array, term: Term) -> Local:
        """The mean of ``term`` over objects at u (6,), with derivatives by u."""
        camera, velocities = self.freedom.at(u), self.freedom.velocities(u)
        terms = [
            term(surface.integrals(camera, target.fields, velocities), target)
            for surface, target in zip(self.surfaces, self.targets, strict=True)
        ]
        return Local(
            value=float(np.mean([t.value for t in terms])),
            gradient=np.mean([t.gradient for t in terms], axis=0),
            curvature=np.mean([t.curvature for t in terms], axis=0),
        )

    def best(self, start: Array, term: Term, *, iterations: int) -> Array:
        """Parameters (6,) of the least objective near ``start`` (6,), after at most ``iterations`` steps."""
        ones = np.ones(6)
        return minimise(lambda u: self.objective(u, term), start, bounds=(-ones, ones), iterations=iterations).x


def iou_loss(integrals: Integrals, target: Target) -> Local:
    """1 - IoU with its derivatives: with areas A of the silhouette and M of the mask and L the area where only one is,
    IoU = (A + M - L) / (A + M + L). The curvature is that of L alone. ``target`` is one without distances, so that its
    mismatch is L - M."""
    # value = 1 - (both - L) / total = 2 L / total; derivatives by the quotient rule.
    A, dA = float(integrals.value[AREA]), integrals.gradient[AREA]
    L, dL = target.area + float(integrals.value[MISMATCH]), integrals.gradient[MISMATCH]
    both, total = A + target.area, A + target.area + L
    return Local(
        value=2 * L / total,
        gradient=2 * (both * dL - L * dA) / total**2,
        curvature=2 * both / total**2 * integrals.curvature,
    )


def _fit(scene: Scene, config: ForeignCameraConfig, max_faces: int) -> InstancesFit:
    """The problem at the search's resolution, without objects whose masks have no pixel there."""
    small = scene.camera.limited(config.resolution)
    masks = [(o, resample(o.mask, small.width, small.height)) for o in scene]
    shown = [(outlined(o, max_faces), mask) for o, mask in masks if mask.any()]
    middle = np.median([o.middle for o in scene], axis=0)
    center = scene.camera.to_camera(middle[None])[0]
    shift = config.max_translation * float(np.linalg.norm(center))
    return InstancesFit(
        surfaces=tuple(Surface.of([(o.vertices_world, o.mesh.faces)]) for o, _ in shown),
        targets=tuple(Target.of(mask) for _, mask in shown),
        freedom=CameraFreedom(camera=small, center=center, reach=np.array([config.max_rotation] * 3 + [shift] * 3)),
    )


def _way(scene: Scene, camera: Camera, freedom: CameraFreedom) -> str:
    """How far a camera is from the scene's own, in words."""
    T = scene.camera.T_camera_world @ camera.T_world_camera
    way = float(np.linalg.norm(T[:3, 3])) / float(np.linalg.norm(freedom.center))
    return f"turned {math.degrees(rotation_angle(T[:3, :3])):.2f} deg, moved {100 * way:.2f}% of its distance"
