"""Where the ground shows shadows in a picture, and how much of its light objects at rest already take in the photo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.background.regions import Mask, grown
from f3sr.frames import Camera

DARKEST = 0.2
"""Least share of light that a background is taken to hold already: it is divided by it."""


def ground_seen(camera: Camera, limit: Mask | None) -> NDArray[np.float32]:
    """(h, w) 1 where the ray through a pixel meets the ground from above, within ``limit`` where that is known."""
    h, w = camera.height, camera.width
    x, y = np.arange(w) + 0.5, np.arange(h) + 0.5
    to_world = (camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K))[2]
    falls = to_world[0] * x + to_world[1] * y[:, None] + to_world[2]
    seen = (falls < 0) & (camera.center[2] > 0)
    return (seen if limit is None else seen & limit).astype(np.float32)


def shadows_within(
    rest: NDArray[np.float32], photo: NDArray[np.uint8], background: NDArray[np.uint8], objects: Mask
) -> NDArray[np.float32]:
    """(h, w, 3) the share of light that the background's pixels hold already.

    Where the background is the photo, it holds the photo's shadows, ``rest`` (h, w, 3). Where it was completed, it goes
    on from there without a seam of light; so does what it is divided by.
    """
    completed = grown(np.any(photo != background, axis=2) | objects, 1)
    if not completed.any() or completed.all():
        return np.ones_like(rest) if completed.all() else np.maximum(rest, DARKEST)
    held = membrane(rest, ~completed)
    return np.maximum(np.where(completed[..., None], held, rest), DARKEST).astype(np.float32)
