"""The Reasoner by rules: what every object of a scene is to physics, as its package says.

Restitution counts only for what is sent at something: bouncing contacts are soft, and a pile that rests on them would
sink.
"""

from __future__ import annotations

from dataclasses import replace

from f3sr.goals.plan import Kind, Semantics, TaskSpec
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene, SceneObject

AT_SPEED: set[Kind] = {"drop", "throw", "bounce", "launch_and_return", "roll", "push_into"}
"""Kinds in which the active object meets things at speed, through the air or along the ground."""


def semantics_of(task: TaskSpec, scene: Scene) -> tuple[Semantics, ...]:
    """The physical properties of every object for a task, in the scene's order."""
    return tuple(declared(o) if o.id in at_speed(task) else at_rest(o) for o in scene)


def at_speed(task: TaskSpec) -> frozenset[int]:
    """What meets things at speed in a task."""
    return frozenset({task.active}) if task.kind in AT_SPEED else frozenset()


def at_rest(o: SceneObject) -> Semantics:
    """The properties of an object that does not bounce."""
    return declared(replace(o, restitution=0.0))


def declared(o: SceneObject) -> Semantics:
    """The physical properties that a package declares for an object."""
    return Semantics(
        id=o.id,
        material=o.material[:80],
        structure=o.structure,
        mass=body_of(o).mass,
        density=o.density,
        friction=o.friction,
        rolling_friction=o.rolling_friction,
        restitution=o.restitution,
        damping=o.damping,
        mobility=o.mobility,
        source=o.material_source,
    )
