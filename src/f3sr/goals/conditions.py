"""Success conditions measured on a rollout: whether each is met, by how much, and when.

A margin is at least 0 where a condition is met. Events are in order: a condition that comes after another counts only
from the other's event on, and is missed where that one is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, vector_from_rotation
from f3sr.goals import plan as p
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import Seen, outside, parts_of
from f3sr.scene import GROUND, Scene

Unit = Literal["m", "rad", "m/s", "s"]


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One condition on one rollout."""

    condition: p.Condition
    margin: float
    """By how much it is met, or, negative, missed."""
    unit: Unit
    time: float | None
    """When: of the event [s], or of the closest miss where that has a time."""
    said: str
    """What was found, in words."""
    relative: float
    """The margin over what it is measured by: what is asked for, or the object's size."""
    reached: float | None = None
    """The most that was found, where so much is asked for; in ``unit``."""
    phase: int = 0
    """Index of the plan's phase that it belongs to."""

    @property
    def met(self) -> bool:
        return self.margin >= 0


STAYS = 0.7
"""Share of the distance asked for that is left where something comes to rest."""


def judge(conditions: Sequence[p.Condition], rollout: Rollout, scene: Scene) -> list[Judged]:
    """Every condition of a plan on a rollout of ``scene``."""
    seen = Seen(rollout, scene)
    found: list[Judged] = []
    for condition in conditions:
        start = 0.0
        if condition.after is not None:
            before = found[condition.after]
            if not before.met:
                said = f"condition {condition.after + 1}, which it comes after, did not happen"
                found.append(replace(before, condition=condition, said=said))
                continue
            start = before.time or 0.0
        found.append(_in_time(_MEASURES[type(condition)](condition, seen, start), condition.within))
    return found


def _in_time(judged: Judged, within: float | None) -> Judged:
    if within is None or not judged.met or judged.time is None or judged.time <= within:
        return judged
    late = judged.time - within
    return replace(judged, margin=-late, unit="s", said=f"{judged.said}, {late:.2f} s late", relative=-late / within)


# --- the conditions -----------------------------------------------------------------------------------------------


def _contact(c: p.Contact, seen: Seen, start: float) -> Judged:
    a, b = seen.name(c.a), seen.name(c.b)
    rows = seen.rollout.touches(c.a, c.b)
    early = rows[(rows["time"] > 0) & (rows["time"] < start - 1e-9)]
    rows = rows[rows["time"] >= start - 1e-9]
    if c.first and len(early):
        ahead = start - float(early[0]["time"])
        said = f"{a} touches {b} {ahead:.2f} s early"
        return Judged(condition=c, margin=-ahead, unit="s", time=start - ahead, said=said, relative=-ahead / start)
    if len(rows):
        first = rows[0]
        said = f"{a} touches {b} after {first['time']:.2f} s"
        return Judged(condition=c, margin=0.0, unit="m", time=float(first["time"]), said=said, relative=0.0)
    gap, time = seen.gap(c.a, c.b, start)
    said = f"{a} misses {b} by {1000 * gap:.0f} mm after {time:.2f} s"
    return Judged(
        condition=c, margin=-max(gap, 1e-9), unit="m", time=time, said=said, relative=-gap / seen.of(c.a).size
    )


def _displaced(c: p.Displaced, seen: Seen, start: float) -> Judged:
    moved = seen.way(c.a) - seen.way(c.a)[0]
    far = np.linalg.norm(moved, axis=1)
    if c.direction is not None:
        along = moved @ _unit(c.direction)
        aside = np.sqrt(np.maximum(far**2 - along**2, 0))
        far = along - np.maximum(0, aside - along)
    reached = _reached(c, seen, far, c.at_least, "m", start, f"{seen.name(c.a)} moves")
    if c.at_most is None or not reached.met:
        return reached
    end, left = moved[-1], c.at_most - float(np.linalg.norm(moved[-1]))
    said = f"{seen.name(c.a)} ends {1000 * np.linalg.norm(end):.0f} mm away, asked for {1000 * c.at_least:.0f}"
    if c.direction is not None:
        ahead = float(end @ _unit(c.direction))
        aside = float(np.sqrt(max(end @ end - ahead**2, 0.0)))
        stays = min(ahead - aside, ahead - STAYS * c.at_least)
        if stays < min(left, 0.0):
            said = f"{seen.name(c.a)} ends {1000 * ahead:.0f} mm that way and {1000 * aside:.0f} mm aside"
        left = min(left, stays)
    if left < 0:
        return replace(reached, margin=left, relative=left / c.at_most, said=said)
    return replace(reached, margin=min(left, reached.margin), relative=min(left / c.at_most, reached.relative))


def _toppled(c: p.Toppled, seen: Seen, start: float) -> Judged:
    lean = seen.lean(c.a)
    reached = _reached(c, seen, lean, c.at_least, "rad", start, f"{seen.name(c.a)} leans")
    if reached.met and lean[-1] < c.at_least:
        left = float(lean[-1]) - c.at_least
        said = f"{seen.name(c.a)} leans by {np.degrees(lean.max()):.0f} degrees but ends at {np.degrees(lean[-1]):.0f}"
        return replace(reached, margin=left, relative=left / c.at_least, said=said)
    return reached


def _upright(c: p.Upright, seen: Seen, start: float) -> Judged:
    lean = float(seen.lean(c.a)[-1])
    said = f"{seen.name(c.a)} ends leaning by {np.degrees(lean):.0f} degrees"
    margin, end = c.at_most - lean, float(seen.time[-1])
    return Judged(condition=c, margin=margin, unit="rad", time=end, said=said, relative=margin / c.at_most)


def _rolled(c: p.Rolled, seen: Seen, start: float) -> Judged:
    """Turns from sample to sample about the horizontal axis across the way to where it was farthest, or about its own,
    to and fro set off against each other."""
    way, R = seen.way(c.a), seen.rollout.poses(c.a)[:, :3, :3]
    if c.upended:
        axes = (R @ R[0].T @ UP)[1:]
    else:
        off = (way - way[int(np.argmax(seen.since(start)))])[:, :2]
        x, y = off[int(np.argmax(np.linalg.norm(off, axis=1)))]
        axes = np.array([-y, x, 0.0]) / max(float(np.hypot(x, y)), 1e-12)
    turns = np.array([vector_from_rotation(b @ a.T) for a, b in pairwise(R)])
    turned = np.concatenate([[0.0], np.cumsum(np.where(seen.since(start)[1:], (turns * axes).sum(1), 0.0))])
    turned = np.asarray(np.abs(turned) if c.upended else turned, float)
    return _reached(c, seen, turned, c.at_least, "rad", start, f"{seen.name(c.a)} rolls")


def _bounced(c: p.Bounced, seen: Seen, start: float) -> Judged:
    touched = _contact(p.Contact(a=c.a, b=c.b), seen, start)
    if not touched.met or touched.time is None:
        return replace(touched, condition=c)
    z, since = seen.way(c.a)[:, 2], seen.since(touched.time)
    lowest = np.minimum.accumulate(np.where(since, z, np.inf))
    rise = np.where(since, z - lowest, 0.0)
    return _reached(c, seen, rise, c.at_least, "m", start, f"{seen.name(c.a)} bounces off {seen.name(c.b)}")


def _over(c: p.Over, seen: Seen, start: float) -> Judged:
    """Between samples the way is straight; of all points within the outline the lowest counts."""
    samples = np.flatnonzero(seen.since(start))
    way, top = seen.way(c.a)[samples], float(seen.corners(c.b)[:, 2].max())
    low = np.array([seen.lowest(c.a, int(k)) for k in samples])
    fine = np.linspace(0, len(samples) - 1, 8 * len(samples))
    at = np.arange(len(samples))
    points = np.column_stack([np.interp(fine, at, way[:, k]) for k in (0, 1)])
    off, clear = outside(points, seen.corners(c.b)), np.interp(fine, at, low) - top
    within = off <= 0
    k = int(np.flatnonzero(within)[np.argmin(clear[within])]) if within.any() else int(np.argmin(off))
    margin = float(clear[k]) if within.any() else -float(off[k])
    how = f"{1000 * abs(margin):.0f} mm " + (
        "beside" if not within.any() else "above" if margin >= 0 else "below the top of"
    )
    said = f"{seen.name(c.a)} passes {how} {seen.name(c.b)}"
    time = float(np.interp(fine[k], at, seen.time[samples]))
    return Judged(condition=c, margin=margin, unit="m", time=time, said=said, relative=margin / seen.of(c.a).size)


def _off(c: p.Off, seen: Seen, start: float) -> Judged:
    margin = float(outside(seen.way(c.a)[-1:, :2], seen.corners(c.b, -1))[0])
    where = "outside" if margin >= 0 else "within"
    said = f"{seen.name(c.a)} ends {1000 * abs(margin):.0f} mm {where} the outline of {seen.name(c.b)}"
    end = float(seen.time[-1])
    return Judged(condition=c, margin=margin, unit="m", time=end, said=said, relative=margin / seen.of(c.a).size)


def _height(c: p.Height, seen: Seen, start: float) -> Judged:
    z = seen.way(c.a)[:, 2]
    return _reached(c, seen, z - z[0], c.at_least, "m", start, f"{seen.name(c.a)} rises")


def _returned(c: p.Returned, seen: Seen, start: float) -> Judged:
    off = np.linalg.norm(seen.way(c.a) - seen.way(c.a)[0], axis=1)
    if off.max() <= c.to_within:
        missing = float(off.max()) - c.to_within
        return Judged(
            condition=c,
            margin=min(missing, -1e-9),
            unit="m",
            time=None,
            said=f"{seen.name(c.a)} never leaves its place",
            relative=missing / seen.of(c.a).size,
        )
    if not c.stays:
        return _came_back(c, seen, off, start)
    away = np.flatnonzero(off > c.to_within)[-1]
    margin = c.to_within - float(off[-1])
    back = float(seen.time[min(away + 1, len(off) - 1)])
    said = f"{seen.name(c.a)} ends {1000 * off[-1]:.0f} mm from where it was"
    return Judged(condition=c, margin=margin, unit="m", time=back, said=said, relative=margin / seen.of(c.a).size)


def _came_back(c: p.Returned, seen: Seen, off: Array, start: float) -> Judged:
    """The nearest that it comes after it was away."""
    since = seen.since(start) & (np.maximum.accumulate(off) > c.to_within)
    near = np.where(since, off, np.inf)
    best = int(np.argmin(near))
    margin = c.to_within - float(near[best])
    said = f"{seen.name(c.a)} comes back to {1000 * near[best]:.0f} mm from where it was"
    time = float(seen.time[np.flatnonzero(near <= max(c.to_within, near[best]))[0]])
    return Judged(condition=c, margin=margin, unit="m", time=time, said=said, relative=margin / seen.of(c.a).size)


def _at_rest(c: p.AtRest, seen: Seen, start: float) -> Judged:
    way = seen.way(c.a)[seen.at_the_end]
    seconds = max(float(np.ptp(seen.time[seen.at_the_end])), 1e-9)
    speed = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / seconds
    said = f"{seen.name(c.a)} moves at {1000 * speed:.0f} mm/s at the end"
    margin = c.speed - speed
    return Judged(condition=c, margin=margin, unit="m/s", time=None, said=said, relative=margin / c.speed)


def _on(c: p.On, seen: Seen, start: float) -> Judged:
    """Touching at the end, and not the ground besides; the centre of mass above the other's and within its outline."""
    a, b, end = seen.name(c.a), seen.name(c.b), float(seen.time[-1])
    above = np.inf
    if c.b != GROUND:
        aside = float(outside(seen.way(c.a)[-1:, :2], seen.corners(c.b, -1))[0])
        above = min(float(seen.way(c.a)[-1, 2] - seen.way(c.b)[-1, 2]), -aside)
    if not seen.touching(c.a, c.b):
        gap, _ = seen.gap(c.a, c.b, end)
        margin, said = -max(gap, 1e-9), f"{a} ends {1000 * gap:.0f} mm from {b}"
    elif c.b != GROUND and seen.touching(c.a, GROUND):
        margin, said = -seen.of(c.a).size / 2, f"{a} ends on the ground beside {b}"
    else:
        margin = min(above, seen.of(c.a).size)
        said = f"{a} ends on {b}" if above >= 0 else f"{a} ends beside {b}"
    return Judged(condition=c, margin=margin, unit="m", time=end, said=said, relative=margin / seen.of(c.a).size)


def _inside(c: p.Inside, seen: Seen, start: float) -> Judged:
    """How deep the point halfway between the lowest and the centre lies in the other's hull: what lies in a bowl may
    look over its rim. What lies on the ground is not inside, as under the handle of a pan."""
    way, end = seen.way(c.a), float(seen.time[-1])
    point = way[-1].copy()
    point[2] = (point[2] + seen.lowest(c.a, len(way) - 1)) / 2
    T = seen.rollout.poses(c.b)[-1]
    corners = np.concatenate([q.vertices for q in parts_of(seen.of(c.b))])
    hull = Polytope.of(ConvexPart.hull_of(corners))
    margin = -float((hull.normals @ (T[:3, :3].T @ (point - T[:3, 3])) - hull.offsets).max())
    if seen.touching(c.a, GROUND):
        margin = min(margin, -seen.of(c.a).size / 2)
    where = "inside" if margin >= 0 else "outside"
    said = f"{seen.name(c.a)} ends {1000 * abs(margin):.0f} mm {where} {seen.name(c.b)}"
    return Judged(condition=c, margin=margin, unit="m", time=end, said=said, relative=margin / seen.of(c.a).size)


def _reached(c: p.Condition, seen: Seen, values: Array, needed: float, unit: Unit, start: float, what: str) -> Judged:
    """That a value (T,) is at least so much at some sample from a time on."""
    values = np.where(seen.since(start), values, -np.inf)
    best = int(np.argmax(values))
    found = float(values[best])
    reached = np.flatnonzero(values >= needed - 1e-9)
    time = float(seen.time[reached[0] if len(reached) else best])
    shown = f"{np.degrees(found):.0f} degrees" if unit == "rad" else f"{1000 * found:.0f} mm"
    asked = f"{np.degrees(needed):.0f} degrees" if unit == "rad" else f"{1000 * needed:.0f} mm"
    return Judged(
        condition=c,
        margin=found - needed,
        unit=unit,
        time=time,
        said=f"{what} by {shown}, at least {asked} asked",
        relative=(found - needed) / max(needed, 1e-3),
        reached=found,
    )


_MEASURES: Mapping[type[Any], Callable[[Any, Seen, float], Judged]] = {
    p.Contact: _contact,
    p.Displaced: _displaced,
    p.Toppled: _toppled,
    p.Upright: _upright,
    p.Rolled: _rolled,
    p.Bounced: _bounced,
    p.Over: _over,
    p.Off: _off,
    p.Height: _height,
    p.Returned: _returned,
    p.AtRest: _at_rest,
    p.On: _on,
    p.Inside: _inside,
}


def _unit(direction: Sequence[float]) -> Array:
    d = np.asarray(direction, float)
    return d / np.linalg.norm(d)
