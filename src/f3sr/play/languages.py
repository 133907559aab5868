"""Languages by name: the rules, and what other packages add in the entry point group ``f3sr.language``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from f3sr.backends.registry import Backend, Kind
from f3sr.files.strict_json import problem
from f3sr.goals.checks import PlanError
from f3sr.goals.language_protocol import Language, Launch, Planned, Tried
from f3sr.goals.plan import InitialConditions, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.scene import Scene

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

LANGUAGES = Kind(name="language", protocol=Language, built_in={"rules": "f3sr.play.rule_based_language:Rules"})
MOST = 1000
"""Tasks, semantics or launches of one answer: a scene has fewer objects."""


@dataclass(frozen=True, eq=False)
class CheckedLanguage:
    """A ``Language`` that holds every answer of a back end against its type. Whether an answer suits the scene,
    ``goals.checks`` says. Raises PlanError for an answer of another type, BackendError where the back end raises."""

    backend: Backend[Language]

    def plan(self, goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
        answer = self.backend.asked(lambda b: b.plan(goal, scene, phases))
        if isinstance(answer, Refusal):
            return answer
        answer = self._typed(answer, Planned)
        readings = [self._record(t, TaskSpec) for t in self._listed(answer.readings)]
        return Planned(readings=readings, last=answer.last is not False)

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        answer = self.backend.asked(lambda b: b.reason(task, scene))
        return tuple(self._record(s, Semantics) for s in self._listed(answer))

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        answer = self.backend.asked(lambda b: b.build(task, semantics, scene, tried))
        return answer if isinstance(answer, Refusal) else [self._launch(launch) for launch in self._listed(answer)]

    def _launch(self, answer: object) -> Launch:
        launch = self._typed(answer, Launch)
        initial, simulation = launch.initial, launch.simulation
        return Launch(
            initial=self._record(initial, InitialConditions), simulation=self._record(simulation, SimulationPlan)
        )

    def _listed(self, answer: object) -> Sequence[object]:
        listed: Sequence[object] = self._typed(answer, Sequence)
        if len(listed) > MOST:
            raise PlanError(f"{self.backend}: answered with {len(listed):,} values; accepted: at most {MOST:,}")
        return listed

    def _record(self, answer: object, kind: type[M]) -> M:
        """Validated once more: pydantic makes records without looking where it is asked to."""
        try:
            return kind.model_validate(self._typed(answer, kind).model_dump(warnings=False))
        except ValidationError as error:
            found, accepted = problem(error, ", ".join(kind.model_fields))
            raise PlanError(f"{self.backend}: answered with {found}; accepted: {accepted}") from None

    def _typed(self, answer: object, kind: type[T]) -> T:
        if not isinstance(answer, kind):
            raise PlanError(f"{self.backend}: answered with {type(answer).__name__}; accepted: {kind.__name__}")
        return answer
