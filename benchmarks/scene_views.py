"""How a made scene may be photographed: other cameras, masks with ragged edges or missing, no geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


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
    misses_carrier: bool = False
    """What carries most other objects has no mask and no asset, as one that a network overlooked."""
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
    "missed": View(misses_carrier=True),
    "no_geometry": View(has_geometry=False),
}


def scene_name(case: str, seed: int, view: str) -> str:
    return f"{case}_{seed}" + (f"_{view}" if view != USUAL else "")
