"""The one MuJoCo model of the product: the bodies of objects, their contacts and the ground."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, cast
from weakref import WeakKeyDictionary

import numpy as np
from annotated_types import Interval

from f3sr.core.mesh import ConvexPart, MassProperties, Mesh, solid_properties
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_from_quaternion
from f3sr.files.bounds import MIN_MOMENT
from f3sr.physics import restitution
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.scene import GRAVITY, GROUND, Ground, SceneObject
from f3sr.settings import settings

GROUND_NAME = "ground"

MjSpec = MjModel = MjData = MjsMesh = Any
"""MuJoCo's classes, which carry no type information."""


IMPRATIO = 10.0
"""Ratio of friction to normal impedance: the higher, the less contacts slip in the elliptic cone."""
MEMORY = 2**28
"""Memory of a simulation's contacts and constraints [B]; only what is used is taken. MuJoCo's own guess is too small
where many parts lie in each other before they are parted."""
SOLIMP = (0.95, 0.99, 0.0005, 0.5, 2.0)
"""Contact impedance: least, most, width [m], midpoint and power; stiff within half a millimetre."""
CONDIM = 6
"""Contact dimensions: six add rolling friction, without which balls never stop."""
TORSIONAL_FRICTION = 0.005
"""Friction against spinning about the contact normal [m]."""
LEAST_MOMENT = 1.01 * MIN_MOMENT
"""What smaller principal moments of inertia are raised to [kg m2]: rounding leaves it above ``MIN_MOMENT``."""
GROUND_ROLLING_FRICTION = 0.001
"""Rolling friction of the ground [m]."""

Length = Annotated[float, Interval(gt=0, le=1)]


@settings
class PhysicsConfig:
    """Contact model and time stepping, chosen for piles that rest (docs: measures)."""

    timestep: Annotated[float, Interval(gt=0, le=0.005)] = 0.002
    """Time step [s], at most half of solref's first value."""
    solref: tuple[Length, Annotated[float, Interval(gt=0, le=10)]] = (0.005, 1.0)
    """Contact time constant [s] and damping ratio. A time constant of .02 creeps ten times more."""
    contact: ContactMargin = DEFAULT_MARGIN

    @property
    def margin(self) -> float:
        """Contact margin of each body [m]. Bodies at rest are two margins apart."""
        return self.contact.body

    def __post_init__(self) -> None:
        if self.solref[0] < 2 * self.timestep:
            raise ValueError("solref whose first value is at least two time steps")


DEFAULT_PHYSICS = PhysicsConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class Body:
    """A rigid body of the engine, in the object frame, metres, scale baked in."""

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
    """Contact ``solref`` override for bouncing objects; None uses the model's default."""
    parts: tuple[ConvexPart, ...]


@cache
def engine() -> Any:
    """The ``mujoco`` module, imported on first use.

    Its warnings go neither to the terminal nor to a MUJOCO_LOG.TXT in the working folder: f3sr reports a state that
    blows up itself. A caller's ``mujoco.set_mju_user_warning`` still receives them.
    """
    import mujoco

    log = cast(Any, mujoco).MjLogConfig.get()
    log.logto_file = log.logto_console = False
    log.set()
    warnings.filterwarnings("ignore", category=UserWarning, module=re.escape(__name__))  # of ``compiled``
    return mujoco


def compiled(spec: MjSpec) -> MjModel:
    """The model of a specification. Raises ValueError if MuJoCo rejects a number."""
    return spec.compile()


def body_name(id: int) -> str:
    return f"object_{id:02d}"


def part_name(body: str, k: int) -> str:
    """Of the geom and the mesh of a body's part."""
    return f"{body}_{k:02d}"


def body_of(o: SceneObject, *, bounces: bool = False) -> Body:
    """The rigid body of an object: mass and inertia of its solid at its density, its parts in metres.

    Its contacts follow its restitution only where it ``bounces``: a pile would sink into contacts so soft. Principal
    moments below ``LEAST_MOMENT``, of grains and needles, are raised to it."""
    solid, from_mesh = solid_of(o)
    scale = np.diag([o.scale, o.scale, o.scale, 1.0])
    return Body(
        name=body_name(o.id),
        T_world_body=o.T_world_object,
        fixed=o.mobility == "fixed",
        mass=o.density * solid.volume * o.scale**3,
        center=solid.center * o.scale,
        inertia=_simulable(inertia_of(o)),
        from_mesh=from_mesh,
        friction=(o.friction, TORSIONAL_FRICTION, o.rolling_friction),
        solref=restitution.solref(o.restitution) if bounces else None,
        parts=tuple(part.moved(scale) for part in o.solids),
    )


def inertia_of(o: SceneObject) -> Array:
    """(3, 3) [kg m2] about the centre of mass of an object's solid, however small."""
    return o.density * solid_of(o)[0].inertia * o.scale**5


def _simulable(inertia: Array) -> Array:
    moments, axes = np.linalg.eigh(inertia)
    if moments[0] >= MIN_MOMENT:
        return inertia
    return axes @ np.diag(np.maximum(moments, LEAST_MOMENT)) @ axes.T


def solid_of(o: SceneObject) -> tuple[MassProperties, bool]:
    """Volume, centre and inertia of an object's solid, as given, else of its mesh or its parts; and whether of the
    mesh."""
    return _solid(o.mesh, o.parts or (o.mesh.hull,)) if o.solid is None else (o.solid, o.mesh.is_solid)


def build_spec(
    objects: Sequence[SceneObject],
    config: PhysicsConfig = DEFAULT_PHYSICS,
    *,
    ground_friction: float = Ground.friction,
    bounces: bool = False,
) -> MjSpec:
    """The editable MuJoCo model: the ground, and per object a body with one mesh geom per convex part.

    Bodies are named ``object_03``, their geoms and meshes ``object_03_00``; dynamic ones have a free joint of
    the body's name. The body frame is the object frame.
    """
    spec = empty_spec(config, ground_friction=ground_friction)
    for o in objects:
        add_body(spec, body_of(o, bounces=bounces), config)
    return spec


def contact_loads(model: MjModel, data: MjData, ids: Sequence[int]) -> dict[tuple[int, int], float]:
    """Loads in a state: (carried, carrier) to the net upward contact force [N], positive entries only.

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


_SOLIDS: WeakKeyDictionary[Mesh, tuple[tuple[ConvexPart, ...], MassProperties, bool]] = WeakKeyDictionary()


def _solid(mesh: Mesh, parts: tuple[ConvexPart, ...]) -> tuple[MassProperties, bool]:
    """``solid_properties``, once per mesh: only its scale and density change from stage to stage."""
    known = _SOLIDS.get(mesh)
    if known is None or not (known[2] or known[0] == parts):
        _SOLIDS[mesh] = known = (parts, *solid_properties(mesh, parts))
    return known[1], known[2]


def ground_contact_friction(ground_friction: float) -> tuple[float, float, float]:
    """Sliding, torsional [m] and rolling [m] friction of the ground."""
    return ground_friction, TORSIONAL_FRICTION, GROUND_ROLLING_FRICTION


def empty_spec(config: PhysicsConfig, *, ground_friction: float = Ground.friction) -> MjSpec:
    """Options and the ground plane z = 0."""
    mujoco = engine()
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True  # thin solids: rounding may break the triangle inequality of moments
    spec.option.timestep = config.timestep
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = IMPRATIO
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.noslip_iterations = 0
    spec.memory = MEMORY
    spec.worldbody.add_geom(
        name=GROUND_NAME,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[20, 20, 0.1],
        friction=ground_contact_friction(ground_friction),
        **contact_options(config),
    )
    return spec


def contact_options(config: PhysicsConfig, margin: float | None = None) -> dict[str, Any]:
    return {
        "condim": CONDIM,
        "solref": config.solref,
        "solimp": SOLIMP,
        "margin": config.margin if margin is None else margin,
    }


def add_body(spec: MjSpec, body: Body, config: PhysicsConfig) -> None:
    """The body with its explicit inertia."""
    mujoco = engine()
    T, moment = body.T_world_body, body.inertia
    node = spec.worldbody.add_body(name=body.name, pos=T[:3, 3], quat=quaternion_from_rotation(T[:3, :3]))
    if not body.fixed:
        node.add_freejoint(name=body.name)
    node.explicitinertial = True
    node.mass, node.ipos = body.mass, body.center
    node.fullinertia = [*np.diag(moment), moment[0, 1], moment[0, 2], moment[1, 2]]
    for k, part in enumerate(body.parts):
        name = part_name(body.name, k)
        mesh = add_mesh(spec, name, part)
        geom = node.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            friction=body.friction,
            **contact_options(config),
        )
        if body.solref is not None:
            geom.solref, geom.priority = body.solref, 1
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # takes thin parts too


def add_mesh(spec: MjSpec, name: str, part: ConvexPart) -> MjsMesh:
    return spec.add_mesh(
        name=name,
        uservert=part.vertices.astype(np.float32).ravel(),
        userface=part.faces.astype(np.int32).ravel(),
    )


def pose_of(model: MjModel, data: MjData, o: SceneObject) -> Array:
    """The pose (4, 4) of an object's body."""
    if o.mobility == "fixed":
        return o.T_world_object
    q = data.joint(body_name(o.id)).qpos
    return pose(rotation_from_quaternion(q[3:]), q[:3])
