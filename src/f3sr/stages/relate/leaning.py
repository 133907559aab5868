"""Who leans on whom: what an object touches well above its base, and would fall over without."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from f3sr.core.transforms import Array
from f3sr.scene import GROUND, Relation
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.load_shares import Carried, outside_of
from f3sr.stages.relate.proximity import SurfaceDistance, smaller_size, touches


def leaning(
    resting: Mapping[int, Carried],
    near: Mapping[tuple[int, int], SurfaceDistance],
    above: Mapping[int, Collection[int]],
    known: Known,
) -> list[Relation]:
    """``leaning_on`` relations: objects that a higher contact balances.

    The centre of mass is outside the supports near the lowest contact, and a contact higher up brings it nearer. That
    contact is not with an object that rests on it (``above``)."""
    relations: list[Relation] = []
    for id, c in resting.items():
        s = known.surfaces[id]
        contacts = _contacts(id, c, near, above[id], known)
        least = known.config.lean_height * s.height
        base = [points for points, height, _ in contacts if height < least]
        if not base or (out := outside_of(base, c.middle)) <= known.config.stable * s.size:
            continue
        for points, height, other in contacts:
            if other == GROUND or height < least or outside_of([*base, points], c.middle) >= out:
                continue
            evidence = (
                f"touches it {100 * min(height / s.height, 1):.0f}% of its height up; its middle is "
                f"{1000 * out:.0f} mm outside what carries it below"
            )
            confidence = float(min(1.0, 0.5 + out / (4 * known.config.stable * s.size)))
            relations.append(
                Relation(subject=id, predicate="leaning_on", object=other, confidence=confidence, evidence=evidence)
            )
    return relations


def _contacts(
    id: int, c: Carried, near: Mapping[tuple[int, int], SurfaceDistance], above: Collection[int], known: Known
) -> list[tuple[Array, float, int]]:
    """All that an object touches: points (n, 2) in plan, height [m] over its lowest point, id."""
    found = [(p.points[:, :2], float(p.points[:, 2].mean()) - c.lowest, p.id) for p in c.patches]
    carriers = {p.id for p in c.patches}
    shift = c.middle - known.surfaces[id].middle_of_mass
    for (a, b), n in near.items():
        other = b if a == id else a
        if id not in (a, b) or other in carriers or other in above or not touches(n, smaller_size(known, a, b), known):
            continue
        found.append(((n.place[:2] + shift)[None], float(n.place[2]) - known.surfaces[id].lowest, other))
    return sorted(found, key=lambda f: (f[1], f[2]))


def rests_on(carriers: Mapping[int, Collection[int]]) -> dict[int, set[int]]:
    """Everything that rests on each object, directly or not, by who carries each."""
    above: dict[int, set[int]] = {id: set() for id in carriers}
    for id in carriers:
        left, seen = [*carriers[id]], set[int]()
        while left:
            below = left.pop()
            if below != GROUND and below not in seen:
                seen.add(below)
                above[below].add(id)
                left += carriers[below]
    return above
