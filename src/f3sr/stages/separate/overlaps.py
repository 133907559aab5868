"""Overlap between objects, ended by one joint move: horizontal where none carries the other, or in space."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from f3sr.contact import crowds, joint_separation
from f3sr.contact.compounds import Compound, collide, smallest_shift
from f3sr.core.transforms import UP, Array
from f3sr.report import Decision
from f3sr.scene import GROUND, Scene, name_of
from f3sr.stages.separate.config import PICTURE_SIGMA, SeparateConfig
from f3sr.stages.separate.placement import Placement

ROUNDS = 16
"""Most rounds of horizontal parting; the report allows 32."""
LIFTS = 100
"""Most lifts of a scene: each frees a body, and another may then be in its way."""
UNFELT = 0.1
"""IoU that a move by its own size costs an object, in directions that change no silhouette and no depth."""

HELD_DOWN = 10.0
"""By how many times more IoU a lift costs what stands on the ground than the picture says: the photo shows it there."""


def take_beside(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Remove secondary supports that an object overlaps by error.

    Lifting the object out would cost more IoU than the picture allows, and moving both apart costs less.
    """
    decisions: list[Decision] = []
    for o in layout.scene:
        for other in set(o.carriers) - {o.supported_by, GROUND}:
            lifted, apart = _losses(layout, o.id, other, config)
            if lifted <= PICTURE_SIGMA or lifted <= apart:
                continue
            now = layout.scene[o.id]
            left = tuple(s for s in now.supports if s.id != other)
            total = sum(s.share for s in left)
            supports = tuple(replace(s, share=s.share / total) for s in left)
            layout.scene = layout.scene.with_objects(replace(now, supports=supports))
            reason = f"lifting it out would lose {lifted:.2f} of IoU with the masks, moving both apart {apart:.2f}"
            decisions.append(Decision(choice=f"beside {name_of(other)}, not on it", reason=reason, about=o.id))
    return decisions


def _losses(layout: Placement, id: int, other: int, config: SeparateConfig) -> tuple[float, float]:
    """IoU lost by lifting an object out of another one, and by moving both apart; at most 1 each."""
    bodies = {k: layout.bodies[k] for k in (id, other)}
    rise = smallest_shift(bodies[id], bodies[other], UP, config.clearance)
    lifted = min(1.0, rise * float(np.sqrt(layout.loss(id)[2, 2])))
    weights = {k: weight_of(layout, k) for k in bodies if layout.scene[k].mobility == "dynamic"}
    found = joint_separation.part(bodies, [(id, other)], weights, clearance=config.clearance)
    return lifted, 1.0 if found.unsolved else min(1.0, float(np.sqrt(found.cost)))


def part(layout: Placement, config: SeparateConfig) -> bool:
    """End the overlap of all unrelated pairs by one joint horizontal move of least cost.

    Returns whether anything moved. The cost is IoU and error of depth (``weight_of``). Carried objects move with their
    carrier. A move may cause new overlap, so it is repeated; pairs that overlapped once stay constrained in all rounds.
    """
    moved, known = False, set[tuple[int, int]]()
    for _ in range(ROUNDS):
        pairs = {(a, b) for a, b in _unrelated(layout.scene) if collide(layout.bodies[a], layout.bodies[b])}
        if not pairs:
            break
        known |= pairs
        found = joint_separation.part(
            layout.bodies,
            sorted(known),
            {o.id: weight_of(layout, *layout.scene.subtree(o.id)) for o in layout.scene if o.mobility == "dynamic"},
            carriers={o.id: None if o.supported_by == GROUND else o.supported_by for o in layout.scene},
            clearance=config.clearance,
        )
        for id, shift in found.own.items():
            layout.move(layout.scene.subtree(id), np.append(shift, 0.0))
            moved = moved or bool(shift.any())
        if pairs <= set(found.unsolved):
            break
    return moved


def part_in_space(layout: Placement, config: SeparateConfig) -> bool:
    """End all overlap, also with what carries a body, by one joint move in space of little cost.

    Returns whether anything moved. Bodies move one by one, without what they carry."""
    if not layout.collisions():
        return False
    weights = {o.id: weight_in_space(layout, o.id) for o in layout.scene if o.mobility == "dynamic"}
    found = crowds.spread(layout.bodies, weights, clearance=config.clearance)
    for id, shift in found.shifts.items():
        layout.shift_in_view(id, shift)
    return found.cost > 0


def lift_out(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Lift what still overlaps another body or the ground until it is free, with all that it carries.

    Of two bodies the higher one is lifted. This is the last resort, as what is lifted leaves its mask."""
    lifted = defaultdict[int, float](float)
    for _ in range(LIFTS):
        able = (_higher(layout, a, b) for a, b in layout.collisions())
        id = next((id for id in able if id is not None), None)
        if id is None:
            break
        members = layout.scene.subtree(id)
        others = Compound.of(body for k, body in layout.bodies.items() if k not in members)
        rises = [smallest_shift(layout.bodies[k], others, UP, config.clearance) for k in members]
        rise = max(*rises, config.clearance - min(map(layout.lowest, members)))
        layout.move(members, rise * UP)
        lifted[id] += 1000 * rise
    reason = "it overlapped, and there is no free place nearer"
    return [
        Decision(choice=f"lifted by {rise:.0f} mm", reason=reason, about=id, fallback=True)
        for id, rise in lifted.items()
    ]


def _higher(layout: Placement, a: int, b: int) -> int | None:
    """The higher one of two bodies that may be lifted off the other, with all that it carries; None where none may."""
    for id, other in sorted(((a, b), (b, a)), key=lambda pair: -_middle(layout, pair[0])):
        members = layout.scene.subtree(id) if id != GROUND else ()
        if members and other not in members and all(layout.scene[k].mobility != "fixed" for k in members):
            return id
    return None


def _middle(layout: Placement, id: int) -> float:
    return -np.inf if id == GROUND else float(layout.bodies[id].bounds[:, 2].mean())


def weight_in_space(layout: Placement, id: int) -> Array:
    """Metric (3, 3) [1/m2] of a move of a body in space: what stands on the ground is held down."""
    held = HELD_DOWN**2 * layout.picture(id)[2, 2] if layout.scene[id].supported_by == GROUND else 0.0
    return _metric(layout, id) + held * np.outer(UP, UP)


def weight_of(layout: Placement, *ids: int) -> Array:
    """Metric (2, 2) [1/m2] of a horizontal move of bodies together."""
    return _metric(layout, *ids)[:2, :2]


def _metric(layout: Placement, *ids: int) -> Array:
    """Metric (3, 3) [1/m2] of a move of bodies together, as squared IoU: IoU that they lose, error of depth in that
    unit, and a small regulariser by size."""
    felt = sum((layout.picture(k) + layout.depth_loss(k) for k in ids), np.zeros((3, 3)))
    return felt + np.eye(3) * (UNFELT / layout.scene[ids[0]].size) ** 2


def _unrelated(scene: Scene) -> Iterator[tuple[int, int]]:
    """Pairs of ids of which neither carries the other."""
    for a, b in combinations([o.id for o in scene], 2):
        if a not in _carriers(scene, b) and b not in _carriers(scene, a):
            yield a, b


def _carriers(scene: Scene, id: int) -> set[int]:
    """Ids of everything that carries an object, directly or not."""
    return {*scene.ancestors(id), *scene[id].carriers}
