"""What models may answer, as records that are checked: plan, properties, launch, and all of them at once."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from f3sr.files.bounds import MAX_OBJECTS, Density, Friction, Id, RollingFriction, Share
from f3sr.files.meanings import Documented
from f3sr.goals.plan import MOST_PHASES, InitialConditions, TaskSpec
from f3sr.scene import Structure
from f3sr.scene_package.scene_json import Version

Seconds = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Reason = Annotated[str, Field(min_length=1, max_length=300)]


class _Answer(Documented):
    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Version
    """1"""


class _OrRefusal(_Answer):
    refusal: Reason | None = None
    """One sentence, where the goal asks for nothing that this scene can show."""

    def _require_one(self, phases: int) -> None:
        if (phases > 0) == (self.refusal is not None):
            raise ValueError("both phases and refusal, or neither; accepted: one of them")


class PlannerAnswer(_OrRefusal):
    """The Planner's answer: the phases of a goal in order."""

    phases: Annotated[tuple[TaskSpec, ...], Field(max_length=MOST_PHASES)] = ()

    @model_validator(mode="after")
    def _one(self) -> Self:
        self._require_one(len(self.phases))
        return self


class Estimate(Documented):
    """The physical properties of an object."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Id
    material: Annotated[str, Field(min_length=1, max_length=80)]
    structure: Structure
    density: Density
    """[kg/m3] over the volume in the digest, contents and air included."""
    friction: Friction
    """Coefficient of sliding friction."""
    rolling_friction: RollingFriction
    """[m]"""
    restitution: Share
    """Coefficient of restitution from a hard table."""


class ReasonerAnswer(_Answer):
    """The Reasoner's answer: the properties of every object, in the order of the digest."""

    objects: Annotated[tuple[Estimate, ...], Field(max_length=MAX_OBJECTS)]


class BuilderAnswer(_Answer):
    """The Builder's answer: how the active object is launched."""

    initial: InitialConditions
    duration: Seconds
    """Of the simulation [s]."""


class DirectPhase(Documented):
    """A phase of a final plan."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    task: TaskSpec
    initial: InitialConditions
    duration: Seconds
    """[s]"""


class DirectAnswer(_OrRefusal):
    """A whole plan in one answer."""

    objects: Annotated[tuple[Estimate, ...], Field(max_length=MAX_OBJECTS)] = ()
    """The properties of every object, in the order of the digest."""
    phases: Annotated[tuple[DirectPhase, ...], Field(max_length=MOST_PHASES)] = ()

    @model_validator(mode="after")
    def _one(self) -> Self:
        self._require_one(len(self.phases))
        return self


AgentName = Literal["roles", "direct"]
