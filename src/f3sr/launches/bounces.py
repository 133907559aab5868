"""Launches that bounce: off the floor to a target, off the target, or up and down; aimed in closed form.

The floor is what the object and its target stand on: the ground, or a desk (``LaunchContext.floor``)."""

from __future__ import annotations

import math

import numpy as np

from f3sr.core.transforms import UP, Array, rotation_about
from f3sr.goals.language_protocol import Tried
from f3sr.goals.scene_layout import way_between
from f3sr.launches import ballistics
from f3sr.launches.flights import AFTER, AIMS, goal_of, is_blocked
from f3sr.launches.launch_context import LaunchContext, Launches
from f3sr.physics.restitution import LEAST
from f3sr.scene import GRAVITY

LEFT = 0.15
"""Time [s] after which a launched object touches the floor by falling on it."""
FASTER = 5
"""Most speeds that are tried for one throw."""


def bouncing(s: LaunchContext) -> Launches:
    """To the floor and from there to the target; the aim is corrected by where the bounce led. What does not bounce
    slides on."""
    e = s.layout.scene[s.active].restitution
    start, lift = s.start
    if s.target is None:
        yield from _bouncing_up(s, start, lift)
        return
    if s.task.way in ("off", "onto", "over"):
        spots = (s.layout.spots(s.target) or [s.layout.center(s.target)[:2]])[:9:4]
        for place in spots:
            for arc in (1.5, 3.0):
                goal = np.array([*place, s.layout.top(*place.tolist())[0] + s.height])
                v, seconds = ballistics.throw(start, goal, max(start[2], goal[2]) + arc * s.size)
                yield [s.thrown(v, lift=lift, seconds=seconds + AFTER)]
        return
    if e <= LEAST or not s.layout.rolls(s.active, s.direction):
        yield from _skipping(s, start, lift)
    if e <= LEAST:
        return
    if s.layout.pool(s.target) is None or s.task.way != "into":
        yield from _bouncing_at(s, s.target, e)
        return
    ways = list[tuple[bool, int, Array, float]]()
    for arc in (0.15, 0.5, 1.0, 2.0, 3.5):
        for aim in AIMS:
            goal, over = goal_of(s, aim)
            apex = max(over, goal[2]) + arc * s.size
            ways.append((_bounce_blocked(s, start, goal, e, apex), len(ways), goal, apex))
    for _, _, goal, apex in sorted(ways, key=lambda w: w[:2])[:7]:
        shift = np.zeros(3)
        for _ in range(3):
            v, seconds = ballistics.bounce(start, goal + shift, s.low, e, apex)
            (tried,) = yield [s.thrown(v, angular=s.rolling(v * [1, 1, 0]), lift=lift, seconds=seconds + AFTER)]
            came = _came_down(s, tried, float(goal[2]))
            if came is None or np.linalg.norm(came - goal[:2]) < 0.1 * s.size:
                break
            shift[:2] += np.clip(goal[:2] - came, -s.size, s.size)


def _bouncing_at(s: LaunchContext, target: int, e: float) -> Launches:
    """To the floor somewhere on the way, from where the bounce leads to the target's side: wherever both flights are
    clear, straight on first."""
    start, lift = s.start
    top, rolls = float(s.layout.span(target)[1, 2]), s.layout.rolls(s.active, s.direction)
    ways = list[tuple[bool, float, int, Array, float]]()
    for angle in range(-35, 36, 7):
        u = rotation_about(UP, math.radians(angle)) @ s.direction
        near, beyond = way_between(s.layout.hull(s.active), s.layout.hull(target), u[:2])
        if not 0 < near < beyond:
            continue
        for part in (0.5, 0.65, 0.35, 0.8, 0.92):
            place = np.append((start + part * near * u)[:2], s.low)
            for arc in (0.4, 0.8, 1.5, 3.0) if rolls else (0.15, 0.25, 0.4, 0.8):
                v, first = ballistics.throw(start, place, max(start[2], s.low) + arc * s.size)
                # It comes down with g t - v_z. What spins as it rolls keeps its horizontal speed; from what does not,
                # friction takes as much of it as it presses.
                down = GRAVITY * first - v[2]
                kept = 1 if rolls else 1 - s.drag / GRAVITY * (1 + e) * down / max(np.linalg.norm(v[:2]), 1e-12)
                if kept <= 0:
                    continue
                off = np.array([kept * v[0], kept * v[1], e * down])
                second = (1 - part) / part * first / kept
                height = s.low + off[2] * second - GRAVITY * second**2 / 2
                if s.low < height < 0.9 * top + 0.1 * (s.low - s.height):
                    flights, goal = [(start, v, first), (place, off, second)], start + near * u
                    blocked = not _floor_at(s, place) or is_blocked(s, flights, goal, near=0.0)
                    ways.append((blocked, abs(angle), len(ways), v, first + second))
    for *_, v, seconds in sorted(ways, key=lambda w: w[:3])[:10]:
        yield from _in_time(s, target, v, lift, seconds + AFTER)


def _in_time(s: LaunchContext, target: int, v: Array, lift: Array | None, seconds: float) -> Launches:
    """A throw whose horizontal speed is bisected between those that miss after the bounce, as friction takes speed
    then, and those that touch the target before it."""
    slow, fast, factor = 0.0, math.inf, 1.0
    for _ in range(FASTER):
        off = v * [factor, factor, 1]
        spin = s.rolling(off * [1, 1, 0]) if s.layout.rolls(s.active, s.direction) else None
        (tried,) = yield [s.thrown(off, angular=spin, lift=lift, seconds=seconds)]
        bounced = min((t for t in tried.rollout.touches(s.active, s.floor)["time"] if t > LEFT), default=math.inf)
        touched = min((t for t in tried.rollout.touches(s.active, target)["time"] if t > 0), default=math.inf)
        if bounced < touched < math.inf:
            return
        if touched < bounced:
            fast = factor
        else:
            slow = factor
        factor = (slow + fast) / 2 if fast < math.inf else 1.5 * factor


def _floor_at(s: LaunchContext, place: Array) -> bool:
    """Whether nothing but what it is to bounce off is under the object around a place."""
    around = [place[:2] + 0.7 * s.height * np.array(k) for k in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
    return all(s.layout.top(float(x), float(y), without=s.active)[1] == s.floor for x, y in around)


def _bounce_blocked(s: LaunchContext, start: Array, goal: Array, e: float, apex: float) -> bool:
    """Whether something is in the way of a bounce, or where it is to bounce is no floor."""
    v, _ = ballistics.bounce(start, goal, s.low, e, apex)
    down = math.sqrt(v[2] ** 2 + 2 * GRAVITY * (start[2] - s.low))
    first = (v[2] + down) / GRAVITY
    place = np.append((start + v * first)[:2], s.low)
    off = np.array([v[0], v[1], e * down])
    second = (off[2] + math.sqrt(max(off[2] ** 2 - 2 * GRAVITY * (goal[2] - s.low), 0.0))) / GRAVITY
    return not _floor_at(s, place) or is_blocked(s, [(start, v, first), (place, off, second)], goal)


def _skipping(s: LaunchContext, start: Array, lift: Array | None) -> Launches:
    """What does not roll comes down before the target, and hops or slides on."""
    assert s.target is not None
    along = s.layout.corners(s.target) @ s.direction
    gap = float(along.min() - start @ s.direction) - 0.5 * float(np.ptp(s.layout.corners(s.active) @ s.direction))
    for part, arc in ((0.6, 0.5), (0.75, 0.5), (0.6, 1.2), (0.4, 0.5), (0.8, 1.5)):
        place = start + max(part * gap, 0.02) * s.direction
        v, seconds = ballistics.throw(start, np.array([*place[:2], s.low]), max(start[2], s.low) + arc * s.size)
        # Speed that friction takes on the rest of the gap: v^2 = 2 a d.
        on = math.sqrt(2 * s.drag * (1 - part) * max(gap, 0.0))
        v = v + max(0.0, 1.5 * on - float(v @ s.direction)) * s.direction if s.layout.pool(s.target) is None else v
        yield [s.thrown(v, lift=lift, seconds=seconds + AFTER)]


def _came_down(s: LaunchContext, tried: Tried, height: float) -> Array | None:
    """Where (2,) the centre of mass was when it came down to a height after its first bounce; None where it never was
    so high."""
    flown = tried.rollout.touches(s.active, s.floor)["time"]
    flown = flown[flown > LEFT]
    if not len(flown):
        return None
    way, after = s.way(tried), tried.rollout.time > float(flown[0])
    high = np.flatnonzero(after & (way[:, 2] >= height))
    if not len(high) or high[-1] + 1 >= len(way):
        return None
    k = next((int(i) for i in high if way[i + 1, 2] < height), int(high[-1]))
    z0, z1 = way[k, 2], way[k + 1, 2]
    # Linear between the last sample above the height and the first below it.
    t = (z0 - height) / max(z0 - z1, 1e-9)
    return np.asarray(way[k, :2] + t * (way[k + 1] - way[k])[:2])


def _bouncing_up(s: LaunchContext, start: Array, lift: Array | None) -> Launches:
    """Up to the wanted height and down again where it is, higher and higher."""
    for factor in (1.0, 1.6, 2.5):
        rise = factor * (s.task.amount or 1.5 * s.size)
        up = ballistics.height_speed(rise)
        yield [s.thrown(up * UP, lift=lift, seconds=2 * up / GRAVITY + AFTER)]
