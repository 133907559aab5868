"""Unrelated objects that overlap, parted by one joint horizontal move."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from f3sr import contact, parting
from f3sr.frames import Array
from f3sr.scene import GROUND, Scene
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.layout import Layout, supports_of

UNFELT = 0.1
"""IoU that a move by its own size costs an object in directions which the picture does not feel."""


def part(layout: Layout, config: SeparateConfig) -> bool:
    """Part all unrelated pairs that overlap by one joint horizontal move, the one that the picture feels least; what an
    object carries goes with it. Returns whether anything moved."""
    moved = False
    for _ in range(config.rounds):
        pairs = [(a, b) for a, b in _unrelated(layout.scene) if contact.collide(layout.bodies[a], layout.bodies[b])]
        if not pairs:
            break
        found = parting.part(
            layout.bodies,
            pairs,
            {o.id: weight_of(layout, *layout.scene.subtree(o.id)) for o in layout.scene if o.mobility == "dynamic"},
            carriers={o.id: None if o.supported_by == GROUND else o.supported_by for o in layout.scene},
            clearance=config.clearance,
        )
        for id, shift in found.own.items():
            layout.move(layout.scene.subtree(id), np.append(shift, 0.0))
            moved = moved or bool(shift.any())
        if len(found.unsolved) == len(pairs):
            break
    return moved


def weight_of(layout: Layout, *ids: int) -> Array:
    """What moving bodies together costs (2, 2): the IoU that they lose, and a little per length of the first one's
    size."""
    felt = sum((layout.loss(k)[:2, :2] for k in ids), np.zeros((2, 2)))
    return felt + np.eye(2) * (UNFELT / layout.scene[ids[0]].size) ** 2


def _unrelated(scene: Scene) -> Iterator[tuple[int, int]]:
    """Pairs that neither carry nor contain one another."""
    inside = scene.graph.of("inside") | {(b, a) for a, b in scene.graph.of("contains")}
    for a, b in combinations([o.id for o in scene], 2):
        carried = a in _carriers(scene, b) or b in _carriers(scene, a)
        related = carried or (a, b) in inside or (b, a) in inside
        if not related:
            yield a, b


def _carriers(scene: Scene, id: int) -> set[int]:
    """All that carries an object, directly or not."""
    return {*scene.ancestors(id), *supports_of(scene[id])}
