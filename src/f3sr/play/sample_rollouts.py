"""A plan played in other scenes that the photo may show as well: how often its goal is met."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from f3sr.errors import require_kind
from f3sr.goals.plan import Phase, Plan, Semantics
from f3sr.goals.sequence import simulate
from f3sr.goals.verify import Verdict, verify
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene

NINETY = 1.645
"""Standard deviations of a normal distribution that 90 % are within."""


@dataclass(frozen=True, kw_only=True)
class SuccessRate:
    """Of one plan over samples of its scene; ``missed`` says what failed, by the number of the sample, from 1."""

    met: int
    count: int
    missed: dict[int, str]

    @property
    def rate(self) -> float:
        return self.met / self.count

    @property
    def interval(self) -> tuple[float, float]:
        """That holds the true rate with 90 % (Wilson 1927)."""
        n, p, z2 = self.count, self.rate, NINETY**2
        middle = (p + z2 / (2 * n)) / (1 + z2 / n)
        half = NINETY / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n**2))
        return max(0.0, middle - half), min(1.0, middle + half)


def success_rate(plan: Plan, scenes: Iterable[Scene]) -> SuccessRate:
    """Play a plan, launch and all, as it is in some scenes of the same objects. Raises InputError for no plan."""
    require_kind("plan", plan, Plan, accepted="the plan of a played goal")
    missed: dict[int, str] = {}
    count = 0
    for scene in scenes:
        count += 1
        verdict = _verdict(plan, scene)
        if isinstance(verdict, str):
            missed[count] = verdict
        elif not verdict.met:
            missed[count] = "; ".join([*verdict.broken, *(c.said for c in verdict.conditions if not c.met)])
    return SuccessRate(met=count - len(missed), count=count, missed=missed)


def _verdict(plan: Plan, scene: Scene) -> Verdict | str:
    """What came of a plan in another scene: its densities stay, so masses go with the sizes."""
    phases = tuple(phase.model_copy(update={"semantics": _as_heavy(phase, scene)}) for phase in plan.phases)
    plan = plan.model_copy(update={"phases": phases})
    try:
        return verify(scene, plan, simulate(scene, plan))
    except FloatingPointError as error:
        return f"cannot be played: {error}"


def _as_heavy(phase: Phase, scene: Scene) -> tuple[Semantics, ...]:
    """A phase's semantics with the masses that its densities give in another scene."""
    return tuple(
        s.model_copy(update={"mass": body_of(scene[s.id]).mass * s.density / scene[s.id].density})
        for s in phase.semantics
    )
