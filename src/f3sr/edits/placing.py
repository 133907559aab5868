"""Where an edit puts an object and what rides on it, before contact and physics."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact.compounds import Compound, free_travel, placed, smallest_shift
from f3sr.core.transforms import UP, Array, pose, rotation_about, turn_about
from f3sr.edits.edit_list import MoveEdit, ScaleEdit, SupportEdit, TurnEdit
from f3sr.options import EDIT
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import GROUND, Scene, SceneObject, Support, name_of

NEAREST, FARTHEST = 0.25, 4.0
"""Shares of its distance to which an object is moved along its viewing ray onto a support: a photo tells distances
better than that."""
PLACES = 97
"""Places on the ray that are tried, evenly by the logarithm of the distance, and again around the best."""

PoseEdit = MoveEdit | TurnEdit | ScaleEdit | SupportEdit


@dataclass(frozen=True, eq=False, kw_only=True)
class Put:
    """A scene with objects where an edit puts them."""

    scene: Scene
    placed: frozenset[int]
    """Ids of the objects with new poses, and of those that lost what carried them: they come to rest anew."""
    roots: tuple[int, ...]
    """Those of them that look for what is below them; the others ride on these."""
    touched: frozenset[int] = frozenset()
    """Ids of objects that stay, and that physics must look at all the same."""
    on: int | None = None
    """The support that the edit asks for."""
    note: str = ""
    """What was done otherwise than asked."""


def put(scene: Scene, edit: PoseEdit, number: int) -> Put:
    """The scene with an object where an edit wants it, and what rides on it moved along."""
    o, riders = scene[edit.id], _riders(scene, edit.id)
    if isinstance(edit, ScaleEdit):
        return _scaled(scene, o, riders, edit.factor, number)
    T, k, note = _similarity(scene, o, edit)
    left = frozenset(riders) if _tilt(T) > math.atan(o.friction) else frozenset[int]()  # steeper than friction holds
    riders = tuple(id for id in riders if id not in left)
    given = f"given by edit {number}"
    moved = [o.moved(T, scale=k, stage=EDIT, reason=given)]
    moved += [scene[id].moved(T, scale=k, stage=EDIT, reason=f"with {name_of(o.id)}, {given}") for id in riders]
    return Put(
        scene=scene.with_objects(*moved),
        placed=frozenset({o.id, *riders}) | left,
        roots=(o.id, *_highest_carriers(scene, left)),
        on=edit.on if isinstance(edit, SupportEdit) else None,
        note=note,
    )


def _similarity(scene: Scene, o: SceneObject, edit: MoveEdit | TurnEdit | SupportEdit) -> tuple[Array, float, str]:
    """The motion x -> T (k x) of an edit, and what was done otherwise than asked."""
    if isinstance(edit, MoveEdit):
        return pose(t=edit.by), 1.0, ""
    if isinstance(edit, TurnEdit):
        return turn_about(o.middle, _rotation(edit)), 1.0, ""
    return _onto(scene, o, edit.on)


def without(scene: Scene, id: int) -> Put:
    """The scene without an object: what it carried alone has nothing below it, and is to be lowered."""
    gone = scene[id]
    fallen = frozenset(_riders(scene, id))
    left = tuple(_less(o, id) for o in scene if o.id != id)
    relations = tuple(r for r in scene.graph.relations if id not in (r.subject, r.object))
    nodes = tuple(n for n in scene.graph.nodes if n.id != id)
    smaller = replace(scene, objects=left, graph=replace(scene.graph, relations=relations, nodes=nodes))
    shared = frozenset(o.id for o in scene if id in o.carriers or o.id in gone.carriers) - {id}
    return Put(scene=smaller, placed=fallen, roots=_highest_carriers(smaller, fallen), touched=shared)


def _less(o: SceneObject, id: int) -> SceneObject:
    """An object that does not rest on ``id`` any more."""
    if id not in o.carriers:
        return o
    kept = tuple(s for s in o.supports if s.id != id)
    total = sum(s.share for s in kept)
    supports = tuple(replace(s, share=s.share / total) for s in kept) if total else ()
    if not supports and o.mobility == "dynamic":
        supports = (Support(id=GROUND),)
    return replace(o, supports=supports, supported_by=supports[0].id if supports else None)


def _riders(scene: Scene, id: int) -> tuple[int, ...]:
    """Ids of all that rests on an object alone, but for what is fixed, supports first."""
    found = {id}
    for k in scene.supports_first:
        if k != id and scene[k].mobility == "dynamic" and scene[k].carriers and found.issuperset(scene[k].carriers):
            found.add(k)
    return tuple(k for k in scene.supports_first if k in found and k != id)


def _highest_carriers(scene: Scene, ids: Collection[int]) -> tuple[int, ...]:
    """Those of some objects that rest on none of them, supports first."""
    return tuple(k for k in scene.supports_first if k in ids and not set(scene[k].carriers) & set(ids))


def _rotation(edit: TurnEdit) -> Array:
    """(3, 3); whole turns are none, to the bit."""
    degrees = math.fmod(edit.degrees, 360)
    return rotation_about(edit.axis, math.radians(degrees)) if degrees else np.eye(3)


def _tilt(T: Array) -> float:
    """The angle [rad] by which a motion tilts the vertical."""
    return float(np.arccos(np.clip(T[2, 2], -1, 1)))


def _scaled(scene: Scene, o: SceneObject, riders: tuple[int, ...], k: float, number: int) -> Put:
    """The object scaled about its place on its support; what rides on it keeps its size and its place on it."""
    foot = _foot(o)
    moved = {o.id: o.moved(pose(t=(1 - k) * foot), scale=k, stage=EDIT, reason=f"given by edit {number}")}
    shifts = {o.id: np.zeros(3)}
    for id in riders:
        below = scene[id].supported_by
        shifts[id] = (k - 1) * (_foot(scene[id]) - foot) if below == o.id or below not in shifts else shifts[below]
        reason = f"with {name_of(o.id)}, scaled by edit {number}"
        moved[id] = scene[id].moved(pose(t=shifts[id]), stage=EDIT, reason=reason)
    return Put(scene=scene.with_objects(*moved.values()), placed=frozenset(moved), roots=(o.id,))


def _foot(o: SceneObject) -> Array:
    """The middle of an object's box, at the height of its lowest point (3,) [m]."""
    low, high = o.bounds_world
    return np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])


# --- onto a support -----------------------------------------------------------------------------------------------


def _onto(scene: Scene, o: SceneObject, on: int) -> tuple[Array, float, str]:
    """The similarity x -> T (k x) that puts an object onto a support, and what was done but along its ray."""
    camera, body = scene.camera, body_in_place(o)
    C = camera.center
    if on == GROUND:
        depth = float(C[2]) - body.lowest
        k = float(C[2]) / depth if depth > 0 else 0.0
        if NEAREST <= k <= FARTHEST:
            return camera.homothety(k), k, ""
        return pose(t=-body.lowest * UP), 1.0, "its viewing ray does not meet the ground; lowered from where it was"
    carrier, middle = body_in_place(scene[on]), o.middle
    tried = np.geomspace(NEAREST, FARTHEST, PLACES)
    best: tuple[float, float, float] | None = None
    for _ in range(2):
        found = [(abs(h), float(k), h) for k in tried if (h := _height(body, carrier, C, middle, float(k))) is not None]
        best = min(found, default=best)
        if best is None:
            break
        step = tried[1] / tried[0]
        tried = np.geomspace(best[1] / step, best[1] * step, PLACES)
    if best is not None:
        _, k, height = best
        return pose(t=-height * UP) @ camera.homothety(k), k, ""
    aside = np.append((scene[on].middle - middle)[:2], 0.0)
    height = _above(body.moved(pose(t=aside)), carrier)
    down = height if math.isfinite(height) else 0.0
    return pose(t=aside - down * UP), 1.0, f"its viewing ray passes {name_of(on)}; put over the middle of it"


def _height(body: Compound, carrier: Compound, C: Array, middle: Array, k: float) -> float | None:
    """Height [m] of a body above a carrier at a share k of its distance; negative: how far it must rise. None where
    its middle (3,) is not over the carrier."""
    if not _is_over(C + k * (middle - C), carrier):
        return None
    height = _above(body.moved(pose(k * np.eye(3), (1 - k) * C)), carrier)
    return height if math.isfinite(height) else None


def _above(body: Compound, carrier: Compound) -> float:
    """Height [m] of a body above a carrier; negative: how far it must rise to be free of it; inf: it is beside it."""
    rise = smallest_shift(body, carrier, UP, DEFAULT_MARGIN.clearance)
    return -rise if rise > 0 else free_travel(body, carrier, -UP)


def _is_over(point: Array, carrier: Compound) -> bool:
    """Whether the vertical through a point (3,) meets a body."""
    for part in carrier:
        # n . x <= d for all faces: on the vertical an interval of heights, where no vertical face leaves the point out.
        rest, slope = part.offsets - part.normals[:, :2] @ point[:2], part.normals[:, 2]
        flat = np.abs(slope) < 1e-12
        if (rest[flat] < 0).any():
            continue
        ends = rest[~flat] / slope[~flat]
        top, bottom = ends[slope[~flat] > 0], ends[slope[~flat] < 0]
        if len(top) and len(bottom) and top.min() >= bottom.max():
            return True
    return False


def body_in_place(o: SceneObject) -> Compound:
    """What physics sees of an object, in the world [m]."""
    return placed(o.solids, o.T_world_asset)


def bodies_in_place(objects: Iterable[SceneObject]) -> dict[int, Compound]:
    return {o.id: body_in_place(o) for o in objects}
