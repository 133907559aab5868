"""Which family of shapes a mask shows, and what it stands on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.lifting import fits
from f3sr.lifting.fits import Fit
from f3sr.lifting.outlined import Outlined
from f3sr.scene import Instance

PRIOR = {"box": 0.03, "solid of revolution": 0.015, "bowl or cup": 0.02, "standing silhouette": -0.01,
         "lying silhouette": -0.01}  # fmt: skip
"""Gain of 1 - IoU that a family is worth beside others: rigid families fit by chance less."""
LABELLED = 0.06
"""The same for a family that the label names."""
ELONGATED = 1.8
"""Ratio of a mask's axes from which on its long axis tells how it lies."""

WORDS = {
    "box": ("box", "brick", "book", "cube", "crate", "carton", "speaker", "cabinet", "drawer", "block"),
    "bowl or cup": ("bowl", "cup", "mug", "plate", "pan", "frypan", "pot", "dish", "basket", "bucket", "glass", "bin"),
    "solid of revolution": ("can", "bottle", "jar", "vase", "lamp", "cylinder", "candle", "ball", "apple", "orange",
                            "lemon", "peach", "plum", "pear", "strawberry", "tomato"),
    "lying silhouette": ("spoon", "fork", "knife", "wrench", "hammer", "screwdriver", "pen", "pencil", "scissors",
                         "banana", "spatula", "remote", "key"),
    "standing silhouette": ("chair", "person", "plant", "toy", "doll", "bear"),
}  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """The shape of an object, what else was close, and the height [m] it stands on."""

    best: Fit
    runner_up: Fit | None
    floor: float
    top: float
    """Height of its upper side, or of the inside's floor, on which others may rest [m]."""

    @property
    def told(self) -> str:
        """For the report."""
        first = f"{self.best.family}, IoU {self.best.overlap:.2f}"
        return f"{first}; next best {self.runner_up.family}, {self.runner_up.overlap:.2f}" if self.runner_up else first


def choose(instance: Instance, seen: Outlined, carrier: Choice | None) -> Choice:
    """The shape of a mask: on the carrier where the ray to its foot meets the carrier's top, else on the ground."""
    floor = 0.0
    if carrier is not None and _carries(seen, carrier):
        floor = carrier.top
    fitted = candidates(instance.label, seen, floor) or candidates(instance.label, seen, 0.0)
    if not fitted:
        raise ValueError(f"no shape stands where object {instance.id} is seen")
    ranked = sorted(fitted, key=lambda fit: -_score(fit, instance.label, seen))
    best = ranked[0]
    return Choice(
        best=best, runner_up=ranked[1] if len(ranked) > 1 else None, floor=floor, top=_top(best, floor)
    )


def candidates(label: str, seen: Outlined, floor: float) -> list[Fit]:
    """The fit of every family on the height ``floor`` [m]."""
    hollow = "bowl or cup" in named(label)
    found = [
        fits.fit_box(seen, floor),
        fits.fit_revolution(seen, floor, hollow=hollow),
        fits.fit_standing(seen, floor),
        fits.fit_lying(seen, floor),
    ]
    return [fit for fit in found if fit is not None]


def named(label: str) -> list[str]:
    """Families that a label names by one of its words."""
    words = label.lower().replace("-", " ").replace("_", " ").split()
    return [family for family, names in WORDS.items() if any(word in names for word in words)]


def _score(fit: Fit, label: str, seen: Outlined) -> float:
    score = fit.overlap + PRIOR[fit.family]
    if fit.family in named(label):
        score += LABELLED
    ratio, slant = _elongation(seen)
    if ratio > ELONGATED and fit.family == "standing silhouette" and slant > math.radians(35):
        score -= 0.1
    if fit.family == "lying silhouette" and (ratio < ELONGATED or slant < math.radians(35)):
        score -= 0.03
    return score


def _elongation(seen: Outlined) -> tuple[float, float]:
    """Ratio of the mask's axes, and the angle of the long one to the vertical [rad]."""
    rows, columns = np.nonzero(seen.mask)
    values, vectors = np.linalg.eigh(np.cov(np.column_stack([columns, rows]).T))
    x, y = vectors[:, 1]
    return math.sqrt(values[1] / max(values[0], 1e-9)), math.atan2(abs(x), abs(y))


def _carries(seen: Outlined, carrier: Choice) -> bool:
    """Whether the ray to the mask's foot meets the carrier's top within its outline."""
    point = seen.on_plane(seen.foot[None], np.array([0, 0, 1.0]), carrier.top)[0]
    return bool(np.isfinite(point).all()) and _within(point[:2], carrier.best.solid.vertices[:, :2])


def _within(point: Array, outline: Array) -> bool:
    from scipy.spatial import ConvexHull

    hull = ConvexHull(outline)
    return bool((hull.equations[:, :2] @ point + hull.equations[:, 2] <= 0).all())


def _top(fit: Fit, floor: float) -> float:
    heights = fit.solid.vertices[:, 2]
    if fit.family == "bowl or cup":
        return float(floor + 0.15 * (heights.max() - floor))
    return float(heights.max())
