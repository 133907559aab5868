"""The Reasoner by rules: what every object of a scene is to physics, and from where that is known.

What a package declares stays as it is. A package whose material is unknown declares nothing: its density is the
pipeline's default, and the label knows better. Restitution is given only to what flies and what it flies at: bouncing
contacts are soft, and a pile that rests on them would sink.
"""

from __future__ import annotations

from f3sr.goals.plan import Kind, Semantics, Source, TaskSpec
from f3sr.language.materials import MaterialPrior, material_of
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene, SceneObject

FLYING: set[Kind] = {"drop", "throw", "bounce", "launch_and_return"}
"""Kinds in which the active object meets things at speed."""
UNDECLARED = "unknown"
"""The material of an object of which a package declares nothing."""


def semantics_of(task: TaskSpec, scene: Scene) -> tuple[Semantics, ...]:
    """The physical properties of every object for a task, in the scene's order."""
    return tuple(_of(o, bounces=o.id == task.active and task.kind in FLYING) for o in scene)


def declared(o: SceneObject, *, source: Source = "scene") -> Semantics:
    """The physical properties that a package declares for an object."""
    known = material_of(o.label)
    return Semantics(
        id=o.id,
        material=o.material[:80],
        structure=known.structure if known else "solid",
        mass=body_of(o).mass,
        density=o.density,
        friction=o.friction,
        rolling_friction=o.rolling_friction,
        restitution=o.restitution,
        mobility=o.mobility,
        source=source,
    )


def _of(o: SceneObject, *, bounces: bool) -> Semantics:
    known = material_of(o.label)
    if o.material != UNDECLARED:
        return declared(o)
    if known is None:
        return declared(o, source="default")
    return _by_label(o, known, known.restitution if bounces else o.restitution)


def _by_label(o: SceneObject, known: MaterialPrior, restitution: float) -> Semantics:
    return Semantics(
        id=o.id,
        material=known.name,
        structure=known.structure,
        mass=body_of(o).mass * known.density / o.density,
        density=known.density,
        friction=known.friction,
        rolling_friction=known.rolling_friction,
        restitution=restitution,
        mobility=o.mobility,
        source="label",
    )
