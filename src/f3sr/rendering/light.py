"""The light of a scene, a disc at infinity and an even sky, and the lights that stand for both."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from f3sr.core.transforms import Array, rotation_between

DIRECT, SKY = 16, 16
"""Lights that stand for the disc and for the sky on objects."""
DIRECT_ON_GROUND, SKY_ON_GROUND = 32, 64
"""Lights that stand for both on the ground, which is wide and smooth: steps between few shadows would show.

Multiples of 8: each light is one bit of a byte (``layers.WORD``), and no byte holds both kinds."""
GOLDEN = np.pi * (3 - 5**0.5)
"""Turn from point to point of a sunflower [rad] (Vogel 1979)."""
LOWEST = np.sin(np.radians(8.0))
"""Least z of the unit vector to a light, 8 degrees over the horizon: below it, shadows have no end."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """Irradiance per channel (3,) by source; on an open place of the ground ``even``, ``direct`` and ``sky`` sum to
    1."""

    direction: Array
    """(3,) unit, towards the middle of the disc."""
    angle: float
    """Angular radius of the disc [rad]."""
    even: Array = field(default_factory=lambda: np.zeros(3))
    """What reaches everything, light that textures hold already included."""
    direct: Array = field(default_factory=lambda: np.zeros(3))
    """Of the disc, on a surface that faces it."""
    sky: Array = field(default_factory=lambda: np.zeros(3))
    """Of an even sky, on a surface that faces up."""
    below: Array = field(default_factory=lambda: np.zeros(3))
    """From the ground, on a surface that faces down."""
    unlit: bool = False
    """Objects show their textures as they are: only the ground's shadows are of this light."""
    shadow: Array = field(default_factory=lambda: np.ones(3))
    """What the ground's shadows are multiplied by, per channel: how dark the photo's are against this light's."""

    @cached_property
    def strength(self) -> Array:
        """(4, 3) on objects: even, direct, sky, below."""
        if self.unlit:
            return np.stack([np.ones(3), *np.zeros((3, 3))])
        return np.stack([self.even, self.direct, self.sky, self.below])

    @cached_property
    def hidden(self) -> Array:
        """(2, 3) of the ground's light that one of the lights of the disc, or of the sky, stands for."""
        # Lambert on level ground: the cosine is the direction's z. Sky lights have equal weight there: see
        # ``ground_sky``.
        direct = self.direct * self.direction[2] / DIRECT_ON_GROUND
        return np.stack([direct, self.sky / SKY_ON_GROUND]) * self.shadow


def disc(direction: Array, angle: float, count: int) -> Array:
    """Unit directions (count, 3) spread evenly over the cap of ``angle`` [rad] around ``direction``, none lower than
    ``LOWEST``."""
    k = np.arange(count)
    # Archimedes: equal steps of z are equal areas of the sphere. The golden angle spreads the turns.
    z = 1 - (k + 0.5) / count * (1 - np.cos(angle))
    r = np.sqrt(np.maximum(0, 1 - z * z))
    local = np.column_stack([r * np.cos(k * GOLDEN), r * np.sin(k * GOLDEN), z])
    return _raised(local @ rotation_between([0, 0, 1], direction).T)


def even_sky(count: int) -> Array:
    """Unit directions (count, 3) spread evenly over the upper half of the sphere."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count
    r = np.sqrt(1 - z * z)
    return _raised(np.column_stack([r * np.cos(k * GOLDEN), r * np.sin(k * GOLDEN), z]))


def ground_sky(count: int) -> Array:
    """Unit directions (count, 3) of equal weight on the ground: denser around the zenith, by the cosine."""
    k = np.arange(count)
    # Points even over the unit disc, lifted to the sphere (Malley's method): density follows the cosine.
    r = np.sqrt((k + 0.5) / count)
    return _raised(np.column_stack([r * np.cos(k * GOLDEN), r * np.sin(k * GOLDEN), np.sqrt(1 - r * r)]))


def _raised(directions: Array) -> Array:
    """Directions (n, 3), the low ones lifted to ``LOWEST`` at the same turn."""
    low = directions[:, 2] < LOWEST
    flat = directions[:, :2] / np.maximum(np.linalg.norm(directions[:, :2], axis=1), 1e-12)[:, None]
    raised = np.column_stack([flat * np.sqrt(1 - LOWEST**2), np.full(len(flat), LOWEST)])
    return np.where(low[:, None], raised, directions)
