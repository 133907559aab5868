"""What a film shows in which order: the phases of a rollout, and between them how an object is lifted to its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from f3sr.core.transforms import Array, rotation_from_vector, vector_from_rotation
from f3sr.film.slow_motion import finer, rate_of
from f3sr.goals.plan import Phase, Plan
from f3sr.goals.rollout import Rollout, joined
from f3sr.goals.sequence import played_phases
from f3sr.goals.verify import Verdict
from f3sr.scene import Scene

LIFTING = 0.6
"""How long a film shows an object on its way to where its phase lets it go [s]: no physics, as of a hand."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """A phase in a film, in the scene that it starts in; ``rollout`` and ``verdict`` count from its own start.

    ``drawn`` is the same rollout with the samples that slow motion needs."""

    scene: Scene
    phase: Phase
    rollout: Rollout
    drawn: Rollout
    verdict: Verdict
    start: float
    """When the film shows its first sample [s]."""
    frame: int
    """And that frame."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Footage:
    """All frames of a film as one rollout at even times, and its phases."""

    rollout: Rollout
    scenarios: tuple[Scenario, ...]


def footage(
    scene: Scene,
    plan: Plan,
    rollout: Rollout,
    verdict: Verdict,
    slow: Fraction,
    *,
    opening: float = 0.0,
    closing: float = 0.0,
) -> Footage:
    """The film of a rollout: phases follow each other without a cut. What starts elsewhere is lifted there; in the
    first phase only after an ``opening`` [s] that shows the scene of the photo at rest. The end stays for a
    ``closing`` [s].

    Raises InputError where phases have other sample rates, or slow motion gives another motion."""
    shown, found, time, frame = list[Rollout](), list[Scenario](), 0.0, 0
    for k, played in enumerate(played_phases(scene, plan, rollout)):
        part, began = finer(played.scene, played.phase, played.rollout, slow), float(rollout.time[rollout.starts[k]])
        before = [_resting(played.scene, part, opening)] if opening and not shown else []
        if played.phase.initial.offsets and (shown or before):
            before.append(_lifted((shown + before)[-1], part))
        for still in before:
            time, frame = time + float(still.time[-1]), frame + len(still.time) - 1
        shown += before
        conditions = tuple(
            replace(c, time=None if c.time is None else c.time - began) for c in verdict.conditions if c.phase == k
        )
        own = Verdict(conditions=conditions, broken=verdict.broken, side_effects=verdict.side_effects)
        found.append(
            Scenario(
                scene=played.scene,
                phase=played.phase,
                rollout=played.rollout,
                drawn=part,
                verdict=own,
                start=time,
                frame=frame,
            )
        )
        shown.append(part)
        time, frame = time + float(part.time[-1]), frame + len(part.time) - 1
    if closing:
        shown.append(_still(shown[-1], shown[-1].T_world_object[-1], closing))
    return Footage(rollout=_without_cuts(joined(shown)), scenarios=tuple(found))


def _resting(scene: Scene, after: Rollout, seconds: float) -> Rollout:
    """The scene as it rests in the photo."""
    return _still(after, np.array([scene[int(id)].T_world_object for id in after.ids]), seconds)


def _still(like: Rollout, poses: Array, seconds: float) -> Rollout:
    """Poses (n, 4, 4) that stay, at the rate of another rollout."""
    steps = max(1, round(seconds * float(rate_of(like))))
    time = np.arange(steps + 1) / float(rate_of(like))
    return replace(like, time=time, T_world_object=np.tile(poses, (steps + 1, 1, 1, 1)), contacts=like.contacts[:0])


def _lifted(before: Rollout, after: Rollout) -> Rollout:
    """The way of what starts elsewhere than it rests: up first, then aside."""
    start, end = before.T_world_object[-1], after.T_world_object[0]
    steps = max(2, round(LIFTING * float(rate_of(after))))
    poses = np.array([[_between(a, b, k / steps) for a, b in zip(start, end, strict=True)] for k in range(steps + 1)])
    time = np.arange(steps + 1) / float(rate_of(after))
    return replace(after, time=time, T_world_object=poses, contacts=after.contacts[:0])


def _between(a: Array, b: Array, share: float) -> Array:
    """A pose on the way from one to another: what rises does so in the first half."""
    smooth = share * share * (3 - 2 * share)
    early, late = min(1.0, 2 * smooth), max(0.0, 2 * smooth - 1)
    up, aside = (early, late) if b[2, 3] > a[2, 3] else (late, early)
    T = np.eye(4)
    T[:3, :3] = rotation_from_vector(smooth * vector_from_rotation(b[:3, :3] @ a[:3, :3].T)) @ a[:3, :3]
    T[:3, 3] = a[:3, 3] + (b - a)[:3, 3] * [aside, aside, up]
    return T


def _without_cuts(rollout: Rollout) -> Rollout:
    """One phase: the last sample of each is the first of the next."""
    kept = np.ones(len(rollout.time), bool)
    kept[rollout.starts[1:]] = False
    return Rollout(
        time=rollout.time[kept],
        ids=rollout.ids,
        T_world_object=rollout.T_world_object[kept],
        contacts=rollout.contacts,
    )


def paths(scenes: Sequence[Scenario], frames: int) -> list[tuple[int, int, int]]:
    """Whose path is drawn in which frames: id of the active object, first frame, and the one after the last."""
    firsts = [0, *(s.frame for s in scenes[1:]), frames]
    return [(s.phase.task.active, a, b) for s, a, b in zip(scenes, firsts, firsts[1:], strict=False)]
