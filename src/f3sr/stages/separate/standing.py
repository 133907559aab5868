"""Stable poses before physics: as they are, on a footing, or tipped until they lie."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact import tipping
from f3sr.contact.compounds import placed, smallest_shift
from f3sr.contact.footing import flush, footing, plane_below
from f3sr.contact.force_balance import Balance
from f3sr.contact.static_bodies import StaticBody, bodies_of, center_of, contacts_of, rigid
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, rotation_from_vector, transform, turn_about, vector_from_rotation
from f3sr.metrics.measures import visible_ious
from f3sr.report import Decision
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.placement import Placement, Saved
from f3sr.stages.separate.support_contact import gap, room_below

STILL = 1e-3
"""Least turn [rad] of an object that is tipped."""
WAYS_BACK = (0.0, 0.5, 1.0)
"""Shares of an object's move along viewing rays that are undone before it is tipped: the candidates."""
BESIDE = 0.1
"""Largest distance of a neighbour that an object may lean on, as a share of its size."""
CUTS = 4
"""Most times that a footing is made shorter."""
TOUCH = 5e-5
"""Depth [m] up to which a footing may be inside what carries it."""
HALVINGS = 3
"""Halvings of the turn until an object lies: they find the least eighth after which a footing holds it."""


def stand(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Make every object stable before physics, supports first: as it is, on a footing, or tipped until it lies."""
    decisions: list[Decision] = []
    for o in _standing(layout):
        decision = None if _is_held_above(layout, o.id, config) else _put_on_a_footing(layout, o, config)
        if decision is None and layout.missing[o.id]:
            _lower_without_footing(layout, o.id, config)
            decision = _put_on_a_footing(layout, layout.object(o.id), config)
        decision = decision or _lie_down(layout, layout.object(o.id), config)
        if decision:
            decisions.append(decision)
    return decisions


def _is_held_above(layout: Placement, id: int, config: SeparateConfig) -> bool:
    """Whether a body is over its support because something else is in its way: it does not stand there."""
    body, above = layout.bodies[id], gap(layout.bodies[id], id, layout, config) - layout.missing[id]
    return above > config.clearance and room_below(body, id, layout, config) < above - config.clearance


def _lower_without_footing(layout: Placement, id: int, config: SeparateConfig) -> None:
    """Lower a body that hangs over its support for a footing that it does not get."""
    layout.missing[id] = 0.0
    layout.move(layout.scene.subtree(id), -gap(layout.bodies[id], id, layout, config) * UP)


def on_footings_in_place(scene: Scene, config: SeparateConfig) -> Scene:
    """The scene with a footing under each object that would then stand as it is; nothing moves.

    A footing fills the gap to the support. A round underside gets one only where it touches."""
    layout = Placement(_without_footings(scene, [o.id for o in scene]))
    for o in _standing(layout):
        above = max(0.0, gap(layout.bodies[o.id], o.id, layout, config))
        if _fit_a_footing(layout, o, config, below=above) is None and 0 < above < config.contact.apart:
            _fit_a_footing(layout, o, config, below=0.0)
    return layout.moved_scene()


def on_own_footings(scene: Scene, ids: Collection[int], *, overlapping: bool, config: SeparateConfig) -> Scene:
    """The scene with a footing under each of some objects that would stand on one, were it lowered; nothing moves.

    No footing reaches below the lowest point of its object. Unless objects are still ``overlapping``, it ends over
    what carries it."""
    layout = Placement(_without_footings(scene, ids))
    for o in _standing(layout):
        if o.id in ids and _fit_a_footing(layout, o, config, below=0.0) and not overlapping:
            _end_over_carriers(layout, o, config)
    return layout.moved_scene()


def _without_footings(scene: Scene, ids: Collection[int]) -> Scene:
    bare = (replace(scene[id], footing=()) for id in ids if scene[id].mobility != "fixed")
    return scene.with_objects(*bare)


def _standing(layout: Placement) -> Iterator[SceneObject]:
    """Movable objects that something carries, supports first."""
    objects = (layout.object(id) for id in layout.scene.supports_first)
    return (o for o in objects if o.mobility != "fixed" and o.supported_by is not None)


def _end_over_carriers(layout: Placement, o: SceneObject, config: SeparateConfig) -> None:
    """Let a footing end over what rises beside the lowest point of its object; where it cannot, there is none."""
    carriers, low = layout.carriers(o.id), 0.0
    for _ in range(CUTS):
        wedges = layout.footings[o.id]
        over = smallest_shift(placed(wedges, o.T_world_asset), carriers, UP, config.clearance) if wedges else 0.0
        if over <= TOUCH:
            return
        low += over
        layout.stand(o.id, layout.parts[o.id], ())
        _fit_a_footing(layout, o, config, below=-low)
    layout.stand(o.id, layout.parts[o.id], ())


def _put_on_a_footing(layout: Placement, o: SceneObject, config: SeparateConfig) -> Decision | None:
    """Give an object a footing in its present pose, and put it onto its support with all it carries."""
    decision = _fit_a_footing(layout, o, config, below=layout.missing[o.id])
    if decision:
        layout.move(layout.scene.subtree(o.id), -gap(layout.bodies[o.id], o.id, layout, config) * UP)
    return decision


def _fit_a_footing(layout: Placement, o: SceneObject, config: SeparateConfig, *, below: float) -> Decision | None:
    """Give an object a footing down to ``below`` [m] under its lowest point, if it is then stable and the footing
    overlaps no other body."""
    if not config.footing.enabled:
        return None
    carriers = [layout.object(k) for k in o.carriers if k != GROUND]
    center = center_of([layout.object(k) for k in layout.scene.load(o.id)], parts=layout.bodies)
    plane = plane_below(o, carriers, config.footing, center=center)
    wedges = footing(o, plane, config.footing, below=below, center=center) if plane else ()
    if not plane or not wedges:
        return None
    before, was = layout.saved(), layout.collisions_of(o.id)
    layout.stand(o.id, flush(o, plane), wedges)
    if layout.collisions_of(o.id) - was - set(o.carriers):
        layout.restore(before)
        return None
    return _footing_decision(o, wedges)


def _lie_down(layout: Placement, o: SceneObject, config: SeparateConfig) -> Decision | None:
    """Tip an object until it lies, from its present place or from earlier ones on its viewing rays.

    A leaning object may have been moved past its neighbour. The stable candidate with the highest visible IoU wins.
    """
    members, start = layout.scene.subtree(o.id), layout.saved()
    was = {k: layout.collisions_of(k) for k in members}
    found: list[_Tried] = []
    for share in WAYS_BACK if layout.has_beside(o.id, BESIDE * o.size) else WAYS_BACK[:1]:
        layout.restore(start)
        layout.along_rays(members, layout.scale[o.id] ** -share)
        layout.move(members, -gap(layout.bodies[o.id], o.id, layout, config) * UP)
        if any(layout.collisions_of(k) - was[k] - set(members) for k in members):
            continue
        decision, stands = _laid_down(layout, layout.object(o.id), config)
        if not share and stands and decision is None:
            return None
        seen = float(np.mean(list(visible_ious(layout.moved_scene()).values())))
        found.append(_Tried(stands=stands, seen=seen, layout=layout.saved(), decision=decision))
    if not any(tried.stands for tried in found):
        layout.restore(start)
        return None
    best = max(found, key=lambda tried: (tried.stands, tried.seen))
    layout.restore(best.layout)
    return best.decision


@dataclass(frozen=True, eq=False, kw_only=True)
class _Tried:
    """A candidate: whether it is stable, the mean visible IoU of all objects, its state and its decision."""

    stands: bool
    seen: float
    layout: Saved
    decision: Decision | None


def _laid_down(layout: Placement, o: SceneObject, config: SeparateConfig) -> tuple[Decision | None, bool]:
    """Tip an object with its subtree about its contacts until it lies, or only until a footing holds it.

    On the ground its centre stays in place. Returns the decision, and whether the object is stable.
    """
    members = layout.scene.subtree(o.id)
    whole, others = _parted(layout, o.id)
    found = tipping.land(whole, others, config.landing, contact=config.contact)
    if found.tipped or found.turn < STILL:
        return None, found.stands
    if on_the_way := _lie_down_in_part(layout, o, whole.centers[0], found, config):
        return on_the_way, True
    was = {k: layout.collisions_of(k) for k in members}
    layout.turn(members, found.T)
    if o.supported_by == GROUND:
        back = whole.centers[0] - transform(found.T, whole.centers[:1])[0]
        lying = layout.saved()
        layout.move(members, np.append(back[:2], 0.0))
        if any(layout.collisions_of(k) - was[k] - set(members) for k in members):
            layout.restore(lying)
    decision = Decision(
        choice=f"laid down by {np.degrees(found.turn):.1f} degrees",
        reason="its weight then lies between its contacts before physics starts",
        about=o.id,
    )
    return decision, found.stands


def _lie_down_in_part(
    layout: Placement, o: SceneObject, center: Array, found: tipping.Landing, config: SeparateConfig
) -> Decision | None:
    """The least part of a landing's turn, about an object's centre (3,), after which a footing holds it."""
    before, angle = layout.saved(), float(np.degrees(found.turn))
    best: tuple[Saved, Decision] | None = None
    failed, stood = 0, 2**HALVINGS
    while stood - failed > 1:
        middle = (failed + stood) // 2
        share = middle / 2**HALVINGS
        layout.restore(before)
        decision = _turned_onto_a_footing(layout, o, center, share * vector_from_rotation(found.T[:3, :3]), config)
        if decision is None:
            failed = middle
        else:
            stood, turned = middle, f"turned by {share * angle:.1f} of {angle:.1f} degrees and "
            best = layout.saved(), replace(decision, choice=turned + decision.choice)
    layout.restore(best[0] if best else before)
    return best[1] if best else None


def _turned_onto_a_footing(
    layout: Placement, o: SceneObject, center: Array, turn: Array, config: SeparateConfig
) -> Decision | None:
    """Turn an object with its subtree by a rotation vector (3,) about a point (3,) and give it a footing.

    None where it is not stable there or overlaps another body."""
    members = layout.scene.subtree(o.id)
    was = {k: layout.collisions_of(k) for k in members}
    layout.turn(members, turn_about(center, rotation_from_vector(turn)))
    layout.move(members, max(0.0, config.clearance - min(layout.lowest(k) for k in members)) * UP)
    decision = _put_on_a_footing(layout, layout.object(o.id), config)
    is_free = not any(layout.collisions_of(k) - was[k] - set(members) for k in members)
    return decision if is_free and decision and _stands(layout, o.id, config) else None


def _parted(layout: Placement, id: int) -> tuple[StaticBody, list[StaticBody]]:
    """A body with its subtree as one rigid body, and all others as fixed ones."""
    members = layout.scene.subtree(id)
    bodies = {b.id: b for b in bodies_of([layout.object(k.id) for k in layout.scene], parts=layout.bodies)}
    whole = rigid([bodies[k] for k in members], id)
    return whole, [replace(bodies[k], fixed=True) for k in bodies if k not in members]


def _stands(layout: Placement, id: int, config: SeparateConfig) -> bool:
    """Whether a body with its subtree has the stability margin of a footing, all others fixed."""
    whole, others = _parted(layout, id)
    everything = [whole, *others]
    contacts = contacts_of(everything, reach=config.contact.loose)
    friction = layout.scene.ground.friction
    return Balance([whole], everything, contacts, friction).bears(config.footing.min_margin)


def _footing_decision(o: SceneObject, wedges: tuple[ConvexPart, ...]) -> Decision:
    height = max(float(np.ptp(w.moved(o.T_world_asset).vertices[:, 2])) for w in wedges)
    reason = (
        f"its hidden underside is uneven or tilted against its support; the footing adds up to "
        f"{1000 * height:.1f} mm ({100 * height / o.size:.1f} % of its size), for contact only"
    )
    return Decision(choice="given a footing", reason=reason, about=o.id)
