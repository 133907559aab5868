"""How numbers, objects and places are written on the page."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from f3sr.scene import GROUND, Scene

NO_VALUE = "–"
NBSP = "\u00a0"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, *, digits: int = 4) -> str:
    """``digits`` significant digits, whole numbers as they are; powers of ten outside 0.001 to 99999."""
    if not np.isfinite(value):
        return NO_VALUE
    if value == int(value) and abs(value) < 1e5:
        return f"{int(value)}".replace("-", "−")
    if 1e-3 <= abs(value) < 1e5:
        decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
        return f"{value:.{decimals}f}".replace("-", "−")
    mantissa, exponent = f"{value:.{min(digits, 2) - 1}e}".split("e")
    return f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPTS)}".replace("-", "−")


def length(meters: float) -> str:
    """A length in mm, or in m from one metre on."""
    if abs(meters) >= 1:
        return f"{number(meters, digits=3)}{NBSP}m"
    return f"{_small(1000 * meters)}{NBSP}mm"


def share(value: float) -> str:
    return f"{_small(100 * value)}{NBSP}%"


def _small(value: float) -> str:
    """Two digits; a tiny value is less than 0.01."""
    return f"<{NBSP}0.01" if 0 < value < 0.01 else number(value, digits=2)


def name_of(id: int, scene: Scene) -> str:
    """``3 red mug``; an object without a label is its id."""
    if id == GROUND:
        return "the ground"
    return f"{id} {scene[id].label}".strip() if id in {o.id for o in scene} else f"object {id}"


def counted(n: int, one: str, many: str | None = None) -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"


def listed(parts: Iterable[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last
