"""Trials of launches: rollouts that end when all is still, judged, counted and rated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from f3sr.core.transforms import Array, transform
from f3sr.goals.checks import LONGEST
from f3sr.goals.language_protocol import Launch, Tried
from f3sr.goals.plan import Phase, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.rollout import Rollout
from f3sr.goals.rollout_queries import LAST
from f3sr.goals.scene_layout import SceneLayout
from f3sr.goals.simulate import model_of, simulate_phase, start_state
from f3sr.goals.verify import verify_phase
from f3sr.language.reasoner import at_rest
from f3sr.physics.mujoco_model import engine
from f3sr.scene import GROUND, Scene

ROLLOUTS = 64
"""That the search for one goal may take."""
WORK = 480.0
"""Seconds simulated in all of them, times the objects of the scene: at most about 12 s of a processor."""
SLOW, SLOWLY = 0.01, 0.1
"""Speeds [m/s, rad/s] below which everything counts as still."""
LINGERS = 1.5
"""Longest wait [s] for objects that the goal does not involve, once all others are still."""
SHORTEST = 0.8
"""Of a rollout [s]: less is over before anybody sees it."""
RUNAWAY, WHIRL = 2.0, 400.0
"""Times the limit of speeds, and turning [rad/s], from which on something was thrown by a contact: the trial ends."""
SURE = 0.03
"""Relative margin from which on a plan that meets its conditions is not bettered."""
IN_SIGHT = 0.9
"""Share of the active object that the photo is to show when the goal is met, and at the end: what fell over may have an
end behind another."""
OVERLAP = 1e-3
"""Deepest overlap with which something may start elsewhere [m]."""
REST, DRIFT = 0.25, 5e-4
"""Duration [s] of the check that objects rest with a plan's semantics, and the largest motion [m] allowed in it."""


class OverlapError(Exception):
    """A start inside something else."""


@dataclass(eq=False)
class Trials:
    """Rollouts of one phase of a goal, from the scene that it starts in."""

    scene: Scene
    rollouts: int = 0
    seconds: float = 0.0
    _models: dict[Any, Any] = field(default_factory=dict[Any, Any])
    _rollouts: dict[Any, Rollout] = field(default_factory=dict[Any, Rollout])

    @property
    def spent(self) -> bool:
        return self.rollouts >= ROLLOUTS or self.seconds * len(self.scene.objects) >= WORK

    def run(self, task: TaskSpec, semantics: Sequence[Semantics], launch: Launch) -> Tried:
        """The launch with the duration that it took, its rollout and verdict.

        Raises OverlapError or FloatingPointError."""
        phase = phase_of(task, semantics, launch)
        key = (phase.semantics, launch)
        if key not in self._rollouts:
            self._rollouts[key] = self._rollout(phase)
        return self._judged(phase, self._rollouts[key])

    def rested(self, task: TaskSpec, semantics: Sequence[Semantics], tried: Tried) -> Tried:
        """The same launch, played until every object rests, or as long as a phase may last: as soon as that meets the
        task, else after the trial's own end."""
        simulation = tried.launch.simulation.model_copy(update={"duration": LONGEST})
        launch = Launch(initial=tried.launch.initial, simulation=simulation)
        phase, everything = phase_of(task, semantics, launch), range(sum(o.mobility == "dynamic" for o in self.scene))
        model = self._model_of(phase.semantics, phase.simulation)
        launched = max((i.time + i.duration for i in phase.initial.impulses), default=0.0)
        found = tried
        for after in (launched, float(tried.rollout.time[-1]) - 2 * LAST):
            self.rollouts += 1
            watch = Still(after, everything, fastest=np.inf)
            found = self._judged(phase, simulate_phase(self.scene, phase, until=watch, model=model))
            if found.verdict.met:
                break
        return found

    def _judged(self, phase: Phase, rollout: Rollout) -> Tried:
        ended = phase.simulation.model_copy(update={"duration": float(rollout.time[-1])})
        phase = phase.model_copy(update={"simulation": ended})
        launch = Launch(initial=phase.initial, simulation=ended)
        return Tried(launch=launch, rollout=rollout, verdict=verify_phase(self.scene, phase, rollout))

    def _rollout(self, phase: Phase) -> Rollout:
        """Another reading of the same words may ask for the same launch: that is no new rollout."""
        model, task = self._model_of(phase.semantics, phase.simulation), phase.task
        if phase.initial.offsets:
            self._require_clear(model, phase)
        last = max((i.time + i.duration for i in phase.initial.impulses), default=0.0)
        watched = {task.active, *(c.a for c in task.conditions), *({task.target} - {None, GROUND})}
        rows = [k for k, o in enumerate(o for o in self.scene if o.mobility == "dynamic") if o.id in watched]
        self.rollouts += 1
        limits = phase.simulation.limits
        watch = Still(last, rows, fastest=RUNAWAY * limits.speed if limits else np.inf)
        try:
            rollout = simulate_phase(self.scene, phase, until=watch, model=model)
        except FloatingPointError:
            end = watch.last - 2 * phase.simulation.timestep * phase.simulation.steps_per_sample
            if end <= 0:
                raise
            rollout = simulate_phase(self.scene, phase, until=lambda time, _: time >= end, model=model)
        self.seconds += float(rollout.time[-1])
        return rollout

    def steady(self, semantics: Sequence[Semantics]) -> tuple[Semantics, ...]:
        """The semantics with which the scene rests: what moves by itself, and what it touches, gets back what the
        package has, with which it was settled."""
        known = {o.id: at_rest(o) for o in self.scene}
        made, simulation = list(semantics), SimulationPlan(duration=REST)
        for _ in range(3):
            moved = _drifts(self._model_of(made, simulation), simulation.steps)
            restless = {o.id for o, far in zip(self.scene, moved, strict=True) if far > DRIFT}
            near = {n for id in restless for n in self._neighbours(id)} | restless
            changed = [known[s.id] if s.id in near else s for s in made]
            if changed == made:
                break
            made = changed
        return tuple(made)

    def _neighbours(self, id: int) -> set[int]:
        below = {s.id for s in self.scene[id].supports}
        above = {o.id for o in self.scene if any(s.id == id for s in o.supports)}
        return below | above

    def _model_of(self, semantics: Sequence[Semantics], simulation: SimulationPlan) -> Any:
        """The last few models are kept: one serves all launches with the same materials."""
        key = (tuple(semantics), simulation.timestep, simulation.margin)
        if key not in self._models:
            if len(self._models) > 3:
                self._models.pop(next(iter(self._models)))
            self._models[key] = model_of(self.scene, semantics, simulation)
        return self._models[key]

    def _require_clear(self, model: Any, phase: Phase) -> None:
        """Raise OverlapError if the active object starts elsewhere and inside something."""
        ids = [o.id for o in self.scene]
        data, body = start_state(model, ids, phase.initial.offsets), ids.index(phase.task.active) + 1
        mine = (model.geom_bodyid[data.contact.geom] == body).any(1) if data.ncon else np.zeros(0, bool)
        if (data.contact.dist[mine] < -OVERLAP).any():
            raise OverlapError("the active object would start inside something else")


def phase_of(task: TaskSpec, semantics: Sequence[Semantics], launch: Launch) -> Phase:
    return Phase(task=task, semantics=tuple(semantics), initial=launch.initial, simulation=launch.simulation)


class Still:
    """Ends a rollout when the goal's objects have been still for the time that counts as its end.

    The other objects must be still too, or have had ``LINGERS``. It also ends if anything is faster than ``fastest``
    [m/s]. ``rows`` are the indices of the goal's objects among all movable ones."""

    def __init__(self, after: float, rows: Sequence[int], *, fastest: float) -> None:
        self.after, self.since, self.rows = max(after, SHORTEST - LAST), np.inf, list(rows)
        self.fastest, self.last = fastest, 0.0

    def __call__(self, time: float, data: Any) -> bool:
        self.last, every = time, np.abs(data.qvel).reshape(-1, 6)
        if every[:, :3].max() > self.fastest or every[:, 3:].max() > WHIRL:
            return True
        moves = (every[:, :3].max(1) >= SLOW) | (every[:, 3:].max(1) >= SLOWLY)
        still = time > self.after and not moves[self.rows].any()
        self.since = min(self.since, time) if still else np.inf
        return time - self.since >= (LINGERS if moves.any() else LAST)


def sure(tried: Tried) -> bool:
    """Whether it is met, and not by a hair."""
    graded = [c.relative for c in tried.verdict.conditions if c.condition.type != "contact"]
    return tried.verdict.met and min(graded, default=1.0) >= SURE


def in_sight(tried: Tried, layout: SceneLayout, task: TaskSpec) -> bool:
    """Whether the photo would show nearly all of the active object when the goal is met, and at the end."""
    return _sight(tried, layout, task) == 1.0


def _sight(tried: Tried, layout: SceneLayout, task: TaskSpec) -> float:
    """How much of it the photo would show, in tenths of what it is to show: no more than at the start.

    At the end others may hide it where it is to be inside one."""
    times = [c.time for c in tried.verdict.conditions if c.time is not None]
    time = max(times, default=float(tried.rollout.time[-1]))
    sample = int(np.argmin(np.abs(tried.rollout.time - time)))
    start, met, end = (_moved(tried, layout, task.active, k) for k in (0, sample, -1))
    share = layout.scene.camera.share_in_frame(met)
    if not any(c.type == "inside" for c in task.conditions):
        share = min(share, layout.in_view(task.active, end))
    wanted = min(layout.in_view(task.active, start), IN_SIGHT)
    return 1.0 if share >= wanted else round(share / wanted, 1)


def _moved(tried: Tried, layout: SceneLayout, id: int, sample: int) -> Array:
    """The corners (n, 3) of an object in a sample of a rollout, in the world [m]."""
    start = layout.scene[id].T_world_object
    return transform(tried.rollout.poses(id)[sample] @ np.linalg.inv(start), layout.corners(id))


def rating(tried: Tried, layout: SceneLayout, task: TaskSpec) -> tuple[bool, int, float, bool, float]:
    """Better is more: met, fewer side effects, more in sight, sure, with more margin."""
    return (
        tried.verdict.met,
        -len(tried.verdict.side_effects),
        _sight(tried, layout, task),
        sure(tried),
        min(tried.verdict.margin, 10 * SURE),
    )


def _drifts(model: Any, steps: int) -> np.ndarray[Any, Any]:
    """How far every body's centre of mass moves by itself [m]."""
    mujoco = engine()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.xipos[1:].copy()
    mujoco.mj_step(model, data, steps)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return np.linalg.norm(data.xipos[1:] - start, axis=1)
