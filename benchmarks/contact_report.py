"""The report's own separation and settling, kept as a peer: lifts and half pushes found by bisection, strong damping.

Equations 10 and 11, at most 32 rounds sideways, then 2.4 s with friction 4 and damping 3 (linear) and 30 (angular). Its
packing fallback is left out: too little is said of it to build it. MuJoCo has one coefficient of friction, so it gets
the static one; its step of .01 s stays ours, .002 s, as stiff contacts need it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from f3sr.contact import compounds
from f3sr.contact.compounds import Compound
from f3sr.contact.polytopes import Polytope
from f3sr.core.transforms import UP, Array, pose
from f3sr.physics import mujoco_model
from f3sr.physics.mujoco_model import PhysicsConfig
from f3sr.scene import Scene, SceneObject
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.placement import Placement

GAP = 1e-3
"""Left after every move [m]: eps_g of equation 11."""
BISECTIONS = 36
ROUNDS = 32
STATIC_FRICTION = 4.0
DENSITY = 1000.0
"""[kg/m3]"""
LINEAR_DAMPING, ANGULAR_DAMPING = 3.0, 30.0
"""[1/s]"""
SECONDS = 2.4


@dataclass(eq=False)
class Layout:
    """Bodies while they are moved, and by how much each was [m]."""

    bodies: dict[int, Compound]
    shifts: dict[int, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: Scene) -> Layout:
        bodies: dict[int, Compound] = {o.id: Compound.of(Polytope.of(p) for p in o.colliders_world) for o in scene}
        return cls(bodies, {id: np.zeros(3) for id in bodies})

    def move(self, id: int, t: Array) -> None:
        self.bodies[id] = shifted(self.bodies[id], t)
        self.shifts[id] = self.shifts[id] + t


def separate(scene: Scene) -> Scene:
    """Lift what is sunk into its support, supports first, with all that rests on it; then push unrelated objects apart.

    Nothing is ever lowered, and what is pushed leaves behind what rests on it.
    """
    layout = Layout.of(scene)
    for id in sorted(layout.bodies, key=lambda id: (len(scene.ancestors(id)), id)):
        lift = lift_of(layout.bodies[id], scene[id].supported_by, layout.bodies)
        for other in scene.subtree(id) if lift else ():
            layout.move(other, lift * UP)
    pairs = list(unrelated(scene))
    for _ in range(ROUNDS):
        pushed = [pushed_apart(layout, a, b) for a, b in pairs]
        if not any(pushed):
            break
    return scene.with_objects(*(moved(scene[id], t) for id, t in layout.shifts.items() if t.any()))


def part(layout: Placement, config: SeparateConfig) -> bool:
    """The sideways pass alone, in the place of our joint one: each object takes along what it carries."""
    pairs, parted = list(unrelated(layout.scene)), False
    for _ in range(ROUNDS):
        pushed = [_pushed_with_carried(layout, a, b, config.clearance) for a, b in pairs]
        if not any(pushed):
            break
        parted = True
    return parted


def _pushed_with_carried(layout: Placement, a: int, b: int, clearance: float) -> bool:
    A, B = layout.bodies[a], layout.bodies[b]
    line = middle(A) - middle(B)
    line[2] = 0
    length = float(np.linalg.norm(line))
    direction = line / length if length > 1e-9 else np.array([1.0, 0, 0])
    push = shortest(A, B, direction)
    if push == 0:
        return False
    layout.move(layout.scene.subtree(a), (push + clearance) / 2 * direction)
    layout.move(layout.scene.subtree(b), -(push + clearance) / 2 * direction)
    return True


def lift_of(body: Compound, support: int | None, bodies: Mapping[int, Compound]) -> float:
    """Equation 11, the ground included: the least lift out of the support, and the gap; 0 where they do not collide."""
    sunk = max(0.0, -min(float(p.bounds[0, 2]) for p in body))
    free = shortest(body, bodies[support], UP) if support in bodies else 0.0
    return max(sunk, free) + GAP if max(sunk, free) > 0 else 0.0


def pushed_apart(layout: Layout, a: int, b: int) -> bool:
    """Part two objects along the line of their middles, each by half; whether they collided."""
    line = middle(layout.bodies[a]) - middle(layout.bodies[b])
    line[2] = 0
    length = float(np.linalg.norm(line))
    direction = line / length if length > 1e-9 else np.array([1.0, 0, 0])
    push = shortest(layout.bodies[a], layout.bodies[b], direction)
    if push == 0:
        return False
    layout.move(a, (push + GAP) / 2 * direction)
    layout.move(b, -(push + GAP) / 2 * direction)
    return True


def shortest(A: Compound, B: Compound, direction: Array) -> float:
    """The way along a direction after which A is free of B: doubled until it is, then bisected. It finds no first way
    out where there are several."""
    if not compounds.collide(A, B):
        return 0.0
    low, high = 0.0, GAP
    while compounds.collide(shifted(A, high * direction), B):
        low, high = high, 2 * high
    for _ in range(BISECTIONS):
        half = (low + high) / 2
        if compounds.collide(shifted(A, half * direction), B):
            low = half
        else:
            high = half
    return high


def settle(scene: Scene) -> Scene:
    """A fixed time of strongly damped physics, whatever still moves then; as it was where that blows up."""
    mujoco = mujoco_model.engine()
    config = PhysicsConfig()
    objects = [replace(o, friction=STATIC_FRICTION, density=DENSITY) for o in scene]
    model = mujoco_model.build_spec(objects, config, ground_friction=STATIC_FRICTION).compile()
    data = mujoco.MjData(model)
    rates = np.array([LINEAR_DAMPING] * 3 + [ANGULAR_DAMPING] * 3)
    damping = np.tile(1 - rates * config.timestep, model.nv // 6)
    for _ in range(round(SECONDS / config.timestep)):
        mujoco.mj_step(model, data)
        data.qvel *= damping
    if not np.isfinite(data.qpos).all():
        return scene
    return scene.with_objects(*(at_rest(o, data) for o in scene if o.mobility == "dynamic"))


def at_rest(o: SceneObject, data: mujoco_model.MjData) -> SceneObject:
    body = data.body(mujoco_model.body_name(o.id))
    return replace(o, T_world_object=pose(body.xmat.reshape(3, 3), body.xpos))


def unrelated(scene: Scene) -> Iterator[tuple[int, int]]:
    """Pairs of which neither carries the other: support pairs are excluded from the horizontal pass."""
    for a, b in combinations([o.id for o in scene], 2):
        if a not in scene.ancestors(b) and b not in scene.ancestors(a):
            yield a, b


def shifted(body: Compound, t: Array) -> Compound:
    return body.moved(pose(t=t))


def middle(body: Compound) -> Array:
    return body.bounds.mean(0)


def moved(o: SceneObject, t: Array) -> SceneObject:
    return o.moved(pose(t=t), stage="separate", reason=f"the report's recipe: {1000 * float(np.linalg.norm(t)):.1f} mm")
