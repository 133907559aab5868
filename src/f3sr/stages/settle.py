"""settle: passive physics until the scene truly rests, undamped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval

from f3sr.core.transforms import Array, invert_pose, rotation_angle
from f3sr.physics import settling as physics_settling
from f3sr.physics.mujoco_model import PhysicsConfig
from f3sr.physics.settling import SettleConfig
from f3sr.report import Decision, Measure, Report
from f3sr.scene import Scene, SceneObject, Support, name_of
from f3sr.settings import settings

DRIFT = "undamped drift"
"""The measure of how far a centre of mass moves in the undamped check."""


@settings
class SettleStageConfig:
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    settling: SettleConfig = field(default_factory=SettleConfig)
    min_share: Annotated[float, Interval(ge=0, lt=1)] = 0.05
    """Share of an object's load from which on something counts as its support."""


def settle(scene: Scene, config: SettleStageConfig | None = None) -> tuple[Scene, Report]:
    """Let the objects come to rest under gravity; how far each one moved is reported.

    A simulation that blows up leaves the scene as it was, a Decision.
    """
    config = config or SettleStageConfig()
    result = physics_settling.settle(scene.objects, config.physics, settling=config.settling)
    drift = max(result.drifts.values())
    decisions: list[Decision] = []
    if result.exploded:
        decisions.append(Decision(choice="poses kept as they were", reason="the simulation blew up", fallback=True))
    elif not result.at_rest:
        decisions.append(
            Decision(
                choice="kept although not at rest",
                reason=f"an undamped release still moves {1000 * drift:.2f} mm after {result.seconds:.1f} s",
            )
        )
    moved = tuple(_at(o, result.T_world_object[o.id]) for o in scene)
    if not result.exploded:
        moved = tuple(_carried(o, result.loads, config.min_share) for o in moved)
        decisions += _changed_supports(scene.objects, moved)
    measures = [
        Measure(name="at rest", after=float(result.at_rest)),
        Measure(name="time to rest", after=result.seconds, unit="s"),
        Measure(name=DRIFT, after=1000 * drift, unit="mm"),
        *(Measure(name=DRIFT, after=1000 * result.drifts[o.id], unit="mm", about=o.id) for o in scene),
        *(_travel(before, after) for before, after in zip(scene, moved, strict=True)),
        *(_turn(before, after) for before, after in zip(scene, moved, strict=True)),
    ]
    return scene.with_objects(*moved), Report(stage="settle", measures=tuple(measures), decisions=tuple(decisions))


def restless(report: Report, config: SettleStageConfig) -> frozenset[int]:
    """Ids of the objects that do not rest after ``settle``, by its report."""
    drifts = {m.about: m.after for m in report.measures if m.name == DRIFT and m.about is not None}
    limit = 1000 * config.settling.drift_limit
    moving = frozenset(id for id, drift in drifts.items() if not drift <= limit)
    return moving if moving or report.value("at rest") else frozenset(drifts)


def _carried(o: SceneObject, loads: Mapping[tuple[int, int], float], min_share: float) -> SceneObject:
    """The object with the supports that really carry it, the strongest first; as it was when nothing does."""
    forces = {carrier: force for (carried, carrier), force in loads.items() if carried == o.id}
    total = sum(forces.values())
    shares = {id: force / total for id, force in forces.items() if force >= min_share * total}
    if not shares:
        return o
    ordered = sorted(shares, key=lambda id: (-shares[id], id))
    supports = tuple(Support(id=id, share=shares[id] / sum(shares.values())) for id in ordered)
    return replace(o, supports=supports, supported_by=ordered[0])


def _changed_supports(before: Sequence[SceneObject], after: Sequence[SceneObject]) -> list[Decision]:
    return [
        Decision(
            choice=f"rests on {name_of(b.supports[0].id)}, not on {_name(a.supported_by)} as before physics",
            reason=", ".join(f"{name_of(s.id)}: {100 * s.share:.0f}% of the load" for s in b.supports),
            about=b.id,
        )
        for a, b in zip(before, after, strict=True)
        if a.supported_by != b.supported_by
    ]


def _name(id: int | None) -> str:
    return "something unseen" if id is None else name_of(id)


def _at(o: SceneObject, T_world_object: Array) -> SceneObject:
    T = T_world_object @ invert_pose(o.T_world_object)
    return o if np.array_equal(T_world_object, o.T_world_object) else o.moved(T, stage="settle", reason="came to rest")


def _travel(before: SceneObject, after: SceneObject) -> Measure:
    distance = float(np.linalg.norm(after.bounds_world.mean(0) - before.bounds_world.mean(0)))
    return Measure(name="moved", after=1000 * distance, unit="mm", about=after.id)


def _turn(before: SceneObject, after: SceneObject) -> Measure:
    R = after.T_world_object[:3, :3] @ before.T_world_object[:3, :3].T
    return Measure(name="turned", after=np.degrees(rotation_angle(R)), unit="deg", about=after.id)
