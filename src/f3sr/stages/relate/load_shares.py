"""All that carries an object, and how much: where its underside touches, and how its weight spreads over that."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import GROUND, Support
from f3sr.stages.relate.known import Known, leads
from f3sr.stages.relate.supports import Candidate, lowest_of
from f3sr.vision.depth_prior import ASSET_SIGMA

TURNS = np.linspace(0, 2 * np.pi, 48, endpoint=False)
DIRECTIONS = np.stack([np.cos(TURNS), np.sin(TURNS)])
"""(2, 48) In which the edge of a patch is looked for."""
EVEN = 0.05
"""Pull of the shares towards those of the areas, where the lever alone does not tell them."""
WHOLE = 10.0
"""Weight of the shares' sum being 1."""
LEAST = 0.02
"""Least share of a support in contact."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Patch:
    """Where an object's underside touches a carrier, or is nearest to it: points (n, 3) in the plan, ``gap`` [m]."""

    id: int
    points: Array
    gap: float
    cost: float
    """Of carrying beside the main support."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Carried:
    """What carries an object, the main support first, and its middle of mass (2,) in the plan as it rests there."""

    patches: tuple[Patch, ...]
    middle: Array
    lowest: float
    """Height [m] of its lowest point there."""

    @property
    def supports(self) -> tuple[Support, ...]:
        """Shares by the lever: weights w >= 0 of the patches' middles whose mean is nearest the middle of mass."""
        from scipy.optimize import nnls

        if len(self.patches) == 1:
            return (Support(id=self.patches[0].id),)
        middles = np.stack([p.points[:, :2].mean(0) for p in self.patches])
        span = max(float(np.ptp(middles, axis=0).max()), np.finfo(float).tiny)
        areas = np.array([len(p.points) for p in self.patches], float)
        n = len(areas)
        A = np.vstack([(middles - self.middle).T / span, np.full((1, n), WHOLE), EVEN * np.eye(n)])
        w = np.maximum(nnls(A, np.concatenate([[0, 0, WHOLE], EVEN * areas / areas.sum()]))[0], LEAST)
        shares = [Support(id=p.id, share=float(x / w.sum())) for p, x in zip(self.patches, w, strict=True)]
        return (shares[0], *sorted(shares[1:], key=lambda s: (-s.share, s.id)))


def carried(chosen: Candidate, others: Sequence[Candidate], known: Known, *, given: Collection[int] = ()) -> Carried:
    """The main support, those ``given``, and others that touch the underside as it rests there.

    If the centre of mass lies outside the contact, something else must carry too. Then the best candidate that brings
    it nearer is taken, although its distance is less well known. An object that does not hide others where they overlap
    in the picture does not lie on them. The ground is an additional support only where balance needs it.
    """
    config, mine = known.config, known.surfaces[chosen.child]
    here = known.plan.along_rays(mine.underside, chosen.contact.k)
    middle = mine.weights @ here[:, :2]
    main, *rest = _touched([chosen, *others], here, known)
    patches = [main]
    spare: list[Patch] = []
    for c, patch in zip(others, rest, strict=True):
        if not len(patch.points) or not (c.parent in given or _hides(chosen.child, c.parent, known)):
            continue
        near = abs(patch.gap) <= config.share_reach * mine.size and patch.cost < 1
        firm = near and c.parent != GROUND and c.contact.overlap >= config.share_overlap
        (patches if firm or c.parent in given else spare).append(patch)
    slack, out = config.stable * mine.size, outside(patches, middle)
    for patch in sorted(spare, key=lambda p: (p.cost, p.id)):
        if out <= slack or patch.cost > config.needed_cost:
            break
        if outside([*patches, patch], middle) < out - slack:
            patches.append(patch)
            break
    return Carried(patches=tuple(patches), middle=middle, lowest=float(here[:, 2].min()))


def outside(patches: Sequence[Patch], at: Array) -> float:
    """How far a place (2,) lies outside all that touches [m]; negative inside."""
    return outside_of([p.points[:, :2] for p in patches], at)


def outside_of(points: Sequence[Array], at: Array) -> float:
    """How far a place (2,) lies outside the convex hull of some points [m], each (n, 2); negative inside."""
    return float((DIRECTIONS.T @ at - (np.concatenate(points) @ DIRECTIONS).max(0)).max())


def without_circles(resting: Mapping[int, Carried]) -> dict[int, Carried]:
    """Everybody without those further supports that would rest on them in turn; the surest are kept first."""
    below = {id: {c.patches[0].id} for id, c in resting.items()}
    dropped: set[tuple[int, int]] = set()
    further = [(p.cost, id, p.id) for id, c in resting.items() for p in c.patches[1:]]
    for _, id, carrier in sorted(further):
        if leads(carrier, id, below):
            dropped.add((id, carrier))
        else:
            below[id].add(carrier)
    return {
        id: replace(c, patches=tuple(p for p in c.patches if (id, p.id) not in dropped)) for id, c in resting.items()
    }


def _touched(candidates: Sequence[Candidate], here: Array, known: Known) -> list[Patch]:
    """What of the underside touches each candidate, or is nearest to touching it. Every cell belongs to what is nearest
    below it: the ground under a plate carries nothing that lies on the plate."""
    chosen, mine, config = candidates[0], known.surfaces[candidates[0].child], known.config
    span = float(np.ptp(here[:, :2], axis=0).max())
    reach = max(config.share_reach * mine.size, np.tan(config.tilt) * span)
    D = np.stack([known.distances(chosen.child, here, c.parent) for c in candidates])
    D[np.isnan(D)] = np.inf
    ground = np.array([c.parent == GROUND for c in candidates])
    D[np.ix_(ground, np.isfinite(D[~ground]).any(0))] = np.inf
    nearest = D.argmin(0)
    patches: list[Patch] = []
    for k, c in enumerate(candidates):
        own = np.where((nearest == k) & ((k == 0) | (D[k] > -config.max_gap * mine.size)), D[k], np.inf)
        if c.parent == GROUND and k > 0 and not np.isfinite(own[here[:, 2].argmin()]):
            own[:] = np.inf  # what else the ground carries, it carries at its lowest point
        gap = lowest_of(own)
        touching = own <= max(gap, 0.0) + reach if np.isfinite(gap) else np.zeros(len(own), bool)
        if k == 0 and not touching.any():
            touching = np.ones(len(own), bool)
        patches.append(Patch(id=c.parent, points=here[touching], gap=gap, cost=_beside_cost(c, chosen, known)))
    return patches


def _beside_cost(c: Candidate, chosen: Candidate, known: Known) -> float:
    """Cost of resting on both: how differently far along the viewing rays the two are, and what gap is left."""
    config, size = known.config, known.surfaces[c.child].size
    apart = np.log(c.contact.k / chosen.contact.k) / (np.sqrt(2) * ASSET_SIGMA)
    return float(0.5 * apart**2 + 0.5 * (c.contact.gap / (config.height_sigma * size)) ** 2)


def _hides(id: int, other: int, known: Known) -> bool:
    """Whether the photo shows an object rather than the other where they overlap; True where nothing is known."""
    common = None if other == GROUND else known.common(id, other)
    return common is None or not len(common.first_seen) or bool(common.first_seen.mean() >= 0.5)
