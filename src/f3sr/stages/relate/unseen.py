"""What rests on something without a mask: above the ground and all else, where the depth can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.resampling import resample
from f3sr.scene import GROUND, SceneObject
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.supports import Candidate
from f3sr.vision.depth_prior import sigma


@dataclass(frozen=True, kw_only=True)
class Hanging:
    """An object well above the ground, by the photo's own geometry too, that nothing else is likely to carry."""

    evidence: str
    """In figures."""
    is_sure: bool
    """Whether it would have to move by more than that geometry may be wrong."""


def hanging(o: SceneObject, found: Sequence[Candidate], known: Known) -> Hanging | None:
    """How an object hangs in the air; None where it does not.

    Generated poses can be far off: only where the photo's own geometry agrees with the object's depth is it believed.
    What is deep in something does not hang, however unlikely it is to rest on that.
    """
    config, mine = known.config, known.surfaces[o.id]
    if any(c.parent != GROUND and (c.cost < config.unseen_cost or c.is_deep) for c in found):
        return None
    height, eye = mine.lowest, known.plan.eye
    farther = height / (eye - height) if eye > height else np.inf
    if height <= config.unseen_height * o.size or farther <= config.unseen_scale:
        return None
    off = depth_error(o, known)
    if off is None or off > config.unseen_agreement * min(farther, 1.0):
        return None
    noise = sigma(known.scene.geometry)
    reach = "no distance" if np.isinf(farther) else f"only {100 * farther:.0f}% farther away"
    evidence = (
        f"{1000 * height:.0f} mm above the ground, {height / o.size:.1f} of its sizes, no other object is likely to "
        f"carry it, and it would reach the ground at {reach}, while the photo's geometry, of {100 * noise:.1f}% noise, "
        f"agrees with its depth to {100 * off:.1f}%"
    )
    return Hanging(evidence=evidence, is_sure=farther > config.unseen_sigmas * noise)


def depth_error(o: SceneObject, known: Known) -> float | None:
    """Relative difference of an object's median visible depth to that of the geometry in its mask; None without it."""
    geometry, view = known.scene.geometry, known.picture.views[o.id]
    if geometry is None or not view.pixels:
        return None
    h, w = known.picture.labels.shape
    rows, columns = (
        ((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip((h, w), geometry.valid.shape, strict=True)
    )
    z = np.where(geometry.valid, geometry.points[:, :, 2], np.nan)[rows][:, columns]
    there = (resample(o.mask, w, h) & np.isfinite(z))[view.window] & view.covers
    if not there.any():
        return None
    return float(abs(np.log(np.median(view.depth[there]) / np.median(z[view.window][there]))))
