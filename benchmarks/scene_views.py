"""How a made scene may be photographed: other cameras, masks with ragged edges, no geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

RAGGED, CORRELATED = 2.5, 6.0
"""Standard deviation of a ragged edge's place, and of the filter that correlates it along the edge [px]."""


@dataclass(frozen=True, kw_only=True)
class View:
    """What differs from the usual photo: level, some 30 degrees from above, that the objects fill."""

    elevation: float | None = None
    """Of the camera over the objects' middle [deg]."""
    across: float | None = None
    """Angle that the objects' box spans [deg]: the nearer the camera, the larger."""
    roll: float = 0.0
    """About the optical axis [deg]."""
    fills: float = 0.86
    """Share of the picture that the objects' box spans; above 1 the border cuts it."""
    is_tall: bool = False
    is_ragged: bool = False
    """Masks have ragged edges, as networks draw them."""
    has_geometry: bool = True


USUAL = "usual"
VIEWS: Mapping[str, View] = {
    USUAL: View(),
    "low": View(elevation=8),
    "steep": View(elevation=68),
    "top": View(elevation=86),
    "wide": View(across=85),
    "tele": View(across=12),
    "cut": View(fills=1.45),
    "rolled": View(roll=25),
    "tall": View(is_tall=True),
    "small": View(fills=0.3),
    "ragged": View(is_ragged=True),
    "no_geometry": View(has_geometry=False),
}


def ragged(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """A mask (H, W) whose edge wanders."""
    inside = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    noise = ndimage.gaussian_filter(rng.normal(size=mask.shape), CORRELATED)
    return inside + RAGGED * noise / noise.std() > 0
