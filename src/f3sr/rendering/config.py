"""What of the picture may be set: samples, shadows and how the light is looked for."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Interval

from f3sr.settings import settings


@settings
class LightConfig:
    """How the light of the photo is found."""

    enabled: bool = True
    """Whether light is looked for; else textures are shown as they are, and shadows fall from the default light."""
    samples: Annotated[int, Interval(ge=200, le=100_000)] = 6000
    """Pixels of objects, and as many of the ground, that the light is fitted to."""
    least_gain: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """By which share a light with a direction must lower the misfit against light without one."""


@settings
class ShadowConfig:
    """How finely shadows are drawn."""

    enabled: bool = True
    """Whether objects cast shadows."""
    map_size: Annotated[int, Interval(ge=64, le=2048)] = 384
    """Side of the map of every light [texel]; maps cover the scene at rest 1.6 times."""
    caster_faces: Annotated[int, Interval(ge=50, le=100_000)] = 800
    """Triangles per object that cast shadows of the direct light: what is finer than a map's texel is lost anyway."""
    sky_caster_faces: Annotated[int, Interval(ge=50, le=100_000)] = 250
    """Triangles per object that cast shadows of the sky, which are wide and soft."""


@settings
class RenderConfig:
    """How a film's frames are drawn."""

    samples: Annotated[int, Interval(ge=1, le=4)] = 2
    """Samples along each side of a pixel."""
    near: Annotated[float, Interval(gt=0, le=1)] = 0.01
    """Distance of the near plane [m]: what is nearer to the camera is not drawn."""
    crease: Annotated[float, Interval(ge=0, le=3.1416)] = 0.7
    """Angle between triangles from which their edge is seen [rad]."""
    shadows: ShadowConfig = field(default_factory=ShadowConfig)
    light: LightConfig = field(default_factory=LightConfig)
