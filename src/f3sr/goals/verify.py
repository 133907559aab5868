"""verify: the verdict on a rollout: the plan's conditions with margins, and the rules that every rollout keeps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict

from f3sr.core.transforms import rotation_angle
from f3sr.goals.conditions import Judged, Unit, judge
from f3sr.goals.plan import Condition, Kind, Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.simulate import as_planned
from f3sr.scene import GROUND, Scene
from f3sr.scene_package.scene_json import dump_json

DROPPED: set[Kind] = {"drop", "lift_and_drop"}
"""Kinds that start where something is let go."""
FASTER = 1.5
"""Times the limit of speeds that anything may reach: more comes from contacts that go wrong, not from falling."""
STILL = 1e-3
"""How far anything may move before the first control [m]."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The success conditions of a plan, measured on its rollout, with the rules that it breaks (docs: goals)."""

    conditions: tuple[Judged, ...]
    broken: tuple[str, ...]
    """Rules that the rollout does not keep, in words."""

    @property
    def met(self) -> bool:
        """Whether every condition is met and no rule is broken."""
        return not self.broken and all(c.met for c in self.conditions)

    @property
    def margin(self) -> float:
        """The least relative margin of the conditions, negative if one is missed. The largest marks the best plan."""
        return min(c.relative for c in self.conditions)

    @property
    def said(self) -> str:
        """One line for people: the missed conditions, or that all are met."""
        missed = [c.said for c in self.conditions if not c.met]
        return "; ".join([*self.broken, *missed]) or "; ".join(c.said for c in self.conditions)


def verify(scene: Scene, plan: Plan, rollout: Rollout) -> Verdict:
    """Measure the conditions of a plan and the rules on a rollout of ``scene``, the package's."""
    planned = scene.with_objects(*as_planned(scene, plan.semantics, plan.initial))
    judged = judge(plan.task.conditions, rollout, planned)
    return Verdict(conditions=tuple(judged), broken=tuple(_broken(scene, planned, plan, rollout)))


class JudgedRecord(BaseModel):
    """A condition of the plan on its rollout."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    condition: Condition
    met: bool
    margin: float
    """By how much it is met; negative if missed. In ``unit``."""
    unit: Unit
    time: float | None
    """Time of the event, or of the nearest miss [s]; null if the condition is no event."""
    said: str


class VerdictDocument(BaseModel):
    """verdict.json: the measured success conditions of a plan."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, title="f3sr verdict")

    met: bool
    """Every condition is met and no rule broken."""
    margin: float
    """The least margin of all conditions, relative to the amount asked for or the object's size; a contact's is 0."""
    said: str
    """One line for people: the missed conditions, or that all are met."""
    conditions: tuple[JudgedRecord, ...]
    """In the order of the plan."""
    broken_rules: tuple[str, ...]
    """Broken rules: only the active object is launched, never after it touched its target, and from its place."""


def to_json(verdict: Verdict) -> bytes:
    """verdict.json."""
    judged = [
        JudgedRecord(condition=c.condition, met=c.met, margin=c.margin, unit=c.unit, time=c.time, said=c.said)
        for c in verdict.conditions
    ]
    document = VerdictDocument(
        met=verdict.met,
        margin=verdict.margin,
        said=verdict.said,
        conditions=tuple(judged),
        broken_rules=verdict.broken,
    )
    return dump_json(document.model_dump(mode="json"))


def _broken(scene: Scene, planned: Scene, plan: Plan, rollout: Rollout) -> Iterator[str]:
    """The rules: the rollout starts as the scene but for declared offsets, only the active object is set off, never
    after it touched its target, and nothing moves before."""
    task, initial = plan.task, plan.initial
    for o in planned:
        start = rollout.poses(o.id)[0]
        off = float(np.linalg.norm(start[:3, 3] - o.T_world_object[:3, 3]))
        if off > 1e-6 or rotation_angle(start[:3, :3] @ o.T_world_object[:3, :3].T) > 1e-5:
            yield f"object {o.id} does not start where the scene has it"
    for id in sorted(initial.controlled - {task.active}):
        yield f"object {id} is set off, which only the active object {task.active} may be"
    if initial.offsets and task.kind not in DROPPED:
        yield f"object {initial.offsets[0].id} starts elsewhere, which only what is dropped may"
    last = max((i.time + i.duration for i in initial.impulses), default=0.0)
    if task.target is not None and task.target != GROUND and task.way not in ("off", "away-from"):
        touched = rollout.touches(task.active, task.target)["time"]
        if len(touched) and float(touched[0]) < last:
            yield f"an impulse comes {last - float(touched[0]):.2f} s after the active object touched its target"
    limits = plan.simulation.limits
    most = FASTER * limits.speed if limits else np.inf
    for o in planned:
        way = rollout.poses(o.id)[:, :3, 3]
        speed = float(np.max(np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(rollout.time), initial=0.0))
        if speed > most:
            yield f"object {o.id} is flung away at {speed:.0f} m/s"
    first = _first_control(plan)
    before = rollout.time <= first + 1e-9
    for o in scene:
        way = rollout.poses(o.id)[before, :3, 3]
        moved = float(np.linalg.norm(way - way[0], axis=1).max()) if len(way) else 0.0
        if moved > STILL:
            yield f"object {o.id} moves by {1000 * moved:.1f} mm before anything is set off"


def _first_control(plan: Plan) -> float:
    """When the first impulse comes [s]; 0 where something is offset or moves from the start."""
    initial = plan.initial
    if initial.velocities or initial.offsets:
        return 0.0
    return min((i.time for i in initial.impulses), default=plan.simulation.duration)
