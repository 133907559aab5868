"""Whether a model's answer suits a scene: what ``goals.checks`` asks of everybody, and what only models get wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from f3sr.agents.role_answers import Estimate
from f3sr.goals import checks
from f3sr.goals.conditions import judge
from f3sr.goals.language_protocol import Launch
from f3sr.goals.launch_limits import limits_of
from f3sr.goals.plan import InitialConditions, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.rollout import CONTACT, Rollout
from f3sr.language.grammar.materials import material_of
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene

OTHERWISE = 2.0
"""Ratio of an estimated density to the table's, or its inverse, from which on the user is told."""


def require(faults: Iterator[str]) -> None:
    """Raises ValueError with the first fault: words for the model."""
    if fault := next(faults, None):
        raise ValueError(fault)


def task_faults(task: TaskSpec, scene: Scene) -> Iterator[str]:
    """Of a task: unknown objects, no length, and conditions that hold although nothing moves."""
    fault = next(checks.task_faults(task, scene), None)
    if fault is not None:
        yield fault
        return
    if all(judged.met for judged in judge(task.conditions, _still(scene), scene)):
        yield "its conditions hold before anything moves; accepted: one at least that the motion brings about"


def _still(scene: Scene) -> Rollout:
    """A second in which nothing moves and what rests on something touches it."""
    time = np.arange(31) / 30
    T = np.repeat(np.stack([o.T_world_object for o in scene])[None], len(time), axis=0)
    pairs = sorted({(min(o.id, s.id), max(o.id, s.id)) for o in scene for s in o.supports})
    rows = [(float(t), a, b, 1.0) for t in time for a, b in pairs]
    return Rollout(
        time=time, ids=np.array([o.id for o in scene]), T_world_object=T, contacts=np.array(rows, dtype=CONTACT)
    )


def estimate_faults(estimates: Sequence[Estimate], scene: Scene) -> Iterator[str]:
    """Of properties: of other objects, in another order, or beyond what the engine can move."""
    ids = [o.id for o in scene]
    if [e.id for e in estimates] != ids:
        yield f"properties of objects {[e.id for e in estimates][:12]}; accepted: of {ids}, in this order"
        return
    semantics = [semantics_of(e, scene, at_speed=False) for e in estimates]
    yield from checks.semantics_faults(semantics, scene)


def semantics_of(estimate: Estimate, scene: Scene, *, at_speed: bool) -> Semantics:
    """A model's properties of an object; restitution counts only at speed, as for the rules."""
    o = scene[estimate.id]
    return Semantics(
        **estimate.model_dump(exclude={"restitution"}),
        restitution=estimate.restitution if at_speed else 0.0,
        mass=body_of(o).mass * estimate.density / o.density,
        damping=o.damping,
        mobility=o.mobility,
        source="model",
    )


def launch_of(initial: InitialConditions, duration: float, scene: Scene) -> Launch:
    return Launch(initial=initial, simulation=SimulationPlan(duration=duration, limits=limits_of(scene)))


def disagreements(estimates: Sequence[Estimate], scene: Scene) -> Iterator[str]:
    """Densities that differ much from those of the table, in words for the user."""
    for e in estimates:
        prior = material_of(scene[e.id].label)
        if prior is not None and not 1 / OTHERWISE < e.density / prior.density < OTHERWISE:
            yield (
                f"{scene[e.id].label}: {e.density:.4g} kg/m3 of {e.material} by the model, "
                f"{prior.density:.4g} of {prior.name} by the table"
            )
