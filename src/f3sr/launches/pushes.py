"""Launches along the ground: sliding, pushing into something, rolling, toppling; closed forms first, then corrected."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.goals.language_protocol import Tried
from f3sr.launches import ballistics
from f3sr.launches.flights import striking, throwing_far
from f3sr.launches.launch_context import Aim, LaunchContext, Launches
from f3sr.scene import GRAVITY

PACE = 0.6
"""At which a hand pushes things about [m/s]."""
BEYOND = 1.06
"""Factor by which to aim farther than the goal's condition asks."""
BEYOND_BY = 0.004
"""Way [m] by which to aim farther in any case: for short ways, of which a factor is little."""
LEANS = math.radians(30)
"""Largest lean [rad] that is not falling over."""
BLOWS = (0.5, 0.8, 1.2, 1.8, 2.6, 3.8, 5.5)
"""Speeds at which one thing is pushed into another [m/s]."""
SURPLUS = (1.4, 1.9, 2.7, 4.0, 6.0)
"""Factors on the energy that toppling needs, tried in order."""
SPINS = (6.0, -6.0, 12.0, -12.0)
"""Rotation [rad/s] about the vertical, of what is to fall over and roll: it keeps it as a rotation about its own axis.
"""
BOWLED = 1.6
"""Fastest that something is rolled on a clear way to a target [m/s]: faster, a ball climbs what it meets by its spin.
"""
CLEAR = 0.005
"""Least distance [m] before the target at which a push ends."""


def sliding(s: LaunchContext) -> Launches:
    """A push along the direction; how far is corrected by how far it went, the pace where it fell."""
    if s.task.way == "off" and s.target is not None:
        yield from _sliding_off(s)
        return
    if s.layout.rolls(s.active, s.direction):
        yield from _rolling_far(s, s.direction)
        return
    needed = next((c for c in s.task.conditions if c.type == "displaced" and c.a == s.active), None)
    goal = (needed.at_least if needed else s.task.amount or s.size) * BEYOND + BEYOND_BY
    pace, aim = min(PACE * s.hard, s.calm(s.direction)), Aim(goal)
    for _ in range(9):
        (tried,) = yield [s.pushed(s.direction, aim.far, pace)]
        if s.lean(tried) > LEANS and pace > 0.1 and s.moved(tried) < 3 * goal:
            pace *= 0.6
        else:
            aim.ended(s.moved(tried))


def _sliding_off(s: LaunchContext) -> Launches:
    assert s.target is not None
    edge = s.layout.over_the_edge(s.active, s.target, s.direction)
    along = s.layout.corners(s.active) @ s.direction
    length = float(np.ptp(along))
    for factor, pace in ((1.0, 0.4), (1.1, 0.7), (1.2, 1.1), (1.2, 1.7), (1.3, 2.5), (1.3, 3.5)):
        yield [s.pushed(s.direction, factor * (edge + 0.6 * length), pace * s.hard)]
    if s.pool is not None:  # over the rim of what it lies in
        yield from throwing_far(s)


def pushing(s: LaunchContext) -> Launches:
    """At the target from where it is met first, faster and faster."""
    if s.target is None or s.task.way == "towards":
        yield from sliding(s)
        return
    if s.pool is not None:  # over the rim of what it lies in, not through it
        yield from striking(s, s.target)
    direction, gap = free_way(s, s.target)
    blocked = _met_first(s, direction) not in (None, s.target)
    outcome = any(c.a == s.target for c in s.task.conditions if c.type in ("toppled", "displaced", "rolled"))
    calm = s.calm(direction)
    for speed in (*BLOWS[1 if outcome else 0 :], s.limits.speed):
        pace = min(speed * s.hard, s.limits.speed)
        if not outcome and speed > calm and gap > s.size:
            pace = max(calm, 0.15) * (speed / BLOWS[0])
        until = gap - max(CLEAR, 0.05 * gap)
        if s.layout.rolls(s.active, direction):
            yield [s.thrown(pace * direction, angular=s.rolling(pace * direction), seconds=3.0)]
        elif until <= pace * 0.05:
            speed = math.sqrt(pace**2 + 2 * s.drag * max(gap, 0.0))
            yield [s.struck(direction, speed, until, seconds=3.0)]
        else:
            yield [s.pushed(direction, gap + pace**2 / (2 * s.drag), pace, until=until)]
        if blocked and speed > BLOWS[2]:
            break
    topples = any(c.type == "toppled" and c.a == s.target for c in s.task.conditions)
    if s.pool is None and (blocked or topples):
        yield from striking(s, s.target)


def free_way(s: LaunchContext, target: int) -> tuple[Array, float]:
    """The direction nearest to the goal's in which the target is met first, and the distance to it [m].

    It is the goal's own direction if there is none."""
    for angle in sorted(np.radians(np.arange(-50, 51, 5)), key=abs):
        c, n = math.cos(angle), math.sin(angle)
        x, y, _ = s.direction
        u = np.array([c * x - n * y, n * x + c * y, 0.0])
        met = s.layout.meets(s.active, u)
        if met and met[0][1] == target:
            return u, met[0][0]
    met = [way for way, id in s.layout.meets(s.active, s.direction) if id == target]
    apart = float(np.linalg.norm((s.layout.center(target) - s.center)[:2])) - s.size / 2
    return s.direction, met[0] if met else max(apart, 0.01)


def _met_first(s: LaunchContext, direction: Array) -> int | None:
    met = s.layout.meets(s.active, direction)
    return met[0][1] if met else None


def rolling(s: LaunchContext) -> Launches:
    """Off with the turning of its speed, to a target faster and faster."""
    direction, gap = (s.direction, 0.0) if s.target is None else free_way(s, s.target)
    slow = GRAVITY * s.layout.scene[s.active].rolling_friction / max(s.height, 1e-3)
    if s.target is not None and s.task.way not in ("towards", "away-from"):
        start = max(0.35, math.sqrt(2 * slow * gap) * 1.4) * s.hard
        clear = s.pool is None and _met_first(s, direction) == s.target
        for factor in (1.0, 1.5, 2.2, 3.2, 4.5, 6.5):
            speed = factor * start
            if clear and speed > BOWLED * s.hard:
                return
            v = speed * direction
            yield [s.thrown(v, angular=s.rolling(v), seconds=min(LONG, gap / speed + 2.0))]
            if factor > 2 and s.pool is not None:
                yield from _hopping(s, direction, speed)
        return
    yield from _rolling_far(s, direction)


def _rolling_far(s: LaunchContext, direction: Array) -> Launches:
    """With the turning of its speed; v^2 is corrected by how far it went."""
    slow = GRAVITY * s.layout.scene[s.active].rolling_friction / max(s.height, 1e-3)
    needed = next((c for c in s.task.conditions if c.type == "displaced" and c.a == s.active), None)
    goal = (needed.at_least if needed else s.size) * 1.12 + BEYOND_BY
    if needed and needed.at_most:
        goal = min(1.1 * goal, (needed.at_least + needed.at_most) / 2)
    aim = Aim(goal, most=3.0)
    for _ in range(9):
        v = min(math.sqrt(2 * slow * aim.far), s.limits.speed) * direction
        (tried,) = yield [s.thrown(v, angular=s.rolling(v), seconds=LONG)]
        aim.ended(min(s.moved(tried), goal * _turned(tried)))


def _turned(tried: Tried) -> float:
    """How much of the turning asked for was reached, as a share; infinite where it was enough."""
    rolled = [c for c in tried.verdict.conditions if c.condition.type == "rolled"]
    return min((1 + c.relative for c in rolled if not c.met), default=math.inf)


def _hopping(s: LaunchContext, direction: Array, speed: float) -> Launches:
    """Over the rim of what it lies in, rolling."""
    assert s.pool is not None
    v = speed * direction
    for clear in (0.3, 0.8, 1.5):
        up = ballistics.height_speed(max(s.pool.level - s.center[2], 0.0) + clear * s.height)
        yield [s.thrown(v + up * UP, angular=s.rolling(v), seconds=3.0)]


LONG = 4.5
"""Duration of a rollout of what rolls [s]."""


def toppling(s: LaunchContext) -> Launches:
    """About the edge of the base, with more and more energy; where no words say so, also to other sides."""
    said = any(c.type == "displaced" for c in s.task.conditions)
    turned = np.array([-s.direction[1], s.direction[0], 0.0])
    sides = [s.direction] if said else [s.direction, turned, -turned, -s.direction]
    ways = [(side, surplus) for side in sides for surplus in SURPLUS[:3]] + [(sides[0], more) for more in SURPLUS[3:]]
    rolls = any(c.type == "rolled" for c in s.task.conditions)
    spins = (0.0, *SPINS) if rolls else (0.0,)
    load = s.layout.loaded_mass(s.active) / s.layout.mass(s.active)
    for spin, (side, surplus) in product(spins, ways):
        twist = ballistics.topple(
            s.layout.corners(s.active),
            s.center,
            s.layout.inertia(s.active),
            s.layout.mass(s.active),
            side,
            surplus=surplus * load * (1.3 if s.task.manner == "hard" else 1.0),
        )
        if twist is None:
            over = np.asarray(np.cross(UP, side), float)
            yield [s.thrown(0.3 * side, angular=3.0 * over, seconds=2.5)]
        else:
            yield [s.thrown(twist.linear, angular=twist.angular + spin * UP, seconds=2.5)]
