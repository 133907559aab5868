"""Seeded stacks of simple bodies: dropped straight onto what lies below, so that some stand and some do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from f3sr.contact import compounds
from f3sr.contact.contact_patches import Contacts, find_contacts
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart, Mesh, union
from f3sr.core.transforms import UP, Array, pose, rotation_about
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import GROUND, SceneObject

CLEARANCE = DEFAULT_MARGIN.clearance
"""Left between bodies [m], as the product does."""
KINDS = ("box", "slab", "plate", "can", "angle", "table")


def shape(kind: str) -> tuple[ConvexPart, ...]:
    """The convex parts [m] of a kind of body."""
    boxes: dict[str, Sequence[tuple[Sequence[float], Sequence[float]]]] = {
        "box": [((0.10, 0.08, 0.06), (0, 0, 0))],
        "slab": [((0.16, 0.14, 0.08), (0, 0, 0))],
        "plate": [((0.24, 0.20, 0.006), (0, 0, 0))],
        "angle": [((0.14, 0.08, 0.03), (0, 0, 0.015)), ((0.03, 0.08, 0.10), (-0.055, 0, 0.05))],
        "table": [
            ((0.18, 0.14, 0.02), (0, 0, 0.07)),
            *(((0.02, 0.02, 0.06), (x, y, 0.03)) for x in (-0.07, 0.07) for y in (-0.05, 0.05)),
        ],
    }
    if kind == "can":
        angles = 2 * np.pi * np.arange(24) / 24
        ring = 0.035 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return (ConvexPart.hull_of(np.concatenate([np.c_[ring, np.full(24, z)] for z in (-0.05, 0.05)])),)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    return tuple(ConvexPart.hull_of(signs * np.array(size) + center) for size, center in boxes[kind])


def thing(id: int, kind: str, T: Array, supported_by: int = GROUND) -> SceneObject:
    """A body of a kind as an object of a scene, its frame at its centre of mass."""
    parts = shape(kind)
    vertices, faces = union(parts)
    mesh = Mesh(vertices=vertices, faces=faces)
    return SceneObject(
        id=id,
        label=kind,
        mask_name=f"{id:02d}_{kind}.png",
        mask=np.ones((1, 1), bool),
        mesh=mesh,
        T_world_object=T,
        parts=parts,
        supported_by=supported_by,
    )


def world_parts(o: SceneObject) -> tuple[Polytope, ...]:
    return tuple(Polytope.of(p) for p in o.colliders_world)


def stack(
    seed: int, *, count: tuple[int, int] = (3, 5), spread: float = 0.04, tilt: float = 0.0
) -> tuple[SceneObject, ...]:
    """Bodies with middles up to ``spread`` off the axis, turned at random, each lifted out of those below.

    ``tilt``: largest angle [rad] between their axes and the vertical.
    """
    rng = np.random.default_rng(seed)
    objects: list[SceneObject] = []
    below: list[Polytope] = []
    for id in range(int(rng.integers(count[0], count[1] + 1))):
        kind = str(rng.choice(KINDS))
        shift = np.zeros(2) if id == 0 else rng.uniform(-spread, spread, 2)
        T = pose(rotation_about(UP, float(rng.uniform(0, 2 * np.pi))), np.r_[shift, 0])
        if tilt:
            axis = np.r_[rng.normal(size=2), 0.0]
            T = T @ pose(rotation_about(axis, float(rng.uniform(0, tilt))))
        o = thing(id, kind, T)
        parts = world_parts(o)
        low = min(p.bounds[0, 2] for p in parts)
        lift = CLEARANCE - low
        raised = [p.shifted(lift * UP) for p in parts]
        lift += compounds.smallest_shift(raised, below, UP, CLEARANCE) if below else 0.0
        objects.append(replace(o, T_world_object=pose(t=lift * UP) @ T))
        below += world_parts(objects[-1])
    touching = find_contacts({o.id: world_parts(o) for o in objects})
    return tuple(replace(o, supported_by=_under(o.id, touching)) for o in objects)


def _under(id: int, contacts: Contacts) -> int:
    """What a body rests on: what it touches below itself, the ground last."""
    return max((lower for upper, lower in contacts.pairs if upper == id), default=GROUND)
