"""balance: objects where contact forces carry them, as near to where the photo shows them as can be."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from f3sr.contact.compounds import placed
from f3sr.contact.equilibrium import BodyMove, FootedBody, nearest_equilibrium
from f3sr.contact.static_bodies import bodies_of
from f3sr.core.transforms import Array
from f3sr.metrics.contact_groups import groups_of
from f3sr.physics.contact_margin import ContactMargin
from f3sr.scene import Scene, SceneObject

MOST_OBJECTS = 32
"""Most objects of a contact group that is moved into balance; the time grows with the square of their number."""


class Footed(Protocol):
    """Gives footings to some objects where they stand; the objects may still be ``overlapping``."""

    def __call__(self, scene: Scene, ids: Collection[int], /, *, overlapping: bool) -> Scene: ...


def balance(
    scene: Scene,
    costs: Mapping[int, Array],
    contact: ContactMargin,
    *,
    footed: Footed,
    apart: bool = False,
    start: Scene | None = None,
    guessed: Collection[int] = (),
    may_hold: Collection[int] = (),
    most: int = 0,
    descends: bool = False,
) -> Scene:
    """The scene with each contact group moved to an equilibrium near it (``contact.equilibrium``).

    Supports are not asked: what carries an object follows from the forces. ``costs`` are the (7, 7) precisions of
    ``nearest_equilibrium`` for what may move, by id; the others stay. Poses are in the world [m]; physics is not run.
    ``footed`` gives the footings on which objects end. ``apart`` begins the search where nothing overlaps, and
    ``start`` where objects rest in another scene. Where it comes to no end it ``descends`` by more steps, which count
    the arms of forces too. Objects whose friction is ``guessed``, by id, get more where their group would slide from
    there.

    A group without an equilibrium near it gets one with objects fixed as if something unseen carried them, of those
    that it ``may_hold``, by id: one by one that without which least is left unbalanced. Where that would be more than
    ``most`` in all, the scene is returned as it is.
    """
    came = free = scene
    for group in _groups(scene, costs, contact):
        seek = partial(
            nearest_equilibrium,
            precisions={id: costs[id] for id in group},
            clearance=contact.clearance,
            ground_friction=scene.ground.friction,
            apart=apart,
            start={id: _move(scene[id], start[id]) for id in group} if start else None,
            guessed=[id for id in group if id in guessed],
            may_hold=[id for id in group if id in may_hold],
            descends=descends,
        )
        while (found := seek(bodies_of(free), footings=partial(_footings, scene, footed))).unheld is not None:
            if not most:
                return came
            most -= 1
            free, scene = (s.with_objects(s[found.unheld].on_something_unseen()) for s in (free, scene))
        told = f"into balance with {len(group) - 1} others, at {np.sqrt(found.cost):.1f} standard deviations in all"
        there = footed(_moved(scene, found.footed_at, told), group, overlapping=False)
        moved = _moved(scene, found.moves, told)
        footed_objects = (replace(moved[k], parts=there[k].parts, footing=there[k].footing) for k in group)
        scene = moved.with_objects(*(_rougher(o, found.friction.get(o.id)) for o in footed_objects))
    return scene


def _groups(scene: Scene, costs: Mapping[int, Array], contact: ContactMargin) -> list[list[int]]:
    """Ids of what may move in each contact group that is not too large."""
    groups = (sorted(g & costs.keys()) for g in groups_of(scene, scene, contact.apart))
    return [g for g in groups if 1 <= len(g) <= MOST_OBJECTS]


def _footings(scene: Scene, footed: Footed, moves: Mapping[int, BodyMove], overlapping: bool) -> dict[int, FootedBody]:
    """The bodies of objects after some moves, with the footings that they have there."""
    there = footed(_moved(scene, moves, ""), sorted(moves), overlapping=overlapping)
    bodies = bodies_of(replace(there[id], footing=()) for id in moves)
    footings = {id: placed(o.footing, o.T_world_asset) for id in moves if (o := there[id]).footing}
    return {b.id: FootedBody(body=b, footing=footings.get(b.id)) for b in bodies}


def _moved(scene: Scene, moves: Mapping[int, BodyMove], reason: str) -> Scene:
    moved = (scene[id].moved(m.T, scale=m.scale, stage="refine", reason=reason) for id, m in moves.items())
    return scene.with_objects(*moved)


def _rougher(o: SceneObject, friction: float | None) -> SceneObject:
    if friction is None:
        return o
    reason = f"friction {friction:g}, not {o.friction:g}, as it would slide from where the photo shows it"
    return replace(o, friction=friction, material_reason="; ".join(filter(None, (o.material_reason, reason))))


def _move(before: SceneObject, after: SceneObject) -> BodyMove:
    T, scale = before.motion_to(after)
    return BodyMove(T=T, scale=scale)
