"""A plan played another way: its launch faster or slower, and turned about the vertical."""

from __future__ import annotations

import math
from typing import TypeVar

from f3sr.goals.plan import Impulse, InitialConditions, Plan, Push3, Velocity

T = TypeVar("T", Velocity, Impulse)


def varied(plan: Plan, *, speed: float, turn: float) -> Plan:
    """The plan with velocities and impulses of its first phase times ``speed``, turned by ``turn`` [rad] about +Z.

    Where objects are put before stays, and so does what must come of it. Later phases start where the first one ends,
    and keep their launches.
    """
    first, *rest = plan.phases
    start = first.initial
    changed = InitialConditions(
        offsets=start.offsets,
        velocities=tuple(_launched(v, speed, turn) for v in start.velocities),
        impulses=tuple(_launched(i, speed, turn) for i in start.impulses),
    )
    return plan.model_copy(update={"phases": (first.model_copy(update={"initial": changed}), *rest)})


def _launched(launch: T, speed: float, turn: float) -> T:
    ways = {"linear": _turned(launch.linear, speed, turn), "angular": _turned(launch.angular, speed, turn)}
    return launch.model_copy(update=ways)


def _turned(way: Push3, speed: float, turn: float) -> Push3:
    x, y, z = way
    c, s = math.cos(turn), math.sin(turn)
    return speed * (c * x - s * y), speed * (s * x + c * y), speed * z
