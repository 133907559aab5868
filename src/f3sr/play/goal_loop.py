"""A goal from words to verdict: plan, reason, build, try, correct, until it is met or the search is exhausted."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

from f3sr.errors import require_kind
from f3sr.goals import checks
from f3sr.goals.language_protocol import Language, Launch, Tried
from f3sr.goals.plan import Displaced, Height, Plan, Semantics, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import Rollout
from f3sr.goals.scene_layout import SceneLayout
from f3sr.goals.simulate import simulate
from f3sr.goals.verify import Verdict, verify
from f3sr.play.rule_based_language import Rules
from f3sr.play.trials import IN_FRAME, OverlapError, Trials, in_frame, rating, sure
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

    Returns a Refusal if the words are not understood or geometry rules the goal out. Otherwise returns the best trial;
    its verdict says whether it meets the goal. ``language`` answers the three steps (default: rules). Raises PlanError
    if an answer of it cannot be played, InputError for anything but a package.
    """
    _require_package(package)
    language, scene = language or Rules(), package.scene
    tasks = language.plan(goal, scene)
    if isinstance(tasks, Refusal):
        return tasks
    if not tasks:
        raise checks.PlanError("the Planner gave no task; accepted: at least one, or a refusal")
    return _Playing(language, Trials(scene, goal[:2000], scene_sha(package))).played(tasks[:READINGS])


def replay_plan(package: Package, plan: Plan) -> Played:
    """Play a plan again: the same rollout, to the byte. Raises PlanError if the plan does not fit the package."""
    _require_package(package)
    if plan.scene != scene_sha(package):
        raise checks.PlanError(
            f"the plan belongs to another scene ({plan.scene[:12]}); this one is {scene_sha(package)[:12]}"
        )
    checks.require(checks.faults_of(plan, package.scene), of="plan")
    try:
        rollout = simulate(package.scene, plan)
    except FloatingPointError as error:
        raise checks.PlanError(f"the plan cannot be played: {error}") from None
    return Played(plan=plan, rollout=rollout, verdict=verify(package.scene, plan, rollout))


def _require_package(package: Package) -> None:
    require_kind("package", package, Package, accepted="f3sr.read_package(...)")


@dataclass(eq=False)
class _Playing:
    """The search for one goal, over all its readings."""

    language: Language
    trials: Trials
    best: tuple[TaskSpec, Sequence[Semantics], Tried] | None = None
    refused: Refusal | None = None

    @property
    def scene(self) -> Scene:
        return self.trials.scene

    def played(self, tasks: Sequence[TaskSpec]) -> Played | Refusal:
        for task in tasks:
            checks.require(checks.task_faults(task, self.scene), of="task")
            self._try(task)
            if self.trials.spent or (self.best is not None and self.best[2].verdict.met):
                break
        if self.best is None:
            return self.refused or Refusal(reason="impossible", message="no way was found to set this off")
        task, semantics, tried = self.best
        plan = self.trials.plan(task, semantics, tried.launch, self.trials.rollouts)
        return Played(plan=plan, rollout=tried.rollout, verdict=tried.verdict)

    def _try(self, task: TaskSpec) -> None:
        """One reading: launches until one meets the goal with margin in the frame, or none is left."""
        semantics = tuple(self.language.reason(task, self.scene))
        checks.require(checks.semantics_faults(semantics, self.scene), of="semantics")
        semantics, layout = self.trials.steady(semantics), SceneLayout(self.scene)
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
                if sure(one) and in_frame(one, layout, task.active) >= IN_FRAME:
                    return
                if one.verdict.met and met is None:
                    met = self.trials.rollouts

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
        rated = rating(one, layout, task.active)
        if self.best is None or rated > rating(self.best[2], layout, self.best[0].active):
            self.best = (task, semantics, one)


def scene_sha(package: Package) -> str:
    return hashlib.sha256((package.folder / "scene.json").read_bytes()).hexdigest()
