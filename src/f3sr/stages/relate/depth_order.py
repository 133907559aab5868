"""Who stands before whom as the camera sees it, and whose silhouettes overlap."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from itertools import combinations

import numpy as np

from f3sr.scene import Predicate, Relation
from f3sr.stages.relate.known import Known, leads
from f3sr.vision.depth_prior import ASSET_SIGMA

ENOUGH = 20
"""Pixels in common from which the photo tells who is in front."""
LARGEST = 0.99
"""Confidence that no evidence of this kind exceeds."""


def overlaps(known: Known) -> list[Relation]:
    """``overlaps_2d``, once per pair, the lower id first: full silhouettes share pixels."""
    relations: list[Relation] = []
    for a, b in combinations(known.surfaces, 2):
        common = known.common(a, b)
        if common and common.share >= known.config.common:
            relations.append(
                Relation(
                    subject=a,
                    predicate="overlaps_2d",
                    object=b,
                    confidence=float(min(LARGEST, 0.5 + common.share)),
                    evidence=f"full silhouettes share {100 * common.share:.0f}% of the smaller one",
                )
            )
    return relations


def depth_order(known: Known, related: Collection[tuple[int, int]]) -> list[Relation]:
    """``in_front_of`` and ``behind``, between objects near each other in the picture of which neither carries nor
    contains the other (``related``): who hides whom where silhouettes overlap, else depths that do not overlap.

    The surest first; one that would close a circle, as three sticks can lie on each other, is left out.
    """
    found: list[tuple[float, int, int, str]] = []
    for a, b in combinations(known.surfaces, 2):
        if (a, b) not in related and (b, a) not in related and _near_in_view(a, b, known):
            found += [told] if (told := _ordered(a, b, known)) else []
    before: dict[int, set[int]] = {id: set() for id in known.surfaces}
    relations: list[Relation] = []
    for confidence, a, b, evidence in sorted(found, key=lambda t: (-t[0], t[1], t[2])):
        if not leads(b, a, before):
            before[a].add(b)
            relations += both_ways(a, "in_front_of", b, confidence, evidence)
    return relations


def both_ways(a: int, predicate: Predicate, b: int, confidence: float, evidence: str) -> list[Relation]:
    """A relation and its inverse."""
    return [
        Relation(subject=a, predicate=predicate, object=b, confidence=confidence, evidence=evidence),
        Relation(subject=b, predicate=INVERSE[predicate], object=a, confidence=confidence, evidence=evidence),
    ]


INVERSE: dict[Predicate, Predicate] = {
    "in_front_of": "behind",
    "behind": "in_front_of",
    "contains": "inside",
    "inside": "contains",
}
SYMMETRIC: frozenset[Predicate] = frozenset({"next_to", "touching", "overlaps_2d"})


def _ordered(a: int, b: int, known: Known) -> tuple[float, int, int, str] | None:
    """Confidence, the one in front, the one behind, evidence."""
    from scipy.special import ndtr

    common, config = known.common(a, b), known.config
    if common and len(common.first_seen) >= ENOUGH:
        seen, nearer = float(common.first_seen.mean()), float(np.median(common.ratio))
        sure = max(seen, 1 - seen)
        if sure < config.sure_order:
            return None
        front, back = (a, b) if seen > 0.5 else (b, a)
        depth = abs(nearer) * (1 if (nearer > 0) == (seen > 0.5) else -1)
        confidence = min(LARGEST, sure * (0.5 + 0.5 * float(ndtr(depth / config.order_sigma))))
        words = f"seen in {100 * sure:.0f}% of the pixels in common, {100 * abs(depth):.1f}% of the distance "
        return confidence, front, back, words + ("nearer there" if depth >= 0 else "farther there")
    (near_a, far_a), (near_b, far_b) = (known.picture.views[i].range for i in (a, b))
    if far_a < near_b or far_b < near_a:
        front, back, far, near = (a, b, far_a, near_b) if far_a < near_b else (b, a, far_b, near_a)
        confidence = float(ndtr(np.log(near / far) / (np.sqrt(2) * ASSET_SIGMA)))
        return min(LARGEST, confidence), front, back, f"ends {1000 * (near - far):.0f} mm of depth before it begins"
    return None


def _near_in_view(a: int, b: int, known: Known) -> bool:
    """Whether two objects are seen and their views' boxes come near each other."""
    first, second = known.picture.views[a], known.picture.views[b]
    if not first.pixels or not second.pixels:
        return False
    slack = known.config.in_view * max(known.picture.labels.shape)
    top, bottom, left, right = first.box
    other_top, other_bottom, other_left, other_right = second.box
    gap = max(other_top - bottom, top - other_bottom, other_left - right, left - other_right)
    return gap <= slack


def ids_of(relations: Iterable[Relation], predicate: Predicate) -> set[tuple[int, int]]:
    return {(r.subject, r.object) for r in relations if r.predicate == predicate}
