"""The one MuJoCo model of the product: bodies of objects, settling, and the release that measures rest."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, cast
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval

from f3sr import restitution
from f3sr.core.mesh import ConvexPart, MassProperties, Mesh, solid_properties
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_from_quaternion
from f3sr.scene import GROUND, SceneObject
from f3sr.settings import settings

GROUND_NAME = "ground"

MjSpec = MjModel = MjData = MjsMesh = Any
"""MuJoCo's classes, which carry no type information."""


Share = Annotated[float, Interval(ge=0, lt=1)]
Length = Annotated[float, Interval(gt=0, le=1)]
Power = Annotated[float, Interval(ge=1, le=10)]
Friction = Annotated[float, Interval(ge=0, le=10)]


@settings
class PhysicsConfig:
    """Contact model and time stepping, chosen for piles that rest (docs: measures)."""

    timestep: Annotated[float, Interval(gt=0, le=0.005)] = 0.002
    """[s], at most half of solref's first value."""
    gravity: Annotated[float, Interval(ge=-100, le=0)] = -9.81
    """Along world z [m/s2]."""
    impratio: Annotated[float, Interval(ge=1, le=100)] = 10.0
    """Friction to normal impedance: higher slips less in the elliptic cone."""
    solref: tuple[Length, Annotated[float, Interval(gt=0, le=10)]] = (0.005, 1.0)
    """Contact time constant [s], at least two time steps, and damping ratio. .02 creeps ten times more."""
    solimp: tuple[Share, Share, Length, Share, Power] = (0.95, 0.99, 0.0005, 0.5, 2.0)
    """Contact impedance: least, most, width [m], midpoint, power."""
    condim: Literal[4, 6] = 6
    """Contact dimensions: 6 adds rolling friction, without which balls never stop."""
    torsional_friction: Annotated[float, Interval(ge=0, le=1)] = 0.005
    """[m]: friction against spinning about the contact normal."""
    ground_friction: tuple[Friction, Friction, Friction] = (0.6, 0.005, 0.001)
    """Sliding, torsional [m] and rolling [m] friction of the ground; a contact takes the larger of two."""
    margin: Annotated[float, Interval(ge=0, le=1e-3)] = 1.6e-4
    """Contact distance of each body [m]: it keeps soft contact from turning into overlap. MuJoCo adds the margins of
    two bodies, so that they rest two margins apart. Four fifths of the release protocol's: where the true scale is a
    fifth larger than a photo tells, what rests must not fall to the protocol's margin (K .0021 -> .00002 J)."""
    multiccd: bool = True
    """Several contact points per pair of parts. Off, stacks explode."""

    def __post_init__(self) -> None:
        if self.solref[0] < 2 * self.timestep:
            raise ValueError("solref whose first value is at least two time steps")
        if self.solimp[0] > self.solimp[1]:
            raise ValueError("solimp whose first value is at most its second")


DEFAULT_PHYSICS = PhysicsConfig()
RELEASE_MARGIN = 2e-4
"""Contact distance of each body in the release protocol [m]."""


@settings
class SettleConfig:
    """When a scene counts as at rest, and how long to wait for it."""

    damping: Annotated[float, Interval(gt=0, le=50)] = 4.0
    """[1/s]: velocities lose this rate while settling, never afterwards."""
    linear_rest: Annotated[float, Interval(gt=0, le=1)] = 1e-3
    """[m/s]: a centre of mass slower than this is at rest."""
    angular_rest: Annotated[float, Interval(gt=0, le=10)] = 1e-2
    """[rad/s]: a body that turns slower than this is at rest."""
    rest_time: Annotated[float, Interval(gt=0, le=2)] = 0.2
    """[s]: speeds are averaged over this time, so that contacts that chatter by micrometres count as still."""
    time_limit: Annotated[float, Interval(gt=0, le=600)] = 10.0
    """[s] of damped simulation, all rounds together."""
    check_time: Annotated[float, Interval(gt=0, le=60)] = 2.0
    """[s] of the undamped check after each round."""
    release_time: Annotated[float, Interval(gt=0, le=60)] = 5.0
    """[s] of the second one, as long as the release protocol: what tips over starts slowly."""
    drift_limit: Annotated[float, Interval(gt=0, le=0.1)] = 5e-4
    """[m]: largest travel of a centre of mass in the check, half of what the release protocol may show. Soft contacts
    let what rests on a slope creep at a steady rate, .1 mm in 5 s in piles and .4 mm in nested bowls: no longer
    settling ends that."""
    even_masses: bool = True
    """Check a second time with each mass spread evenly over the parts and a wider contact margin, as the release
    protocol does: a pose can stand with the one centre of mass and tip with the other, a ball lie still until it is
    touched."""
    rounds: Annotated[int, Interval(ge=1, le=100)] = 16
    """How often to settle and check again: what creeps may take eight."""


DEFAULT_SETTLING = SettleConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """An object as the engine sees it, in its own frame, metres, scale baked in."""

    name: str
    T_world_body: Array
    fixed: bool
    mass: float
    """[kg]"""
    center: Array
    """Centre of mass (3,) [m]."""
    inertia: Array
    """(3, 3) [kg m2] about the centre of mass."""
    from_mesh: bool
    """True when the mass is that of the visual mesh, False when of the union of the parts."""
    friction: tuple[float, float, float]
    """Sliding, torsional, rolling."""
    solref: tuple[float, float] | None
    """Of the contacts of what bounces; None where the model's own hold."""
    parts: tuple[ConvexPart, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Settled:
    """Where the objects came to rest."""

    T_world_object: Mapping[int, Array]
    """The final pose of every object, fixed ones included; the initial poses when ``exploded``."""
    at_rest: bool
    """True when the final poses passed the undamped check."""
    exploded: bool
    """True when the state stopped being finite."""
    seconds: float
    """Simulated time until rest [s], checks not counted."""
    max_speed: float
    """Largest speed of a centre of mass on the way [m/s]."""
    drifts: Mapping[int, float]
    """Largest travel of every centre of mass, but upward, in the last undamped check [m]; infinite when there was
    none."""
    loads: Mapping[tuple[int, int], float]
    """(carried, carrier) ids, the ground GROUND, to the net upward force between them [N]; empty when ``exploded``."""


class Release(NamedTuple):
    """What happens when the scene is let go (equations 13 and 14)."""

    K_max: float
    """Largest total kinetic energy in the first second [J]."""
    D_max: float
    """Largest travel of a centre of mass [m]."""


@cache
def engine() -> Any:
    """The ``mujoco`` module, imported on first use.

    Its warnings go neither to the terminal nor to a MUJOCO_LOG.TXT in the working folder: what f3sr makes of a state
    that blows up is said by f3sr. A ``mujoco.set_mju_user_warning`` of a caller's is told them all the same.
    """
    import mujoco

    log = cast(Any, mujoco).MjLogConfig.get()
    log.logto_file = log.logto_console = False
    log.set()
    warnings.filterwarnings("ignore", category=UserWarning, module=re.escape(__name__))  # of ``compiled``
    return mujoco


def compiled(spec: MjSpec) -> MjModel:
    """The model of a specification. Raises ValueError where MuJoCo takes some number for impossible."""
    return spec.compile()


def body_name(id: int) -> str:
    return f"object_{id:02d}"


def body_of(o: SceneObject, config: PhysicsConfig = DEFAULT_PHYSICS) -> Body:
    """The rigid body of an object: mass and inertia of its solid at its density, its parts in metres."""
    solid, from_mesh = _solid(o.mesh, o.parts or (o.mesh.hull,)) if o.solid is None else (o.solid, o.mesh.is_solid)
    scale = np.diag([o.scale, o.scale, o.scale, 1.0])
    return Body(
        name=body_name(o.id),
        T_world_body=o.T_world_object,
        fixed=o.mobility == "fixed",
        mass=o.density * solid.volume * o.scale**3,
        center=solid.center * o.scale,
        inertia=o.density * solid.inertia * o.scale**5,
        from_mesh=from_mesh,
        friction=(o.friction, config.torsional_friction, o.rolling_friction),
        solref=restitution.solref(o.restitution),
        parts=tuple(part.moved(scale) for part in o.solids),
    )


def build_spec(objects: Sequence[SceneObject], config: PhysicsConfig = DEFAULT_PHYSICS) -> MjSpec:
    """The editable MuJoCo model: the ground, and per object a body with one mesh geom per convex part.

    Bodies are named ``object_03``, their geoms and meshes ``object_03_00``; dynamic ones have a free joint of
    the body's name. The body frame is the object frame.
    """
    spec = _empty_spec(config)
    for o in objects:
        _add_body(spec, body_of(o, config), config)
    return spec


def _even_spec(objects: Sequence[SceneObject], config: PhysicsConfig) -> MjSpec:
    """The same model with the masses and the margin of the release protocol: spread evenly over the parts, and wider,
    so that a push like the protocol's comes first."""
    spec = _empty_spec(config, RELEASE_MARGIN)
    for o in objects:
        body = body_of(o, config)
        _add_body(spec, body, config, even_density=o.density * filling(o), margin=RELEASE_MARGIN)
    return spec


def settle(
    objects: Sequence[SceneObject],
    config: PhysicsConfig = DEFAULT_PHYSICS,
    *,
    settling: SettleConfig = DEFAULT_SETTLING,
) -> Settled:
    """Let the objects fall, slide and topple until they rest by themselves.

    Damped simulation up to rest, then an undamped release of the final positions; what still moves goes on
    from where the release ended. A scene that blows up is reported, not raised.
    """
    mujoco = engine()
    model = compiled(build_spec(objects, config))
    checks = [(model, settling.check_time)]
    if settling.even_masses:
        checks.append((compiled(_even_spec(objects, config)), settling.release_time))
    for m, _ in checks:
        m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # a reset would hide a blow-up
    run = _Settling(model, settling)
    data, calm = mujoco.MjData(model), False
    drifts = np.full(len(objects), np.inf)
    for _ in range(settling.rounds):
        run.until_rest(data)
        drifts, calm = np.zeros(len(objects)), not run.exploded
        for m, seconds in checks:
            released = run.fresh(m, data)
            travels, calm = run.undamped(m, released, seconds)
            drifts = np.maximum(drifts, travels)
            if not calm:
                data = run.fresh(model, released)
                break
        if calm or run.exploded or run.seconds >= settling.time_limit:
            break
    return Settled(
        T_world_object={o.id: o.T_world_object if run.exploded else _pose_of(model, data, o) for o in objects},
        at_rest=calm and not run.exploded,
        exploded=run.exploded,
        seconds=run.seconds,
        max_speed=run.max_speed,
        drifts={o.id: float(d) for o, d in zip(objects, drifts, strict=True)},
        loads={} if run.exploded else contact_loads(model, data, [o.id for o in objects]),
    )


def contact_loads(model: MjModel, data: MjData, ids: Sequence[int]) -> dict[tuple[int, int], float]:
    """Who carries whom in a state: (carried, carrier) to the net upward contact force [N], positive entries only.

    Body k + 1 of the model is the object ``ids[k]``; the world is the ground.
    """
    mujoco = engine()
    mujoco.mj_forward(model, data)
    names = [GROUND, *ids]
    lift: dict[tuple[int, int], float] = {}
    wrench = np.zeros(6)
    for k in range(data.ncon):
        contact = data.contact[k]
        mujoco.mj_contactForce(model, data, k, wrench)
        upward = float((contact.frame.reshape(3, 3).T @ wrench[:3])[2])  # on the second geom's body
        first, second = (names[model.geom_bodyid[g]] for g in contact.geom)
        lift[second, first] = lift.get((second, first), 0.0) + upward
        lift[first, second] = lift.get((first, second), 0.0) - upward
    return {(a, b): force for (a, b), force in lift.items() if force > 0 and a != GROUND and a != b}


def release(objects: Sequence[SceneObject], *, true_scale: float = 1.0, seconds: float = 5.0) -> Release:
    """Let the scene go from rest, undamped, and measure it: one protocol for every method (docs: measures).

    Unlike the product's own model all objects have friction .6, rolling friction .001 and 600 kg/m3 of the
    visual volume spread evenly over their parts, and lengths are multiplied by ``true_scale``. D is sampled
    every 10 steps.
    """
    mujoco = engine()
    if not objects:
        return Release(0.0, 0.0)
    model = compiled(_release_spec(objects, true_scale))
    data = mujoco.MjData(model)
    K_max = D_max = 0.0
    mujoco.mj_forward(model, data)
    centers = data.xipos[1:].copy()
    for step in range(int(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if step < 500:
            mujoco.mj_energyVel(model, data)
            K_max = max(K_max, float(data.energy[1]))
        if step % 10 == 9:
            D_max = max(D_max, float(np.linalg.norm(data.xipos[1:] - centers, axis=1).max()))
    return Release(K_max, D_max)


def filling(o: SceneObject) -> float:
    """By how much the density of an object's parts must differ from its own, for the mass of the release protocol: its
    solid's volume, at least 1 mm3, over that of all parts.

    The solid's volume is the least of: the mesh's own when closed without welding (split vertices count as open), its
    hull's, and the sum over the parts.
    """
    parts = sum(p.volume for p in o.solids)
    return max(1e-9 / o.scale**3, min(o.mesh.stored_volume, o.mesh.hull.volume, parts)) / parts


_SOLIDS: WeakKeyDictionary[Mesh, tuple[tuple[ConvexPart, ...], MassProperties, bool]] = WeakKeyDictionary()


def _solid(mesh: Mesh, parts: tuple[ConvexPart, ...]) -> tuple[MassProperties, bool]:
    """``solid_properties``, once per mesh: only its scale and density change from stage to stage."""
    known = _SOLIDS.get(mesh)
    if known is None or not (known[2] or known[0] == parts):
        _SOLIDS[mesh] = known = (parts, *solid_properties(mesh, parts))
    return known[1], known[2]


def _empty_spec(config: PhysicsConfig, margin: float | None = None) -> MjSpec:
    """Options and the ground plane z = 0."""
    mujoco = engine()
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True  # thin solids: rounding may break the triangle inequality of moments
    spec.option.timestep = config.timestep
    spec.option.gravity = [0, 0, config.gravity]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = config.impratio
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.noslip_iterations = 0
    if not config.multiccd:
        spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MULTICCD)
    spec.worldbody.add_geom(
        name=GROUND_NAME,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[20, 20, 0.1],
        friction=config.ground_friction,
        **_contact(config, margin),
    )
    return spec


def _contact(config: PhysicsConfig, margin: float | None = None) -> dict[str, Any]:
    return {
        "condim": config.condim,
        "solref": config.solref,
        "solimp": config.solimp,
        "margin": config.margin if margin is None else margin,
    }


def _add_body(
    spec: MjSpec,
    body: Body,
    config: PhysicsConfig,
    *,
    even_density: float | None = None,
    margin: float | None = None,
) -> None:
    """The body with its explicit inertia, or with the same density in all its parts when one is given."""
    mujoco = engine()
    T, moment = body.T_world_body, body.inertia
    node = spec.worldbody.add_body(name=body.name, pos=T[:3, 3], quat=quaternion_from_rotation(T[:3, :3]))
    if not body.fixed:
        node.add_freejoint(name=body.name)
    if even_density is None:
        node.explicitinertial = True
        node.mass, node.ipos = body.mass, body.center
        node.fullinertia = [*np.diag(moment), moment[0, 1], moment[0, 2], moment[1, 2]]
    for k, part in enumerate(body.parts):
        name = f"{body.name}_{k:02d}"
        mesh = _add_mesh(spec, name, part)
        geom = node.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            friction=body.friction,
            **_contact(config, margin),
        )
        if body.solref is not None:
            geom.solref, geom.priority = body.solref, 1
        if even_density is None:
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # takes thin parts too
        else:
            geom.density = even_density


def _add_mesh(spec: MjSpec, name: str, part: ConvexPart) -> MjsMesh:
    return spec.add_mesh(
        name=name,
        uservert=part.vertices.astype(np.float32).ravel(),
        userface=part.faces.astype(np.int32).ravel(),
    )


def _release_spec(objects: Sequence[SceneObject], true_scale: float) -> MjSpec:
    """The model of the release protocol: bodies in the order of their masks' names, at the origin, with their
    vertices in world coordinates, mass by density on the geoms."""
    mujoco = engine()
    config = replace(DEFAULT_PHYSICS, margin=RELEASE_MARGIN)
    spec = _empty_spec(config)
    spec.compiler.balanceinertia = False
    for i, o in enumerate(sorted(objects, key=lambda o: o.mask_name)):
        body = spec.worldbody.add_body(name=f"o{i}")
        if o.mobility != "fixed":
            body.add_freejoint()
        to_true = np.diag([true_scale, true_scale, true_scale, 1.0]) @ o.T_world_asset
        for k, part in enumerate(o.solids):
            _add_mesh(spec, f"m{i}_{k}", part.moved(to_true))
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=f"m{i}_{k}",
                density=600 * filling(o),
                friction=config.ground_friction,
                **_contact(config),
            )
    return spec


@dataclass(eq=False)
class _Settling:
    """The run of ``settle``: steps data and keeps count of time and speed."""

    model: MjModel
    config: SettleConfig
    seconds: float = 0.0
    max_speed: float = 0.0
    exploded: bool = False

    def until_rest(self, data: MjData) -> None:
        """Damped steps until the mean speeds of a window of ``rest_time`` are low, or the time is up."""
        damping = 1 - self.config.damping * self.model.opt.timestep
        while self.seconds < self.config.time_limit and not self.exploded:
            before = _Snapshot.of(data)
            for _ in range(self._window):
                self._step(self.model, data, damping)
            self.seconds += self.config.rest_time
            if self._slow(before, _Snapshot.of(data)):
                return

    def undamped(self, model: MjModel, data: MjData, seconds: float) -> tuple[Array, bool]:
        """Undamped steps: the largest travel of every centre of mass (n,) [m], and whether all that counts as rest."""
        engine().mj_forward(model, data)
        start = before = after = _Snapshot.of(data)
        drifts = np.zeros(model.nbody - 1)
        for _ in range(max(1, round(seconds / self.config.rest_time))):
            before = after
            for _ in range(self._window):
                self._step(model, data, 1.0)
                way = data.xipos - start.centers
                way[:, 2] = np.minimum(way[:, 2], 0)  # what is pushed up by a wider margin does not fall
                drifts = np.maximum(drifts, np.linalg.norm(way, axis=1)[1:])
            after = _Snapshot.of(data)
            if self.exploded or drifts.max() > 20 * self.config.drift_limit:
                return drifts, False
        return drifts, self._slow(before, after) and bool(drifts.max() <= self.config.drift_limit)

    @staticmethod
    def fresh(model: MjModel, data: MjData) -> MjData:
        """The same positions with nothing remembered: no velocity, no warm start."""
        new = engine().MjData(model)
        new.qpos[:] = data.qpos
        return new

    @property
    def _window(self) -> int:
        """Steps in ``rest_time``."""
        return max(1, round(self.config.rest_time / self.model.opt.timestep))

    def _step(self, model: MjModel, data: MjData, damping: float) -> None:
        """One step, noting the largest speed; ``cvel`` is (angular, linear) at each free body's centre of mass."""
        engine().mj_step(model, data)
        data.qvel *= damping
        speed = float(np.linalg.norm(data.cvel[:, 3:], axis=1).max())
        self.max_speed = max(self.max_speed, speed)
        self.exploded = self.exploded or not np.isfinite(speed)

    def _slow(self, before: _Snapshot, after: _Snapshot) -> bool:
        """True when every body's mean speeds between two snapshots, one window apart, are below both limits."""
        linear = np.linalg.norm(after.centers - before.centers, axis=1).max() / self.config.rest_time
        turns = np.einsum("nij,nij->n", after.turns, before.turns)
        angular = np.arccos(np.clip((turns.min() - 1) / 2, -1, 1)) / self.config.rest_time
        self.exploded = self.exploded or not np.isfinite(linear + angular)
        return bool(linear < self.config.linear_rest and angular < self.config.angular_rest)


@dataclass(frozen=True, eq=False)
class _Snapshot:
    """Centres of mass (n, 3) [m] and orientations (n, 3, 3) of all bodies."""

    centers: Array
    turns: Array

    @classmethod
    def of(cls, data: MjData) -> _Snapshot:
        return cls(data.xipos.copy(), data.xmat.copy().reshape(-1, 3, 3))


def _pose_of(model: MjModel, data: MjData, o: SceneObject) -> Array:
    """The pose (4, 4) of an object's body."""
    if o.mobility == "fixed":
        return o.T_world_object
    q = data.joint(body_name(o.id)).qpos
    return pose(rotation_from_quaternion(q[3:]), q[:3])
