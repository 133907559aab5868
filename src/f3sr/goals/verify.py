"""verify: the verdict on a rollout: conditions with margins, the rules that every rollout keeps, and side effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic import ConfigDict

from f3sr.core.transforms import rotation_angle
from f3sr.files.meanings import Documented
from f3sr.goals.conditions import Judged, Unit, judge
from f3sr.goals.plan import Condition, Inside, Kind, Off, On, Phase, Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import LAST
from f3sr.goals.sequence import PlayedPhase, played_phases
from f3sr.goals.side_effects import side_effects
from f3sr.goals.simulate import as_planned
from f3sr.scene import GROUND, Scene
from f3sr.scene_package.scene_json import dump_json

DROPPED: set[Kind] = {"drop", "lift_and_drop"}
"""Kinds that start where something is let go."""
FASTER = 1.5
"""Times the limit of speeds that anything may reach: more comes from contacts that go wrong, not from falling."""
RESTS = 0.02
"""Speed [m/s] of what rests before the next phase starts: twice that at which trials end."""
STILL = 1e-3
"""How far anything may move before the first control [m]."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The success conditions of a plan, measured on its rollout, with the rules that it breaks (docs: goals)."""

    conditions: tuple[Judged, ...]
    """Of all phases in order; times count from the start of the rollout."""
    broken: tuple[str, ...]
    """Rules that the rollout does not keep, in words."""
    side_effects: tuple[str, ...] = ()
    """What nobody asked for, in words: what else fell over, left its support or the photo."""

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
    """Measure a plan on its rollout: conditions and rules of every phase. ``scene`` is the package's."""
    verdicts = list[Verdict]()
    for k, played in enumerate(played_phases(scene, plan, rollout)):
        verdict = verify_phase(played.scene, played.phase, played.rollout)
        restless = _restless(played) if k + 1 < len(plan.phases) else ()
        verdicts.append(replace(verdict, broken=(*verdict.broken, *restless)))
        undone = _undone(plan.phases[:k], played) if k + 1 == len(plan.phases) else ()
        verdicts[-1] = replace(verdicts[-1], side_effects=(*verdicts[-1].side_effects, *undone))
    return _whole(verdicts, [float(rollout.time[start]) for start in rollout.starts])


def verify_phase(scene: Scene, phase: Phase, rollout: Rollout) -> Verdict:
    """Measure the conditions of a phase, the rules and the side effects on its rollout; ``scene`` is its start."""
    planned = scene.with_objects(*as_planned(scene, phase.semantics, phase.initial))
    judged = judge(phase.task.conditions, rollout, planned)
    return Verdict(
        conditions=tuple(judged),
        broken=tuple(_broken(scene, planned, phase, rollout)),
        side_effects=tuple(side_effects(scene, phase.task, rollout)),
    )


def _whole(verdicts: Sequence[Verdict], starts: Sequence[float]) -> Verdict:
    """One verdict of all phases, with the times at which they start [s]."""
    if len(verdicts) == 1:
        return verdicts[0]

    def numbered(name: Literal["broken", "side_effects"]) -> tuple[str, ...]:
        return tuple(f"phase {k}: {said}" for k, v in enumerate(verdicts, 1) for said in getattr(v, name))

    return Verdict(
        conditions=tuple(
            replace(c, phase=k, time=None if c.time is None else c.time + start)
            for k, (v, start) in enumerate(zip(verdicts, starts, strict=True))
            for c in v.conditions
        ),
        broken=numbered("broken"),
        side_effects=numbered("side_effects"),
    )


def _undone(before: Sequence[Phase], last: PlayedPhase) -> Iterator[str]:
    """Where something is not any more, at the end of the last phase, though an earlier one brought it there."""
    phases = (*before, last.phase)
    places = [
        c.model_copy(update={"after": None})
        for k, phase in enumerate(before)
        for c in phase.task.conditions
        if isinstance(c, Inside | On | Off) and c.a not in {later.task.active for later in phases[k + 1 :]}
    ]
    for judged in judge(places, last.rollout, last.scene):
        if not judged.met:
            yield f"an earlier phase is undone: {judged.said}"


def _restless(played: PlayedPhase) -> Iterator[str]:
    """Objects that still move where the next phase would start from rest."""
    end = played.rollout.time >= played.rollout.time[-1] - LAST - 1e-9
    seconds = max(float(np.ptp(played.rollout.time[end])), 1e-9)
    for id in played.rollout.ids.tolist():
        speed = float(np.ptp(played.rollout.poses(id)[end, :3, 3], axis=0).max()) / seconds
        if speed > RESTS:
            yield f"object {id} still moves at {1000 * speed:.0f} mm/s when the next phase starts"


class JudgedRecord(Documented):
    """A condition of the plan on its rollout."""

    model_config = ConfigDict(extra="forbid")

    condition: Condition
    met: bool
    margin: float
    """By how much it is met; negative if missed. In ``unit``."""
    unit: Unit
    time: float | None
    """Time of the event, or of the nearest miss [s]; null if the condition is no event."""
    said: str
    phase: int
    """Index of the plan's phase that it belongs to."""


class VerdictDocument(Documented):
    """verdict.json: the measured success conditions of a plan."""

    model_config = ConfigDict(extra="forbid", title="f3sr verdict")

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
    side_effects: tuple[str, ...]
    """What nobody asked for: what else fell over, left its support or the photo."""


def to_json(verdict: Verdict) -> bytes:
    """verdict.json."""
    return dump_json(as_document(verdict).model_dump(mode="json"))


def as_document(verdict: Verdict) -> VerdictDocument:
    """What verdict.json holds."""
    judged = [
        JudgedRecord(
            condition=c.condition, met=c.met, margin=c.margin, unit=c.unit, time=c.time, said=c.said, phase=c.phase
        )
        for c in verdict.conditions
    ]
    return VerdictDocument(
        met=verdict.met,
        margin=verdict.margin,
        said=verdict.said,
        conditions=tuple(judged),
        broken_rules=verdict.broken,
        side_effects=verdict.side_effects,
    )


def _broken(scene: Scene, planned: Scene, phase: Phase, rollout: Rollout) -> Iterator[str]:
    """The rules: the rollout starts as the scene but for declared offsets, only the active object is set off, never
    after it touched its target, and nothing moves before."""
    task, initial = phase.task, phase.initial
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
    limits = phase.simulation.limits
    most = FASTER * limits.speed if limits else np.inf
    for o in planned:
        way = rollout.poses(o.id)[:, :3, 3]
        speed = float(np.max(np.linalg.norm(np.diff(way, axis=0), axis=1) / np.diff(rollout.time), initial=0.0))
        if speed > most:
            yield f"object {o.id} is flung away at {speed:.0f} m/s"
    first = _first_control(phase)
    before = rollout.time <= first + 1e-9
    for o in scene:
        way = rollout.poses(o.id)[before, :3, 3]
        moved = float(np.linalg.norm(way - way[0], axis=1).max()) if len(way) else 0.0
        if moved > STILL:
            yield f"object {o.id} moves by {1000 * moved:.1f} mm before anything is set off"


def _first_control(phase: Phase) -> float:
    """When the first impulse comes [s]; 0 where something is offset or moves from the start."""
    initial = phase.initial
    if initial.velocities or initial.offsets:
        return 0.0
    return min((i.time for i in initial.impulses), default=phase.simulation.duration)
