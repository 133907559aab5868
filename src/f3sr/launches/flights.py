"""Launches through the air: dropping, throwing, launching up; closed forms first, then other arcs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.launches import ballistics
from f3sr.launches.launch_context import CLEARANCE, Aim, LaunchContext, Launches, Search
from f3sr.scene import GRAVITY, GROUND

ARCS = (0.4, 0.9, 1.6, 2.8)
"""How far above what it flies over an arc's top is, in sizes of what flies."""
AIMS = (0.0, -0.25, 0.25)
"""Where inside the target to aim, in half lengths of it along the way."""
STEEP, NARROW_AIMS = (2.8, 4.5, 1.6, 7.0), (0.0, -0.08, 0.08)
"""The same into an opening that is hardly wider than what flies: from high above, near its middle, and with its
longest axis upright when it comes down."""
TIGHT = 0.7
"""Share of an opening's width from which on what flies is hardly narrower."""
AFTER = 1.6
"""How long to look after a flight [s]."""


def dropping(s: LaunchContext) -> Launches:
    """Let go above the middle of the target, then above other places of it; lower where it does not stay."""
    height = max(s.task.amount or 0.3 * s.size, CLEARANCE)
    places = list(_places(s))
    for k, place in enumerate(places[:10]):
        for part in (1.0, 0.3) if k < 2 else (1.0,) if k % 2 else (0.5,):
            drop = max(part * height, CLEARANCE)
            yield [s.lifted(_above(s, place, drop), seconds=math.sqrt(2 * drop / GRAVITY) + AFTER + 0.6)]


def _above(s: LaunchContext, shift: Array, height: float) -> Array:
    """The offset (3,) to so far above where it first touches something once it is shifted by (2,); above where it is,
    where nothing says onto what it falls."""
    if s.task.target is None:
        return height * UP
    surface, _ = s.layout.landing(s.active, shift)
    return np.array([*shift, surface + height - s.layout.span(s.active)[0, 2]])


def _places(s: LaunchContext) -> Iterator[Array]:
    """Shifts (2,) to above the target, the best first: all of the object over it and level there, near its middle."""
    middle = s.layout.hull(s.active).mean(0)
    if s.task.target is None:
        yield np.zeros(2)
        return
    if s.target is None:
        yield from _free_ground(s)
        return
    low, high = s.layout.span(s.target)[:, :2]
    aim = (low + high) / 2
    pool = s.layout.pool(s.target)
    if pool is not None:
        for part in ((0, 0), (0.3, 0), (-0.3, 0), (0, 0.3), (0, -0.3)):
            yield pool.center + pool.radius * np.array(part) - middle
        return
    rated = list[tuple[float, int, Array]]()
    for i in (0, -1, 1, -2, 2):
        for j in (0, -1, 1, -2, 2):
            shift = aim + np.array([i, j]) * (high - low) / 6 - middle
            under = s.layout.under(s.active, shift)
            top, first = s.layout.landing(s.active, shift)
            # Share of the object that is level over the target; being over something else first costs more than any
            # share gains.
            good = sum(1.0 for z, whose in under if whose == s.target and z > top - 0.1 * s.size) / len(under)
            off = math.hypot(i, j) / 6
            rated.append((off - 2 * good + (3 if first != s.target else 0), len(rated), shift))
    yield from (shift for _, _, shift in sorted(rated, key=lambda r: r[:2]))


def _free_ground(s: LaunchContext) -> Iterator[Array]:
    """Shifts (2,) to places where only ground is below, the nearest in the photo first."""
    found = list[tuple[float, Array]]()
    for radius in np.arange(0, 6) * 0.5 * s.size:
        for angle in np.linspace(0, 2 * np.pi, 12 if radius else 1, endpoint=False):
            shift = radius * np.array([math.cos(angle), math.sin(angle)])
            if all(whose == GROUND for _, whose in s.layout.under(s.active, shift)):
                found.append((radius + 5 * s.size * (s.layout.in_frame(s.active, np.append(shift, 0)) < 0.8), shift))
        if len(found) > 8:
            break
    yield from (shift for _, shift in sorted(found, key=lambda f: f[0]))


def throwing(s: LaunchContext) -> Launches:
    """Arcs to the centre and other parts of the target, flat to steep, those with a clear path first."""
    if s.task.way == "over" and s.target is not None:
        yield from _throwing_over(s, s.target)
        return
    if s.task.target is None or s.task.way in ("off", "away-from"):
        yield from throwing_far(s)
        return
    if s.target is not None and any(c.a == s.target for c in s.task.conditions if c.type in ("toppled", "displaced")):
        yield from striking(s, s.target)
    hindered = yield from _arcs(s, *s.start)
    if hindered:
        yield from _arcs(s, *s.raised)


def _arcs(s: LaunchContext, start: Array, lift: Array | None) -> Search[bool]:
    """Returns whether the first met something at once, which a start above it would not."""
    arcs = (0.12, *ARCS) if s.task.way == "into" or s.task.manner == "hard" else ARCS
    ways = list[tuple[bool, int, Array, float, Array]]()
    narrow = list(product(NARROW_AIMS, STEEP)) if s.task.way == "into" and _is_tight(s) else []
    for k, (aim, arc) in enumerate((*narrow, *product(AIMS, arcs))):
        goal, over = goal_of(s, aim)
        v, seconds = ballistics.throw(start, goal, max(start[2], over) + arc * s.size)
        spin = _turned_upright(s, seconds) if k < len(narrow) else np.zeros(3)
        ways.append((is_blocked(s, [(start, v, seconds)], goal), k, v, seconds, spin))
    for k, (_, _, v, seconds, spin) in enumerate(sorted(ways, key=lambda w: w[:2])):
        (tried,) = yield [s.thrown(v, angular=spin, lift=lift, seconds=seconds + AFTER)]
        if k == 0 and lift is None and s.hindered(tried):
            return True
    return False


def _is_tight(s: LaunchContext) -> bool:
    """Whether the opening of the target is hardly wider than the object's middle extent."""
    pool = None if s.target is None else s.layout.pool(s.target)
    extents = np.sort(np.ptp(s.layout.corners(s.active), axis=0))
    return pool is not None and bool(extents[1] > 2 * TIGHT * pool.radius)


def _turned_upright(s: LaunchContext, seconds: float) -> Array:
    """The angular velocity (3,) [rad/s] that turns the object's longest axis upright in a time [s]."""
    arms = s.layout.corners(s.active) - s.layout.corners(s.active).mean(0)
    longest = np.linalg.eigh(arms.T @ arms)[1][:, -1]
    longest = longest if longest[2] >= 0 else -longest
    axis = np.cross(longest, UP)
    sine = float(np.linalg.norm(axis))
    return axis / max(sine, 1e-12) * math.atan2(sine, longest[2]) / seconds


def is_blocked(
    s: LaunchContext, arcs: list[tuple[Array, Array, float]], goal: Array, *, near: float | None = None
) -> bool:
    """Whether anything is in the path of flights, up to ``near`` [m] before the ``goal`` (3,): the target and what is
    bounced off are not.

    Each flight has a start (3,) [m], a velocity (3,) [m/s] and a duration [s]; the path is looked at in 14 places."""
    half = 0.5 * float(np.ptp(s.layout.corners(s.active) @ np.array([-s.direction[1], s.direction[0], 0.0])))
    free = {GROUND, s.target} | ({s.floor} if s.task.kind == "bounce" else set())
    if near is None:
        near = _extent(s)
    for start, v, seconds in arcs:
        for t in np.linspace(0, seconds, 16)[1:-1]:
            at = start + v * t - [0, 0, GRAVITY * t * t / 2]
            # At its ends the object is among what it starts from and comes to.
            if np.linalg.norm(at[:2] - goal[:2]) < near or np.linalg.norm(at[:2] - s.center[:2]) < half:
                continue
            # Three lines across the way, within the object's width.
            for aside in (-0.7, 0.0, 0.7):
                x, y = at[:2] + aside * half * np.array([-s.direction[1], s.direction[0]])
                top, whose = s.layout.top(float(x), float(y), without=s.active)
                if whose not in free and at[2] - s.height < top + 0.1 * s.size:
                    return True
    return False


def _extent(s: LaunchContext) -> float:
    """How near to its target something is no longer on its way to it [m]."""
    wide = 0.0 if s.target is None else float(np.ptp(s.layout.hull(s.target), axis=0).max()) / 2
    return wide + 0.3 * s.size


def striking(s: LaunchContext, target: int) -> Launches:
    """Flat and fast at the upper part of the target, then in arcs over what is in the way."""
    hindered = yield from _strikes(s, target, *s.start)
    if hindered:
        yield from _strikes(s, target, *s.raised)


def _strikes(s: LaunchContext, target: int, start: Array, lift: Array | None) -> Search[bool]:
    """Returns whether the first met something at once, which a start above it would not."""
    low, high = s.layout.span(target)
    ways = list[tuple[bool, int, Array, float]]()
    for part in (0.75, 0.9, 0.6):
        goal = np.array([*s.layout.center(target)[:2], low[2] + part * (high[2] - low[2])])
        far = max(float(np.linalg.norm((goal - start)[:2])), 1e-3)
        for speed in (2.0, 3.2, 5.0, 1.2, 7.0):
            seconds = far / speed
            # z(t) = z0 + up t - g t^2 / 2 meets the goal's height after ``seconds``.
            up = (goal[2] - start[2]) / seconds + GRAVITY * seconds / 2
            v = np.append(speed * (goal - start)[:2] / far, up)
            if np.linalg.norm(v) <= s.limits.speed:
                ways.append((is_blocked(s, [(start, v, seconds)], goal), len(ways), v, seconds))
        for arc in (0.5, 1.2):
            v, seconds = ballistics.throw(start, goal, max(start[2], goal[2]) + arc * s.size)
            ways.append((is_blocked(s, [(start, v, seconds)], goal), len(ways), v, seconds))
    for k, (_, _, v, seconds) in enumerate(sorted(ways, key=lambda w: w[:2])[:12]):
        (tried,) = yield [s.thrown(v, lift=lift, seconds=seconds + AFTER)]
        if k == 0 and lift is None and s.hindered(tried):
            return True
    return False


def goal_of(s: LaunchContext, aim: float) -> tuple[Array, float]:
    """Where the centre of mass is to come down (3,) [m], and the height [m] that it must clear before.

    ``aim`` is in half lengths of the target along the way, from its middle."""
    if s.target is None:
        goal = s.center + (s.task.amount or 2 * s.size) * s.direction
        return np.array([goal[0], goal[1], s.height]), s.height
    low, high = s.layout.span(s.target)
    middle = (low + high) / 2
    half = float(np.ptp(s.layout.corners(s.target) @ s.direction)) / 2
    pool = s.layout.pool(s.target)
    if s.task.way in ("into", "onto") and pool is not None:
        place = pool.center + aim * pool.radius * s.direction[:2]
        return np.array([*place, pool.level - 0.5 * pool.depth + s.height]), pool.level + s.height
    if s.task.way in ("into", "onto"):
        spots = s.layout.spots(s.target) or [middle[:2]]
        place = spots[min(round(abs(8 * aim)), len(spots) - 1)]
        return np.array([*place, s.layout.top(*place.tolist())[0] + s.height]), float(high[2] + s.height)
    place = middle[:2] + aim * half * s.direction[:2]
    return np.array([*place, middle[2]]), float(middle[2])


def _throwing_over(s: LaunchContext, target: int) -> Launches:
    """Over the target and down behind it, higher and farther."""
    start, lift = s.start
    along = s.layout.corners(target) @ s.direction
    own = s.layout.corners(s.active) @ s.direction
    top = float(s.layout.span(target)[1, 2])
    needed = next((c.at_least for c in s.task.conditions if c.type == "displaced"), 0.0)
    near, far = float(along.min() - start @ s.direction), float(along.max() - start @ s.direction)
    for arc in (0.5, 0.9, 1.4, 2.0, 3.0):
        beyond = max(far + 0.6 * float(np.ptp(own)) + 0.3 * arc * s.size, 1.15 * needed)
        goal = start + beyond * s.direction
        goal = np.array([goal[0], goal[1], s.height])
        apex = _apex_over(start[2], goal[2], beyond, (near, far), top + s.height + 0.35 * arc * s.size)
        v, seconds = ballistics.throw(start, goal, apex)
        (tried,) = yield [s.thrown(v, lift=lift, seconds=seconds + 1.0)]
        if lift is None and s.hindered(tried):
            start, lift = s.raised


def _apex_over(z0: float, z1: float, beyond: float, between: tuple[float, float], clear: float) -> float:
    """The lowest apex of a flight over ``beyond`` that is above ``clear`` between two distances, by bisection."""

    def lowest(apex: float) -> float:
        # Seconds from the start to the top and from there down; times below are counted from the top.
        up, down = math.sqrt(2 * (apex - z0) / GRAVITY), math.sqrt(2 * (apex - z1) / GRAVITY)
        times = [np.clip(x / beyond, 0, 1) * (up + down) - up for x in between]
        return min(apex - GRAVITY * t * t / 2 for t in times)

    # A higher apex is steeper at both ends, so the lowest height between them grows with it: bisection.
    low, high = max(z0, z1, clear), max(z0, z1, clear) + 20 * clear
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (low, middle) if lowest(middle) >= clear else (middle, high)
    return high


def throwing_far(s: LaunchContext) -> Launches:
    """Half as high as a throw of 45 degrees; where it comes down is corrected by where it ends."""
    start, lift = s.start
    goal = (s.task.amount or 2 * s.size) * 1.08
    if s.task.way == "off" and s.target is not None:
        goal = s.layout.over_the_edge(s.active, s.target, s.direction) + 1.2 * s.size
    aim = Aim(goal, far=0.85 * goal)
    rise = next((c.at_least for c in s.task.conditions if c.type == "height"), 0.0)
    for k in range(9):
        place = start + aim.far * s.direction
        apex = start[2] + max(0.2 * aim.far, 1.4 * rise) * (1.0 if k < 5 else 1.6)
        v, seconds = ballistics.throw(
            start, np.array([place[0], place[1], s.height]), max(apex, start[2] + 1e-3, s.height + 1e-3)
        )
        (tried,) = yield [s.thrown(v, lift=lift, seconds=seconds + AFTER + 0.6)]
        aim.ended(s.moved(tried))


def launching(s: LaunchContext) -> Launches:
    """Straight up, faster where friction or a load took some speed; then slightly sideways, out of its container."""
    rise = s.task.amount or 1.5 * s.size
    below = s.layout.support(s.active)
    pool = None if below == GROUND else s.layout.pool(below)
    aside = np.zeros(2) if pool is None else pool.center - s.center[:2]
    for factor, part in ((1.06, 0.0), (1.15, 0.0), (1.06, 0.5), (1.3, 0.0), (1.06, 1.0), (1.6, 0.0), (1.2, 0.7)):
        if part and not aside.any():
            continue
        up = ballistics.height_speed(factor * rise + 0.005)
        flat = part * aside / (2 * up / GRAVITY)
        yield [s.thrown(np.array([*flat, up]), seconds=2 * up / GRAVITY + AFTER)]
