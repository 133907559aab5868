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

PRIOR = {"box": 0.03, "carved box": -0.05, "solid of revolution": 0.02, "bowl or cup": 0.02,
         "standing silhouette": -0.01, "lying silhouette": -0.01}  # fmt: skip
"""Gain of 1 - IoU that a family is worth beside others: rigid families fit by chance less."""
LABELLED = 0.05
"""The same for a family that the label names: a can may be a box."""
HOLLOW = 0.12
"""The same for a bowl or cup, which no silhouette tells from a lens."""
FLAT_TOP = 0.3
"""Least share of a carrier's outline that its top fills: nothing stays on a ball."""
ELONGATED = 1.8
"""Ratio of a mask's axes from which on its long axis tells how it lies."""

COMPACT = 0.75
"""Share of its hull that a mask covers from which on nothing is gained by carving: legs and gaps cover less."""
BEHIND = 0.1
"""Share of a carrier's depth at its back where a foot counts as behind it: things stand rarely on an edge."""
CUT = 0.1
"""Share of the mask's outline on the photo's border from which an object counts as cut."""
FIXED = ("person", "man", "woman", "child", "people", "tree", "chandelier", "curtain", "window", "door", "wall")
"""Words of labels whose things are no rigid bodies, or hold to what is not in the scene."""

HOLLOWS = {
    **dict.fromkeys(("plate", "saucer", "tray"), 0.2),
    **dict.fromkeys(("pan", "frypan", "skillet"), 0.4),
    **dict.fromkeys(("bowl", "dish", "basket"), 0.8),
    **dict.fromkeys(("pot", "wok", "basin"), 1.0),
    **dict.fromkeys(("cup", "mug", "bucket", "bin", "glass", "teacup", "planter"), 2.0),
}  # fmt: skip
"""Words of labels that name hollow things, and the usual ratio of their height to the radius of their rim."""
WORDS = {
    "box": ("box", "brick", "book", "cube", "crate", "carton", "speaker", "cabinet", "drawer", "block"),
    "bowl or cup": tuple(HOLLOWS),
    "solid of revolution": ("can", "bottle", "jar", "vase", "lamp", "cylinder", "candle", "ball", "apple", "orange",
                            "lemon", "peach", "plum", "pear", "strawberry", "tomato"),
    "lying silhouette": ("spoon", "fork", "knife", "wrench", "hammer", "screwdriver", "pen", "pencil", "scissors",
                         "banana", "spatula", "remote", "key"),
    "standing silhouette": ("person", "plant", "toy", "doll", "bear", "tree", "lamp"),
    "carved box": ("chair", "table", "desk", "bench", "stool", "sofa", "couch", "shelf", "armchair", "airplane", "car"),
}  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """The shape of an object, what else was close, and the height [m] it stands on."""

    best: Fit
    runner_up: Fit | None
    floor: float
    top: float
    """Height of its upper side, or of the inside's floor, on which others may rest [m]."""
    fixed: str = ""
    """Why it is no body that physics moves; empty where it is one."""

    def distance(self, centre: Array) -> float:
        """Of the shape's middle from a point (3,) [m]."""
        return float(np.linalg.norm(self.best.solid.vertices.mean(0) - centre))

    @property
    def told(self) -> str:
        """For the report."""
        text = f"{self.best.family}, IoU {self.best.overlap:.2f}"
        text += f"; next best {self.runner_up.family}, {self.runner_up.overlap:.2f}" if self.runner_up else ""
        return text + (f"; fixed: {self.fixed}" if self.fixed else "")


def choose(instance: Instance, seen: Outlined, carrier: Choice | None, *, distance: float) -> Choice:
    """The shape of a mask: on the carrier where the ray to its foot meets the carrier's top, else on the ground, or
    hanging at a ``distance`` [m] where the ground is not below it."""
    floor = carrier.top if carrier is not None and _carries(seen, carrier) else 0.0
    fitted = candidates(instance.label, seen, floor) or candidates(instance.label, seen, 0.0)
    fixed = _why_fixed(instance.label, seen, on_floor=bool(fitted))
    if not fitted:
        fitted = [fits.fit_hanging(seen, distance)]
    ranked = sorted(fitted, key=lambda fit: -_score(fit, instance.label, seen))
    best = ranked[0]
    return Choice(
        best=best,
        runner_up=ranked[1] if len(ranked) > 1 else None,
        floor=floor,
        top=_top(best, floor),
        fixed=fixed,
    )


def candidates(label: str, seen: Outlined, floor: float) -> list[Fit]:
    """The fit of every family on the height ``floor`` [m]."""
    aspects = [HOLLOWS[word] for word in words_of(label) if word in HOLLOWS]
    found = [
        fits.fit_box(seen, floor),
        fits.fit_carved(seen, floor),
        fits.fit_hollow(seen, floor, aspect=aspects[-1]) if aspects else None,
        fits.fit_revolution(seen, floor),
        fits.fit_standing(seen, floor),
        fits.fit_lying(seen, floor),
    ]
    return [fit for fit in found if fit is not None]


def named(label: str) -> list[str]:
    """Families that a label names by one of its words."""
    words = words_of(label)
    return [family for family, names in WORDS.items() if any(word in names for word in words)]


def words_of(label: str) -> list[str]:
    """The words of a label, in lower case."""
    return label.lower().replace("-", " ").replace("_", " ").split()


def _score(fit: Fit, label: str, seen: Outlined) -> float:
    score = fit.overlap + PRIOR.get(fit.family, 0.0)
    if fit.family in named(label):
        score += HOLLOW if fit.family == "bowl or cup" else LABELLED
    if fit.family == "carved box" and seen.solidity > COMPACT:
        score -= 0.08
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
    """Whether the mask's foot is on the carrier: at the height of its top, it is not behind the carrier's back, nor
    beside it. A foot before the carrier's front hangs over it."""
    point = seen.on_plane(seen.foot[None], np.array([0, 0, 1.0]), carrier.top)[0]
    if not np.isfinite(point).all() or not _has_top(carrier):
        return False
    outline, centre = carrier.best.solid.vertices[:, :2], seen.camera.center[:2]
    away = outline.mean(0) - centre
    away /= max(float(np.linalg.norm(away)), 1e-12)
    depths, sides = (outline - centre) @ away, (outline - centre) @ [-away[1], away[0]]
    depth, side = (point[:2] - centre) @ away, (point[:2] - centre) @ np.array([-away[1], away[0]])
    return bool(
        depth < depths.max() - BEHIND * np.ptp(depths)
        and depth > depths.min() - np.ptp(depths)
        and sides.min() < side < sides.max()
    )


def _has_top(carrier: Choice) -> bool:
    """Whether something may stand on it: it is hollow, or its uppermost tenth fills much of its outline."""
    from scipy.spatial import ConvexHull

    if carrier.best.family == "bowl or cup":
        return True
    vertices = carrier.best.solid.vertices
    low, high = float(vertices[:, 2].min()), float(vertices[:, 2].max())
    upper = vertices[vertices[:, 2] > high - 0.1 * (high - low)]
    if len(upper) < 3 or np.linalg.matrix_rank(upper[:, :2] - upper[0, :2], tol=1e-6) < 2:
        return False
    return float(ConvexHull(upper[:, :2]).volume) > FLAT_TOP * float(ConvexHull(vertices[:, :2]).volume)


def _why_fixed(label: str, seen: Outlined, *, on_floor: bool) -> str:
    """Why physics must not move an object: its foot is not seen, or nobody can say what holds it."""
    if not on_floor:
        return "it hangs, or stands beyond the horizon"
    words = words_of(label)
    if alive := [word for word in words if word in FIXED]:
        return f"the label says {alive[0]}"
    if seen.cut > CUT:
        return "the photo's border cuts it"
    return ""


def _top(fit: Fit, floor: float) -> float:
    heights = fit.solid.vertices[:, 2]
    if fit.family == "bowl or cup":
        return float(floor + 0.15 * (heights.max() - floor))
    return float(heights.max())
