"""align: the camera, then every object, moved so that rendered silhouettes meet the photo's masks."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval, Len

from f3sr import raster
from f3sr.facets import resting_turn
from f3sr.frames import Array, Camera, invert_pose, pose, rotation_about, rotation_from_vector, transform
from f3sr.mesh import Mesh, mass_properties
from f3sr.report import Decision, Measure, Report, keep_better
from f3sr.scene import Scene, SceneObject
from f3sr.settings import settings
from f3sr.silhouette import LossWeights, Mask, Target, centroid, iou, loss, resample, union_of

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
    camera_evaluations: Annotated[int, Interval(ge=10, le=10000)] = 120
    """Loss evaluations of the camera's search."""
    yaw_seeds: Annotated[tuple[Turn, ...], Len(1, 64)] = tuple(math.radians(a) for a in (-30, -15, 0, 15, 30))
    """Turns about the vertical that a search starts from [rad]."""
    max_shift: Annotated[float, Interval(gt=0, le=2)] = 0.35
    """Largest move in the image plane, as a share of the object's size; the report's bound."""
    max_yaw: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(45)
    """Largest turn about the vertical [rad]."""
    max_scale: Annotated[float, Interval(gt=0, lt=1)] = 0.25
    """Largest change of scale; the report's bound."""
    evaluations: Annotated[int, Interval(ge=10, le=10000)] = 120
    """Loss evaluations per object after the seeds."""
    prior: tuple[Weight, Weight, Weight, Weight] = (0.01, 0.01, 0.02, 0.02)
    """Quadratic priors on shift (over max_shift), yaw (over max_yaw) and scale (over max_scale)."""
    iou_tolerance: Annotated[float, Interval(ge=0, le=0.1)] = 0.0
    """IoU an accepted step may lose."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Of the loss that silhouettes are compared by."""


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

        def work(o: SceneObject) -> tuple[SceneObject, list[Decision]]:
            return _align_object(o, visible_region(o, nearer[o.id]), scene.camera, config)

        with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
            results = list(pool.map(work, [o for o in scene if only is None or o.id in only]))
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


def nearer_objects(scene: Scene) -> dict[int, list[SceneObject]]:
    """Per object, those that may hide it: told by the rendered depths where two objects overlap in the picture, else by
    their median depths. Two that cannot be ordered may hide each other."""
    small = scene.camera.limited(384)
    depths = {o.id: raster.render([o], small).depth for o in scene}
    return {o.id: [p for p in scene if p.id != o.id and _nearer(depths[p.id], depths[o.id])] for o in scene}


def visible_region(o: SceneObject, nearer: Iterable[SceneObject]) -> Mask:
    """The pixels (H, W) where an object's silhouette must agree with its mask: not in a nearer object's mask."""
    return ~union_of((p.mask for p in nearer), o.mask.shape)


def _nearer(a: Array, b: Array) -> bool:
    """Whether depth image a (h, w) lies in front of b, inf where empty; True when unsure."""
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) > 20:
        return bool(np.median(a[both] - b[both]) < 0)
    if not np.isfinite(a).any() or not np.isfinite(b).any():
        return True
    return bool(np.median(a[np.isfinite(a)]) < np.median(b[np.isfinite(b)]))


# --- the camera ---------------------------------------------------------------------------------------------------


def _align_camera(scene: Scene, config: AlignConfig) -> tuple[Scene, Decision]:
    """6-DoF camera about the scene's centre, intrinsics fixed (equation 7), accepted on the mean IoU of instances."""
    small = scene.camera.limited(config.resolution)
    target = Target.of(
        resample(union_of((o.mask for o in scene), (scene.photo.height, scene.photo.width)), small.width, small.height)
    )
    center = scene.camera.to_camera(np.mean([o.bounds_world.mean(0) for o in scene], axis=0)[None])[0]
    reach = np.array([config.camera_rotation] * 3 + [config.camera_translation * float(np.linalg.norm(center))] * 3)
    vertices = np.concatenate([o.vertices_world for o in scene])
    offsets = np.cumsum([0] + [len(o.mesh.vertices) for o in scene])
    faces = np.concatenate([o.mesh.faces + n for o, n in zip(scene, offsets, strict=False)]).astype(np.int32)
    weights = replace(config.weights, centroid=0.0, area=0.0)

    def camera_at(x: Array) -> Camera:
        T_new_old = _about(center, rotation_from_vector(x[:3] * reach[:3]), x[3:] * reach[3:])
        return small.moved(small.T_world_camera @ invert_pose(T_new_old))

    def objective(x: Array) -> float:
        camera = camera_at(x)
        rendered = raster.silhouette(camera.to_camera(vertices), faces, camera.K, camera.width, camera.height)
        return loss(rendered, target, weights) + 0.01 * float(x @ x)

    x = _minimise(objective, np.zeros(6), evaluations=config.camera_evaluations)
    moved = replace(scene, camera=scene.camera.moved(camera_at(x).T_world_camera))
    return keep_better(
        scene, moved, score=lambda s: float(np.mean(_ious(s, config))), step="camera", measure="mean mask IoU",
        tolerance=config.iou_tolerance,
    )  # fmt: skip


def _about(center: Array, R: Array, t: Array) -> Array:
    """x -> R (x - center) + center + t."""
    return pose(R, center - R @ center + t)


# --- objects ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class _Search:
    """One object's problem in unit parameters: (shift, shift, yaw, scale), each in [-1, 1] inside its bound."""

    object: SceneObject
    camera: Camera
    """Of a window around the object."""
    target: Target
    config: AlignConfig

    @property
    def reach(self) -> Array:
        c = self.config
        shift = c.max_shift * self.object.size
        return np.array([shift, shift, c.max_yaw, c.max_scale])

    @property
    def basis(self) -> Array:
        """B_C (3, 2): the directions of the shift in the world."""
        return self.camera.T_world_camera[:3, :2] if self.config.freedom == "image" else np.eye(3)[:, :2]

    @property
    def anchor(self) -> Array:
        """The point (3,) that yaw and scale leave in place."""
        low, high = self.object.bounds_world
        middle = (low + high) / 2
        return middle if self.config.freedom == "image" else np.array([middle[0], middle[1], low[2]])

    def similarity(self, x: Array) -> tuple[Array, float]:
        """Equation 8 as (rigid T, scale)."""
        dx, dy, yaw, sigma = x * self.reach
        R, s = rotation_about([0, 0, 1], yaw), 1 + sigma
        return pose(R, self.anchor + self.basis @ [dx, dy] - R @ (s * self.anchor)), s

    @cached_property
    def vertices(self) -> Array:
        return self.object.vertices_world

    def silhouette(self, x: Array) -> Mask:
        T, s = self.similarity(x)
        vertices = transform(T, s * self.vertices)
        c = self.camera
        return raster.silhouette(c.to_camera(vertices), self.object.mesh.faces, c.K, c.width, c.height)

    def objective(self, x: Array) -> float:
        inside = np.clip(x, -1, 1)
        outside = float(np.abs(x - inside).sum())
        prior = float(np.asarray(self.config.prior) @ inside**2)
        return loss(self.silhouette(inside), self.target, self.config.weights) + prior + outside

    def iou(self, x: Array) -> float:
        return iou(self.silhouette(x), self.target.mask, self.target.valid)

    def seed(self, yaw: float) -> Array:
        """Closed form from the hard mask: centroid gives the shift, the square root of the area ratio the scale."""
        x = np.array([0.0, 0.0, yaw / self.config.max_yaw, 0.0])
        depth = self.camera.to_camera(self.object.bounds_world.mean(0)[None])[0, 2]
        # Pixels per unit of shift, so that the same step serves both kinds of freedom.
        pixels = self.camera.K[:2, :2] @ (self.camera.T_camera_world[:3, :3] @ self.basis)[:2] / depth
        for _ in range(2):
            s = self.silhouette(x) & self.target.valid
            area = np.count_nonzero(s)
            if area < 16:
                break
            x[:2] += np.linalg.lstsq(pixels, self.target.centroid - centroid(s))[0] / self.reach[:2]
            x[3] = ((1 + x[3] * self.reach[3]) * np.sqrt(self.target.area / area) - 1) / self.reach[3]
            x = np.clip(x, -1, 1)
        return x

    def solve(self) -> Array:
        """The best seed, polished."""
        seeds = [np.zeros(4), *(self.seed(yaw) for yaw in self.config.yaw_seeds)]
        start = min(seeds, key=self.objective)
        return np.clip(_minimise(self.objective, start, evaluations=self.config.evaluations), -1, 1)


def _align_object(
    o: SceneObject, valid: Mask, camera: Camera, config: AlignConfig
) -> tuple[SceneObject, list[Decision]]:
    """The object where its silhouette fits its mask best, standing on a facet where that is near and fits."""
    search = _search(o, valid, camera, config)
    kept, decision = keep_better(
        np.zeros(4), search.solve(), score=search.iou, step="object", measure="valid mask IoU",
        tolerance=config.iou_tolerance, about=o.id,
    )  # fmt: skip
    turn = _resting_turn(o, config)
    if turn is None:
        return _applied(search, kept, decision), [decision]
    standing = _search(o.moved(turn, stage="align", reason="onto its nearest stable facet"), valid, camera, config)
    best = standing.solve()
    (chosen, x), tilt = keep_better(
        (search, kept), (standing, best), score=lambda c: c[0].iou(c[1]), step="onto a stable facet",
        measure="valid mask IoU", tolerance=config.tilt_loss, about=o.id,
    )  # fmt: skip
    return _applied(chosen, x, decision), [decision, tilt]


def _search(o: SceneObject, valid: Mask, camera: Camera, config: AlignConfig) -> _Search:
    """The problem of one object, seen in a window around its mask and its render that leaves room for every shift."""
    pixels, _ = camera.project(o.vertices_world)
    rows, columns = (np.flatnonzero(o.mask.any(axis=axis)) for axis in (1, 0))
    low = np.minimum(pixels.min(0), [columns[0], rows[0]])
    high = np.maximum(pixels.max(0), [columns[-1] + 1, rows[-1] + 1])
    limit = np.array([camera.width, camera.height])
    low, high = np.clip(low, -limit, 2 * limit), np.clip(high, -limit, 2 * limit)
    margin = 0.15 * (high - low).max()
    x, y = np.floor(low - margin).astype(int)
    width, height = np.ceil(high + margin).astype(int) - (x, y)
    window = camera.cropped(x, y, width, height).limited(config.resolution)
    inside = (slice(y, y + height), slice(x, x + width))
    mask, region = (
        resample(_window(m, inside, fill=fill), window.width, window.height)
        for m, fill in ((o.mask, False), (valid, True))
    )
    return _Search(object=o, camera=window, target=Target.of(mask, region), config=config)


def _window(mask: Mask, inside: tuple[slice, slice], *, fill: bool) -> Mask:
    """A part of a mask that may reach beyond its borders; ``fill`` is what lies there."""
    (rows, columns), (h, w) = inside, mask.shape
    out = np.full((rows.stop - rows.start, columns.stop - columns.start), fill)
    r, c = slice(max(rows.start, 0), min(rows.stop, h)), slice(max(columns.start, 0), min(columns.stop, w))
    out[r.start - rows.start : r.stop - rows.start, c.start - columns.start : c.stop - columns.start] = mask[r, c]
    return out


def _resting_turn(o: SceneObject, config: AlignConfig) -> Array | None:
    """The world pose change (4, 4) about the object's middle that puts it on its nearest stable facet, if near."""
    if not config.max_tilt:
        return None
    hull = o.mesh.hull
    solid = o.mesh.welded if o.mesh.is_solid else (hull.vertices, hull.faces)
    R = resting_turn(hull, mass_properties(*solid).center, o.T_world_object[:3, :3], max_tilt=config.max_tilt)
    return None if R is None else _about(o.bounds_world.mean(0), R, np.zeros(3))


def _applied(search: _Search, x: Array, decision: Decision) -> SceneObject:
    if not x.any():
        return search.object
    T, s = search.similarity(x)
    return search.object.moved(T, scale=s, stage="align", reason=decision.reason)


# --- shared -------------------------------------------------------------------------------------------------------


def _minimise(objective: Callable[[Array], float], start: Array, *, evaluations: int) -> Array:
    """Nelder-Mead from a simplex of a fifth of the bounds; the loss of a hard raster is piecewise constant."""
    from scipy.optimize import minimize

    simplex = np.concatenate([start[None], start + 0.2 * np.eye(len(start))])
    result = minimize(
        objective, start, method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": evaluations, "xatol": 1e-3, "fatol": 1e-4, "adaptive": True},
    )  # fmt: skip
    return np.asarray(result.x)


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
