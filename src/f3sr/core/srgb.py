"""sRGB values and linear light (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import Array


def linear(srgb: Array) -> Array:
    """Linear light in [0, 1] of sRGB values in [0, 1], of any shape."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def srgb(light: Array) -> Array:
    """sRGB values in [0, 1] of linear light in [0, 1], of any shape; the inverse of ``linear``."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)
