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
from numpy.typing import NDArray

from f3sr import physics
from f3sr.contact import Polytope
from f3sr.frames import Array, quaternion_from_rotation, transform, vector_from_rotation
from f3sr.goals import plan as p
from f3sr.goals.layout import outline
from f3sr.goals.rollout import Rollout
from f3sr.mesh import ConvexPart
from f3sr.scene import GROUND, Scene, SceneObject

LAST = 0.2
"""What counts as the end of a rollout [s]."""

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

    @property
    def met(self) -> bool:
        return self.margin >= 0


def judge(conditions: Sequence[p.Condition], rollout: Rollout, scene: Scene) -> list[Judged]:
    """Every condition of a plan on a rollout of ``scene``."""
    seen = _Seen(rollout, scene)
    found: list[Judged] = []
    for condition in conditions:
        before = None if condition.after is None else found[condition.after]
        if before is not None and not before.met:
            said = f"what it is to come after did not happen: {before.said}"
            found.append(replace(before, condition=condition, said=said))
            continue
        start = 0.0 if before is None or before.time is None else before.time
        found.append(_in_time(_MEASURES[type(condition)](condition, seen, start), condition.within))
    return found


def _in_time(judged: Judged, within: float | None) -> Judged:
    if within is None or not judged.met or judged.time is None or judged.time <= within:
        return judged
    late = judged.time - within
    return replace(judged, margin=-late, unit="s", said=f"{judged.said}, {late:.2f} s late", relative=-late / within)


class _Seen:
    """A rollout with its scene: ways of centres, turns and distances."""

    def __init__(self, rollout: Rollout, scene: Scene) -> None:
        self.rollout, self.scene, self.time = rollout, scene, rollout.time

    def of(self, id: int) -> SceneObject:
        return self.scene[id]

    def way(self, id: int) -> Array:
        """(T, 3) of a centre of mass [m]."""
        T, center = self.rollout.poses(id), physics.body_of(self.scene[id]).center
        return T[:, :3, :3] @ center + T[:, :3, 3]

    def lean(self, id: int) -> Array:
        """(T,): how far what was up at the start leans from up [rad]."""
        R = self.rollout.poses(id)[:, :3, :3]
        return np.arccos(np.clip((R @ R[0].T)[:, 2, 2], -1, 1))

    def since(self, start: float) -> NDArray[np.bool_]:
        """(T,): samples from a time on."""
        return self.time >= start - 1e-9

    @property
    def at_the_end(self) -> NDArray[np.bool_]:
        return self.time >= self.time[-1] - LAST - 1e-9

    def touching(self, a: int, b: int) -> bool:
        """Whether two touch at the end."""
        return bool((self.rollout.touches(a, b)["time"] >= self.time[-1] - LAST).any())

    def name(self, id: int) -> str:
        return "the ground" if id == GROUND else self.scene[id].label or f"object {id}"

    def gap(self, a: int, b: int, start: float) -> tuple[float, float]:
        """The least distance [m] of two objects, or of one and the ground, at any sample from a time on, and when."""
        samples = np.flatnonzero(self.since(start))
        if b == GROUND:
            heights = [self.lowest(a, int(k)) for k in samples]
            least = int(np.argmin(heights))
            return max(0.0, heights[least]), float(self.time[samples[least]])
        return _nearest(self, a, b, samples)

    def corners(self, id: int, sample: int = 0) -> Array:
        """(n, 3): corners of an object's parts in the world [m]."""
        return transform(self.rollout.poses(id)[sample], np.concatenate([q.vertices for q in _parts(self.scene[id])]))

    def lowest(self, id: int, sample: int) -> float:
        """Height of the lowest point of an object's parts [m]."""
        T = self.rollout.poses(id)[sample]
        return min(float((q.vertices @ T[2, :3]).min()) for q in _parts(self.scene[id])) + float(T[2, 3])


def _parts(o: SceneObject) -> Sequence[ConvexPart]:
    """In the object's frame, metres."""
    return physics.body_of(o).parts


# --- the conditions -----------------------------------------------------------------------------------------------


def _contact(c: p.Contact, seen: _Seen, start: float) -> Judged:
    a, b = seen.name(c.a), seen.name(c.b)
    rows = seen.rollout.touches(c.a, c.b)
    rows = rows[rows["time"] >= start - 1e-9]
    if len(rows):
        first = rows[0]
        said = f"{a} touches {b} after {first['time']:.2f} s with {first['force']:.1f} N"
        return Judged(condition=c, margin=0.0, unit="m", time=float(first["time"]), said=said, relative=0.0)
    gap, time = seen.gap(c.a, c.b, start)
    said = f"{a} misses {b} by {1000 * gap:.0f} mm after {time:.2f} s"
    return Judged(
        condition=c, margin=-max(gap, 1e-9), unit="m", time=time, said=said, relative=-gap / seen.of(c.a).size
    )


def _displaced(c: p.Displaced, seen: _Seen, start: float) -> Judged:
    moved = seen.way(c.a) - seen.way(c.a)[0]
    far = np.linalg.norm(moved, axis=1)
    if c.direction is not None:
        along = moved @ _unit(c.direction)
        aside = np.sqrt(np.maximum(far**2 - along**2, 0))
        far = along - np.maximum(0, aside - along)
    reached = _reached(c, seen, far, c.at_least, "m", start, f"{seen.name(c.a)} moves")
    if c.at_most is None or not reached.met:
        return reached
    left = c.at_most - float(far[-1])
    said = f"{seen.name(c.a)} ends {1000 * far[-1]:.0f} mm away, asked for {1000 * c.at_least:.0f}"
    if left < 0:
        return replace(reached, margin=left, relative=left / c.at_most, said=said)
    return replace(reached, margin=min(left, reached.margin), relative=min(left / c.at_most, reached.relative))


def _toppled(c: p.Toppled, seen: _Seen, start: float) -> Judged:
    lean = seen.lean(c.a)
    reached = _reached(c, seen, lean, c.at_least, "rad", start, f"{seen.name(c.a)} leans")
    if reached.met and lean[-1] < c.at_least:
        left = float(lean[-1]) - c.at_least
        said = f"{seen.name(c.a)} leans by {np.degrees(lean.max()):.0f} degrees but ends at {np.degrees(lean[-1]):.0f}"
        return replace(reached, margin=left, relative=left / c.at_least, said=said)
    return reached


def _upright(c: p.Upright, seen: _Seen, start: float) -> Judged:
    lean = float(seen.lean(c.a)[-1])
    said = f"{seen.name(c.a)} ends leaning by {np.degrees(lean):.0f} degrees"
    margin, end = c.at_most - lean, float(seen.time[-1])
    return Judged(condition=c, margin=margin, unit="rad", time=end, said=said, relative=margin / c.at_most)


def _rolled(c: p.Rolled, seen: _Seen, start: float) -> Judged:
    """Turns from sample to sample, each about the horizontal axis across the way between the two."""
    way, R = seen.way(c.a), seen.rollout.poses(c.a)[:, :3, :3]
    step = np.diff(way, axis=0)[:, :2]
    across = np.column_stack([-step[:, 1], step[:, 0], np.zeros(len(step))])
    across /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
    turns = np.array([vector_from_rotation(b @ a.T) for a, b in pairwise(R)])
    gained = np.where(seen.since(start)[1:], np.einsum("ti,ti->t", turns, across), 0.0)
    turned = np.concatenate([[0.0], np.cumsum(gained)])
    return _reached(c, seen, turned, c.at_least, "rad", start, f"{seen.name(c.a)} rolls")


def _bounced(c: p.Bounced, seen: _Seen, start: float) -> Judged:
    touched = _contact(p.Contact(a=c.a, b=c.b), seen, start)
    if not touched.met or touched.time is None:
        return replace(touched, condition=c)
    z, since = seen.way(c.a)[:, 2], seen.since(touched.time)
    lowest = np.minimum.accumulate(np.where(since, z, np.inf))
    rise = np.where(since, z - lowest, 0.0)
    return _reached(c, seen, rise, c.at_least, "m", start, f"{seen.name(c.a)} bounces off {seen.name(c.b)}")


def _over(c: p.Over, seen: _Seen, start: float) -> Judged:
    """Between samples the way is straight; of all points within the outline the lowest counts."""
    samples = np.flatnonzero(seen.since(start))
    way, top = seen.way(c.a)[samples], float(seen.corners(c.b)[:, 2].max())
    low = np.array([seen.lowest(c.a, int(k)) for k in samples])
    fine = np.linspace(0, len(samples) - 1, 8 * len(samples))
    at = np.arange(len(samples))
    points = np.column_stack([np.interp(fine, at, way[:, k]) for k in (0, 1)])
    outside, clear = _outside(points, seen.corners(c.b)), np.interp(fine, at, low) - top
    within = outside <= 0
    k = int(np.flatnonzero(within)[np.argmin(clear[within])]) if within.any() else int(np.argmin(outside))
    margin = float(clear[k]) if within.any() else -float(outside[k])
    how = f"{1000 * abs(margin):.0f} mm " + (
        "beside" if not within.any() else "above" if margin >= 0 else "below the top of"
    )
    said = f"{seen.name(c.a)} passes {how} {seen.name(c.b)}"
    time = float(np.interp(fine[k], at, seen.time[samples]))
    return Judged(condition=c, margin=margin, unit="m", time=time, said=said, relative=margin / seen.of(c.a).size)


def _off(c: p.Off, seen: _Seen, start: float) -> Judged:
    margin = float(_outside(seen.way(c.a)[-1:, :2], seen.corners(c.b, -1))[0])
    where = "outside" if margin >= 0 else "within"
    said = f"{seen.name(c.a)} ends {1000 * abs(margin):.0f} mm {where} the outline of {seen.name(c.b)}"
    end = float(seen.time[-1])
    return Judged(condition=c, margin=margin, unit="m", time=end, said=said, relative=margin / seen.of(c.a).size)


def _height(c: p.Height, seen: _Seen, start: float) -> Judged:
    z = seen.way(c.a)[:, 2]
    return _reached(c, seen, z - z[0], c.at_least, "m", start, f"{seen.name(c.a)} rises")


def _returned(c: p.Returned, seen: _Seen, start: float) -> Judged:
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


def _came_back(c: p.Returned, seen: _Seen, off: Array, start: float) -> Judged:
    """The nearest that it comes after it was away."""
    since = seen.since(start) & (np.maximum.accumulate(off) > c.to_within)
    near = np.where(since, off, np.inf)
    best = int(np.argmin(near))
    margin = c.to_within - float(near[best])
    said = f"{seen.name(c.a)} comes back to {1000 * near[best]:.0f} mm from where it was"
    time = float(seen.time[np.flatnonzero(near <= max(c.to_within, near[best]))[0]])
    return Judged(condition=c, margin=margin, unit="m", time=time, said=said, relative=margin / seen.of(c.a).size)


def _at_rest(c: p.AtRest, seen: _Seen, start: float) -> Judged:
    way = seen.way(c.a)[seen.at_the_end]
    seconds = max(float(np.ptp(seen.time[seen.at_the_end])), 1e-9)
    speed = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) / seconds
    said = f"{seen.name(c.a)} moves at {1000 * speed:.0f} mm/s at the end"
    margin = c.speed - speed
    return Judged(condition=c, margin=margin, unit="m/s", time=None, said=said, relative=margin / c.speed)


def _on(c: p.On, seen: _Seen, start: float) -> Judged:
    """Touching at the end, and not the ground besides; the centre of mass above the other's and within its outline."""
    a, b, end = seen.name(c.a), seen.name(c.b), float(seen.time[-1])
    above = np.inf
    if c.b != GROUND:
        aside = float(_outside(seen.way(c.a)[-1:, :2], seen.corners(c.b, -1))[0])
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


def _inside(c: p.Inside, seen: _Seen, start: float) -> Judged:
    """How deep the point halfway between the lowest and the centre lies in the other's hull: what lies in a bowl may
    look over its rim. What lies on the ground is not inside, as under the handle of a pan."""
    way, end = seen.way(c.a), float(seen.time[-1])
    point = way[-1].copy()
    point[2] = (point[2] + seen.lowest(c.a, len(way) - 1)) / 2
    T = seen.rollout.poses(c.b)[-1]
    corners = np.concatenate([q.vertices for q in _parts(seen.of(c.b))])
    hull = Polytope.of(ConvexPart.hull_of(corners))
    margin = -float((hull.normals @ (T[:3, :3].T @ (point - T[:3, 3])) - hull.offsets).max())
    if seen.touching(c.a, GROUND):
        margin = min(margin, -seen.of(c.a).size / 2)
    where = "inside" if margin >= 0 else "outside"
    said = f"{seen.name(c.a)} ends {1000 * abs(margin):.0f} mm {where} {seen.name(c.b)}"
    return Judged(condition=c, margin=margin, unit="m", time=end, said=said, relative=margin / seen.of(c.a).size)


def _reached(c: p.Condition, seen: _Seen, values: Array, needed: float, unit: Unit, start: float, what: str) -> Judged:
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
        said=f"{what} by {shown} of {asked}",
        relative=(found - needed) / max(needed, 1e-3),
    )


_MEASURES: Mapping[type[Any], Callable[[Any, _Seen, float], Judged]] = {
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


def _outside(points: Array, corners: Array) -> Array:
    """(n,) how far horizontal points (n, 2) are outside, or, negative, inside the outline of corners (m, 3) seen from
    above: by the outline's sides."""
    return np.max(points @ (planes := outline(corners[:, :2]))[:, :2].T + planes[:, 2], axis=1)


# --- distances ----------------------------------------------------------------------------------------------------


def _nearest(seen: _Seen, a: int, b: int, samples: NDArray[np.int64]) -> tuple[float, float]:
    """The least distance [m] of two objects at some samples, and when [s], by MuJoCo's own distances of parts.

    Samples whose bounding spheres are farther apart than the least so far are left out."""
    mujoco = physics.engine()
    objects = [seen.of(a), seen.of(b)]
    model = physics.build_spec([replace(o, mobility="dynamic") for o in objects]).compile()
    data = mujoco.MjData(model)
    radii = [max(float(np.linalg.norm(q.vertices, axis=1).max()) for q in _parts(o)) for o in objects]
    poses = [seen.rollout.poses(id) for id in (a, b)]
    apart = np.linalg.norm(poses[0][samples, :3, 3] - poses[1][samples, :3, 3], axis=1) - sum(radii)
    least, when = np.inf, float(seen.time[-1])
    for k in np.argsort(apart):
        if apart[k] > least:
            break
        for joint, T in enumerate(poses):
            data.qpos[7 * joint : 7 * joint + 7] = _qpos(T[samples[k]])
        mujoco.mj_kinematics(model, data)
        distance = _distance(model, data)
        if distance < least:
            least, when = distance, float(seen.time[samples[k]])
    return max(0.0, least), when


def _distance(model: Any, data: Any) -> float:
    """Between the geoms of the first and the second body [m]."""
    mujoco = physics.engine()
    first, second = (np.flatnonzero(model.geom_bodyid == body).tolist() for body in (1, 2))
    between, least = np.zeros(6), 1e3
    for g in first:
        for h in second:
            near = np.linalg.norm(data.geom_xpos[g] - data.geom_xpos[h]) - model.geom_rbound[g] - model.geom_rbound[h]
            if near < least:
                least = min(least, mujoco.mj_geomDistance(model, data, g, h, least, between))
    return least


def _qpos(T: Array) -> Array:
    return np.r_[T[:3, 3], quaternion_from_rotation(T[:3, :3])]
