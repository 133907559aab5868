"""Who touches whom, who stands next to whom: distances of surfaces, or of proxies, between objects that are near."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from f3sr.contact import polytopes
from f3sr.contact.compounds import Compound, placed
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array
from f3sr.scene import Relation, Scene
from f3sr.stages.relate.known import Known

SAMPLES = 3000
"""Surface points per object: a few millimetres apart on a box of 20 cm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfaceDistance:
    """How near two objects come: ``distance`` [m], negative in depth, and where: a point (3,) in the plan."""

    distance: float
    place: Array
    exact: bool
    """Told from proxies."""


def nearest(known: Known, *, exact: bool) -> dict[tuple[int, int], SurfaceDistance]:
    """The distance of all pairs of objects that may be next to each other, the lower id first. ``exact``: that of the
    proxies where those touch."""
    clouds = {o.id: _cloud(known, o.id) for o in known.scene}
    bodies = _bodies(known) if exact else {}
    found: dict[tuple[int, int], SurfaceDistance] = {}
    for a, b in known.pairs():
        reach = known.config.beside * smaller_size(known, a, b)
        near = _touching(bodies[a], bodies[b], known.config.contact.reach) if exact else None
        near = near or _apart(clouds[a], clouds[b], reach)
        if near:
            found[a, b] = near
    return found


def touches(near: SurfaceDistance, size: float, known: Known) -> bool:
    """Whether two objects count as touching; ``size`` is that of the smaller one."""
    if near.exact:
        return near.distance <= known.config.contact.reach
    return near.distance <= known.config.touch * size


def touching(near: Mapping[tuple[int, int], SurfaceDistance], known: Known, *, exact: bool) -> list[Relation]:
    """Once per pair. Where proxies are known only they tell."""
    relations: list[Relation] = []
    for (a, b), n in near.items():
        size = smaller_size(known, a, b)
        if (exact and not n.exact) or not touches(n, size, known):
            continue
        limit = known.config.contact.reach if exact else known.config.touch * size
        confidence = 1.0 if exact else float(np.clip(1 - 0.5 * n.distance / limit, 0.5, 1))
        what = "proxies" if exact else "surfaces"
        relations.append(
            Relation(
                subject=a,
                predicate="touching",
                object=b,
                confidence=confidence,
                evidence=f"{what} {_millimetres(n.distance)} apart",
            )
        )
    return relations


def next_to(
    near: Mapping[tuple[int, int], SurfaceDistance], related: Collection[tuple[int, int]], known: Known
) -> list[Relation]:
    """Once per pair: near each other and on one level, neither carrying nor containing the other (``related``)."""
    relations: list[Relation] = []
    for (a, b), n in near.items():
        reach = known.config.beside * smaller_size(known, a, b)
        level = _same_level(known, a, b)
        if (a, b) in related or (b, a) in related or n.distance > reach or level < known.config.same_level:
            continue
        relations.append(
            Relation(
                subject=a,
                predicate="next_to",
                object=b,
                confidence=float(np.clip(1 - 0.5 * max(n.distance, 0.0) / reach, 0.5, 1)),
                evidence=f"{_millimetres(n.distance)} away, next to {100 * min(level, 1):.0f}% of the lower height",
            )
        )
    return relations


def smaller_size(known: Known, a: int, b: int) -> float:
    return min(known.surfaces[a].size, known.surfaces[b].size)


def _same_level(known: Known, a: int, b: int) -> float:
    """The height [share of the lower object's] that two objects have in common."""
    s, t = known.surfaces[a], known.surfaces[b]
    common = min(s.bounds[1, 2], t.bounds[1, 2]) - max(s.bounds[0, 2], t.bounds[0, 2])
    return float(common / max(min(s.height, t.height), 1e-9 * s.size))


def _millimetres(distance: float) -> str:
    return f"{1000 * max(distance, 0.0):.1f} mm"


@dataclass(frozen=True, eq=False)
class _Cloud:
    points: Array
    tree: Any
    """A ``scipy.spatial.KDTree`` of the points."""


def _cloud(known: Known, id: int) -> _Cloud:
    from scipy.spatial import KDTree

    s = known.surfaces[id]
    points = sample_surface(s.vertices, s.faces, SAMPLES)
    return _Cloud(points, KDTree(points))


def _apart(a: _Cloud, b: _Cloud, reach: float) -> SurfaceDistance | None:
    """The nearest of the sampled points, None beyond ``reach``."""
    low, high = b.points.min(0) - reach, b.points.max(0) + reach
    asked = a.points[np.all((a.points >= low) & (a.points <= high), axis=1)]
    if not len(asked):
        return None
    distances, hits = b.tree.query(asked, distance_upper_bound=reach)
    k = int(np.argmin(distances))
    if not np.isfinite(distances[k]):
        return None
    place = (asked[k] + b.points[int(np.asarray(hits)[k])]) / 2
    return SurfaceDistance(distance=float(distances[k]), place=place, exact=False)


def _bodies(known: Known) -> dict[int, Compound]:
    """Every object's proxies, in the plan."""
    scene: Scene = known.scene
    T = known.plan.T_plan_world
    return {o.id: placed(o.parts, T @ o.T_world_asset) for o in scene}


def _touching(A: Compound, B: Compound, limit: float) -> SurfaceDistance | None:
    """The contact of two bodies: the pair of parts with the least gap along a facet of their Minkowski difference.

    That gap is their distance, except where corners meet. None beyond ``limit``."""
    best: SurfaceDistance | None = None
    for a in A:
        for b in B:
            if np.any(a.bounds[0] - limit > b.bounds[1]) or np.any(b.bounds[0] - limit > a.bounds[1]):
                continue
            gap = float(-polytopes.facets(a, b)[1].min())
            if gap <= limit and (best is None or gap < best.distance):
                low, high = np.maximum(a.bounds[0], b.bounds[0]), np.minimum(a.bounds[1], b.bounds[1])
                best = SurfaceDistance(distance=gap, place=(low + high) / 2, exact=True)
    return best
