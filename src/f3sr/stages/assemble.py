"""assemble: photo, masks, geometry and assets brought into one provisional world; every later stage may be skipped."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose
from f3sr.files.bounds import MAX_FRICTION, MIN_MOMENT
from f3sr.io.given_properties import MATERIALS, GivenProperties
from f3sr.io.inputs import Inputs, PosedAsset
from f3sr.language.grammar.materials import COMPACT, material_of, unknown_density
from f3sr.physics.mujoco_model import LEAST_MOMENT, inertia_of, solid_of
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Geometry, Ground, Instance, Scene, SceneGraph, SceneObject
from f3sr.settings import settings
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import iou

POSE_GRID = 2.0**-32
"""Step to which poses are rounded: .2 nm, and scales to as many binary digits. Digits beyond depend on how a program
writes a pose down, and a pile magnifies them to a millimetre."""
NAMED = 8
"""Objects of unknown material that the report names, at most."""


@settings
class AssembleConfig:
    max_depth_ratio: Annotated[float, Interval(gt=1, le=10)] = 1.3
    """Largest ratio of an asset's depth to the geometry's, or its inverse. Beyond, the asset moves along its rays."""
    ground_friction: Annotated[float, Interval(ge=0, le=MAX_FRICTION)] = Ground.friction
    """Coefficient of sliding friction of the ground. A contact takes the larger of two bodies'."""


@dataclass(frozen=True, kw_only=True)
class Assembled(Outcome):
    stage: ClassVar[str] = "assemble"
    depth_ratios: Mapping[int, float] = field(default_factory=dict[int, float])
    """Depth of assets in their input poses over the geometry's, by object id, where both are known."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return tuple(
            Measure(name="asset depth / geometry depth", before=ratio, after=ratio, about=id)
            for id, ratio in self.depth_ratios.items()
        )


def as_given(inputs: Inputs) -> Scene:
    """The inputs as a scene, nothing checked or moved: the photo, its camera at the origin, objects where their assets'
    poses say, to ``POSE_GRID``, without proxies."""
    camera = Camera(width=inputs.photo.width, height=inputs.photo.height, K=inputs.K, T_world_camera=T_UP_FROM_CAMERA)
    return Scene(
        photo=inputs.photo,
        camera=camera,
        geometry=inputs.geometry,
        ground_mask=inputs.ground_mask,
        graph=inputs.graph or SceneGraph(),
        objects=tuple(
            _given_object(i, inputs.assets[i.id], camera, inputs.properties.get(i.id)) for i in inputs.instances
        ),
    )


def assemble(
    scene: Scene, config: AssembleConfig | None = None, *, told: Sequence[Decision] = ()
) -> tuple[Scene, Assembled]:
    """Bring a scene ``as_given`` into one frame: a level camera at the origin, objects where their assets' poses say.

    Some assets contradict the depth of the geometry inside their mask by more than ``max_depth_ratio``. They are scaled
    about the camera centre, which keeps their silhouette. Every object gets one hull as its provisional proxy.
    ``told`` are the decisions from reading the inputs.
    """
    config = config or AssembleConfig()
    camera = scene.camera
    objects = tuple(replace(o, parts=(o.mesh.hull,)) for o in scene)
    decisions = list(told)
    decisions += [d for o in objects if (d := _check_place(o, camera))]
    decisions.append(_told_of_materials(objects))
    decisions += [_told_of_fixed(o) for o in objects if o.mobility == "fixed"]
    decisions += [d for o in objects if (d := _told_of_moments(o))]
    ratios: dict[int, float] = {}
    placed: list[SceneObject] = []
    for o in objects:
        ratio = _depth_ratio(o, camera, scene.geometry) if scene.geometry else None
        if ratio is not None:
            ratios[o.id] = ratio
            o, decision = _agree_with_geometry(o, ratio, camera, config)
            decisions += decision
        placed.append(o)
    ground = replace(scene.ground, friction=config.ground_friction)
    return replace(scene.with_objects(*placed), ground=ground), Assembled(
        depth_ratios=ratios, decisions=tuple(decisions)
    )


def _given_object(instance: Instance, asset: PosedAsset, camera: Camera, given: GivenProperties | None) -> SceneObject:
    """An object as its asset says, of the given material or the one that its label tells, its supports unknown."""
    o = SceneObject(
        id=instance.id,
        label=instance.label,
        mask_name=instance.name,
        mask=instance.mask,
        mesh=asset.mesh,
        T_world_object=camera.T_world_camera @ _rounded(asset.T_camera_object),
        scale=_in_digits(asset.scale),
        lifted=asset.lifted,
    )
    if known := material_of(o.label):
        o = replace(o, **known.properties, material_source="label", material_reason=f"the label {o.label!r}")
    else:
        volume = solid_of(o)[0].volume * o.scale**3
        o = replace(
            o, density=unknown_density(volume), material_reason=f"nothing but its volume, {1000 * volume:.2g} l"
        )
    if asset.fixed:
        o = replace(o, mobility="fixed", mobility_source="given")
    if not given:
        return o
    named = material_of(given.material) if given.material else None
    reasons = [given.reason or f"{MATERIALS} gives {', '.join(given.properties)}"]
    if named or given.density is not None:
        o = replace(o, **(named.properties if named else {}), material_source="given")
    else:
        reasons += [o.material_reason] if o.material_reason else []
    if given.mobility:
        o = replace(o, mobility_source="given")
    return replace(o, **given.properties, material_reason="; ".join(reasons))


def _rounded(T: Array) -> Array:
    """A rigid transform (4, 4) to the digits that count; still rigid."""
    rounded = np.round(T / POSE_GRID) * POSE_GRID + 0.0  # no -0
    R = rounded[:3, :3]
    return pose(R @ (3 * np.eye(3) - R.T @ R) / 2, rounded[:3, 3])  # Newton's step to the nearest rotation: 1e-19 off


def _in_digits(scale: float) -> float:
    mantissa, exponent = math.frexp(scale)
    return math.ldexp(round(mantissa / POSE_GRID) * POSE_GRID, exponent)


def _told_of_materials(objects: Sequence[SceneObject]) -> Decision:
    """How many objects have a material from where; those of unknown density are named."""
    counts = Counter(o.material_source for o in objects)
    unknown = [o.label or o.mask_name for o in objects if o.material_source == "default"]
    more = f" and {len(unknown) - NAMED} more" if len(unknown) > NAMED else ""
    named = f"; none is known of {', '.join(unknown[:NAMED])}{more}" if unknown else ""
    default = SceneObject.density, SceneObject.friction
    heaviest = f"{default[0]:g} kg/m3, less above {1000 * COMPACT:g} l,"
    return Decision(
        choice=f"materials: {counts['given']} given, {counts['label']} by label, {len(unknown)} by default{named}",
        reason=f"the default is {heaviest} with friction {default[1]:g}",
        fallback=bool(unknown),
    )


def _told_of_fixed(o: SceneObject) -> Decision:
    choice = "fixed as given: kept where alignment puts it, never moved onto a support"
    return Decision(choice=choice, reason=f"by {MATERIALS}, or by what made its mesh", about=o.id, fallback=True)


def _told_of_moments(o: SceneObject) -> Decision | None:
    least = float(np.linalg.eigvalsh(inertia_of(o))[0])
    if least >= MIN_MOMENT:
        return None
    choice = f"turns as if no principal moment of its inertia were below {LEAST_MOMENT:.2g} kg m2"
    reason = f"the least is {least:.2g} kg m2, and MuJoCo takes none so small"
    return Decision(choice=choice, reason=reason, about=o.id, fallback=True)


def _depth_ratio(o: SceneObject, camera: Camera, geometry: Geometry) -> float | None:
    """Median of rendered depth over geometry depth where the render, the mask and valid geometry meet."""
    h, w = geometry.valid.shape
    small = camera.resized(w, h)
    depth = rasterizer.render([o], small).depth
    where = geometry.inside(o.mask) & np.isfinite(depth)
    if not where.any():
        return None
    return float(np.median(depth[where] / geometry.points[where][:, 2]))


def _agree_with_geometry(
    o: SceneObject, ratio: float, camera: Camera, config: AssembleConfig
) -> tuple[SceneObject, tuple[Decision, ...]]:
    if max(ratio, 1 / ratio) <= config.max_depth_ratio:
        return o, ()
    k = 1 / ratio
    reason = f"the asset's depth is {ratio:.2f} times the geometry's"
    moved = o.moved(camera.homothety(k), scale=k, stage="assemble", reason=reason)
    choice = f"moved along its viewing rays by {k:.3f}"
    return moved, (Decision(choice=choice, reason=reason, about=o.id, fallback=True),)


def _check_place(o: SceneObject, camera: Camera) -> Decision | None:
    """A warning where the asset does not even touch its mask: its pose, or the axes it is given in, is wrong."""
    if _overlap(o.vertices_world, o, camera) > 0:
        return None
    return Decision(
        choice="kept, but its pose looks wrong",
        reason="its silhouette does not touch its mask",
        about=o.id,
        fallback=True,
    )


def _overlap(vertices_world: Array, o: SceneObject, camera: Camera) -> float:
    small = camera.limited(256)
    rendered = rasterizer.silhouette(small.to_camera(vertices_world), o.mesh.faces, small.K, small.width, small.height)
    return iou(rendered, resample(o.mask, small.width, small.height))
