"""The moments of a rollout that tell what happened: few, in order, each with its frame and words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from f3sr.core.transforms import Array
from f3sr.film.event_text import clock, happened, metres, named
from f3sr.film.footage import Scenario
from f3sr.goals.plan import Contact, Displaced, Height, Phase, Rolled
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import Seen
from f3sr.goals.verify import Verdict
from f3sr.scene import GRAVITY, GROUND, Scene

FEWEST, MOST = 4, 6
"""Least and largest number of pictures of a strip of one phase,"""
MOST_OF_ALL = 9
"""and largest of several phases, but for three of each."""
CLOSE = 0.05
"""Moments nearer to each other [s] are one: their pictures would look the same."""
FLIES = 0.02
"""Height [m] above start and end from which something that touches nothing is said to fly."""
SLOW = 0.02
"""Speed [m/s] of what is at rest."""
HARD = 5.0
"""Contact force, in weights of the object, from which it is a blow."""
FALLS = 0.15
"""Speed [m/s] downwards of what hits the ground."""
FAR = 0.02
"""Way [m] that is worth a picture from its middle."""
LULL = 0.2
"""How long it takes [s] to see that."""
APART = 1
"""Frames between moments that are only there to fill the strip, and others."""


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A frame worth looking at: the first that shows what happened at ``time`` [s]."""

    frame: int
    time: float
    what: tuple[str, ...]
    """In words, a statement each."""
    rank: int = 9
    """0 for what is always shown; of too many the highest go."""


def moments_of(scenarios: Sequence[Scenario]) -> tuple[Moment, ...]:
    """The key moments of a film's phases, by its own times and frames; each phase but the last ends where the next
    begins."""
    each = MOST if len(scenarios) == 1 else max(3, MOST_OF_ALL // len(scenarios))
    found = list[Moment]()
    for k, s in enumerate(scenarios):
        moments = key_moments(s.scene, s.phase, s.rollout, s.verdict, most=each)
        shown = moments if k + 1 == len(scenarios) else [m for m in moments if m.what != ("end",)]
        for m in shown:
            what = tuple(f"phase {k + 1}" if said == "start" and k else said for said in m.what)
            found.append(replace(m, frame=frame_at(s.drawn, m.time) + s.frame, time=m.time + s.start, what=what))
    return tuple(found)


def key_moments(
    scene: Scene, phase: Phase, rollout: Rollout, verdict: Verdict, *, most: int = MOST
) -> tuple[Moment, ...]:
    """At most so many moments of a phase by time; at least ``FEWEST`` if the rollout has as many different frames.

    They are the start, the launch of the active object, its first contact with the target and the top of its flight.
    The event of every met condition and the end follow."""
    seen = Seen(rollout, scene)
    found = _merged(sorted(_events(seen, phase, verdict), key=lambda m: (m.frame, m.rank)))
    while len(found) > most:
        found.remove(_least(found))
    while len(found) < min(FEWEST, most) and (more := _between(found, seen, phase.task.active)):
        found = sorted([*found, more], key=lambda m: m.frame)
    return tuple(found)


def frame_at(rollout: Rollout, time: float) -> int:
    """Index of the first sample at or after ``time`` [s], the last one after the end."""
    return min(int(np.searchsorted(rollout.time, time - 1e-6)), len(rollout.time) - 1)


def _events(seen: Seen, phase: Phase, verdict: Verdict) -> Iterator[Moment]:
    end = float(seen.time[-1])
    yield _moment(seen, 0.0, "start", 0)
    yield from _controls(seen, phase)
    yield from _meeting(seen, phase)
    yield from _apex(seen, phase.task.active)
    yield from _impact(seen, phase, verdict)
    for judged in verdict.conditions:
        if judged.met:
            rank = 3 if isinstance(judged.condition, Displaced | Rolled | Height) else 2
            time = end if judged.time is None else judged.time
            yield _moment(seen, time, happened(judged.condition, seen.scene), rank)
    yield _moment(seen, end, "end", 0)
    for judged in verdict.conditions:
        if not judged.met:
            yield _moment(seen, end, f"missed: {judged.said}", 0)


def _moment(seen: Seen, time: float, what: str, rank: int) -> Moment:
    return Moment(frame=frame_at(seen.rollout, time), time=time, what=(what,), rank=rank)


def _meeting(seen: Seen, phase: Phase) -> Iterator[Moment]:
    """The first contact with the target; where they are to part, when they have."""
    active, target = phase.task.active, phase.task.target
    if target is None or not len(touches := seen.rollout.touches(active, target)):
        return
    name, other = named(seen.scene, active), named(seen.scene, target)
    first, last = float(touches["time"][0]), frame_at(seen.rollout, float(touches["time"][-1])) + 1
    if phase.task.way not in ("off", "away-from"):
        yield _moment(seen, first, f"{name} touches {other}", 1)
    elif last < len(seen.time):
        yield _moment(seen, float(seen.time[last]), f"{name} parts from {other}", 1)


def _controls(seen: Seen, phase: Phase) -> Iterator[Moment]:
    """What sets objects off. A push that goes on in parts is one."""
    for offset in phase.initial.offsets:
        up = f" {metres(offset.translation[2])} higher" if offset.translation[2] > 0.0005 else ""
        yield _moment(seen, 0.0, f"{named(seen.scene, offset.id)} is let go{up}", 1)
    for velocity in phase.initial.velocities:
        speed = float(np.linalg.norm(velocity.linear))
        yield _moment(seen, 0.0, f"{named(seen.scene, velocity.id)} is set off at {speed:.2g} m/s", 1)
    ends: dict[int, float] = {}
    for impulse in sorted(phase.initial.impulses, key=lambda i: i.time):
        if impulse.time > ends.get(impulse.id, -1.0) + 1e-6:
            how = ("pushed" if impulse.duration > 0 else "struck") + (" again" if impulse.id in ends else "")
            yield _moment(seen, impulse.time, f"{named(seen.scene, impulse.id)} is {how}", 1)
        ends[impulse.id] = impulse.time + impulse.duration


def _apex(seen: Seen, active: int) -> Iterator[Moment]:
    """The top of the highest flight."""
    heights = seen.way(active)[:, 2]
    top = int(np.argmax(heights))
    rise = float(heights[top] - max(heights[0], heights[-1]))
    rows = seen.rollout.contacts
    own = rows["time"][(rows["a"] == active) | (rows["b"] == active)]
    step = float(seen.time[min(1, len(heights) - 1)])
    if rise > FLIES and not np.any(np.abs(own - seen.time[top]) < step):
        words = f"{named(seen.scene, active)} at its highest, {metres(float(heights[top] - heights[0]))} up"
        yield _moment(seen, float(seen.time[top]), words, 2)


def _impact(seen: Seen, phase: Phase, verdict: Verdict) -> Iterator[Moment]:
    """The hardest blow that the active object takes or gives after it was set off, unless that contact is told anyway.
    What slides is shaken by the ground, but hits it only where it comes down."""
    active, rows = phase.task.active, seen.rollout.contacts
    own = rows[((rows["a"] == active) | (rows["b"] == active)) & (rows["time"] > CLOSE)]
    before = [frame_at(seen.rollout, time) - 1 for time in own["time"]]
    # Vertical speed of each sample to the next; the last one's is anything over infinity, 0.
    climb = np.diff(seen.way(active)[:, 2], append=0.0) / np.diff(seen.time, append=np.inf)
    own = own[(climb[before] < -FALLS) | (own["a"] != GROUND)]
    weight = GRAVITY * next(s.mass for s in phase.semantics if s.id == active)
    if not len(own) or own["force"].max() < HARD * weight:
        return
    hardest = own[int(np.argmax(own["force"]))]
    other = int(hardest["a"] if hardest["b"] == active else hardest["b"])
    contacts = (c.condition for c in verdict.conditions if isinstance(c.condition, Contact))
    if other != phase.task.target and {active, other} not in [{c.a, c.b} for c in contacts]:
        words = f"{named(seen.scene, active)} hits {named(seen.scene, other)}"
        yield _moment(seen, float(hardest["time"]), words, 3)


def _merged(moments: list[Moment]) -> list[Moment]:
    """Merge moments of one frame, or so close that they look alike, at their last frame. The start stays."""
    groups = list[list[Moment]]()
    for m in moments:
        last = groups[-1][-1] if groups else None
        if last and (m.frame == last.frame or (last.frame > 0 and m.time - last.time < CLOSE)):
            groups[-1].append(m)
        else:
            groups.append([m])
    return [_one(group) for group in groups]


def _one(group: Sequence[Moment]) -> Moment:
    """The last with all that is said; what was earlier than its clock shows with its own time."""
    last, times = group[-1], dict[str, str]()
    for m in group:
        for words in m.what:
            times.setdefault(words, clock(m.time))
    what = tuple(words if time == clock(last.time) else f"{words} ({time})" for words, time in times.items())
    return replace(last, what=what, rank=min(m.rank for m in group))


def _least(moments: list[Moment]) -> Moment:
    """Of the highest rank the one nearest to another."""
    gaps = {m.frame: b.frame - a.frame for a, m, b in zip(moments, moments[1:], moments[2:], strict=False)}
    inner = moments[1:-1]
    return min(inner, key=lambda m: (-m.rank, gaps[m.frame]))


def _between(moments: list[Moment], seen: Seen, active: int) -> Moment | None:
    """Another moment: in the middle of the longest way between two, or else where the active object comes to rest; None
    where neither is far enough from all others."""
    way, taken = seen.way(active), [m.frame for m in moments]
    # (T,) length of the way so far.
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]
    gaps = [(a, b) for a, b in pairwise(taken) if b - a > 2 * APART]
    first, last = max(gaps, key=lambda g: float(length[g[1]] - length[g[0]]), default=(0, 0))
    rest = int(np.searchsorted(length, length[-1] - SLOW * LULL))
    if length[last] - length[first] > FAR:
        half = int(np.searchsorted(length, (length[first] + length[last]) / 2))
        middle = min(max(half, first + APART), last - APART)
        return _moment(seen, float(seen.time[middle]), _moving(seen, way, active, middle), 5)
    if min(abs(rest - frame) for frame in taken) > APART:
        return _moment(seen, float(seen.time[rest]), f"{named(seen.scene, active)} comes to rest", 5)
    return None


def _moving(seen: Seen, way: Array, active: int, frame: int) -> str:
    low, high = max(0, frame - 1), min(frame + 1, len(way) - 1)
    speed = float(np.linalg.norm(way[high] - way[low])) / float(seen.time[high] - seen.time[low])
    name = named(seen.scene, active)
    return f"{name} is at rest" if speed < SLOW else f"{name} moves at {speed:.2g} m/s"
