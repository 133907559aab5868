"""A goal from words to verdict: for every phase plan, reason, build, try, correct, until it is met or none is left."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from f3sr.errors import require_kind
from f3sr.goals import checks
from f3sr.goals.language_protocol import Language, Launch, Tried
from f3sr.goals.plan import MOST_PHASES, Displaced, Height, Phase, Plan, Semantics, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import Rollout, joined
from f3sr.goals.scene_layout import SceneLayout
from f3sr.goals.sequence import scene_after, simulate
from f3sr.goals.verify import Verdict, verify
from f3sr.play.rule_based_language import Rules
from f3sr.play.trials import OverlapError, Trials, in_sight, phase_of, rating, sure
from f3sr.scene import Scene
from f3sr.scene_package.package import Package

READINGS = 4
"""Readings of a goal that are tried, the strictest first."""
MORE = 3
"""Further rollouts after the first that meets the goal: one may meet it with margin and in the photo's frame."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Played:
    """A played goal: its plan, the rollout (poses and contacts over time) and the verdict on its conditions."""

    plan: Plan
    rollout: Rollout
    verdict: Verdict
    stopped: bool = False
    """Whether the goal has more phases, which were not played because the last one here was missed."""

    @property
    def nearest(self) -> str:
        """A hint for a missed distance or height: the amount that was reached. Otherwise empty."""
        for c in self.verdict.conditions:
            if c.reached is None or not isinstance(c.condition, Displaced | Height):
                continue
            if 0.005 < c.reached < c.condition.at_least:
                return f"at most {math.floor(1000 * c.reached) / 1000:g} m was reached; ask for that"
        return ""


def simulate_goal(package: Package, goal: str, *, language: Language | None = None) -> Played | Refusal:
    """Play a goal in words in the scene of a package (docs: goals). Deterministic.

    Returns a Refusal if the words are not understood or geometry rules the goal out. Otherwise returns the best trial
    of every phase; its verdict says whether it meets the goal. ``language`` answers the three steps (default: rules).
    Raises PlanError if an answer of it cannot be played, InputError for anything but a package or a damaged one.
    """
    _require_package(package)
    require_kind("goal", goal, str, accepted="words, as `f3sr goals PACKAGE` lists them")
    language = Rules() if language is None else language
    require_kind("language", language, Language, accepted="an object with the methods plan, reason and build")
    scene = replace(package.scene, ground_mask=package.support())
    found, ends, rollouts = list[Tried](), list[Scene](), 0
    phases = list[Phase]()
    while True:
        planned = language.plan(goal, scene, ends)
        if isinstance(planned, Refusal):
            return _of_phase(planned, len(phases))
        if not planned.readings:
            raise checks.PlanError("the Planner gave no task; accepted: at least one, or a refusal")
        search = _Search(language, Trials(ends[-1] if ends else scene), phases[0].semantics if phases else ())
        best = search.best_of(planned.readings[:READINGS], rests=not planned.last)
        rollouts += search.trials.rollouts
        if isinstance(best, Refusal):
            return _of_phase(best, len(phases))
        phases.append(best[0])
        found.append(best[1])
        if planned.last or not found[-1].verdict.met:
            break
        if len(phases) == MOST_PHASES:
            raise checks.PlanError(f"more than {MOST_PHASES} phases; accepted: at most {MOST_PHASES}")
        ends.append(scene_after(ends[-1] if ends else scene, phases[-1], found[-1].rollout))
    plan = Plan(goal=goal[:2000], scene=scene_sha(package), phases=tuple(phases), rollouts=rollouts)
    rollout = joined([tried.rollout for tried in found])
    return Played(plan=plan, rollout=rollout, verdict=verify(scene, plan, rollout), stopped=not planned.last)


def _of_phase(refusal: Refusal, played: int) -> Refusal:
    """A refusal that says which phase it is of, where others come before."""
    return replace(refusal, message=f"phase {played + 1}: {refusal.message}") if played else refusal


def replay_plan(package: Package, plan: Plan) -> Played:
    """Play a plan again: the same rollout, to the byte. Raises PlanError if the plan does not fit the package."""
    _require_package(package)
    require_kind("plan", plan, Plan, accepted="the plan of a played goal")
    if plan.scene != scene_sha(package):
        raise checks.PlanError(
            f"the plan belongs to another scene ({plan.scene[:12]}); this one is {scene_sha(package)[:12]}"
        )

    def check(phase: Phase, scene: Scene) -> None:
        checks.require(checks.faults_of(phase, scene), of="plan")

    try:
        rollout = simulate(package.scene, plan, check=check)
    except FloatingPointError as error:
        raise checks.PlanError(f"the plan cannot be played: {error}") from None
    return Played(plan=plan, rollout=rollout, verdict=verify(package.scene, plan, rollout))


def _require_package(package: Package) -> None:
    require_kind("package", package, Package, accepted="f3sr.read_package(...)")


@dataclass(eq=False)
class _Search:
    """The search for one phase, over all its readings."""

    language: Language
    trials: Trials
    materials: Sequence[Semantics]
    """Of the phases before, which stay; empty in the first phase."""
    best: tuple[TaskSpec, Sequence[Semantics], Tried] | None = None
    refused: Refusal | None = None

    @property
    def scene(self) -> Scene:
        return self.trials.scene

    def best_of(self, tasks: Sequence[TaskSpec], *, rests: bool) -> tuple[Phase, Tried] | Refusal:
        """The best trial; where another phase follows, played on until everything ``rests``."""
        for task in tasks:
            checks.require(checks.task_faults(task, self.scene), of="task")
            self._try(task)
            if self.trials.spent or (self.best is not None and self.best[2].verdict.met):
                break
        if self.best is None:
            return self.refused or Refusal(reason="impossible", message="no way was found to set this off")
        task, semantics, tried = self.best
        if rests and tried.verdict.met:
            tried = self.trials.rested(task, semantics, tried)
        return phase_of(task, semantics, tried.launch), tried

    def _try(self, task: TaskSpec) -> None:
        """One reading: launches until one meets the goal with margin in sight, or none is left."""
        semantics = tuple(self.language.reason(task, self.scene))
        checks.require(checks.semantics_faults(semantics, self.scene), of="semantics")
        semantics, layout = self._lasting(semantics), SceneLayout(self.scene)
        tried: list[Tried] = []
        met: int | None = None
        while not self.trials.spent and (met is None or self.trials.rollouts < met + MORE):
            launches = self.language.build(task, semantics, self.scene, tried)
            if isinstance(launches, Refusal):
                self.refused = launches
                return
            if not launches:
                return
            for launch in launches:
                one = self._one(task, semantics, launch)
                if one is None:
                    return
                tried.append(one)
                self._keep(task, semantics, one, layout)
                if _is_best(one, layout, task):
                    return
                if one.verdict.met and met is None:
                    met = self.trials.rollouts

    def _lasting(self, semantics: Sequence[Semantics]) -> tuple[Semantics, ...]:
        """With which the scene rests; only restitution may differ from phase to phase, as it counts at speed alone."""
        if not self.materials:
            return self.trials.steady(semantics)
        made = zip(self.materials, semantics, strict=True)
        return tuple(before.model_copy(update={"restitution": s.restitution}) for before, s in made)

    def _one(self, task: TaskSpec, semantics: Sequence[Semantics], launch: Launch) -> Tried | None:
        checks.require(checks.launch_faults(launch, task, semantics, self.scene), of="launch")
        try:
            return self.trials.run(task, semantics, launch)
        except OverlapError as error:
            self.refused = Refusal(reason="impossible", message=str(error))
        except FloatingPointError as error:
            self.refused = Refusal(reason="impossible", message=str(error))
        return None

    def _keep(self, task: TaskSpec, semantics: Sequence[Semantics], one: Tried, layout: SceneLayout) -> None:
        rated = rating(one, layout, task)
        if self.best is None or rated > rating(self.best[2], layout, self.best[0]):
            self.best = (task, semantics, one)


def _is_best(one: Tried, layout: SceneLayout, task: TaskSpec) -> bool:
    """Whether no better launch is sought: met with margin, in sight, without side effects."""
    return sure(one) and not one.verdict.side_effects and in_sight(one, layout, task)


def scene_sha(package: Package) -> str:
    return hashlib.sha256((package.folder / "scene.json").read_bytes()).hexdigest()
