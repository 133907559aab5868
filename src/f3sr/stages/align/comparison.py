"""One object's pose, scored by what the photo shows of it: its mask, its depths, its detail."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from f3sr.core.levenberg_marquardt import Local
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, turn_about
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.stages.align.config import AlignConfig
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.depth_prior import sigma
from f3sr.vision.depth_residual import DepthEvidence
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.occlusion import Occluders, comparable_region
from f3sr.vision.photometric import Appearance
from f3sr.vision.silhouette import LossWeights, Mask
from f3sr.vision.silhouette_fit import EQUATION_8, EVERYTHING, ObjectFit, object_fit

NOISE = 1.5
"""Spread of an object's depths, in standard deviations of the geometry, that is still its noise: a mean is exceeded."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectEvidence:
    """What the photo shows of one object: ``valid`` (H, W) is where what is ``hiding`` it leaves it visible."""

    scene: Scene
    hiding: Occluders
    valid: Mask
    textured: Mesh
    """The object's own mesh, which the one that silhouettes are drawn from may be a lighter copy of."""

    def hidden_by_any(self, o: SceneObject, *, but: Collection[int] = ()) -> ObjectEvidence:
        """As if every other object, ``but`` some, might hide the object."""
        hiding = Occluders(nearer=[p for p in self.scene if p.id not in {o.id, *but}], in_part=[])
        return replace(self, hiding=hiding, valid=comparable_region(o, hiding, self.scene))


@dataclass(frozen=True, eq=False, kw_only=True)
class Placed:
    """An object on its way: ``base`` moved by the parameters ``u`` (6,) of the freedom of ``fit``."""

    base: SceneObject
    fit: ObjectFit
    u: Array = field(default_factory=lambda: np.zeros(6))

    @cached_property
    def iou(self) -> float:
        return self.fit.iou(self.u)

    def at(self, u: Array) -> SceneObject:
        T, s = self.fit.freedom.similarity(u)
        return moved(self.base, T, scale=s)

    @cached_property
    def object(self) -> SceneObject:
        return self.at(self.u) if self.u.any() else self.base

    def moved(self, u: Array) -> Placed:
        return replace(self, u=u)


@dataclass(frozen=True, kw_only=True)
class Scores:
    """IoU with the valid mask, correlation with the photo, spread of depth about the geometry's, share ``before`` what
    the photo shows; 0 where unknown."""

    iou: float
    correlation: float
    has_detail: bool
    """The mesh has detail to correlate."""
    spread: float
    before: float
    noise: float
    """Standard deviation of the geometry's depths [share of the distance]."""
    config: AlignConfig

    @property
    def total(self) -> float:
        return self.iou + self.config.appearance.weight * self.correlation

    @property
    def shape(self) -> float:
        """How far mask and depth are from those of a perfect mesh."""
        return self.config.orientations.missed(self.iou - self.before, self.spread)

    @property
    def miss(self) -> float:
        """How far all three are from a perfect mesh's."""
        correlation = self.correlation if self.has_detail else None
        return self.config.orientations.missed(self.iou - self.before, self.spread, correlation)

    def agrees(self, before: Scores) -> bool:
        """Whether depths spread about the geometry's no more than ``before``, or no more than its noise may."""
        return self.spread <= max(before.spread, NOISE * self.noise)

    def told(self, after: Scores) -> str:
        nearer = f", nearer than what hides it {self.before:.0%} -> {after.before:.0%}"
        return (
            f"valid mask IoU {self.iou:.4f} -> {after.iou:.4f}, correlation with the photo {self.correlation:.2f} -> "
            f"{after.correlation:.2f}, spread of depth {self.spread:.4f} -> {after.spread:.4f}"
        ) + (nearer if max(self.before, after.before) >= 0.01 else "")


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Any pose of one object against what the photo shows of it. ``depth`` and ``appearance`` are taken in a window
    around where the object was when this was made; None where there is none."""

    view: ObjectEvidence
    config: AlignConfig
    depth: DepthEvidence | None
    appearance: Appearance | None

    @classmethod
    def near(cls, o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> Comparison:
        scene, camera = view.scene, view.scene.camera
        geometry = surfaces_seen(scene)
        window = window_around(o, camera, config.appearance.resolution)
        shown = sampled(o.mask & view.valid, camera, window, fill=False)
        hidden = ~sampled(view.valid, camera, window, fill=True)
        has_detail = config.appearance.enabled and view.textured.has_detail
        return cls(
            view=view,
            config=config,
            depth=DepthEvidence.of(geometry, camera, window, shown, hidden) if geometry else None,
            appearance=Appearance.of(scene.photo, camera, window, shown) if has_detail else None,
        )

    def scores(self, placed: Placed) -> Scores:
        o = placed.object
        depths = self.depth.residual(o) if self.depth else None
        return Scores(
            iou=placed.iou,
            correlation=self.appearance.correlation(self.textured(o)) if self.appearance else 0.0,
            has_detail=self.appearance is not None,
            spread=depths.spread if depths else 0.0,
            before=depths.before if depths else 0.0,
            noise=sigma(self.view.scene.geometry),
            config=self.config,
        )

    @property
    def free(self) -> Array:
        """(6,) what is free once detail is compared."""
        return EVERYTHING if self.config.tilt.enabled else EQUATION_8

    def refined(self, placed: Placed, *, iterations: int, free: Array) -> Placed:
        """Where silhouette and detail fit best, all that is ``free`` (6,) together."""
        found = placed.fit.refined(placed.u, iterations=iterations, free=free, also=self._mismatch(placed))
        return placed.moved(found.x)

    def started(self, o: SceneObject) -> Placed:
        """An object where it is, with its freedom about that and a window around it."""
        return Placed(base=o, fit=self.fit(o, resolution=self.config.resolution))

    def after(self, placed: Placed, T: Array, *, scale: float = 1.0) -> Placed:
        """The object moved by x -> T (scale x) from where it is, a new start of its freedom."""
        base = moved(placed.object, T, scale=scale)
        T_u, s_u = placed.fit.freedom.similarity(placed.u)
        surface = placed.fit.surface.moved(T_u, s_u).moved(T, scale)
        return Placed(base=base, fit=replace(placed.fit, surface=surface, freedom=self._freedom(base)))

    def fit(self, o: SceneObject, *, resolution: int) -> ObjectFit:
        return object_fit(
            o, self.view.valid, self.view.scene.camera, self._freedom(o),
            resolution=resolution, weights=LossWeights(), prior=self.config.search.prior,
        )  # fmt: skip

    def textured(self, o: SceneObject) -> SceneObject:
        return o if o.mesh is self.view.textured else replace(o, mesh=self.view.textured)

    def _freedom(self, o: SceneObject) -> ObjectFreedom:
        config = self.config
        low, high = o.bounds_world
        middle = (low + high) / 2
        shift = config.max_shift * o.size
        tilt = config.tilt.most if config.tilt.enabled and not o.lifted else 0.0
        in_image = config.freedom == "image"
        return ObjectFreedom(
            anchor=middle if in_image else np.array([middle[0], middle[1], low[2]]),
            basis=self.view.scene.camera.T_world_camera[:3, :2] if in_image else np.eye(3)[:, :2],
            reach=np.array([shift, shift, config.max_yaw, tilt, tilt, config.max_scale]),
        )

    def _mismatch(self, placed: Placed) -> Callable[[Array], Local] | None:
        """The appearance's term of the objective."""
        appearance, weight = self.appearance, self.config.appearance.weight
        if appearance is None or not weight:
            return None
        camera = self.view.scene.camera

        def local(u: Array) -> Local:
            velocities = placed.fit.freedom.velocities(u, camera)
            return appearance.mismatch(self.textured(placed.at(u)), velocities).weighted(weight)

        return local


def surfaces_seen(scene: Scene) -> Geometry | None:
    """The geometry, where it shows more than the ground."""
    return scene.geometry if scene.geometry and scene.geometry.source != "ground" else None


def moved(o: SceneObject, T: Array, *, scale: float = 1.0) -> SceneObject:
    """A pose on trial: x -> T (scale x). The reason is told when it is kept."""
    return o.moved(T, scale=scale, stage="align", reason="")


def about_middle(o: SceneObject, R: Array) -> Array:
    """The turn (4, 4) by R (3, 3) about an object's middle."""
    return turn_about(o.middle, R)
