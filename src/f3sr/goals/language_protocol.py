"""The language Protocol: three plain steps from words to something that can be played, for rules or for a model.

Only these typed values pass; ``checks`` looks at every one of them in the same way, whoever made it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from f3sr.goals.plan import InitialConditions, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import Rollout
from f3sr.goals.verify import Verdict
from f3sr.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Launch:
    """How the active object is set off, and how long to look (the Builder's answer)."""

    initial: InitialConditions
    simulation: SimulationPlan


@dataclass(frozen=True, eq=False, kw_only=True)
class Tried:
    """A launch and what came of it."""

    launch: Launch
    rollout: Rollout
    verdict: Verdict


class Language(Protocol):
    def plan(self, goal: str, scene: Scene) -> Sequence[TaskSpec] | Refusal:
        """The Planner: what the words ask for, the strictest reading first; a reading that cannot be met gives way to
        the next."""
        ...

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        """The Reasoner: what every object is to physics."""
        ...

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        """The Builder: launches to try next after all that were tried; none where it knows of no other."""
        ...
