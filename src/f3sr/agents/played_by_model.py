"""A goal played by models: the goal loop with their language, and what the calls were, noted in the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from f3sr.agents.model_language import Direct, Roles
from f3sr.goals.plan import ModelCall, Plan
from f3sr.goals.refusal import Refusal
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.scene_package.package import Package


def simulate_with_models(
    package: Package, goal: str, language: Roles | Direct, calls: Callable[[], Sequence[ModelCall]]
) -> Played | Refusal:
    """``simulate_goal`` with a language of models. The plan notes their ``calls``, and where their properties differ
    much from the table's. Raises ModelError where a model gives no answer that suits."""
    before = len(calls())
    played = simulate_goal(package, goal, language=language)
    if isinstance(played, Refusal):
        return played
    return replace(played, plan=_noted(played.plan, tuple(calls()[before:]), language.notes))


def _noted(plan: Plan, calls: tuple[ModelCall, ...], notes: Sequence[str]) -> Plan:
    first, *rest = plan.phases
    task = first.task.model_copy(update={"assumptions": (*first.task.assumptions, *notes)})
    return plan.model_copy(
        update={"calls": calls, "phases": (first.model_copy(update={"task": task}), *rest)},
    )
