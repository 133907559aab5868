"""Where the ground shows shadows in a picture, and how much of its light objects at rest already take in the photo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.background.regions import Mask, distance_to, grown
from f3sr.frames import Array, Camera

NEAR, FAR = 1.5, 3.0
"""Radii of the scene's ball within which the ground shows all of its shadows, and beyond which it shows none: a table
ends somewhere, and walls take no shadows."""
SEAM = 0.01
"""Distance over which light goes on into a completed background, in shares of the picture's longer side."""
DARKEST = 0.2
"""Least share of light that a background is taken to hold already: it is divided by it."""


def ground_seen(camera: Camera, limit: Mask | None, ball: tuple[Array, float]) -> NDArray[np.float32]:
    """(h, w) how much of its shadows the ground z = 0 shows: 1 where the ray through a pixel meets it from above,
    within ``limit`` where that is known, and less and less from ``NEAR`` to ``FAR`` radii of the scene's ``ball`` from
    its middle, for there it may not be the ground."""
    h, w = camera.height, camera.width
    x, y = np.arange(w) + 0.5, np.arange(h)[:, None] + 0.5
    to_world = camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K)
    ray = [row[0] * x + row[1] * y + row[2] for row in to_world]
    seen = (ray[2] < 0) & (camera.center[2] > 0)
    along = -camera.center[2] / np.where(seen, ray[2], -1)
    away = np.hypot(*(camera.center[k] + along * ray[k] - ball[0][k] for k in range(2))) / ball[1]
    shown = np.clip((FAR - away) / (FAR - NEAR), 0, 1) * seen
    return (shown if limit is None else shown * limit).astype(np.float32)


def shadows_within(
    rest: NDArray[np.float32], photo: NDArray[np.uint8], background: NDArray[np.uint8], objects: Mask
) -> NDArray[np.float32]:
    """(h, w, 3) the share of light that the background's pixels hold already.

    Where the background is the photo, it holds the photo's shadows, ``rest`` (h, w, 3). Where it was completed, it goes
    on from there without a seam of light, and so does this; but patches come from lit places, so a little farther in
    it holds none.
    """
    completed = grown(np.any(photo != background, axis=2) | objects, 1)
    if not completed.any() or completed.all():
        return np.ones_like(rest) if completed.all() else np.maximum(rest, DARKEST)
    share = np.exp(-distance_to(~completed) / (SEAM * max(completed.shape)))[..., None]
    held = 1 - share * (1 - membrane(rest, ~completed))
    return np.maximum(np.where(completed[..., None], held, rest), DARKEST).astype(np.float32)
