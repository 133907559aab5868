"""Relations that scene_graph.json gives: each is held against geometry before it moves anything."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from f3sr.report import Decision
from f3sr.scene import GROUND, Predicate, Relation, SceneGraph
from f3sr.stages.relate.inside import surrounded
from f3sr.stages.relate.known import Known, name_of
from f3sr.stages.relate.order import INVERSE, SYMMETRIC, both_ways
from f3sr.stages.relate.supports import Candidate, ground_contact, object_contact

FIRST = -100.0
"""Cost of a given support that geometry allows: below that of any found here."""
LOOSE = 2.0
"""What contradicts a given relation misses the limits of a found one by this factor."""
ORDERED: frozenset[Predicate] = frozenset({"in_front_of", "behind", "inside", "contains"})
"""Predicates that cannot hold both ways."""
FEW_RIMS = 0.3
"""Share of the directions with a rim below which nothing is inside."""
MOST_TOLD = 50
"""Contradicted relations that are told one by one; the others are counted."""


@dataclass(frozen=True, kw_only=True)
class Given:
    """Given relations that geometry does not contradict: supports as candidates, the others as they are to be told."""

    supports: tuple[Candidate, ...]
    relations: tuple[Relation, ...]
    decisions: tuple[Decision, ...]
    count: int
    """Of different given relations."""


def held_against(graph: SceneGraph, found: Mapping[int, Sequence[Candidate]], known: Known) -> Given:
    """Confirm what is given; what geometry contradicts is not followed, a Decision with the figures.

    ``found``: the candidates of every object.
    """
    supports: list[Candidate] = []
    relations: list[Relation] = []
    refused: list[Decision] = []
    given = canonical(r for r in graph.relations if r.source == "given")
    for r in given:
        if r.predicate == "supported_by":
            against = support_contradicted(r.subject, r.object, known)
            if against is None:
                supports.append(_candidate(r, found[r.subject], known))
        else:
            against = _contradicted(r, known)
            if against is None:
                relations += _told(r)
        if against:
            choice = f"given {r.predicate.replace('_', ' ')} {name_of(r.object)} not followed"
            refused.append(Decision(choice=choice, reason=against, about=r.subject))
    decisions = refused[:MOST_TOLD]
    if len(refused) > MOST_TOLD:
        choice = f"{len(refused) - MOST_TOLD} more given relations not followed"
        decisions.append(Decision(choice=choice, reason="geometry contradicts them too"))
    return Given(supports=tuple(supports), relations=tuple(relations), decisions=tuple(decisions), count=len(given))


def canonical(relations: Iterable[Relation]) -> list[Relation]:
    """Each relation once, the surest of equal ones: ``inside`` and ``in_front_of`` for their inverses, symmetric ones
    with the lower id first."""
    best: dict[tuple[int, str, int], Relation] = {}
    for r in relations:
        turned = r.predicate in ("contains", "behind") or (r.predicate in SYMMETRIC and r.subject > r.object != GROUND)
        if turned and r.object != GROUND:
            r = replace(r, subject=r.object, object=r.subject, predicate=INVERSE.get(r.predicate, r.predicate))
        key = (r.subject, r.predicate, r.object)
        if key not in best or best[key].confidence < r.confidence:
            best[key] = r
    return [best[key] for key in sorted(best)]


def support_contradicted(id: int, by: int, known: Known) -> str | None:
    """Why an object cannot rest on another or on the ground, in figures; None where it can."""
    config, o = known.config, known.surfaces[id]
    if by == GROUND:
        contact = ground_contact(o, known.plan, config)
        if abs(contact.k - 1) <= config.max_ray_scale and abs(contact.gap) <= config.max_gap * o.size:
            return None
        return f"{1000 * o.lowest:.0f} mm above it, {100 * o.lowest / o.size:.0f}% of its size"
    contact = object_contact(id, by, known)
    if contact is None:
        apart = _apart_in_plan(id, by, known)
        beyond = f"their footprints are {1000 * apart:.0f} mm apart" if apart > 0 else "their footprints do not meet"
        return f"{beyond}, also after moving it by {100 * config.max_ray_scale:.0f}% of its distance"
    if abs(contact.gap) <= config.max_gap * o.size:
        return None
    where = "above its top" if contact.gap > 0 else "below its top"
    return (
        f"still {1000 * abs(contact.gap):.0f} mm {where}, {100 * abs(contact.gap) / o.size:.0f}% of its size, after "
        f"{100 * (contact.k - 1):+.1f}% of its distance"
    )


def with_given(found: Iterable[Relation], given: Iterable[Relation]) -> tuple[Relation, ...]:
    """Found relations with given ones in place of equal and of opposite ones, in the order of predicates and ids."""
    kept = {_key(r): r for r in found}
    for r in given:
        if r.predicate in ORDERED:
            for key in ((r.object, r.predicate, r.subject), (r.subject, INVERSE[r.predicate], r.object)):
                kept.pop(key, None)
        same = kept.get(_key(r))
        kept[_key(r)] = replace(r, evidence=f"{r.evidence}; found: {same.evidence}") if same else r
    order = get_args(Predicate)
    return tuple(sorted(kept.values(), key=lambda r: (order.index(r.predicate), r.subject, r.object)))


def _key(r: Relation) -> tuple[int, str, int]:
    return r.subject, r.predicate, r.object


def _candidate(r: Relation, found: Sequence[Candidate], known: Known) -> Candidate:
    """A given support, with the contact and evidence found here."""
    same = next((c for c in found if c.parent == r.object), None)
    if same is None:
        contact = object_contact(r.subject, r.object, known)
        assert contact is not None
        same = Candidate(child=r.subject, parent=r.object, cost=0.0, evidence="far away here", contact=contact)
    return replace(same, cost=FIRST - r.confidence, evidence=f"{r.evidence}; {same.evidence}")


def _told(r: Relation) -> list[Relation]:
    relations = (
        [r] if r.predicate not in INVERSE else both_ways(r.subject, r.predicate, r.object, r.confidence, r.evidence)
    )
    return [replace(t, source="given") for t in relations]


def _contradicted(r: Relation, known: Known) -> str | None:
    """Why a given relation other than a support cannot be, in figures; None where it can."""
    if r.object == GROUND:
        return "only a support names the ground"
    if r.predicate == "inside":
        around = surrounded(r.subject, r.object, 1.0, known, depth=0.0).share
        if _apart_in_plan(r.subject, r.object, known) > 0 or around < FEW_RIMS:
            return f"something of it stands above its lowest point in {100 * around:.0f}% of the directions around"
        return None
    if r.predicate in ("in_front_of", "behind"):
        return _order_contradicted(r.subject, r.object, known)
    if r.predicate == "overlaps_2d":
        return None if known.common(r.subject, r.object) else "their silhouettes share no pixel"
    if r.predicate in ("next_to", "touching", "leaning_on"):
        size = min(known.surfaces[i].size for i in (r.subject, r.object))
        apart = _box_distance(r.subject, r.object, known)
        if apart > LOOSE * known.config.beside * size:
            return f"{1000 * apart:.0f} mm apart, {100 * apart / size:.0f}% of the smaller one's size"
    return None


def _order_contradicted(front: int, back: int, known: Known) -> str | None:
    common = known.common(front, back)
    if common and len(common.first_seen):
        seen = float(common.first_seen.mean())
        if seen < 1 - known.config.sure_order:
            return f"where they overlap the photo shows the other one in {100 * (1 - seen):.0f}% of the pixels"
        return None
    near, far = known.picture.views[front].range[0], known.picture.views[back].range[1]
    if far < near:
        return f"it begins {1000 * (near - far):.0f} mm of depth behind where the other one ends"
    return None


def _apart_in_plan(a: int, b: int, known: Known) -> float:
    """Distance of two footprints' boxes [m], negative where they overlap."""
    (low, high), (other_low, other_high) = known.surfaces[a].bounds[:, :2], known.surfaces[b].bounds[:, :2]
    return float(np.maximum(low - other_high, other_low - high).max())


def _box_distance(a: int, b: int, known: Known) -> float:
    (low, high), (other_low, other_high) = known.surfaces[a].bounds, known.surfaces[b].bounds
    return float(np.linalg.norm(np.maximum(0, np.maximum(low - other_high, other_low - high))))
