"""Which family of shapes a mask shows, and what it stands on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array
from f3sr.language.grammar.normaliser import words_of
from f3sr.language.grammar.nouns import singular
from f3sr.lifting.balls import fit_ball
from f3sr.lifting.boxes import COMPACT_MASK, fit_boxes, fit_carved
from f3sr.lifting.cylinders import fit_cylinder
from f3sr.lifting.fits import FittedShape
from f3sr.lifting.hollows import Usual, fit_hollow
from f3sr.lifting.outline_fit import fitted_to_outline
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.revolutions import fit_revolution
from f3sr.lifting.silhouettes import fit_hanging, fit_lying, fit_standing
from f3sr.lifting.solids import Solid, is_stable
from f3sr.scene import Instance
from f3sr.vision import rasterizer
from f3sr.vision.regions import shrunk

PRIOR = {"ball": 0.03, "box": 0.03, "rounded box": 0.01, "carved box": -0.05, "cylinder": 0.03,
         "solid of revolution": 0.02,
         "bowl or cup": 0.02,
         "bowl or cup upside down": -0.02,
         "standing silhouette": -0.01, "lying silhouette": -0.01}  # fmt: skip
"""Gain of 1 - IoU that a family is worth beside others: rigid families fit by chance less."""
LABELLED = 0.03
"""The same for a family that the label names: a can may be a box."""
SURE = 0.12
"""The same for a bowl or cup, which no silhouette tells from a lens, and for a ball: what is round there is known."""
FLAT_TOP = 0.15
"""Least share of a carrier's outline that its top fills: nothing stays on a peak."""
ELONGATED = 1.8
"""Ratio of a mask's axes from which on its long axis tells how it lies."""

BEHIND = 0.15
"""Share of a carrier's depth at its back where an underside counts as behind it: things stand rarely on an edge."""
HANGS, ASIDE = 0.4, 0.05
"""Shares of a carrier's depth by which an underside may be before its front less ``BEHIND``, and beside it: things hang
over."""
MOST = 0.5
"""Share of an underside that is on the carrier at least."""
RIGID = ("ball", "cylinder", "solid of revolution", "bowl or cup", "bowl or cup upside down", "box", "rounded box")
"""Families that rest upright by their form, though a ball may roll."""
EDGED = ("box", "rounded box", "carved box", "cylinder")
"""Families with sharp edges, which no fruit has."""
REGULAR = ("ball", "box", "rounded box", "cylinder")
"""Families of which one sees that they are bent."""
SPREAD_OUT = 0.2
"""Loss of score of what is longer on the ground than it looks, times the square of the ratio's logarithm. A low camera
reads metres from few rows, and what points along the view is rare. 1.4 times: .02, 2 times: .1, 3.4 times: .3."""
TIPPY = 0.1
"""Loss of score of a shape that would tip over where it is."""
RIM = 0.02
"""Error of a rim in the picture [size of the mask]."""
CUT = 0.1
"""Share of the mask's outline on the photo's border from which an object counts as cut."""
FIXED = ("person", "man", "woman", "child", "people", "tree", "chandelier", "curtain", "window", "door", "wall")
"""Words of labels whose things are no rigid bodies, or hold to what is not in the scene."""

HOLLOWS = {
    **dict.fromkeys(("plate", "saucer", "tray"), Usual(height=0.2, base=0.6, wall=0.03)),
    **dict.fromkeys(("pan", "frypan", "skillet"), Usual(height=0.4, base=0.72, wall=0.025)),
    **dict.fromkeys(("bowl", "dish", "basket"), Usual(height=0.8, base=0.5, wall=0.045)),
    **dict.fromkeys(("pot", "wok", "basin"), Usual(height=1.0, base=0.8, wall=0.025)),
    **dict.fromkeys(("bucket", "bin", "planter"), Usual(height=2.0, base=0.75, wall=0.025)),
    **dict.fromkeys(("cup", "mug", "teacup", "glass"), Usual(height=2.0, base=0.8, wall=0.08)),
}
"""Names of hollow things. A pan: radius 13 cm, that of its level base 9.5, 5 high, its wall 3 mm thick. A mug: radius
4.2 cm, that of its base 3.4, 8.5 high, its wall 3.5 mm thick."""
FRUIT = {"lemon", "lime", "pear", "strawberry", "tomato", "potato", "avocado", "mango", "kiwi", "egg"}
"""Names of things without a flat underside."""
WORDS = {
    "box": ("box", "brick", "book", "cube", "crate", "carton", "speaker", "cabinet", "drawer", "block"),
    "rounded box": ("box", "brick", "book", "crate", "speaker", "block", "can", "tin", "soap", "sponge", "phone",
                    "remote", "toaster", "suitcase"),
    "bowl or cup": tuple(HOLLOWS),
    "ball": ("ball", "baseball", "softball", "basketball", "football", "globe", "marble", "apple", "orange",
             "tangerine", "grapefruit", "peach", "plum", "nectarine", "onion", "melon"),
    "cylinder": ("can", "jar", "cylinder", "candle", "tin", "roll", "battery", "drum", "barrel", "glass", "tumbler"),
    "solid of revolution": ("can", "bottle", "jar", "vase", "lamp", "cylinder", "candle", "lemon", "pear", "strawberry",
                            "tomato"),
    "lying silhouette": ("spoon", "fork", "knife", "wrench", "hammer", "screwdriver", "pen", "pencil", "scissors",
                         "banana", "spatula", "remote", "key"),
    "standing silhouette": ("person", "plant", "toy", "doll", "bear", "tree", "lamp"),
    "carved box": ("chair", "table", "desk", "bench", "stool", "sofa", "couch", "shelf", "armchair", "airplane", "car"),
}  # fmt: skip
KNOWN = FRUIT.union(*WORDS.values())
PREPOSITIONS = {"of", "with", "without", "in", "on", "from", "for", "under", "behind"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Choice:
    """The shape of an object, and what else was close."""

    best: FittedShape
    runner_up: FittedShape | None
    top: float
    """Height of its upper side, or of the inside's floor, on which others may rest [m]."""
    fixed: str = ""
    """Why it is no body that physics moves; empty where it is one."""

    def distance(self, centre: Array) -> float:
        """Of the shape's middle from a point (3,) [m]."""
        return float(np.linalg.norm(self.best.solid.vertices.mean(0) - centre))

    def near_wall(self, mask: NDArray[np.bool_], camera: Camera) -> NDArray[np.bool_]:
        """Pixels (H, W) of its ``mask`` that may hide what is in it: those outside of its opening, whose edge is known
        to a few pixels. What is not hollow hides nothing."""
        rim = self.best.solid.rim
        if rim is None:
            return np.zeros_like(mask)
        fan = np.array([[0, k, k + 1] for k in range(1, len(rim) - 1)], np.int32)
        height, width = mask.shape
        opening = rasterizer.silhouette(camera.to_camera(rim), fan, camera.K, width, height)
        return mask & ~shrunk(opening, math.ceil(RIM * math.sqrt(float(mask.sum()))))

    @property
    def told(self) -> str:
        """For the report."""
        text = f"{self.best.family}, IoU {self.best.overlap:.2f}"
        text += f"; next best {self.runner_up.family}, {self.runner_up.overlap:.2f}" if self.runner_up else ""
        return text + (f"; fixed: {self.fixed}" if self.fixed else "")


def choose(instance: Instance, seen: Outlined, carrier: Choice | None, *, distance: float, loaded: bool) -> Choice:
    """The shape of a mask: on top of the ``carrier``, else on the ground, or hanging at a ``distance`` [m] where the
    ground is not below it. ``loaded``: something may stand on it."""
    floor = carrier.top if carrier is not None else 0.0
    fitted = candidates(instance.label, seen, floor) or candidates(instance.label, seen, 0.0)
    fixed = _why_fixed(instance.label, seen, on_floor=bool(fitted))
    if not fitted:
        fitted = [fit_hanging(seen, distance)]
    ranked = sorted(fitted, key=lambda fit: -_score(fit, instance.label, seen, loaded=loaded))
    best = ranked[0]
    return Choice(
        best=fitted_to_outline(
            best,
            seen,
            on_a_point=best.family == "ball" or head(instance.label) in FRUIT,
            regular=best.family in REGULAR,
        ),
        runner_up=ranked[1] if len(ranked) > 1 else None,
        top=_top(best),
        fixed=fixed,
    )


def carries(seen: Outlined, carrier: Choice) -> bool:
    """Whether most of the mask's underside is on the carrier: at the height of its top it lies over that, and not at
    its back, where the outline of what only stands behind it ends."""
    from scipy.spatial import ConvexHull

    top = _top_outline(carrier.best.solid)
    if top is None:
        return False
    points = seen.on_plane(seen.underside, UP, carrier.top)[:, :2]
    away = top.mean(0) - seen.camera.center[:2]
    away /= max(float(np.linalg.norm(away)), 1e-12)
    depth = float(np.ptp(top @ away))
    sides = ConvexHull(top).equations
    over = np.zeros(len(points), np.bool_)
    for share in np.linspace(BEHIND, HANGS, 4):  # a point as much farther away is over the top
        farther = points + share * depth * away
        over |= (farther @ sides[:, :2].T + sides[:, 2] < ASIDE * depth).all(1)  # not where beyond the horizon
    return float(over.mean()) >= MOST


def _top_outline(solid: Solid) -> Array | None:
    """Corners (n, 2) of what something may stand on: the inside of what is hollow, else its uppermost tenth, where that
    fills much of its outline; else None."""
    from scipy.spatial import ConvexHull

    if solid.rim is not None:
        return solid.rim[:, :2]
    vertices = solid.vertices
    low, high = float(vertices[:, 2].min()), float(vertices[:, 2].max())
    upper = vertices[vertices[:, 2] > high - 0.1 * (high - low), :2]
    if len(upper) < 3 or np.linalg.matrix_rank(upper - upper[0], tol=1e-6) < 2:
        return None
    fills = float(ConvexHull(upper).volume) / float(ConvexHull(vertices[:, :2]).volume)
    return upper if fills > FLAT_TOP else None


def candidates(label: str, seen: Outlined, floor: float) -> list[FittedShape]:
    """The fit of every family on the height ``floor`` [m]."""
    name = head(label)
    found = [
        fit_ball(seen, floor) if "ball" in named(label) else None,
        *fit_boxes(seen, floor),
        fit_carved(seen, floor),
        *(fit_hollow(seen, floor, usual=HOLLOWS[name], upside_down=over) for over in (False, True) if name in HOLLOWS),
        fit_cylinder(seen, floor),
        fit_revolution(seen, floor, is_round=name in FRUIT),
        fit_standing(seen, floor),
        fit_lying(seen, floor),
    ]
    return [fit for fit in found if fit is not None]


def named(label: str) -> list[str]:
    """Families that a label names."""
    name = head(label)
    return [family for family, names in WORDS.items() if name in names]


def head(label: str) -> str:
    """The word of a label that says what a thing is; empty where none is known.

    English puts the head noun last, but for what follows a preposition: a ``tomato soup can`` is a can, a ``bowl of
    apples`` a bowl."""
    words = [singular(word) for word in words_of(label)]
    end = next((k for k, word in enumerate(words) if word in PREPOSITIONS), len(words))
    return next((word for word in reversed(words[:end]) if word in KNOWN), "")


def _score(fit: FittedShape, label: str, seen: Outlined, *, loaded: bool) -> float:
    score = fit.overlap + PRIOR.get(fit.family, 0.0)
    family = fit.family.removesuffix(" upside down")
    if family in named(label):
        score += SURE if family in ("bowl or cup", "ball") else LABELLED
    if fit.family in EDGED and head(label) in FRUIT:
        score -= SURE
    if (loaded or fit.family not in RIGID) and not is_stable(fit.solid):
        score -= TIPPY
    if fit.family == "carved box" and seen.solidity > COMPACT_MASK:
        score -= 0.08
    ratio, slant = _elongation(seen)
    if ratio > ELONGATED and fit.family == "standing silhouette" and slant > math.radians(35):
        score -= 0.1
    longer = _footprint(fit) / seen.apparent_size(fit.solid.vertices.mean(0))
    score -= SPREAD_OUT * max(0.0, math.log(max(longer, 1e-9))) ** 2
    if fit.family == "lying silhouette" and (ratio < ELONGATED or slant < math.radians(35)):
        score -= 0.05
    return score


def _footprint(fit: FittedShape) -> float:
    """Its longest side on the ground [m]."""
    return float(np.ptp(fit.solid.vertices[:, :2], axis=0).max())


def _elongation(seen: Outlined) -> tuple[float, float]:
    """Ratio of the mask's axes, and the angle of the long one to the vertical [rad]."""
    rows, columns = np.nonzero(seen.mask)
    values, vectors = np.linalg.eigh(np.cov(np.column_stack([columns, rows]).T))
    x, y = vectors[:, 1]
    return math.sqrt(values[1] / max(values[0], 1e-9)), math.atan2(abs(x), abs(y))


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


def _top(fit: FittedShape) -> float:
    """Height on which others may rest [m]: the floor of what is hollow is its first piece."""
    corners = fit.solid.pieces[0] if fit.solid.pieces else fit.solid.vertices
    return float(corners[:, 2].max())
