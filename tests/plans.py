"""Plans for made scenes: what the tests of rollouts, launches and replays share."""

from __future__ import annotations

from f3sr.core.transforms import Array
from f3sr.goals.plan import Displaced, InitialConditions, Phase, Plan, Semantics, SimulationPlan, TaskSpec
from f3sr.goals.rollout import Rollout
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene, SceneObject


def made(o: SceneObject, **changed: object) -> Semantics:
    """What an object is, as the package has it but for some values."""
    body = body_of(o)
    values: dict[str, object] = {
        "id": o.id,
        "material": o.material,
        "structure": "solid",
        "mass": body.mass,
        "density": o.density,
        "friction": o.friction,
        "rolling_friction": o.rolling_friction,
        "restitution": o.restitution,
        "mobility": o.mobility,
        "source": "given",
    }
    return Semantics.model_validate(values | changed)


def plan_of(
    scene: Scene,
    *,
    duration: float = 0.5,
    active: int = 0,
    semantics: tuple[Semantics, ...] | None = None,
    **initial: object,
) -> Plan:
    return Plan(
        goal="test",
        scene="0" * 64,
        phases=(
            Phase(
                task=TaskSpec(
                    kind="slide",
                    active=active,
                    conditions=(Displaced(a=active, at_least=0.1),),
                    interpretation="a test",
                ),
                semantics=tuple(made(o) for o in scene) if semantics is None else semantics,
                initial=InitialConditions.model_validate(initial),
                simulation=SimulationPlan(duration=duration),
            ),
        ),
    )


def changed(plan: Plan, **values: object) -> Plan:
    """A plan of one phase with other values in it."""
    (phase,) = plan.phases
    return plan.model_copy(update={"phases": (phase.model_copy(update=values),)})


def centers(rollout: Rollout, o: SceneObject) -> Array:
    """The way of a centre of mass (T, 3)."""
    T = rollout.poses(o.id)
    return T[:, :3, :3] @ body_of(o).center + T[:, :3, 3]
