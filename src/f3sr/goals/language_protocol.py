"""The language Protocol: three steps from words to a launch, for rules or for a model (docs: goals).

Only these typed values pass; ``checks`` validates each of them, regardless of the implementation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from f3sr.goals.plan import InitialConditions, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import Rollout
from f3sr.goals.verify import Verdict
from f3sr.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Launch:
    """How the active object is launched, and the simulation's length and step (the Builder's answer)."""

    initial: InitialConditions
    simulation: SimulationPlan


@dataclass(frozen=True, eq=False, kw_only=True)
class Tried:
    """A launch with its rollout and verdict."""

    launch: Launch
    rollout: Rollout
    verdict: Verdict


@dataclass(frozen=True, kw_only=True)
class Planned:
    """The next phase of a goal (the Planner's answer)."""

    readings: Sequence[TaskSpec]
    """What its words may mean, strictest first. A reading that cannot be met gives way to the next."""
    last: bool = True
    """Whether no other phase follows."""


@runtime_checkable
class Language(Protocol):
    """Words to tasks, tasks to physical properties, tasks to launches; implement it to add a language model."""

    def plan(self, goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
        """The Planner: the next phase of a goal. ``scene`` is what the photo shows and words refer to. ``phases`` are
        the scenes at the ends of all phases before, at rest. A Refusal explains words that cannot be read."""
        ...

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        """The Reasoner: physical properties of every object, in the order of the scene."""
        ...

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        """The Builder: launches to try next, given all trials so far; empty if it has no other."""
        ...
