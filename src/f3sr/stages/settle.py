"""settle: passive physics until the scene truly rests, undamped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from f3sr.core.transforms import Array, invert_pose
from f3sr.metrics.contact_groups import SettledScene
from f3sr.physics import settling as physics_settling
from f3sr.physics.mujoco_model import PhysicsConfig
from f3sr.physics.settling import SettleConfig
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject, Support, name_of
from f3sr.settings import settings

MIN_SHARE = 0.05
"""Least share of an object's load by which something counts as its support."""


@settings
class SettleStageConfig:
    physics: PhysicsConfig = field(default_factory=PhysicsConfig)
    settling: SettleConfig = field(default_factory=SettleConfig)

    def within(self, rounds: int, seconds: float = np.inf) -> Self:
        """The same with no more rounds, and no more damped simulation [s]."""
        was = self.settling
        less = replace(was, rounds=min(rounds, was.rounds), time_limit=min(seconds, was.time_limit))
        return replace(self, settling=less)


@dataclass(frozen=True, kw_only=True)
class Settled(Outcome):
    """Mappings are by object id."""

    stage: ClassVar[str] = "settle"
    at_rest: bool = False
    seconds: float = 0.0
    """Time to rest [s]."""
    drifts: Mapping[int, float] = field(default_factory=dict[int, float])
    """How far centres of mass move in the undamped check [m]."""
    travel: Mapping[int, float] = field(default_factory=dict[int, float])
    """How far middles moved [m]."""
    turns: Mapping[int, float] = field(default_factory=dict[int, float])
    """By how much objects turned [rad]."""
    restless: frozenset[int] = frozenset()
    """Ids of the objects that do not rest."""

    @property
    def drift(self) -> float:
        """The largest [m]."""
        return max(self.drifts.values(), default=0.0)

    @property
    def measures(self) -> tuple[Measure, ...]:
        drift = Measure(name="undamped drift", after=1000 * self.drift, unit="mm")
        return (
            Measure(name="at rest", after=float(self.at_rest)),
            Measure(name="time to rest", after=self.seconds, unit="s"),
            drift,
            *(replace(drift, after=1000 * d, about=id) for id, d in self.drifts.items()),
            *(Measure(name="moved", after=1000 * way, unit="mm", about=id) for id, way in self.travel.items()),
            *(Measure(name="turned", after=np.degrees(a), unit="deg", about=id) for id, a in self.turns.items()),
        )


def settle(scene: Scene, config: SettleStageConfig | None = None) -> tuple[Scene, Settled]:
    """Let the objects come to rest under gravity; how far each one moved is reported.

    A simulation that blows up leaves the scene as it was, a Decision.
    """
    config = config or SettleStageConfig()
    result = physics_settling.settle(
        scene.objects, config.physics, settling=config.settling, ground_friction=scene.ground.friction
    )
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
        moved = tuple(_carried(o, result.loads) for o in moved)
        decisions += _changed_supports(scene.objects, moved)
    outcome = Settled(
        at_rest=result.at_rest,
        seconds=result.seconds,
        drifts={o.id: result.drifts[o.id] for o in scene},
        travel={a.id: float(np.linalg.norm(a.way_to(b))) for a, b in zip(scene, moved, strict=True)},
        turns={a.id: a.angle_to(b) for a, b in zip(scene, moved, strict=True)},
        restless=result.moving,
        decisions=tuple(decisions),
    )
    return scene.with_objects(*moved), outcome


def at_rest(scene: Scene, config: SettleStageConfig) -> SettledScene:
    """The scene after ``settle``, and which of its objects do not rest."""
    scene, settled = settle(scene, config)
    return SettledScene(scene=scene, restless=settled.restless)


def _carried(o: SceneObject, loads: Mapping[tuple[int, int], float]) -> SceneObject:
    """The object with the supports that really carry it, the strongest first; as it was where nothing does, or
    something unseen."""
    if o.is_on_something_unseen:
        return o
    forces = {carrier: force for (carried, carrier), force in loads.items() if carried == o.id}
    total = sum(forces.values())
    shares = {id: force / total for id, force in forces.items() if force >= MIN_SHARE * total}
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
