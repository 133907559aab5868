"""What every task, semantics and launch must keep, whoever made it: rules, a model or a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from f3sr.errors import F3srError
from f3sr.files.bounds import MIN_MOMENT
from f3sr.goals.language_protocol import Launch
from f3sr.goals.launch_limits import beyond, limits_of
from f3sr.goals.plan import InitialConditions, Phase, Plan, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.rollout import MAX_SAMPLES, Rollout
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import GROUND, Scene

LIFTED = {"drop", "lift_and_drop", "throw", "bounce"}
"""Kinds whose active object may start elsewhere than the package has it."""
LONGEST = 10.0
"""Of a rollout [s]: no film of one goal is longer."""
STEPS = 1.1e-3
"""Longest time step [s]: contacts that bounce need it."""


class PlanError(F3srError):
    """A language's answer that cannot be played; one line says what is wrong and what is accepted."""


def require(faults: Iterator[str], *, of: str) -> None:
    """Raises PlanError with the first fault."""
    if fault := next(faults, None):
        raise PlanError(f"the {of} cannot be played: {fault}")


def faults_of(phase: Phase, scene: Scene) -> Iterator[str]:
    """Of a phase of a plan in the scene that it starts in."""
    yield from task_faults(phase.task, scene)
    yield from semantics_faults(phase.semantics, scene)
    launch = Launch(initial=phase.initial, simulation=phase.simulation)
    yield from launch_faults(launch, phase.task, phase.semantics, scene)


def task_faults(task: TaskSpec, scene: Scene) -> Iterator[str]:
    ids = {o.id for o in scene}
    named = {task.active, *task.passives, *([] if task.target is None else [task.target])}
    for c in task.conditions:
        named |= {c.a, *([c.b] if "b" in type(c).model_fields else [])}  # type: ignore[union-attr]
    if unknown := sorted(named - ids - {GROUND}):
        yield f"it names objects {unknown[:8]}; the scene has {sorted(ids)}"
        return
    if scene[task.active].mobility == "fixed":
        yield f"object {task.active} is fixed; accepted: one that can move as the active object"
    directions = [task.direction, *(c.direction for c in task.conditions if c.type == "displaced")]
    if any(d is not None and not 0.5 < np.linalg.norm(d) < 2 for d in directions):
        yield "a direction has no length; accepted: unit vectors"


def semantics_faults(semantics: Sequence[Semantics], scene: Scene) -> Iterator[str]:
    ids = [o.id for o in scene]
    if [s.id for s in semantics] != ids:
        yield f"semantics of objects {[s.id for s in semantics][:12]}; accepted: of {ids}, in this order"
        return
    for s, o in zip(semantics, scene, strict=True):
        mass = body_of(o).mass * s.density / o.density
        if not np.isclose(s.mass, mass, rtol=1e-6):
            yield f"object {s.id} of {s.density:.6g} kg/m3 weighs {s.mass:.6g} kg; accepted: {mass:.6g}, by its volume"
        least = float(np.linalg.eigvalsh(body_of(o).inertia)[0]) * s.density / o.density
        if o.mobility == "dynamic" and least < MIN_MOMENT:
            yield f"object {s.id} has a moment of {least:.3g} kg m2; accepted: at least {MIN_MOMENT:.3g} to move"
        if s.mobility != o.mobility:
            yield f"object {s.id} is {s.mobility}; accepted: {o.mobility}, as the package has it"


def launch_faults(launch: Launch, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene) -> Iterator[str]:
    initial, simulation = launch.initial, launch.simulation
    if strangers := sorted(initial.controlled - {task.active}):
        yield f"it sets off objects {strangers[:8]}; accepted: only the active object {task.active}"
        return
    yield from _in_time(initial, simulation)
    if initial.offsets and task.kind not in LIFTED:
        yield f"it moves object {task.active} before it starts; accepted: only to {', '.join(sorted(LIFTED))}"
    mass = next((s.mass for s in semantics if s.id == task.active), 0.0)
    if excess := beyond(initial, scene[task.active], mass, limits_of(scene)):
        yield excess


def _in_time(initial: InitialConditions, simulation: SimulationPlan) -> Iterator[str]:
    if simulation.duration > LONGEST or simulation.timestep > STEPS:
        yield (
            f"{simulation.duration:.3g} s in steps of {simulation.timestep:.2g} s; accepted: at most {LONGEST:.3g} s, "
            f"in steps of at most {STEPS:.2g} s"
        )
    if any(i.time + i.duration > simulation.duration for i in initial.impulses):
        yield f"an impulse ends after the rollout; accepted: within {simulation.duration:.3g} s"
    if not 2 < simulation.samples <= MAX_SAMPLES:
        yield f"{simulation.samples} samples; accepted: 3 to {MAX_SAMPLES}"


def rollout_faults(rollout: Rollout, plan: Plan) -> Iterator[str]:
    """Of a rollout that was read: phases and samples that its plan does not give."""
    if len(rollout.starts) != len(plan.phases):
        yield f"{len(rollout.starts)} phases; accepted: {len(plan.phases)} as its plan has them"
        return
    for phase, part in zip(plan.phases, rollout.phases, strict=True):
        every = phase.simulation.timestep * phase.simulation.steps_per_sample
        due = every * np.arange(phase.simulation.samples)
        if len(part.time) != len(due) or np.abs(part.time - due).max() > every / 100:
            yield (
                f"{len(part.time)} samples until {part.time[-1]:.3f} s; "
                f"accepted: {len(due)} as its plan has them, one every {every:.3g} s"
            )
