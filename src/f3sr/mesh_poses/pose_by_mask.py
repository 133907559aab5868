"""The pose of a mesh that came without one: by its mask, the photo's detail and the geometry's depths.

The mesh stands upright in a world whose z = 0 is the ground. All yaws are tried, and all sides that may face down; each
gets shift and scale in closed form (``vision/silhouette_fit``). Then the geometry tells the distance: along the viewing
rays no silhouette changes. What misses least of mask, detail and depth wins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from f3sr.backends.protocols import PromptedImage
from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, rotation_angle
from f3sr.mesh_poses.mask_start import at_its_mask, drawn_in, seen_distance, seen_points
from f3sr.mesh_poses.orientations import (
    Orientation,
    OrientationConfig,
    leaning_orientations,
    local_minima,
    tried_orientations,
)
from f3sr.scene import Geometry, Instance, Photo, SceneObject
from f3sr.settings import constants
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.decimated import outlined
from f3sr.vision.depth_prior import GEOMETRY_PIXELS, GEOMETRY_SPREAD, sigma
from f3sr.vision.depth_residual import DepthEvidence
from f3sr.vision.ground_camera import camera_over_ground
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.occlusion import behind_the_photo
from f3sr.vision.photometric import Appearance
from f3sr.vision.silhouette import LossWeights, Mask, Target, union_of
from f3sr.vision.silhouette_fit import EVERYTHING, ObjectFit, object_fit

STAGE = "assemble"
NEIGHBOUR = math.radians(15)
"""Turn up to which one refinement covers two starts."""


@constants
class PoseSearchConfig:
    """The search for the pose of a mesh that has none."""

    orientations: OrientationConfig = OrientationConfig(step=math.radians(10))
    """Rings of yaws. A finer step than in alignment: detail moves by few pixels only."""
    slack: float = 0.1
    """How much worse than the best silhouette, in shares of the mask's area, one may be and be compared in detail."""
    compared: int = 24
    """Orientations that are compared by detail and depth, the best silhouettes first."""
    refined: int = 5
    """Of these, those that are refined."""
    resolution: int = 256
    """Longer side [px] of the window in which these are refined."""
    max_faces: int = 8_000
    """Most faces of their meshes."""
    iterations: int = 10
    """Most steps of a refinement."""
    rounds: int = 5
    """Most refinements, each from where the last one ended: tilts of 60 degrees are within reach."""
    gain: float = 0.02
    """Least that a refinement gains of what is missed for another to follow."""
    upright: float = 0.8
    """Of what the best upright orientation misses, the most that one on another side may miss: generators give most
    objects upright."""
    wide: tuple[float, float, float, float] = (1.0, math.radians(15), 0.15, 0.8)
    """Reach of the first fit: shifts [sizes], yaw and tilts [rad], scale [share]; the start knows no size."""
    near: tuple[float, float, float, float] = (0.2, math.radians(15), 0.15, 0.2)
    """Reach of the refinement, likewise."""
    prior: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.01, 0.05, 0.05, 0.0)
    """Quadratic priors on shifts, yaw, tilts and scale, each over its reach: a tilt must show in the mask."""
    measured: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.01, 0.01, 0.01, 0.0)
    """Those where the geometry shows the object's surface, and so its tilt."""


DEFAULT_SEARCH = PoseSearchConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskedPhoto:
    """A photo with its masks in a world whose z = 0 is the ground."""

    photo: Photo
    camera: Camera
    geometry: Geometry | None
    """None where only the ground is known."""
    instances: Mapping[int, Instance]

    @classmethod
    def of(cls, image: PromptedImage, geometry: Geometry, K: Array) -> MaskedPhoto:
        """``K`` (3, 3) in pixels of the photo; ``geometry`` in camera axes."""
        return cls(
            photo=image.photo,
            camera=camera_over_ground(image, geometry, K),
            geometry=None if geometry.source == "ground" else geometry,
            instances={i.id: i for i in image.instances},
        )

    def distance(self, instance: Instance) -> float:
        """Depth of an object [m]: the geometry's in its mask, else the ground's below the mask's lowest pixels."""
        return seen_distance(instance.mask, self.geometry, self.camera)

    def comparable(self, o: SceneObject) -> Mask:
        """Pixels (H, W) where the silhouette of an object must agree with its mask, before others have a pose."""
        others = [i.mask for i in self.instances.values() if i.id != o.id]
        if self.geometry is not None:
            return ~behind_the_photo(o.mask, others, self.geometry, self.camera)
        return ~union_of(others, o.mask.shape)


@dataclass(frozen=True, eq=False, kw_only=True)
class FoundPose:
    """Where an object may stand: in the world of a MaskedPhoto, with how well it fits."""

    object: SceneObject
    side: int
    iou: float
    """With the mask, where that can be compared."""
    correlation: float | None
    """Of the photo's detail with the textured render; None where the mesh has no detail."""
    spread: float
    """Median deviation of the geometry's depths about the surface [share of the distance]; 0 where unknown."""
    missed: float
    """What it misses of mask, detail and depth."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSearch:
    """All that is compared for one object; ``mesh`` is in axes whose +Z should point up."""

    mesh: Mesh
    instance: Instance
    view: MaskedPhoto
    valid: Mask | None = None
    """(H, W) where the silhouette must agree with the mask; None: as far as the geometry tells."""
    config: PoseSearchConfig = DEFAULT_SEARCH

    def found(self) -> list[FoundPose]:
        """Poses, best first; the first is the one to take."""
        wide = self._fit(outlined(self.start, self.config.orientations.max_faces), self.config.wide, coarse=True)
        rings = tried_orientations(self.start, wide, self.config.orientations)
        if (along := self._measured_axis) is not None:
            rings += leaning_orientations(self.start, wide, along, len(rings), self.config.orientations)
        near = self._promising(rings)
        first = sorted((self.judged(self._moved(wide, f), f.side) for f in near), key=lambda f: f.missed)
        best = _distinct(first)[: self.config.refined]
        best += [f for f in first if f.side == 0 and f not in best][:1]
        refined = sorted((self._refined(f) for f in best), key=lambda f: f.missed)
        return self._ranked(refined)

    def _promising(self, rings: list[list[Orientation]]) -> list[Orientation]:
        """What is worth a look at detail and depth: on every side the silhouettes that fit better than their
        neighbours, then the best of the rest, for round things look alike from everywhere."""
        lowest = local_minima(rings)
        everything = sorted((f for ring in rings for f in ring), key=lambda f: f.value)
        rest = [f for f in everything if f.value <= everything[0].value + self.config.slack]
        ordered = [*sorted(lowest, key=lambda f: f.value), *rest]
        distinct = list({id(f): f for f in ordered}.values())
        return distinct[: max(self.config.compared, len(lowest))]

    @cached_property
    def start(self) -> SceneObject:
        """The object upright at its mask, of the mask's size."""
        return at_its_mask(unplaced(self.instance, self.mesh), self.view.geometry, self.view.camera, stage=STAGE)

    @property
    def _measured_axis(self) -> Array | None:
        """The unit vector (3,) of the world along which the measured surface is longest: what leans lies along it."""
        points = seen_points(self.instance.mask, self.view.geometry)
        if points is None:
            return None
        spread = np.linalg.eigh(np.cov(drawn_in(points).T))[1]
        return self.view.camera.T_world_camera[:3, :3] @ spread[:, -1]

    @cached_property
    def _valid(self) -> Mask:
        return self.view.comparable(self.start) if self.valid is None else self.valid

    @cached_property
    def _appearance(self) -> Appearance | None:
        if not self.mesh.has_detail:
            return None
        window, shown = self._window
        return Appearance.of(self.view.photo, self.view.camera, window, shown)

    @cached_property
    def _depth(self) -> DepthEvidence | None:
        if self.view.geometry is None:
            return None
        window, shown = self._window
        return DepthEvidence.of(self.view.geometry, self.view.camera, window, shown)

    @cached_property
    def _window(self) -> tuple[Camera, Mask]:
        """The camera of a window around the object, and where (h, w) it shows the object."""
        window = window_around(self.start, self.view.camera, self.config.orientations.resolution)
        return window, sampled(self.instance.mask & self._valid, self.view.camera, window, fill=False)

    def _fit(self, o: SceneObject, reach: tuple[float, float, float, float], *, coarse: bool = False) -> ObjectFit:
        shift, yaw, tilt, scale = reach
        freedom = ObjectFreedom(
            anchor=o.middle,
            basis=self.view.camera.T_world_camera[:3, :2],
            reach=np.array([shift * o.size, shift * o.size, yaw, tilt, tilt, scale]),
        )
        resolution = self.config.orientations.resolution if coarse else self.config.resolution
        fit = object_fit(
            o, self._valid, self.view.camera, freedom,
            resolution=resolution, weights=LossWeights(),
            prior=self.config.prior if coarse or self._depth is None else self.config.measured,
        )  # fmt: skip
        if coarse or not (hidden := self._hidden(o, fit.camera)).any():
            return fit
        return replace(fit, target=Target.of(fit.target.mask, fit.target.valid & ~hidden, LossWeights()))

    def _hidden(self, o: SceneObject, window: Camera) -> Mask:
        """Where (h, w) an object would be behind what the geometry sees in others' masks: it is not missed there."""
        if (geometry := self.view.geometry) is None or not self._others.any():
            return np.zeros((window.height, window.width), np.bool_)
        seen = np.where(geometry.valid, geometry.points[..., 2], np.float32(np.nan))
        before = (1 - sigma(geometry)) * sampled(seen, self.view.camera, window, fill=np.nan)
        others = sampled(self._others, self.view.camera, window, fill=False)
        depth = rasterizer.render([o], window).depth
        return others & np.isfinite(depth) & (depth > before)

    @cached_property
    def _others(self) -> Mask:
        return union_of((i.mask for i in self.view.instances.values() if i.id != self.instance.id), self._valid.shape)

    def _moved(self, fit: ObjectFit, found: Orientation) -> SceneObject:
        """The object in an orientation that was tried."""
        T, scale = fit.freedom.similarity(found.u)
        turned = self.start.moved(found.T, stage=STAGE, reason="")
        return self._at_its_depth(turned.moved(T, scale=scale, stage=STAGE, reason=""))

    def _at_its_depth(self, o: SceneObject) -> SceneObject:
        """Along its viewing rays to where the geometry sees it; no silhouette changes."""
        if self._depth is None:
            return o
        residual = self._depth.residual(o)
        if residual.pixels < GEOMETRY_PIXELS or not np.isfinite(residual.median):
            return o
        k = math.exp(-residual.median)
        return o.moved(self.view.camera.homothety(k), scale=k, stage=STAGE, reason="")

    def _refined(self, found: FoundPose) -> FoundPose:
        """The best pose near one: again from there while much is gained, for the reach of a fit is short."""
        for _ in range(self.config.rounds):
            better = self._nearby(found)
            gain = found.missed - better.missed
            found = better if gain >= 0 else found
            if gain < self.config.gain:
                break
        return found

    def _nearby(self, found: FoundPose) -> FoundPose:
        light = outlined(found.object, self.config.max_faces)
        fit = self._fit(light, self.config.near)
        least = fit.refined(
            np.zeros(6), iterations=self.config.iterations, free=EVERYTHING, also=self._depths(light, fit)
        )
        T, scale = fit.freedom.similarity(least.x)
        moved = found.object.moved(T, scale=scale, stage=STAGE, reason="")
        return self.judged(self._at_its_depth(moved), found.side)

    def _depths(self, o: SceneObject, fit: ObjectFit) -> Callable[[Array], Local] | None:
        """What the geometry adds to a fit's objective: how far the surface deviates from its depths."""
        depth = self._depth
        if depth is None:
            return None

        def local(u: Array) -> Local:
            T, scale = fit.freedom.similarity(u)
            moved = o.moved(T, scale=scale, stage=STAGE, reason="")
            deviation = depth.mismatch(moved, fit.freedom.velocities(u, fit.camera), most=GEOMETRY_SPREAD)
            return deviation.weighted(self.config.orientations.depth)

        return local

    def corrected(self, o: SceneObject) -> SceneObject:
        """The object where its light silhouette fits best near a pose that it was given."""
        config = self.config.orientations
        fit = self._fit(outlined(o, config.max_faces), self.config.near, coarse=True)
        least = fit.refined(np.zeros(6), iterations=config.iterations, free=EVERYTHING)
        T, scale = fit.freedom.similarity(least.x)
        return o.moved(T, scale=scale, stage=STAGE, reason="")

    def judged(self, o: SceneObject, side: int = 0) -> FoundPose:
        """The object where it stands, against mask, detail and depth."""
        light = outlined(o, self.config.max_faces)
        iou = self._fit(light, self.config.near).iou(np.zeros(6))
        correlation = self._appearance.correlation(o) if self._appearance else None
        spread = self._depth.residual(o).spread if self._depth else 0.0
        spread = min(spread, GEOMETRY_SPREAD)  # what is beyond says no more
        return FoundPose(
            object=o,
            side=side,
            iou=iou,
            correlation=correlation,
            spread=spread,
            missed=self.config.orientations.missed(iou, spread, correlation),
        )

    def _ranked(self, found: list[FoundPose]) -> list[FoundPose]:
        """Best first; a pose on another side must fit clearly better than all upright ones."""
        upright = next((f for f in found if f.side == 0), None)
        if upright is None or found[0].missed <= self.config.upright * upright.missed:
            return found
        return [upright, *(f for f in found if f is not upright)]


def _distinct(found: list[FoundPose]) -> list[FoundPose]:
    """Those that are turned from all before them."""
    kept = list[FoundPose]()
    for f in found:
        if all(turn_between(f, other) > NEIGHBOUR for other in kept):
            kept.append(f)
    return kept


def turn_between(one: FoundPose, other: FoundPose) -> float:
    """Angle [rad] between two poses of an object."""
    a, b = (f.object.T_world_object[:3, :3] for f in (one, other))
    return float(rotation_angle(a.T @ b))


def unplaced(instance: Instance, mesh: Mesh) -> SceneObject:
    """An instance as an object at the world's origin, in the axes and unit of its mesh."""
    return SceneObject(
        id=instance.id,
        label=instance.label,
        mask_name=instance.name,
        mask=instance.mask,
        mesh=mesh,
        T_world_object=np.eye(4),
    )
