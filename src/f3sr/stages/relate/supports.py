"""What could carry each object: how far it would have to move to rest there, and what the photo says to that."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import GROUND, SceneObject
from f3sr.stages.relate.config import RelateConfig
from f3sr.stages.relate.image_evidence import Common
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.surfaces import FloorPlan, Surfaces
from f3sr.vision.depth_prior import ASSET_SIGMA, SUPPORT_REACH

RAY_STEPS = 16
"""Places to either side that are tried along the viewing rays."""
LOWEST = 2
"""Percentile of the distances of underside and top that counts as contact: single cells on edges err."""
WRONG = 0.02
"""Probability that a pixel shows the wrong one of two objects: masks and silhouettes err at outlines."""
ENOUGH = 0.05
"""Share of the smaller silhouette that two objects must have in common for their order to count in full."""


@dataclass(frozen=True, kw_only=True)
class SupportFit:
    """How an object comes nearest to resting on something: moved by ``k`` along its viewing rays, with a ``gap`` [m]
    left (negative: a depth), ``overlap`` of its footprint over it. ``now`` is the gap where it is, None beside it."""

    k: float
    gap: float
    overlap: float
    cost: float
    now: float | None


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A possible support of ``child``: its ``cost``, lower is better, and the evidence for it."""

    child: int
    parent: int
    cost: float
    evidence: str
    contact: SupportFit = SupportFit(k=1.0, gap=0.0, overlap=1.0, cost=0.0, now=None)

    @property
    def is_deep(self) -> bool:
        """Whether the child is in it where it is."""
        return self.contact.now is not None and self.contact.now < 0


def candidates(o: SceneObject, known: Known) -> list[Candidate]:
    """All supports of one object that geometry allows, judged by geometry and by the photo; the ground always."""
    contacts = {GROUND: ground_contact(known.surfaces[o.id], known.plan, known.config)}
    for p in known.near[o.id]:
        contact = object_contact(o.id, p, known)
        if contact and abs(contact.gap) <= known.config.max_gap * o.size:
            contacts[p] = contact
    step = max(2, round(known.config.below_pixels * known.picture.camera.height))
    seen = known.picture.seen_below(o, step, known.config.edge_part)
    return [_judged(o.id, parent, contact, seen, known) for parent, contact in contacts.items()]


def ground_contact(o: Surfaces, plan: FloorPlan, config: RelateConfig) -> SupportFit:
    """Closed form: the least (x / ASSET_SIGMA)^2 + (gap(x) / height_sigma)^2, gap(x) = lowest - slope x, x = k - 1."""
    slope, ray, height = plan.eye - o.lowest, ASSET_SIGMA, config.height_sigma * o.size
    x = float(np.clip(o.lowest * slope / (slope**2 + (height / ray) ** 2), -0.9, 9))  # above the eye no k leads down
    gap = o.lowest - slope * x
    cost = 0.5 * ((x / ray) ** 2 + (gap / height) ** 2)
    return SupportFit(k=1 + x, gap=gap, overlap=1.0, cost=cost, now=o.lowest)


def object_contact(id: int, other: int, known: Known) -> SupportFit | None:
    """The likeliest contact of an object's underside with another's top along its viewing rays; None where their
    footprints never meet. Both distances are uncertain."""
    o, config = known.surfaces[id], known.config
    ks = 1 + SUPPORT_REACH * np.arange(-RAY_STEPS, RAY_STEPS + 1) / RAY_STEPS
    distances = known.distances(id, known.plan.along_rays(o.underside, ks), other)
    overlaps = np.isfinite(distances).mean(1)
    tried = np.flatnonzero(overlaps >= config.min_overlap)
    if not len(tried):
        return None
    gaps = np.array([lowest_of(distances[i]) for i in tried])
    costs = (
        0.5 * (np.log(ks[tried]) / (np.sqrt(2) * ASSET_SIGMA)) ** 2
        + 0.5 * (gaps / (config.height_sigma * o.size)) ** 2
        + config.overlap_cost * np.maximum(0, 1 - overlaps[tried] / config.full_overlap)
    )
    best, now = int(np.argmin(costs)), gaps[tried == RAY_STEPS]
    return SupportFit(
        k=float(ks[tried[best]]),
        gap=float(gaps[best]),
        overlap=float(overlaps[tried[best]]),
        cost=float(costs[best]),
        now=float(now[0]) if len(now) else None,
    )


def lowest_of(distances: Array) -> float:
    """The distance (n,) that counts as contact; infinite where none is known."""
    finite = distances[np.isfinite(distances)]
    return float(np.percentile(finite, LOWEST)) if len(finite) else np.inf


def forest(candidates: Iterable[Candidate]) -> dict[int, Candidate]:
    """The cheapest candidate per child that closes no cycle, by ascending cost; ties by ids."""
    chosen: dict[int, Candidate] = {}
    for c in sorted(candidates, key=lambda c: (c.cost, c.child, c.parent)):
        if c.child in chosen:
            continue
        walk: int | None = c.parent
        while walk in chosen:
            walk = chosen[walk].parent
            if walk == c.child:
                break
        if walk != c.child:
            chosen[c.child] = c
    return chosen


def likelihood(chosen: Candidate, found: Iterable[Candidate], *, beside: Collection[int] = ()) -> float:
    """How likely one candidate is among all of the same child, those not counted that carry ``beside`` it."""
    from scipy.special import softmax

    rivals = [c.cost for c in found if c.parent != chosen.parent and c.parent not in beside]
    return float(softmax([-cost for cost in (chosen.cost, *rivals)])[0])


def order_cost(common: Common | None, k: float, config: RelateConfig) -> float:
    """How badly an object moved by k along its rays agrees with who is seen where it overlaps another one."""
    from scipy.special import ndtr

    if common is None or not len(common.ratio):
        return 0.0
    in_front = np.clip(ndtr((common.ratio - np.log(k)) / config.order_sigma), WRONG, 1 - WRONG)
    right = np.where(common.first_seen, in_front, 1 - in_front)
    return float(-np.log(right).mean()) * min(1.0, common.share / ENOUGH)


def _judged(id: int, parent: int, contact: SupportFit, seen: Mapping[int, float], known: Known) -> Candidate:
    config = known.config
    here = known.plan.along_rays(known.surfaces[id].underside, contact.k)
    through = min(1.0, sum(_through(id, q, here, contact.k, known) for q in known.near[id] if q != parent))
    order = sum(order_cost(known.common(id, q), contact.k, config) for q in known.surfaces if q != id)
    below = seen.get(parent, 0.0)
    pictured = config.order_cost * order + config.seen_cost * (1 - below)
    return Candidate(
        child=id,
        parent=parent,
        cost=contact.cost + config.through_cost * through + pictured,
        evidence=_evidence(contact, below, through),
        contact=contact,
    )


def _evidence(contact: SupportFit, below: float, through: float) -> str:
    now = "beside it" if contact.now is None else above(contact.now)
    moved = f"{above(contact.gap)} with {100 * contact.overlap:.0f}% of its footprint when moved "
    moved += f"{100 * abs(contact.k - 1):.1f}% {'farther' if contact.k >= 1 else 'nearer'}"
    evidence = f"now {now}, {moved}; {100 * below:.0f}% of its mask's lower edge borders on it"
    return evidence + (f"; {100 * through:.0f}% of the base would be inside others" if through >= 0.005 else "")


def above(gap: float) -> str:
    return f"{1000 * gap:.0f} mm above it" if gap >= 0 else f"{-1000 * gap:.0f} mm deep in it"


def _through(id: int, other: int, here: Array, k: float, known: Known) -> float:
    """The share of an object's base, its underside moved to ``here``, that would be in the middle of another one."""
    o, q = known.surfaces[id], known.surfaces[other]
    base = o.base(known.config.base * o.size)
    points, roof = here[base], known.plan.eye + k * (o.roof[base] - known.plan.eye)
    top, low = q.top_at(points[:, :2])[0], q.low_at(points[:, :2])
    shared = np.minimum(top, roof) - np.maximum(low, points[:, 2])
    return float(np.mean(shared > 0.5 * np.minimum(top - low, roof - points[:, 2])))
