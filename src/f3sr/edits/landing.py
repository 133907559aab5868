"""How objects come to rest where an edit put them: on what is below, apart from what they overlap, settled, closed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, fields, replace

import numpy as np

from f3sr.contact.compounds import collide, free_travel, smallest_horizontal_move, smallest_shift
from f3sr.core.transforms import UP
from f3sr.edits.placing import Put, bodies_in_place
from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.scene import GROUND, Scene, SceneObject, Support
from f3sr.stages.close import close
from f3sr.stages.separate import separate
from f3sr.stages.settle import settle

MEETINGS = 2
"""Most times that what is met on the way joins what settles."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What is done so that a scene rests: another one is tried where that fails."""

    closes: bool = True
    """Gaps below what moved are closed."""
    again: int = 0
    """Times that everything settles once more in the end: what creeps or rolls slowly needs longer."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Landed:
    """A scene in which what an edit put somewhere has come to rest."""

    scene: Scene
    restless: frozenset[int]
    """Ids of objects that do not rest."""
    moving: frozenset[int]
    """Ids of all that may have moved; the others are the very same values."""


def editing(config: Config) -> Config:
    """Settings with which edits come to rest: no object changes its size or its distance to reach its support."""
    shared = with_shared_settings(config)
    return replace(shared, separate=replace(shared.separate, max_ray_scale=0.0))


def land(before: Scene, put: Put, config: Config, effort: Effort) -> Landed:
    """Bring what was put somewhere to rest: only it is parted from the others, then it settles with all it touches.

    ``before`` is the scene at rest before the edit, with the same ids. ``config`` is that of ``editing``."""
    parted, involved = _parted(put, config)
    moving = touching(involved | put.touched, config, before, parted)
    state = settled(parted, moving, config)
    for _ in range(MEETINGS):
        met = touching(moving, config, state.scene, state.scene)
        if met == moving:
            break
        moving = met
        state = settled(state.scene, moving, config)
    if effort.closes:
        state = _closed(state, moving, config)
    for _ in range(effort.again):
        state = settled(state.scene, moving, config)
    unknown = touching(moving, config, state.scene, state.scene) - moving
    return Landed(scene=state.scene, restless=state.restless | unknown, moving=moving)


def touching(ids: Collection[int], config: Config, before: Scene, after: Scene) -> frozenset[int]:
    """Some ids, and those of all that touches them in one of two scenes, and that touches that, and so on."""
    groups = groups_of(before, after, config.settle.physics.contact.apart)
    return frozenset(id for g in groups if g.intersection(ids) for id in g)


def _parted(put: Put, config: Config) -> tuple[Scene, frozenset[int]]:
    """The scene with what was put somewhere on what is below it, apart from all others; and ids of what was moved.

    What is fixed stays where it was put, and what it overlaps gives way."""
    free = frozenset(id for id in put.placed if put.scene[id].mobility == "dynamic")
    scene, held = put.scene, put.placed - free
    for id in put.roots:
        if id in free:
            asked = put.on if id == put.roots[0] else None
            scene = scene.with_objects(_carried(scene, id) if asked is None else _on(scene[id], asked))
    scene = scene.with_objects(*(_standing(scene, id, config) for id in sorted(held)))
    free |= _overlapped(scene, held)
    if not free:
        return scene, held
    parted, _ = separate(_holding(scene, free), config.separate, ground=False, margin=False)
    return _released(parted, scene), free | held


def settled(scene: Scene, moving: Collection[int], config: Config) -> SettledScene:
    """The scene after some objects have settled; the others are held, and stay the same values."""
    rested, told = settle(_holding(scene, moving), config.settle)
    return SettledScene(scene=scene.with_objects(*_those(rested, scene, moving)), restless=told.restless & set(moving))


def _closed(state: SettledScene, moving: Collection[int], config: Config) -> SettledScene:
    """The same with gaps below what moved closed."""
    restless = state.restless

    def at_rest(part: Scene) -> SettledScene:
        rested, told = settle(part, config.settle)
        return SettledScene(scene=rested, restless=told.restless)

    closed, _ = close(_holding(state.scene, moving), config.close, settled=at_rest, restless=restless)
    return SettledScene(scene=state.scene.with_objects(*_those(closed, state.scene, moving)), restless=restless)


def _holding(scene: Scene, free: Collection[int]) -> Scene:
    """The scene with all objects fixed but some."""
    return scene.with_objects(
        *(replace(o, mobility="fixed") for o in scene if o.id not in free and o.mobility == "dynamic")
    )


def _released(held: Scene, scene: Scene) -> Scene:
    """``held`` with every object as free as it is in ``scene``, and what was held the same value."""
    return scene.with_objects(*_those(held, scene, [o.id for o in scene if held[o.id].mobility == "dynamic"]))


def _those(now: Scene, scene: Scene, ids: Collection[int]) -> list[SceneObject]:
    """Some objects as they are now, as free as in ``scene``; the very values of there where nothing has changed."""
    changed = (replace(now[id], mobility=scene[id].mobility) for id in sorted(ids))
    return [scene[o.id] if _is_same(o, scene[o.id]) else o for o in changed]


def _is_same(a: SceneObject, b: SceneObject) -> bool:
    names = [f.name for f in fields(a) if f.name != "supports"]
    return a.supports == b.supports and all(getattr(a, name) is getattr(b, name) for name in names)


def _overlapped(scene: Scene, ids: Collection[int]) -> frozenset[int]:
    """Ids of what can move and overlaps some objects that cannot."""
    bodies = bodies_in_place(scene) if ids else {}
    return frozenset(
        o.id
        for o in scene
        if o.mobility == "dynamic" and any(o.id != id and collide(bodies[id], bodies[o.id]) for id in ids)
    )


def _carried(scene: Scene, id: int) -> SceneObject:
    """An object with what is below it as its support: what it is lifted out of, else what it meets first when lowered.

    It is lifted out of what it overlaps where that is the shorter way out; else it lies beside it."""
    bodies = bodies_in_place(scene)
    body = bodies[id]
    above = {k: b for k, b in bodies.items() if k != id and k not in _resting_on(scene, id)}
    rises = dict[int, float]()
    for k, other in above.items():
        if collide(body, other):
            rise = smallest_shift(body, other, UP)
            if rise <= float(np.linalg.norm(smallest_horizontal_move(body, other))):
                rises[k] = rise
    if rises:
        return _on(scene[id], max(rises, key=lambda k: (rises[k], -k)))
    drops = {k: free_travel(body, other, -UP) for k, other in above.items() if not collide(body, other)}
    drops[GROUND] = max(0.0, body.lowest)
    return _on(scene[id], min(drops, key=lambda k: (drops[k], k)))


def _standing(scene: Scene, id: int, config: Config) -> SceneObject:
    """A fixed object with what it touches below as its support; None where it hangs."""
    bodies = bodies_in_place(scene)
    reach = config.settle.physics.contact.reach
    drops = {k: free_travel(bodies[id], b, -UP) for k, b in bodies.items() if k not in _resting_on(scene, id)}
    drops[GROUND] = bodies[id].lowest
    below = min(drops, key=lambda k: (drops[k], k))
    if drops[below] <= reach:
        return _on(scene[id], below)
    return replace(scene[id], supported_by=None, supports=())


def _resting_on(scene: Scene, id: int) -> set[int]:
    return {id, *scene.subtree(id)}


def _on(o: SceneObject, id: int) -> SceneObject:
    return replace(o, supported_by=id, supports=(Support(id=id),))
