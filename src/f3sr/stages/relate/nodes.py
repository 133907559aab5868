"""Every object in words, from its mask in the photo and its surfaces: size, colour, shape, place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.scene import Node, SceneObject
from f3sr.stages.relate.containment import rims
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.surfaces import Surfaces

PIXELS = 4000
"""Of a mask that colours are counted in, at most."""
SECOND = 0.3
"""Share of the pixels from which on a second colour is named."""
DARK, PALE, WHITE = 0.2, 0.15, 0.8
"""Value below which all is black; saturation below which all is grey; value from which on grey is white."""
HUES = (
    (15, "red"),
    (45, "orange"),
    (70, "yellow"),
    (165, "green"),
    (195, "turquoise"),
    (255, "blue"),
    (290, "purple"),
    (345, "pink"),
    (361, "red"),
)
"""Names of hues up to an angle [deg]."""
BROWN = 0.55
"""Value below which orange is brown."""
SMALL, LARGE = 0.6, 1.6
"""Sizes, in those of the median object, at which small ends and large begins."""
FLAT, LONG, EVEN = 0.25, 0.4, 0.8
"""Largest ratios of sides, least to middle and middle to largest, of flat and long objects; least ratio of equal sides.
"""
BALL, FULL, ROUND = 0.65, 0.85, 0.87
"""Largest share of its box that a ball fills, least share of a box; largest share of its rectangle for a disc."""
OPEN = 0.3
"""Depth of a hollow, in heights, from which on an object is open."""


def nodes(known: Known) -> tuple[Node, ...]:
    """One node per object, by id."""
    visible = known.picture.visibilities(known.scene)
    median = float(np.median([s.size for s in known.surfaces.values()]))
    return tuple(
        Node(id=o.id, label=o.label, description=described(o, known, median), visibility=visible[o.id])
        for o in known.scene
    )


def described(o: SceneObject, known: Known, median: float) -> str:
    """``small red ball, lower left in the photo, about 7 x 7 x 6 cm``."""
    surfaces = known.surfaces[o.id]
    ratio = surfaces.size / median
    size = "small " if ratio < SMALL else "large " if ratio > LARGE else ""
    shown = known.scene.photo.rgb.reshape(-1, 3)[np.flatnonzero(o.mask)]
    sides = surfaces.sides
    unit, name = (1.0, "m") if max(sides) >= 1 else (100.0, "cm")
    lengths = " x ".join(f"{unit * s:.2g}" for s in sides)
    words = f"{size}{colours(shown)} {shape(surfaces, known)}"
    return f"{words}, {place(o.mask)} of the photo, about {lengths} {name}"


def colours(rgb: NDArray[np.uint8]) -> str:
    """The commonest colour of some pixels (n, 3), and the second where it is common too."""
    names = np.array([*dict.fromkeys(name for _, name in HUES), "brown", "black", "grey", "white"])
    counts = np.bincount(_named(rgb[:: max(1, len(rgb) // PIXELS)] / 255.0, names), minlength=len(names))
    first, second = np.argsort(-counts, kind="stable")[:2]
    if counts[second] < SECOND * counts.sum():
        return str(names[first])
    return f"{names[first]} and {names[second]}"


def shape(s: Surfaces, known: Known) -> str:
    """A word for the form, from the sides of its box and how it fills them."""
    length, width, height = s.sides
    small, middle, large = sorted((length, width, height))
    cell = s.grid.cell**2
    area = cell * np.count_nonzero(s.footprint) / max(length * width, cell)
    filled = cell * float((s.roof - s.underside[:, 2]).sum()) / max(length * width * height, 1e-12 * s.size**3)
    rim = rims(s.middle, s.size, known, s.id)
    if height > FLAT * width and np.sort(rim)[len(rim) // 5] - _top(s) > OPEN * height:
        return "open vessel"
    if small < FLAT * middle:
        return "disc" if height == small and width > EVEN * length and area < ROUND else "flat piece"
    if middle < LONG * large:
        return "long piece"
    if small > EVEN * large and filled < BALL:
        return "ball"
    if filled > FULL:
        return "box"
    return "cylinder" if width > EVEN * length and 0.7 < area < ROUND and filled > BALL else "solid"


def place(mask: NDArray[np.bool_]) -> str:
    """Where a mask's middle lies, by thirds of the photo."""
    rows, columns = np.divmod(np.flatnonzero(mask), mask.shape[1])
    if not len(rows):
        return "nowhere"
    row, column = (int(3 * (x.mean() + 0.5) / n) for x, n in zip((rows, columns), mask.shape, strict=True))
    words = (("upper", "", "lower")[row], ("left", "middle" if row != 1 else "", "right")[column])
    return " ".join(filter(None, words)) or "middle"


def _top(s: Surfaces) -> float:
    """Height of the top over the footprint's middle."""
    z = float(s.top_at(s.middle)[0])
    return z if np.isfinite(z) else np.inf


def _named(rgb: Array, names: NDArray[np.str_]) -> NDArray[np.intp]:
    """Index of the name of every colour (n, 3) in [0, 1]."""
    value, least = rgb.max(1), rgb.min(1)
    chroma = value - least
    safe = np.where(chroma > 0, chroma, 1)
    r, g, b = rgb.T
    turns = np.select([value == r, value == g], [(g - b) / safe, 2 + (b - r) / safe], 4 + (r - g) / safe)
    hue = 60 * turns % 360
    limits = np.array([limit for limit, _ in HUES])
    told = np.array([name for _, name in HUES])[np.searchsorted(limits, hue, side="right")]
    told = np.where((told == "orange") & (value < BROWN), "brown", told)
    pale = chroma < PALE * np.maximum(value, 1e-9)
    told = np.where(pale, np.where(value >= WHITE, "white", "grey"), told)
    told = np.where(value < DARK, "black", told)
    order = np.argsort(names)
    return order[np.searchsorted(names, told, sorter=order)]
