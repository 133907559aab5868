"""Side effects: what a rollout does that nobody asked for, in words for people."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from f3sr.goals.plan import Condition, TaskSpec
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import Seen
from f3sr.scene import GROUND, Scene

FELL = math.radians(60)
"""Lean [rad] of what fell over, as of the condition ``toppled``."""
CARRIED = 0.25
"""Share of an object's size by which it must sink to have fallen off what carried it."""
ROUND = 0.8
"""Ratio of shortest to longest side from which on an object is as round as a ball or a cube."""
LEAVES = 0.5
"""Share of an object in the photo's frame below which it has left the photo."""


def side_effects(scene: Scene, task: TaskSpec, rollout: Rollout) -> Iterator[str]:
    """A sentence each: of objects that fell over, fell off their support, or left the photo, unless the task asks for
    it. ``scene`` is that at the start."""
    seen = Seen(rollout, scene)
    for o in scene:
        if o.mobility == "fixed":
            continue
        asked = [c for c in task.conditions if c.a == o.id]
        if _falls(o.id, seen) and not _asks_to_fall(o.id, task, asked):
            yield f"{seen.name(o.id)} falls over"
        if left := _left(o.id, seen, task):
            yield f"{seen.name(o.id)} falls off {seen.name(left)}"
        if _in_frame(o.id, seen, 0) and not _in_frame(o.id, seen, -1):
            yield f"{seen.name(o.id)} leaves the photo"


def _falls(id: int, seen: Seen) -> bool:
    """Whether it lies at the end; what is round has no side to fall on."""
    if float(seen.lean(id)[-1]) < FELL:
        return False
    sides = np.sort(np.ptp(seen.corners(id), axis=0))
    return bool(sides[0] < ROUND * sides[2])


def _asks_to_fall(id: int, task: TaskSpec, asked: list[Condition]) -> bool:
    """Falling is asked for, or belongs to what flies and rolls."""
    if any(c.type == "toppled" for c in asked):
        return True
    return id == task.active and task.kind not in ("slide", "push_into")


def _left(id: int, seen: Seen, task: TaskSpec) -> int | None:
    """The object that it fell off, unless the task sets it off from there, or moves the carrier away."""
    below = seen.of(id).supported_by
    if id == task.active or below is None or below == GROUND or seen.touching(id, below):
        return None
    sunk = float(seen.way(id)[0, 2] - seen.way(id)[-1, 2])
    return below if sunk > CARRIED * seen.of(id).size else None


def _in_frame(id: int, seen: Seen, sample: int) -> bool:
    return seen.scene.camera.share_in_frame(seen.corners(id, sample)) >= LEAVES
