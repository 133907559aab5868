"""Relations that scene_graph.json gives: each is held against geometry before it moves anything."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from f3sr.report import Decision
from f3sr.scene import GROUND, Predicate, Relation, SceneGraph, name_of
from f3sr.stages.relate.containment import surrounded
from f3sr.stages.relate.depth_order import INVERSE, SYMMETRIC, both_ways
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.supports import Candidate, above, object_contact
from f3sr.vision.depth_prior import SUPPORT_REACH

FIRST = -100.0
"""Cost of a given support that geometry allows: below that of any found here."""
MOST_COST = 30.0
"""Largest cost that a message states; less likely supports are not distinguished."""
LOOSE = 2.0
"""What contradicts a given relation misses the limits of a found one by this factor."""
ORDERED: frozenset[Predicate] = frozenset({"in_front_of", "behind", "inside", "contains"})
"""Predicates that cannot hold both ways."""
FOUND = "; found: "
"""Between the evidence that is given and that found here."""
FEW_RIMS = 0.3
"""Share of the directions with a rim below which nothing is inside."""
MOST_TOLD = 50
"""Contradicted relations that are reported one by one; the others are counted."""


@dataclass(frozen=True, kw_only=True)
class Given:
    """Given relations that geometry does not contradict: supports as candidates, the others unchanged, for the
    graph."""

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
            candidate, against = _support(r, found[r.subject], known)
            supports += [candidate] if candidate else []
        else:
            against = _contradicted(r, known)
            relations += [] if against else _told(r)
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


def _support(r: Relation, found: Sequence[Candidate], known: Known) -> tuple[Candidate, None] | tuple[None, str]:
    """A given support as a candidate that comes before all found ones, or why it cannot be, in figures."""
    same = next((c for c in found if c.parent == r.object), None)
    if same is None or (r.object == GROUND and not _reaches_ground(same, known)):
        return None, _too_far(r.subject, r.object, known)
    best = min(found, key=lambda c: (c.cost, c.parent))
    if same.cost - best.cost > known.config.refused_cost:
        times = np.exp(min(same.cost - best.cost, MOST_COST))
        return None, f"{same.evidence}; {times:.2g} times less likely than {name_of(best.parent)}"
    return replace(same, cost=FIRST - r.confidence, evidence=with_found(r.evidence, same.evidence)), None


def _reaches_ground(c: Candidate, known: Known) -> bool:
    config, contact = known.config, c.contact
    near = abs(contact.k - 1) <= SUPPORT_REACH
    return near and abs(contact.gap) <= config.max_gap * known.surfaces[c.child].size


def _too_far(id: int, by: int, known: Known) -> str:
    """Why no place along an object's viewing rays brings it onto another or onto the ground."""
    o = known.surfaces[id]
    if by == GROUND:
        return f"{above(o.lowest)}, {100 * abs(o.lowest) / o.size:.0f}% of its size"
    contact = object_contact(id, by, known) if by in known.near[id] else None
    if contact is None:
        apart = _apart_in_plan(id, by, known)
        where = f"their footprints are {1000 * apart:.0f} mm apart" if apart > 0 else "their footprints do not meet"
        return f"{where}, also when it moves by {100 * SUPPORT_REACH:.0f}% of its distance"
    moved = f"when moved {100 * abs(contact.k - 1):.1f}% {'farther' if contact.k >= 1 else 'nearer'}"
    return f"still {above(contact.gap)}, {100 * abs(contact.gap) / o.size:.0f}% of its size, {moved}"


def with_given(found: Iterable[Relation], given: Iterable[Relation]) -> tuple[Relation, ...]:
    """Found relations with given ones in place of equal and of opposite ones, in the order of predicates and ids."""
    kept = {_key(r): r for r in found}
    for r in given:
        if r.predicate in ORDERED:
            for key in ((r.object, r.predicate, r.subject), (r.subject, INVERSE[r.predicate], r.object)):
                kept.pop(key, None)
        same = kept.get(_key(r))
        kept[_key(r)] = replace(r, evidence=with_found(r.evidence, same.evidence)) if same else r
    order = get_args(Predicate)
    return tuple(sorted(kept.values(), key=lambda r: (order.index(r.predicate), r.subject, r.object)))


def with_found(given: str, found: str) -> str:
    """What is given, and what was found, in place of what was found before."""
    return f"{given.split(FOUND)[0]}{FOUND}{found}"


def _key(r: Relation) -> tuple[int, str, int]:
    return r.subject, r.predicate, r.object


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
