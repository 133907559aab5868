"""All relations of a scene whose supports are known, as its graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.scene import GROUND, Relation, Scene, SceneGraph, SceneObject, Support
from f3sr.stages.relate.containment import inside
from f3sr.stages.relate.depth_order import depth_order, ids_of, overlaps
from f3sr.stages.relate.given import FIRST, Given, with_found, with_given
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.leaning import leaning, rests_on
from f3sr.stages.relate.load_shares import Carried
from f3sr.stages.relate.nodes import nodes
from f3sr.stages.relate.proximity import SurfaceDistance, nearest, next_to, touching
from f3sr.stages.relate.supports import Candidate, likelihood

FROM_GEOMETRY = "geometry and masks"
SURE_FURTHER = 0.9
"""Confidence of a further support that fits as well as the main one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FoundSupports:
    """What was found of supports: every object's candidates, the chosen main ones, all that carries; and the given."""

    found: Mapping[int, Sequence[Candidate]]
    chosen: Mapping[int, Candidate]
    resting: Mapping[int, Carried]
    given: Given


def graph_of(scene: Scene, judged: FoundSupports, known: Known, *, exact: bool) -> SceneGraph:
    """All relations of a scene whose objects have their supports; ``exact``: at rest, with proxies."""
    above = rests_on({o.id: [s.id for s in o.supports] for o in scene})
    near = nearest(known, exact=exact)
    relations = _resting_relations(scene, judged.given, near, known) if exact else _support_relations(scene, judged)
    for o in scene:
        contacts = {c.parent: c.contact.k for c in judged.found[o.id]}
        for p in known.near[o.id]:
            if p not in above[o.id] and (pair := inside(o.id, p, 1.0 if exact else contacts.get(p, 1.0), known)):
                relations += pair
    related = {(a, b) for b in above for a in above[b]} | ids_of(relations, "inside")
    carried_ones = {id: c for id, c in judged.resting.items() if scene[id].supports}
    relations += leaning(carried_ones, near, above, known)
    relations += touching(near, known, exact=exact)
    relations += next_to(near, related, known)
    relations += overlaps(known)
    relations += depth_order(known, related)
    source = scene.graph.source if judged.given.count else FROM_GEOMETRY
    return SceneGraph(relations=with_given(relations, judged.given.relations), source=source, nodes=nodes(known))


def _support_relations(scene: Scene, judged: FoundSupports) -> list[Relation]:
    """One per support, as sure as geometry and the photo are, or as it is given."""
    named = _named(judged.given)
    relations: list[Relation] = []
    for o in scene:
        found = judged.found[o.id]
        costs = {p.id: p.cost for p in judged.resting[o.id].patches}
        for s in o.supports:
            told = next((c for c in found if c.parent == s.id), judged.chosen[o.id])
            if given := named.get((o.id, s.id)):
                confidence = FIRST - given.cost
            elif s.id == o.supported_by:
                confidence = likelihood(told, found, beside=[t.id for t in o.supports])
            else:
                confidence = SURE_FURTHER * float(np.exp(-costs[s.id]))
            relations.append(_support(o, s, confidence, f": {told.evidence}", given))
    return relations


def _resting_relations(
    scene: Scene, given: Given, near: Mapping[tuple[int, int], SurfaceDistance], known: Known
) -> list[Relation]:
    """One per support of a scene at rest; contact of the proxies makes them sure."""
    named = _named(given)
    relations: list[Relation] = []
    for o in scene:
        for s in o.supports:
            touch = _touch(o.id, s.id, near, known)
            evidence = ", their proxies touch" if touch else ", though their proxies do not touch"
            relations.append(_support(o, s, 1.0 if touch else 0.5, evidence, named.get((o.id, s.id))))
    return relations


def _named(given: Given) -> dict[tuple[int, int], Candidate]:
    return {(c.child, c.parent): c for c in given.supports}


def _support(o: SceneObject, s: Support, confidence: float, evidence: str, given: Candidate | None) -> Relation:
    found = f"carries {100 * s.share:.0f}% of it{evidence}"
    return Relation(
        subject=o.id,
        predicate="supported_by",
        object=s.id,
        confidence=confidence,
        evidence=with_found(given.evidence, found) if given else found,
        source="given" if given else "found",
    )


def _touch(a: int, b: int, near: Mapping[tuple[int, int], SurfaceDistance], known: Known) -> bool:
    """Whether the proxies of two objects, or of one and the ground, touch."""
    if b == GROUND:
        o = known.scene[a]
        return min(float(p.vertices[:, 2].min()) for p in o.colliders_world) <= known.config.contact.reach
    n = near.get((min(a, b), max(a, b)))
    return n is not None and n.exact
