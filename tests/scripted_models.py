"""Models that answer from a script, without a network: a competent one, which knows the rules' plans, and bad ones."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, TypeVar

from pydantic import BaseModel

from f3sr.goals.plan import Plan
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.scene_package.package import Package

M = TypeVar("M", bound=BaseModel)


@dataclass
class Scripted:
    """Answers by role; an answer may be a function of the parts. A check that fails raises ValueError at once."""

    answers: Mapping[str, Any]
    asked: list[tuple[str, Sequence[str | bytes]]] = field(default_factory=list[tuple[str, Sequence[str | bytes]]])

    def ask(
        self,
        role: str,
        instructions: str,
        parts: Sequence[str | bytes],
        answer: type[M],
        check: Callable[[M], None] | None = None,
    ) -> M:
        self.asked.append((role, parts))
        given = self.answers[role]
        found = answer.model_validate_json(json.dumps(given(parts) if callable(given) else given))
        if check is not None:
            check(found)
        return found


def competent(package: Package, goal: str) -> Mapping[str, Any]:
    """What a model would answer that plans as the rules do, for every role."""
    return answers_of(played_by_rules(package, goal).plan)


@cache
def played_by_rules(package: Package, goal: str) -> Played:
    """A goal as the rules play it: many tests ask for that of one package, which never changes."""
    played = simulate_goal(package, goal)
    assert isinstance(played, Played), played
    return played


def answers_of(plan: Plan) -> Mapping[str, Any]:
    """The answers of every role that make a plan."""
    phases = [phase.model_dump(mode="json") for phase in plan.phases]
    flying = {p["task"]["active"]: s for p in phases for s in p["semantics"] if s["restitution"] > 0}
    objects = [
        {
            "restitution": flying.get(s["id"], s)["restitution"],
            **{k: s[k] for k in ("id", "material", "structure", "density", "friction", "rolling_friction")},
        }
        for s in phases[0]["semantics"]
    ]
    launches = [{"initial": p["initial"], "duration": p["simulation"]["duration"]} for p in phases]
    turn = iter(range(10**9))
    return {
        "planner": {"schema_version": 1, "phases": [p["task"] for p in phases]},
        "reasoner": {"schema_version": 1, "objects": objects},
        "builder": lambda _: {"schema_version": 1, **launches[next(turn) % len(launches)]},
        "direct": {
            "schema_version": 1,
            "objects": objects,
            "phases": [{"task": p["task"], **launch} for p, launch in zip(phases, launches, strict=True)],
        },
    }
