"""A shape that was fitted to a mask, and what all fits begin with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import Solid

SLIDE = 3.0
"""Most that a level face moves in its plane, in displacements across the view: a low camera reads metres from a few
rows."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FittedShape:
    """A shape of one family, and its overlap with the mask where that is valid (IoU)."""

    family: str
    solid: Solid
    overlap: float

    @classmethod
    def of(cls, family: str, solid: Solid, seen: Outlined) -> Self:
        """A solid with its overlap."""
        return cls(family=family, solid=solid, overlap=seen.overlap(solid.vertices, solid.faces))


def anchored(seen: Outlined, floor: float) -> tuple[Array, float] | None:
    """Where the mask's foot is on the height ``floor``, and the object's size there [m]; None where that is beyond the
    horizon."""
    point = seen.on_plane(seen.foot[None], UP, floor)[0]
    if not np.isfinite(point).all():
        return None
    return point, seen.apparent_size(point)


def horizontal(seen: Outlined, point: Array) -> Array:
    """The horizontal unit vector (3,) from the camera towards a point."""
    away = (point - seen.camera.center) * [1, 1, 0]
    return away / max(float(np.linalg.norm(away)), 1e-12)
