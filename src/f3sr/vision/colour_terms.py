"""The colours of things by the eleven basic terms, told from the photo's pixels.

Terms overlap where people differ: a pixel between orange and brown counts for both, so that either word finds it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array

PIXELS = 4000
"""Pixels of a mask that colours are counted in, at most."""
COMMON = 0.2
"""Share of the pixels from which on an object may be called by a colour; the commonest colour always names it."""


Colour = Literal["black", "grey", "white", "red", "pink", "orange", "brown", "yellow", "green", "blue", "purple"]
"""The eleven basic colour terms of Berlin and Kay (1969)."""


class Term(NamedTuple):
    """A box of CIELAB in lightness, chroma and hue [deg]; a hue range may pass 360."""

    name: Colour
    lightness: tuple[float, float]
    chroma: tuple[float, float]
    hue: tuple[float, float] = (0, 360)


TERMS = (
    Term("black", (0, 22), (0, 18)),
    Term("grey", (18, 82), (0, 12)),
    Term("white", (68, 101), (0, 14)),
    Term("white", (64, 101), (0, 22), (180, 300)),  # in the shade of a blue sky
    Term("red", (15, 62), (28, 200), (5, 48)),
    Term("red", (15, 45), (16, 200), (350, 405)),
    Term("pink", (52, 100), (12, 200), (335, 395)),
    Term("pink", (40, 100), (30, 200), (325, 375)),
    Term("orange", (42, 90), (38, 200), (40, 76)),
    Term("brown", (8, 52), (9, 30), (25, 92)),
    Term("brown", (8, 52), (28, 60), (42, 92)),
    Term("brown", (48, 76), (12, 38), (45, 88)),
    Term("yellow", (45, 101), (24, 200), (72, 118)),
    Term("green", (8, 101), (10, 200), (106, 205)),
    Term("blue", (5, 101), (10, 200), (192, 312)),
    Term("purple", (8, 78), (14, 200), (300, 345)),
)
BASIC: tuple[Colour, ...] = get_args(Colour)


def colours_of(rgb: NDArray[np.uint8]) -> tuple[Colour, ...]:
    """The colours that pixels (n, 3) of sRGB may be called by, the commonest first; none for no pixels."""
    if not len(rgb):
        return ()
    lab = _lab(rgb[:: max(1, len(rgb) // PIXELS)])
    lightness, chroma = lab[:, 0], np.hypot(lab[:, 1], lab[:, 2])
    hue = np.degrees(np.arctan2(lab[:, 2], lab[:, 1])) % 360
    shares = dict.fromkeys(BASIC, 0.0)
    for name in BASIC:
        fits = [_fits(t, lightness, chroma, hue) for t in TERMS if t.name == name]
        shares[name] = float(np.mean(np.any(fits, axis=0)))
    order = sorted(BASIC, key=lambda name: -shares[name])
    return tuple(n for n in order if shares[n] >= min(COMMON, shares[order[0]]) and shares[n] > 0)


def _fits(t: Term, lightness: Array, chroma: Array, hue: Array) -> NDArray[np.bool_]:
    # Relative to the range's start, so that ranges past 360 need no case of their own.
    turned = (hue - t.hue[0]) % 360 <= t.hue[1] - t.hue[0]
    bright = (lightness >= t.lightness[0]) & (lightness < t.lightness[1])
    return bright & (chroma >= t.chroma[0]) & (chroma < t.chroma[1]) & turned


def _lab(rgb: NDArray[np.uint8]) -> Array:
    """CIELAB (n, 3) of sRGB bytes under D65 (IEC 61966-2-1, CIE 15)."""
    v = rgb / 255.0
    linear = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    xyz = linear @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=-1)
