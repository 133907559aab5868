"""How far a goal is met while an episode goes on: its conditions, judged on the rollout so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.goals.conditions import Judged, judge
from f3sr.goals.plan import Condition, Contact, Height, TaskSpec
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import CONTACT, Rollout
from f3sr.physics.mujoco_model import MjData, MjModel
from f3sr.physics.mujoco_scene import poses_from
from f3sr.play.rule_based_language import Rules
from f3sr.scene import GROUND, Scene

Touch = tuple[float, int, int, float]
"""A row of ``rollout.CONTACT``."""


def task_of(scene: Scene, goal: str) -> TaskSpec:
    """What a goal in words asks for, in its strictest reading. Raises InputError for words that are not understood, and
    for more than one phase."""
    planned = Rules().plan(goal, scene, ())
    if isinstance(planned, Refusal):
        raise InputError("goal", found=f"{goal!r}: {planned.message}", accepted="a goal of `f3sr goals PACKAGE`")
    if not planned.last:
        raise InputError("goal", found=f"several phases in {goal!r}", accepted="one: each is an episode of its own")
    task = planned.readings[0]
    return task if task.kind not in ("drop", "lift_and_drop") else _lifted_first(task)


def _lifted_first(task: TaskSpec) -> TaskSpec:
    """The task with the release as a condition: a rollout begins above, an episode where the object lies."""
    lifted = Height(a=task.active, at_least=task.amount or 0.0)
    then = (c.model_copy(update={"after": 0 if c.after is None else c.after + 1}) for c in task.conditions)
    return task.model_copy(update={"conditions": (lifted, *then)})


@dataclass(eq=False, kw_only=True)
class GoalProgress:
    """The conditions of a goal on an episode in ``scene``, of at most ``samples`` samples after its start."""

    scene: Scene
    conditions: Sequence[Condition]
    samples: int
    model: MjModel
    _time: Array = field(init=False)
    _states: Array = field(init=False)
    _touches: list[Touch] = field(init=False, default_factory=list[Touch])
    _count: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._names = np.array([GROUND, *(o.id for o in self.scene)])
        self._time = np.zeros(self.samples + 1)
        self._states = np.zeros((self.samples + 1, len(self.scene.objects), 7))
        self._body_of_geom = np.asarray(self.model.geom_bodyid)
        self._judged_bodies = np.isin(np.arange(self.model.nbody), self._bodies([c.a for c in self.conditions]))
        pairs = ((c.a, c.b) for c in self.conditions if isinstance(c, Contact))
        self._awaited = {tuple(sorted(pair)) for pair in pairs}

    def add(self, data: MjData, states: Array) -> None:
        """A sample now, with the objects' states (N, 7), and what touches the objects that conditions judge."""
        self._time[self._count], self._states[self._count] = data.time, states
        self._count += 1
        bodies = self._body_of_geom[data.contact.geom]
        own = self._judged_bodies[bodies].any(1) & (bodies < len(self._names)).all(1) if len(bodies) else bodies
        if not own.any():
            return
        rows = data.contact.efc_address
        for k in np.flatnonzero(own & (rows >= 0)):
            a, b = sorted(self._names[bodies[k]].tolist())
            self._touches.append((float(data.time), a, b, float(data.efc_force[rows[k]])))
            self._awaited.discard((a, b))

    def _bodies(self, ids: Sequence[int]) -> NDArray[np.int64]:
        return np.flatnonzero(np.isin(self._names, ids))

    @property
    def rollout(self) -> Rollout:
        """Everything so far. Of contacts it has those of judged objects, at its samples."""
        return Rollout(
            time=self._time[: self._count],
            ids=self._names[1:],
            T_world_object=poses_from(self._states[: self._count]),
            contacts=np.array(self._touches, CONTACT),
        )

    def judged(self) -> list[Judged]:
        """Every condition as it stands."""
        return judge(self.conditions, self.rollout, self.scene)

    def met(self) -> bool:
        """Whether all are met now. What must touch and has not is looked at first: measuring distances is slow."""
        return bool(self.conditions) and not self._awaited and all(j.met for j in self.judged())
