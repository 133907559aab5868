"""XML documents as bytes, and numbers in their attributes."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.transforms import Array


def document(root: ET.Element, *, declared: bool = False) -> bytes:
    """An indented document; ``declared`` puts an XML declaration first."""
    ET.indent(root)
    return (b'<?xml version="1.0"?>\n' if declared else b"") + ET.tostring(root) + b"\n"


def numbers(values: float | Iterable[float] | Array) -> str:
    """Numbers at full precision."""
    return " ".join(repr(float(v)) for v in np.atleast_1d(np.asarray(values, float)))


def inertia_of(inertia: Array) -> dict[str, str]:
    """The six numbers of an inertia (3, 3) as URDF and SDF name them."""
    axes = "xyz"
    return {f"i{axes[i]}{axes[j]}": numbers(inertia[i, j]) for i in range(3) for j in range(i, 3)}
