"""balance: objects where contact forces carry them, as near to where the photo shows them as can be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from f3sr.contact.equilibrium import BodyMove, nearest_equilibrium
from f3sr.contact.static_bodies import bodies_of
from f3sr.core.transforms import Array, pose
from f3sr.metrics.contact_groups import groups_of
from f3sr.physics.contact_margin import ContactMargin
from f3sr.scene import Scene, SceneObject

MOST_OBJECTS = 32
"""Most objects of a contact group that is moved into balance; the time grows with the square of their number."""


def balance(
    scene: Scene,
    costs: Mapping[int, Array],
    contact: ContactMargin,
    *,
    apart: bool = False,
    start: Scene | None = None,
) -> Scene:
    """The scene with each contact group moved to an equilibrium near it (``contact.equilibrium``).

    Supports are not asked: what carries an object follows from the forces. ``costs`` are the (7, 7) precisions of
    ``nearest_equilibrium`` for what may move, by id; the others stay. Poses are in the world [m]; physics is not run.
    ``apart`` begins the search where nothing overlaps, and ``start`` where objects rest in another scene.
    """
    bodies = bodies_of(scene)
    groups = [sorted(g & costs.keys()) for g in groups_of(scene, scene, contact.apart)]
    for group in groups:
        if not 1 <= len(group) <= MOST_OBJECTS:
            continue
        found = nearest_equilibrium(
            bodies,
            {id: costs[id] for id in group},
            clearance=contact.clearance,
            ground_friction=scene.ground.friction,
            apart=apart,
            start={id: _move(scene[id], start[id]) for id in group} if start else None,
        )
        told = f"into balance with {len(group) - 1} others, at {np.sqrt(found.cost):.1f} standard deviations in all"
        moved = [scene[id].moved(m.T, scale=m.scale, stage="refine", reason=told) for id, m in found.moves.items()]
        scene = scene.with_objects(*moved)
    return scene


def _move(before: SceneObject, after: SceneObject) -> BodyMove:
    scale = after.scale / before.scale
    R = after.T_world_object[:3, :3] @ before.T_world_object[:3, :3].T
    return BodyMove(T=pose(R, after.T_world_object[:3, 3] - scale * R @ before.T_world_object[:3, 3]), scale=scale)
