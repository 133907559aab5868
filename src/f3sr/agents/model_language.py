"""A Language of models: Planner, Reasoner and Builder as three typed calls, or one direct call for the whole plan.

What a model answers is checked, launched and judged as what the rules answer. The launch solver, off or on, corrects
a launch that misses; a repair asks the model again with the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Interval

from f3sr.agents import answer_checks, prompts
from f3sr.agents.asks import Asks
from f3sr.agents.role_answers import BuilderAnswer, DirectAnswer, Estimate, PlannerAnswer, ReasonerAnswer
from f3sr.agents.scene_evidence import SceneEvidence, digest
from f3sr.goals import checks
from f3sr.goals.language_protocol import Launch, Planned, Tried
from f3sr.goals.plan import Semantics, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.language.reasoner import at_speed
from f3sr.language.reference_resolution import names
from f3sr.play.rule_based_language import Rules
from f3sr.scene import Scene
from f3sr.settings import settings


@settings
class AgentConfig:
    """How a model's answers are used."""

    crops: Annotated[int, Interval(ge=0, le=100)] = 12
    """Most crops of objects that a model is shown: each costs some hundred tokens."""
    solver: bool = True
    """Whether the launch solver of the rules goes on where a model's launch misses."""
    repairs: Annotated[int, Interval(ge=0, le=5)] = 1
    """How many times a model is asked for another launch, with the verdict on its last."""


@dataclass(eq=False)
class _Conversation:
    """What was answered for one goal in one scene."""

    goal: str
    scene: Scene
    evidence: SceneEvidence
    tasks: Sequence[TaskSpec] = ()
    estimates: Sequence[Estimate] = ()
    phase: int = 0
    """Index of the task that is being played."""
    launches: list[Launch] = field(default_factory=list[Launch])
    """The model's own launches of that task."""

    @property
    def parts(self) -> list[str | bytes]:
        return [*self.evidence.parts, f"The goal, in a user's words:\n{self.goal}"]


class _ModelLanguage:
    """What both agents share: phases in order, the Reasoner's properties, and launches until one meets the task."""

    def __init__(self, config: AgentConfig | None = None) -> None:
        self.config = config or AgentConfig()
        self.rules = Rules()
        self.notes: tuple[str, ...] = ()
        """Disagreements of the last goal's estimates with the table, in words."""
        self._now: _Conversation | None = None

    def plan(self, goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
        if not phases or self._now is None:
            evidence = SceneEvidence.of(scene, crops=self.config.crops)
            self._now, self.notes = _Conversation(goal=goal[:2000], scene=scene, evidence=evidence), ()
            if refused := self._begun(self._now):
                return Refusal(reason="model", message=refused)
        tasks = self._now.tasks
        self._now.phase, self._now.launches = len(phases), []
        return Planned(readings=[tasks[len(phases)]], last=len(phases) + 1 == len(tasks))

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        now = self._talking()
        if not now.estimates:
            now.estimates = self._estimated(now)
        self.notes = tuple(answer_checks.disagreements(now.estimates, now.scene))
        return [answer_checks.semantics_of(e, scene, at_speed=e.id in at_speed(task)) for e in now.estimates]

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        now = self._talking()
        own = now.launches
        if not tried:
            own.append(self._launch(now, task, semantics, scene))
            return own
        met = any(t.verdict.met for t in tried)
        if not met and len(own) == len(tried) <= self.config.repairs:
            own.append(self._launch(now, task, semantics, scene, tried[-1]))
            return own[-1:]
        if met or not self.config.solver:
            return ()
        return self.rules.build(task, semantics, scene, tried[len(own) :])

    def _talking(self) -> _Conversation:
        if self._now is None:
            raise checks.PlanError("the model was asked for a launch before a plan")
        return self._now

    def _begun(self, now: _Conversation) -> str | None:
        """Asks for the tasks; a refusal in words, or None."""
        raise NotImplementedError

    def _estimated(self, now: _Conversation) -> Sequence[Estimate]:
        raise NotImplementedError

    def _launch(
        self,
        now: _Conversation,
        task: TaskSpec,
        semantics: Sequence[Semantics],
        scene: Scene,
        missed: Tried | None = None,
    ) -> Launch:
        raise NotImplementedError


class Roles(_ModelLanguage):
    """Planner, Reasoner and Builder; the Reasoner's model may be another than the others'."""

    def __init__(self, model: Asks, reasoner: Asks | None = None, config: AgentConfig | None = None) -> None:
        super().__init__(config)
        self.model, self.reasoner = model, reasoner or model

    def _begun(self, now: _Conversation) -> str | None:
        def suits(answer: PlannerAnswer) -> None:
            for task in answer.phases:
                answer_checks.require(answer_checks.task_faults(task, now.scene))

        answer = self.model.ask("planner", prompts.PLANNER, now.parts, PlannerAnswer, suits)
        now.tasks = answer.phases
        return answer.refusal

    def _estimated(self, now: _Conversation) -> Sequence[Estimate]:
        def suits(answer: ReasonerAnswer) -> None:
            answer_checks.require(answer_checks.estimate_faults(answer.objects, now.scene))

        return self.reasoner.ask("reasoner", prompts.REASONER, now.parts, ReasonerAnswer, suits).objects

    def _launch(
        self,
        now: _Conversation,
        task: TaskSpec,
        semantics: Sequence[Semantics],
        scene: Scene,
        missed: Tried | None = None,
    ) -> Launch:
        def suits(answer: BuilderAnswer) -> None:
            launch = answer_checks.launch_of(answer.initial, answer.duration, scene)
            answer_checks.require(checks.launch_faults(launch, task, semantics, scene))

        known = "\n".join(s.model_dump_json() for s in semantics)
        parts = [*now.parts, f"The task:\n{task.model_dump_json()}", f"The properties of the objects:\n{known}"]
        if scene is not now.scene:
            parts.append(f"The scene as it lies now:\n{digest(scene, names(now.scene))}")
        if missed is not None:
            launched = missed.launch.initial.model_dump_json()
            parts.append(f"Your last launch was {launched}\nIt missed: {missed.verdict.said}\nGive a better one.")
        answer = self.model.ask("builder", prompts.BUILDER, parts, BuilderAnswer, suits)
        return answer_checks.launch_of(answer.initial, answer.duration, scene)


class Direct(_ModelLanguage):
    """One call for the whole plan, for the comparison with roles. A repair is another whole plan."""

    def __init__(self, model: Asks, config: AgentConfig | None = None) -> None:
        super().__init__(config)
        self.model = model
        self._answer: DirectAnswer | None = None

    def _begun(self, now: _Conversation) -> str | None:
        self._answer = self._asked(now, now.parts)
        now.tasks, now.estimates = [phase.task for phase in self._answer.phases], self._answer.objects
        return self._answer.refusal

    def _asked(self, now: _Conversation, parts: Sequence[str | bytes], tasks: Sequence[TaskSpec] = ()) -> DirectAnswer:
        def suits(answer: DirectAnswer) -> None:
            if answer.refusal is not None and not tasks:
                return
            answer_checks.require(answer_checks.estimate_faults(answer.objects, now.scene))
            if tasks and [phase.task for phase in answer.phases] != list(tasks):
                raise ValueError("another task than before; accepted: the same tasks with other launches")
            estimates = {e.id: e for e in answer.objects}
            for phase in answer.phases:
                answer_checks.require(answer_checks.task_faults(phase.task, now.scene))
                semantics = [answer_checks.semantics_of(e, now.scene, at_speed=False) for e in estimates.values()]
                launch = answer_checks.launch_of(phase.initial, phase.duration, now.scene)
                answer_checks.require(checks.launch_faults(launch, phase.task, semantics, now.scene))

        return self.model.ask("direct", prompts.DIRECT, parts, DirectAnswer, suits)

    def _estimated(self, now: _Conversation) -> Sequence[Estimate]:
        return now.estimates

    def _launch(
        self,
        now: _Conversation,
        task: TaskSpec,
        semantics: Sequence[Semantics],
        scene: Scene,
        missed: Tried | None = None,
    ) -> Launch:
        if missed is not None and self._answer is not None:
            launched = self._answer.model_dump_json()
            said = f"Your last plan was {launched}\nThe phase {task.interpretation!r} missed: {missed.verdict.said}"
            self._answer = self._asked(now, [*now.parts, f"{said}\nGive other launches of the same tasks."], now.tasks)
        assert self._answer is not None
        phase = self._answer.phases[now.phase]
        return answer_checks.launch_of(phase.initial, phase.duration, scene)
