"""What lies inside what: the rim of a container around an object's lowest point, looked for in all directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import Relation
from f3sr.stages.relate.known import Known

BEARINGS = np.linspace(0, 2 * np.pi, 24, endpoint=False)
"""Directions [rad] in which a rim is looked for."""
STEPS = 40
"""Places along each of them."""


@dataclass(frozen=True, kw_only=True)
class Surrounded:
    """How a rim surrounds an object: the ``share`` of directions with a rim, and its ``depth``.

    ``depth`` is the median height of the rim over the object's lowest point, in heights of the object."""

    share: float
    depth: float


def surrounded(id: int, other: int, k: float, known: Known, *, depth: float) -> Surrounded:
    """How an object, moved by ``k`` along its viewing rays, is surrounded by another: rims at least ``depth`` of its
    height above its lowest point count."""
    o, p = known.surfaces[id], known.surfaces[other]
    here = known.plan.along_rays(o.underside, k)
    base = here[o.base(known.config.base * o.size)]
    lowest, height = float(here[:, 2].min()), k * max(o.height, 1e-9 * o.size)
    heights = (rims(base[:, :2].mean(0), p.grid.cell * max(p.high.shape), known, other) - lowest) / height
    high = heights[heights >= depth]
    return Surrounded(share=len(high) / len(heights), depth=float(np.median(high)) if len(high) else 0.0)


def inside(id: int, other: int, k: float, known: Known) -> tuple[Relation, Relation] | None:
    """``inside`` and its inverse, where an object lies in another's cavity."""
    config = known.config
    if not _in_box(id, other, k, known):
        return None
    found = surrounded(id, other, k, known, depth=config.rim_depth)
    if found.share < config.rim_share:
        return None
    evidence = (
        f"a rim around {100 * found.share:.0f}% of it, {100 * found.depth:.0f}% of its height above its lowest point"
    )
    confidence = float(min(1.0, found.share * (0.5 + found.depth / (2 * config.rim_depth) - 0.25)))
    within = Relation(subject=id, predicate="inside", object=other, confidence=confidence, evidence=evidence)
    return within, Relation(subject=other, predicate="contains", object=id, confidence=confidence, evidence=evidence)


def rims(at: Array, length: float, known: Known, other: int) -> Array:
    """The highest place of an object's top in every direction from a place (2,), -inf where there is none."""
    along = np.linspace(0, 1.5 * length, STEPS)[:, None]
    xy = at + along[..., None] * np.stack([np.cos(BEARINGS), np.sin(BEARINGS)], axis=1)
    top, _ = known.surfaces[other].top_at(xy)
    return np.where(np.isfinite(top), top, -np.inf).max(0)


def _in_box(id: int, other: int, k: float, known: Known) -> bool:
    """Whether the middle of an object's base lies over another object, above its lowest point."""
    o, p = known.surfaces[id], known.surfaces[other]
    here = known.plan.along_rays(o.underside, k)
    base = here[o.base(known.config.base * o.size)]
    at = base[:, :2].mean(0)
    under = bool(np.all(at >= p.bounds[0, :2]) and np.all(at <= p.bounds[1, :2]))
    return under and float(base[:, 2].min()) >= p.lowest - known.config.max_gap * o.size
