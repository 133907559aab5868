"""align: the camera, then every object, moved so that rendered silhouettes meet the photo's masks."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import field, replace
from typing import Annotated, Literal
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval, Len

from f3sr import raster
from f3sr.devices import Device, results_of
from f3sr.facets import resting_turn
from f3sr.frames import Array, Camera, pose
from f3sr.freedom import CameraFreedom, ObjectFreedom
from f3sr.mesh import Mesh, mass_properties
from f3sr.report import Decision, Measure, Report, keep_better
from f3sr.scene import Scene, SceneObject
from f3sr.settings import settings
from f3sr.silhouette import LossWeights, Mask, Surface, Target, iou, resample, union_of
from f3sr.silhouette_fit import CameraFit, FitSearch, ObjectFit, object_fit
from f3sr.visibility import nearer_objects, visible_region

Turn = Annotated[float, Interval(ge=-np.pi, le=np.pi)]
Weight = Annotated[float, Interval(ge=0, le=10)]


@settings
class AlignConfig:
    resolution: Annotated[int, Interval(ge=64, le=4096)] = 384
    """Longer side [px] of the image the camera is refined in, and of the window around one object."""
    camera: bool = True
    """Refine the camera first."""
    objects: bool = True
    """Refine the objects."""
    freedom: Literal["image", "support"] = "image"
    """Objects shift in the image plane and scale about their middle (equation 8), or, where they already rest, shift
    horizontally and scale about the middle of their base, so that they stay on their support."""
    max_tilt: Annotated[float, Interval(ge=0, le=np.pi / 2)] = math.radians(25)
    """An object is tried on its nearest stable facet when that is within this turn [rad]; 0: never.
    Generated poses tilt by up to twenty degrees; the picture guards what is turned."""
    tilt_loss: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """IoU that standing on a facet may cost: physics would turn the object there anyway."""
    max_faces: Annotated[int, Interval(ge=1000, le=10_000_000)] = 40_000
    """Larger meshes are simplified to as many faces for the search."""
    camera_rotation: Annotated[float, Interval(gt=0, le=np.pi / 4)] = math.radians(1)
    """Trust region of the camera's turn per axis [rad]. The ground tells gravity to half a degree
    (.34 in the mean of ten known scenes); three degrees of freedom here made that 1.2 and gained .002 mIoU."""
    camera_translation: Annotated[float, Interval(gt=0, le=0.5)] = 0.05
    """Trust region of the camera's move, as a share of its distance to the scene."""
    camera_iterations: Annotated[int, Interval(ge=1, le=1000)] = 25
    """Steps tried by the camera's search."""
    camera_prior: Annotated[float, Interval(ge=0, le=10)] = 0.01
    """Quadratic prior on the camera's motion over its trust region."""
    yaw_seeds: Annotated[tuple[Turn, ...], Len(1, 64)] = tuple(math.radians(a) for a in (-30, -15, 0, 15, 30))
    """Turns about the vertical that a search starts from [rad]."""
    max_shift: Annotated[float, Interval(gt=0, le=2)] = 0.35
    """Largest move in the image plane, as a share of the object's size; the report's bound."""
    max_yaw: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(45)
    """Largest turn about the vertical [rad]."""
    max_scale: Annotated[float, Interval(gt=0, lt=1)] = 0.25
    """Largest change of scale; the report's bound."""
    polish_tilt: Annotated[float, Interval(ge=0, le=np.pi / 4)] = 0.0
    """Largest tilt about each horizontal axis [rad]."""
    kept_seeds: Annotated[int, Interval(ge=1, le=64)] = 3
    """Seeds that are refined, the best first."""
    iterations: Annotated[int, Interval(ge=1, le=1000)] = 16
    """Steps tried by the final search; each seed gets half of them."""
    prior: tuple[Weight, Weight, Weight, Weight, Weight, Weight] = (0.01, 0.01, 0.02, 0.02, 0.02, 0.02)
    """Quadratic priors on the shifts, yaw, two tilts and scale, each over its bound."""
    iou_tolerance: Annotated[float, Interval(ge=0, le=0.1)] = 0.0
    """IoU an accepted step may lose."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Of the loss that silhouettes are compared by."""
    device: Device = "auto"
    """Where objects are compared with their masks: the CPU's kernels, a GPU through torch, torch on the CPU (a check,
    slower), or what works best here."""


def align(
    scene: Scene, config: AlignConfig | None = None, *, only: Collection[int] | None = None
) -> tuple[Scene, Report]:
    """Refine the camera against the union of masks (equation 7), then each object from that camera (8, 9).

    Every step is kept only if its IoU does not drop. An object is compared only where nearer objects leave it visible.
    ``only`` names the objects to refine, all by default.
    """
    config = config or AlignConfig()
    full, scene = scene, scene.with_objects(*(_outlined(o, config.max_faces) for o in scene))
    decisions: list[Decision] = []
    before = _ious(scene, config)
    if config.camera:
        scene, decision = _align_camera(scene, config)
        decisions.append(decision)
    if config.objects:
        nearer = nearer_objects(scene)

        def search(o: SceneObject) -> FitSearch[tuple[SceneObject, list[Decision]]]:
            return (yield from _align_object(o, visible_region(o, nearer[o.id]), scene.camera, config))

        chosen = [o for o in scene if only is None or o.id in only]
        results, told = results_of(map(search, chosen), config.device)
        decisions += told
        scene = scene.with_objects(*(o for o, _ in results))
        decisions += [d for _, several in results for d in several]
    after = _ious(scene, config)
    measures = [
        Measure(name="mask IoU", before=b, after=a, about=o.id) for o, b, a in zip(scene, before, after, strict=True)
    ]
    mean = Measure(name="mean mask IoU", before=float(np.mean(before)), after=float(np.mean(after)))
    scene = scene.with_objects(*(replace(o, mesh=full[o.id].mesh) for o in scene))
    return scene, Report(stage="align", measures=(mean, *measures), decisions=tuple(decisions))


_OUTLINES: WeakKeyDictionary[Mesh, dict[int, Mesh]] = WeakKeyDictionary()


def _outlined(o: SceneObject, max_faces: int) -> SceneObject:
    """The object with a mesh light enough to draw hundreds of times; its silhouette is all that is compared."""
    if len(o.mesh.faces) <= max_faces:
        return o
    known = _OUTLINES.setdefault(o.mesh, {})
    if max_faces not in known:
        known[max_faces] = _simplified(o.mesh, max_faces)
    return replace(o, mesh=known[max_faces])


def _simplified(mesh: Mesh, max_faces: int) -> Mesh:
    import fast_simplification

    vertices, faces = mesh.welded
    light = fast_simplification.simplify(vertices, faces, target_count=max_faces)
    return Mesh(vertices=np.asarray(light[0], float), faces=np.asarray(light[1], np.int32))


# --- the camera ---------------------------------------------------------------------------------------------------


def _align_camera(scene: Scene, config: AlignConfig) -> tuple[Scene, Decision]:
    """6-DoF camera about the scene's centre, intrinsics fixed (equation 7), accepted on the mean IoU of instances."""
    small = scene.camera.limited(config.resolution)
    masks = (resample(o.mask, small.width, small.height) for o in scene)
    union = union_of(masks, (small.height, small.width))
    target = Target.of(union, weights=replace(config.weights, centroid=0.0, area=0.0))
    center = scene.camera.to_camera(np.mean([o.bounds_world.mean(0) for o in scene], axis=0)[None])[0]
    reach = np.array([config.camera_rotation] * 3 + [config.camera_translation * float(np.linalg.norm(center))] * 3)
    fit = CameraFit(
        surface=Surface.of([(o.vertices_world, o.mesh.faces) for o in scene]),
        target=target,
        freedom=CameraFreedom(camera=small, center=center, reach=reach),
        prior=config.camera_prior,
    )
    found = fit.best(iterations=config.camera_iterations)
    moved = replace(scene, camera=scene.camera.moved(found.T_world_camera))
    return keep_better(
        scene, moved, score=lambda s: float(np.mean(_ious(s, config))), step="camera", measure="mean mask IoU",
        tolerance=config.iou_tolerance,
    )  # fmt: skip


# --- objects ------------------------------------------------------------------------------------------------------


def _align_object(
    o: SceneObject, valid: Mask, camera: Camera, config: AlignConfig
) -> FitSearch[tuple[SceneObject, list[Decision]]]:
    """The object where its silhouette fits its mask best, standing on a facet where that is near and fits."""
    fit = _fit(o, valid, camera, config)
    kept, decision = keep_better(
        np.zeros(6), (yield from _best(fit, config)), score=fit.iou, step="object", measure="valid mask IoU",
        tolerance=config.iou_tolerance, about=o.id,
    )  # fmt: skip
    turn = _resting_turn(o, config)
    if turn is None:
        return _applied(o, fit, kept, decision), [decision]
    turned = o.moved(turn, stage="align", reason="onto its nearest stable facet")
    standing = _fit(turned, valid, camera, config)
    best = yield from _best(standing, config)
    (chosen, fit, x), tilt = keep_better(
        (o, fit, kept), (turned, standing, best), score=lambda c: c[1].iou(c[2]), step="onto a stable facet",
        measure="valid mask IoU", tolerance=config.tilt_loss, about=o.id,
    )  # fmt: skip
    return _applied(chosen, fit, x, decision), [decision, tilt]


def _fit(o: SceneObject, valid: Mask, camera: Camera, config: AlignConfig) -> ObjectFit:
    freedom = _freedom(o, camera, config)
    return object_fit(
        o, valid, camera, freedom, resolution=config.resolution, weights=config.weights, prior=config.prior
    )


def _best(fit: ObjectFit, config: AlignConfig) -> FitSearch[Array]:
    found = yield from fit.best(config.yaw_seeds, kept=config.kept_seeds, iterations=config.iterations)
    if config.polish_tilt:
        found = yield from fit.refined(found.x, iterations=config.iterations, tilt=True)
    return found.x


def _freedom(o: SceneObject, camera: Camera, config: AlignConfig) -> ObjectFreedom:
    low, high = o.bounds_world
    middle = (low + high) / 2
    shift = config.max_shift * o.size
    in_image = config.freedom == "image"
    return ObjectFreedom(
        anchor=middle if in_image else np.array([middle[0], middle[1], low[2]]),
        basis=camera.T_world_camera[:3, :2] if in_image else np.eye(3)[:, :2],
        reach=np.array([shift, shift, config.max_yaw, config.polish_tilt, config.polish_tilt, config.max_scale]),
    )


def _resting_turn(o: SceneObject, config: AlignConfig) -> Array | None:
    """The world pose change (4, 4) about the object's middle that puts it on its nearest stable facet, if near."""
    if not config.max_tilt:
        return None
    hull = o.mesh.hull
    solid = o.mesh.welded if o.mesh.is_solid else (hull.vertices, hull.faces)
    R = resting_turn(hull, mass_properties(*solid).center, o.T_world_object[:3, :3], max_tilt=config.max_tilt)
    middle = o.bounds_world.mean(0)
    return None if R is None else pose(R, middle - R @ middle)


def _applied(o: SceneObject, fit: ObjectFit, x: Array, decision: Decision) -> SceneObject:
    if not x.any():
        return o
    T, s = fit.freedom.similarity(x)
    return o.moved(T, scale=s, stage="align", reason=decision.reason)


# --- shared -------------------------------------------------------------------------------------------------------


def _ious(scene: Scene, config: AlignConfig) -> Sequence[float]:
    """IoU of each object's full silhouette with its mask, at the working resolution."""
    camera = scene.camera.limited(config.resolution)
    return [
        iou(
            raster.silhouette(camera.to_camera(o.vertices_world), o.mesh.faces, camera.K, camera.width, camera.height),
            resample(o.mask, camera.width, camera.height),
        )
        for o in scene
    ]
