"""plan.json: phases of a goal, each with task, materials, initial conditions, simulation and success conditions.

Every number has a limit that holds for any scene. ``checks`` tests whether a plan fits one scene.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from f3sr.files import strict_json
from f3sr.files.bounds import Damping, Density, Direction3, Friction, Id, IdOrGround, Mass, RollingFriction, Share
from f3sr.files.meanings import Documented
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import MaterialSource, Mobility, Structure
from f3sr.scene_package.scene_json import WHOLE, dump_json

SCHEMA_VERSION = 2
MOST_PHASES = 4
"""Most phases of a plan: more are hard to follow in one film."""
MIN_TIMESTEP = 1e-4
"""Shortest time step of a plan [s]: a tenth of what contacts need."""
MAX_STEPS = 40_000
"""Most steps of a rollout: four times what the longest takes at the usual step."""

Kind = Literal[
    "topple",
    "slide",
    "push_into",
    "roll",
    "drop",
    "lift_and_drop",
    "throw",
    "bounce",
    "launch_and_return",
]
Way = Literal["into", "onto", "against", "towards", "to", "at", "over", "off", "away-from"]
"""How the words relate the active object to the target."""
Manner = Literal["gently", "hard"]
Seconds = Annotated[float, Field(ge=0, le=60, allow_inf_nan=False)]
Metres = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=0, le=math.pi, allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
Component = Annotated[float, Field(ge=-1e4, le=1e4, allow_inf_nan=False)]
Push3 = tuple[Component, Component, Component]
"""Of a push, a speed or a shift: beyond its range no limit of any scene lies."""
Words = Annotated[str, Field(max_length=2000)]
Source = MaterialSource | Literal["words"]
"""Where the properties come from: as the package says, from the goal's words, or from a model."""


Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, le=10**12)]


class _Record(Documented):
    model_config = ConfigDict(extra="forbid", frozen=True)


# --- what must come of it -----------------------------------------------------------------------------------------


class _Condition(_Record):
    after: Annotated[int, Field(ge=0)] | None = None
    """Index of an earlier condition: the event counts only after that condition's event."""
    within: Seconds | None = None
    """Latest time of the event [s]."""


class Contact(_Condition):
    """Two objects touch, or one the ground."""

    type: Literal["contact"] = "contact"
    a: Id
    b: IdOrGround
    first: bool = False
    """Whether they must not touch before the event that this one comes ``after``, but for the start."""


class Displaced(_Condition):
    """The centre of mass moves by at least ``at_least`` [m], and by at most ``at_most`` [m] at the end.

    With a ``direction`` of the world it moves along it, no farther sideways than along."""

    type: Literal["displaced"] = "displaced"
    a: Id
    at_least: Metres
    at_most: Metres | None = None
    direction: Direction3 | None = None


class Toppled(_Condition):
    """At the end the object's initial up direction leans from the vertical by at least ``at_least`` [rad]."""

    type: Literal["toppled"] = "toppled"
    a: Id
    at_least: Angle = math.radians(60)


class Upright(_Condition):
    """At the end the object's initial up direction leans from the vertical by at most ``at_most`` [rad]."""

    type: Literal["upright"] = "upright"
    a: Id
    at_most: Angle = math.radians(30)


class Rolled(_Condition):
    """It rotates by at least ``at_least`` [rad] about axes across its path."""

    type: Literal["rolled"] = "rolled"
    a: Id
    at_least: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
    upended: bool = False
    """Whether it rolls as what has fallen over does: only rotation about its initial up direction counts."""


class Bounced(_Condition):
    """After contact with ``b`` the centre of mass rises again by at least ``at_least`` [m]."""

    type: Literal["bounced"] = "bounced"
    a: Id
    b: IdOrGround
    at_least: Metres


class Over(_Condition):
    """It passes above the other: its lowest point is above the other's highest one.

    Its centre is then within the other's outline, seen from above."""

    type: Literal["over"] = "over"
    a: Id
    b: Id


class Off(_Condition):
    """At the end its centre of mass is outside the other's outline seen from above."""

    type: Literal["off"] = "off"
    a: Id
    b: Id


class On(_Condition):
    """At the end one object is carried by another, or by the ground."""

    type: Literal["on"] = "on"
    a: Id
    b: IdOrGround


class Inside(_Condition):
    """At the end the centre of mass of one is inside the hull of the other."""

    type: Literal["inside"] = "inside"
    a: Id
    b: Id


class AtRest(_Condition):
    """At the end it moves slower than so much, over the last fifth of a second."""

    type: Literal["at_rest"] = "at_rest"
    a: Id
    speed: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)] = 0.02


class Height(_Condition):
    """The centre of mass rises at least so far above where it was."""

    type: Literal["height"] = "height"
    a: Id
    at_least: Metres


class Returned(_Condition):
    """The centre of mass comes back to within so far of where it was."""

    type: Literal["returned"] = "returned"
    a: Id
    to_within: Metres
    stays: bool = True
    """Whether it must be there at the end, or only come back at some time."""


Condition = Annotated[
    Contact | Displaced | Toppled | Upright | Rolled | Bounced | Over | Off | On | Inside | AtRest | Height | Returned,
    Field(discriminator="type"),
]


class TaskSpec(_Record):
    """The typed reading of the words (the Planner's answer)."""

    kind: Kind
    active: Id
    """The one object that is launched."""
    target: IdOrGround | None = None
    way: Way | None = None
    passives: tuple[Id, ...] = ()
    """Objects that rest on or in the active one or the target, and may move with it; they stay free."""
    direction: Direction3 | None = None
    """Unit vector of the world."""
    amount: Metres | None = None
    """Distance to go, height to rise, or height of the release [m]."""
    manner: Manner | None = None
    phases: tuple[Words, ...] = ()
    """Phases of the motion in causal order, in words."""
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1, max_length=16)]
    interpretation: Words
    assumptions: tuple[Words, ...] = ()

    @model_validator(mode="after")
    def _in_order(self) -> TaskSpec:
        for k, condition in enumerate(self.conditions):
            if condition.after is not None and condition.after >= k:
                raise ValueError(f"condition {k} is after {condition.after}; accepted: an earlier one")
        if self.target == self.active or self.active in self.passives:
            raise ValueError(f"object {self.active} is active; accepted: another one as target or passive")
        return self


# --- what things are ----------------------------------------------------------------------------------------------


class Semantics(_Record):
    """Physical properties of an object (the Reasoner's answer)."""

    id: Id
    material: Annotated[str, Field(max_length=80)]
    structure: Structure
    mass: Mass
    """[kg]"""
    density: Density
    """[kg/m3] of its solid's volume, air inside included."""
    friction: Friction
    rolling_friction: RollingFriction
    """[m]"""
    restitution: Share
    damping: Damping = 0.0
    """Rate of velocity loss [1/s], also without contact."""
    mobility: Mobility
    source: Source


# --- how it is set off --------------------------------------------------------------------------------------------


class Offset(_Record):
    """A start pose other than the package's: a shift [m], then a rotation vector [rad] about the centre of mass."""

    id: Id
    translation: Push3 = (0.0, 0.0, 0.0)
    rotation: Push3 = (0.0, 0.0, 0.0)


class Velocity(_Record):
    """Velocity of the centre of mass [m/s] and angular velocity [rad/s] at the start, both in the world."""

    id: Id
    linear: Push3 = (0.0, 0.0, 0.0)
    angular: Push3 = (0.0, 0.0, 0.0)


class Impulse(_Record):
    """An impulse on an object from a time on [s]: at its centre of mass [N s], and angular [N m s], in the world."""

    id: Id
    time: Seconds
    duration: Seconds = 0.0
    """Duration [s] over which a constant force gives the impulse; 0 acts in one step."""
    linear: Push3 = (0.0, 0.0, 0.0)
    angular: Push3 = (0.0, 0.0, 0.0)


class InitialConditions(_Record):
    offsets: tuple[Offset, ...] = ()
    velocities: tuple[Velocity, ...] = ()
    impulses: Annotated[tuple[Impulse, ...], Field(max_length=64)] = ()

    @model_validator(mode="after")
    def _once(self) -> InitialConditions:
        for name in ("offsets", "velocities"):
            ids = [one.id for one in getattr(self, name)]
            if len(set(ids)) < len(ids):
                raise ValueError(f"{name} of objects {ids}; accepted: one per object")
        return self

    @property
    def controlled(self) -> frozenset[int]:
        return frozenset(one.id for one in (*self.offsets, *self.velocities, *self.impulses))


class Limits(_Record):
    """Limits of the active object's launch, for the size of the scene."""

    speed: Limit
    """Initial speed of its centre of mass [m/s]; by rotation its fastest point may have twice that."""
    impulse: Limit
    """One impulse, and the momentum of an initial velocity [N s]."""
    force: Limit
    """Force of a push [N]; for a torque, at the arm of its farthest point."""
    lift: Limit
    """Length of an offset [m]."""


class SimulationPlan(_Record):
    """Settings of the simulation."""

    duration: Annotated[float, Field(gt=0, le=30, allow_inf_nan=False)]
    """[s]"""
    timestep: Annotated[float, Field(ge=MIN_TIMESTEP, le=0.002, allow_inf_nan=False)] = 1 / 960
    """[s]"""
    margin: Annotated[float, Field(ge=0, le=1e-3, allow_inf_nan=False)] = DEFAULT_MARGIN.body
    """Contact margin of each body [m]: with that of the package's settling, what rests stays where it is."""
    steps_per_sample: Annotated[int, Field(ge=1, le=1000)] = 32
    """A sample every so many steps: 30 in a second."""
    limits: Limits | None = None
    """Limits that the initial conditions keep."""

    @model_validator(mode="after")
    def _ends(self) -> SimulationPlan:
        if self.steps > MAX_STEPS:
            raise ValueError(f"{self.steps:,} steps; accepted: at most {MAX_STEPS:,}")
        return self

    @property
    def steps(self) -> int:
        return round(self.duration / self.timestep)

    @property
    def samples(self) -> int:
        """Of the whole rollout, that at 0 with them."""
        return self.steps // self.steps_per_sample + 1


class Phase(_Record):
    """One launch and what must come of it. It starts where everything rests after the phase before."""

    task: TaskSpec
    semantics: tuple[Semantics, ...]
    """Of every object, in the order of the scene."""
    initial: InitialConditions
    simulation: SimulationPlan
    """Times count from the start of the phase."""


class ModelCall(_Record):
    """A call of a language model: what it cost, and digests of what it was shown and what it said."""

    role: Annotated[str, Field(max_length=40)]
    model: Annotated[str, Field(max_length=200)]
    """Provider and name."""
    host: Annotated[str, Field(max_length=300)]
    mode: Annotated[str, Field(max_length=40)]
    """How the form of the answer was asked for: json_schema, tool or json_object."""
    prompt_sha256: Digest
    """Of texts and pictures."""
    reply_sha256: Digest
    input_tokens: Count
    output_tokens: Count
    cost: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None
    """[USD]; null where the price is not known."""
    seconds: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    attempts: Count


class Plan(_Record):
    """Everything that determines a rollout of one scene, to the byte (docs: goals)."""

    schema_version: Annotated[Literal[2], WHOLE] = SCHEMA_VERSION
    goal: Words
    scene: Digest
    """SHA-256 of the package's scene.json: a plan belongs to one scene."""
    phases: Annotated[tuple[Phase, ...], Field(min_length=1, max_length=MOST_PHASES)]
    """One after another."""
    rollouts: Annotated[int, Field(ge=0)] = 0
    """Number of rollouts of the search that found it."""
    calls: Annotated[tuple[ModelCall, ...], Field(max_length=1000)] = ()
    """Of language models that made it, in order; the rules make none."""

    @model_validator(mode="before")
    @classmethod
    def _of_one_launch(cls, values: Any) -> Any:
        """A plan of version 1 is one phase, whose parts it has itself."""
        version = values.get("schema_version") if isinstance(values, dict) else None
        if type(version) is not int or version != 1:
            return values
        phase = {name: values[name] for name in Phase.model_fields if name in values}
        rest = {name: value for name, value in values.items() if name not in phase}
        return rest | {"schema_version": SCHEMA_VERSION, "phases": [phase]}

    @model_validator(mode="after")
    def _same_things(self) -> Plan:
        weights = {tuple((s.id, s.density) for s in phase.semantics) for phase in self.phases}
        if len(weights) > 1:
            raise ValueError("phases with other densities; accepted: the same ones in every phase")
        return self


def to_json(plan: Plan) -> bytes:
    return dump_json(plan.model_dump(mode="json"))


def from_json(data: bytes) -> Plan:
    """The plan of a text; ValueError says what is wrong with it."""
    return Plan.model_validate(strict_json.loads(data))
