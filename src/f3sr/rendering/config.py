"""What of the picture may be set: samples, shadows and the search for the light."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Interval

from f3sr.core.corner_normals import CREASE
from f3sr.settings import settings


@settings
class LightConfig:
    """How the light of the photo is found."""

    enabled: bool = True
    """Fit the light of the photo. Without, textures stay as they are and shadows fall from the default light."""
    samples: Annotated[int, Interval(ge=200, le=100_000)] = 6000
    """Most pixels of objects, and as many of the ground, to which the light is fitted."""
    least_gain: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """Least share of the misfit by which a directed light must beat light without a direction."""
    overhead: Annotated[float, Interval(ge=0, le=1)] = 0.0
    """By how much of the misfit light from above is likelier than light along the ground. 0: the photo alone tells."""
    typical: Annotated[float, Interval(ge=0, le=1000)] = 0.0
    """What usual strengths of direct light, sky and ground weigh beside those that the photo tells, per sample: clear
    evidence wins. 0: the photo alone tells."""


@settings
class ShadowConfig:
    """How finely shadows are drawn."""

    enabled: bool = True
    """Draw the shadows of objects."""
    map_size: Annotated[int, Interval(ge=64, le=2048)] = 384
    """Side of every light's shadow map [texel]. A map covers 1.6 times the scene at rest."""
    caster_faces: Annotated[int, Interval(ge=50, le=100_000)] = 800
    """Most triangles of an object that cast direct shadows. What is finer than a texel is lost anyway."""
    sky_caster_faces: Annotated[int, Interval(ge=50, le=100_000)] = 250
    """Most triangles of an object that cast shadows of the sky, which are wide and soft."""


@settings
class RenderConfig:
    """How a film's frames are drawn."""

    samples: Annotated[int, Interval(ge=1, le=4)] = 2
    """Samples along each side of a pixel."""
    near: Annotated[float, Interval(gt=0, le=1)] = 0.01
    """Distance of the near plane [m]. What is nearer to the camera is not drawn."""
    crease: Annotated[float, Interval(ge=0, le=3.1416)] = CREASE
    """Least angle between triangles at which their common edge is seen [rad]."""
    shadows: ShadowConfig = field(default_factory=ShadowConfig)
    light: LightConfig = field(default_factory=LightConfig)
