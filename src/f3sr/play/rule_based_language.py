"""The language that needs no model: grammar, table of materials and closed forms."""

from __future__ import annotations

from collections.abc import Sequence

from f3sr.goals.language_protocol import Launch, Planned, Tried
from f3sr.goals.plan import InitialConditions, Semantics, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.scene_layout import SceneLayout
from f3sr.goals.simulate import as_planned
from f3sr.language.planner import planned
from f3sr.language.reasoner import semantics_of
from f3sr.launches.builder import Builder
from f3sr.scene import Scene


class Rules:
    """The default ``Language``."""

    def __init__(self) -> None:
        self._last: tuple[TaskSpec, Sequence[Semantics], Scene, Builder] | None = None

    def plan(self, goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
        return planned(goal, scene, phases)

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        return semantics_of(task, scene)

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        return self._builder(task, semantics, scene).next(tried)

    def _builder(self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene) -> Builder:
        last = self._last
        if last is None or last[0] is not task or last[1] is not semantics or last[2] is not scene:
            made = scene.with_objects(*as_planned(scene, semantics, InitialConditions()))
            self._last = last = (task, semantics, scene, Builder(task, SceneLayout(made)))
        return last[3]
