"""A plan's phases one after another: each starts from the scene at rest that the one before it leaves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from f3sr.core import support_forest
from f3sr.goals.plan import Phase, Plan
from f3sr.goals.rollout import Rollout, joined
from f3sr.goals.simulate import model_of, simulate_phase, start_state
from f3sr.physics.mujoco_model import engine
from f3sr.scene import GROUND, Scene, SceneObject, Support

LEAST_SHARE = 0.02
"""Share of an object's load below which a contact supports nothing: what only leans on it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlayedPhase:
    """A phase with the scene that it starts in and its rollout, whose times count from 0."""

    scene: Scene
    phase: Phase
    rollout: Rollout


def simulate(scene: Scene, plan: Plan, *, check: Callable[[Phase, Scene], None] | None = None) -> Rollout:
    """The rollout of a whole plan. ``check`` may refuse a phase in the scene that it starts in. Raises as it and
    ``simulate_phase`` do."""
    rollouts = list[Rollout]()
    for k, phase in enumerate(plan.phases):
        scene = scene_after(scene, plan.phases[k - 1], rollouts[-1]) if rollouts else scene
        if check is not None:
            check(phase, scene)
        rollouts.append(simulate_phase(scene, phase))
    return joined(rollouts)


def played_phases(scene: Scene, plan: Plan, rollout: Rollout) -> Iterator[PlayedPhase]:
    """The phases of a played plan in order; ``scene`` is the package's."""
    for k, (phase, part) in enumerate(zip(plan.phases, rollout.phases, strict=True)):
        yield PlayedPhase(scene=scene, phase=phase, rollout=part)
        if k + 1 < len(plan.phases):
            scene = scene_after(scene, phase, part)


def scene_after(scene: Scene, phase: Phase, rollout: Rollout) -> Scene:
    """The scene at the end of a phase: its poses, at rest, and what carries what there."""
    ends = dict(zip(rollout.ids.tolist(), rollout.T_world_object[-1], strict=True))
    scene = scene.with_objects(*(replace(o, T_world_object=ends[o.id]) for o in scene))
    loads, below = _loads(scene, phase), dict[int, int | None]((o.id, None) for o in scene)
    for _, upper, lower in sorted(((f, a, b) for (a, b), f in loads.items()), reverse=True):
        if below[upper] is None and upper not in support_forest.chain_below(lower, below):
            below[upper] = lower
    return scene.with_objects(*(_supported(o, below[o.id], loads) for o in scene if o.mobility == "dynamic"))


def _supported(o: SceneObject, main: int | None, loads: Mapping[tuple[int, int], float]) -> SceneObject:
    carried = {lower: f for (upper, lower), f in loads.items() if upper == o.id}
    whole = sum(carried.values())
    supports = [Support(id=id, share=f / whole) for id, f in carried.items() if f >= LEAST_SHARE * whole]
    return replace(o, supported_by=main, supports=tuple(sorted(supports, key=lambda s: (-s.share, s.id))))


def _loads(scene: Scene, phase: Phase) -> dict[tuple[int, int], float]:
    """Vertical force [N] on the first of two objects from the second one, or the ground, where it lifts."""
    mujoco, ids = engine(), [GROUND, *(o.id for o in scene)]
    model = model_of(scene, phase.semantics, phase.simulation)
    data = start_state(model, ids[1:], ())
    force, net = np.zeros(6), dict[tuple[int, int], float]()
    for k in range(data.ncon):
        contact: Any = data.contact[k]
        mujoco.mj_contactForce(model, data, k, force)
        a, b = (ids[int(model.geom_bodyid[geom])] for geom in contact.geom)
        up = float(np.asarray(contact.frame).reshape(3, 3)[:, 2] @ force[:3])  # on b
        net[b, a] = net.get((b, a), 0.0) + up
        net[a, b] = net.get((a, b), 0.0) - up
    return {pair: up for pair, up in net.items() if up > 0 and pair[0] != GROUND}
