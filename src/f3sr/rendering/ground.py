"""Where the ground shows shadows in a picture, and how much of its light objects at rest already take in the photo."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.background.regions import Mask, grown
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.rendering.textures import LINEAR

NEAR, FAR = 1.5, 3.0
"""Radii of the scene's ball within which the ground shows all of its shadows, and beyond which it shows none: a table
ends somewhere, and walls take no shadows."""
APART = 3
"""Pixels from objects at which ground is looked at: their borders hold mixed colours."""
TINT = 1.4
"""How far a shadow's channels may differ beyond those of the drawn one: more is an object's colour past its mask."""
DARK = 0.004
"""Linear light that a pixel is taken to have at least: below, a level of eight bits is more than a tenth of it."""
RATIOS = 0.1, 1.5
"""What the photo may show of the background's light: shadows are no darker, and little is lit by objects."""
CLEAR = 0.98
"""Share of light from which ground is not in shadow."""
DOUBT = 0.01
"""How much light drawn shadows must take for a darker place in the photo to be one of theirs rather than its grain."""
THIN = 4
"""Every how many pixels along each side ground in light is looked at."""
AGREES = 0.2
"""Median of the logarithm of photo over background, out of shadows, up to which they are of one place and light."""


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


def light_shown(
    rest: NDArray[np.float32], photo: NDArray[np.uint8], background: NDArray[np.uint8], objects: Mask
) -> tuple[NDArray[np.float32], bool]:
    """(h, w, 3) the share of the background's light that the ground shows with the scene at rest, and whether the
    photo tells it.

    ``rest`` (h, w, 3) is that of the drawn shadows. Where the photo shows ground in them, it is the photo's own, so
    that the film begins with its shadows; elsewhere it is 1, as what is darker there is no shadow that could leave with
    an object; under and beside objects, ``rest`` corrected as around them. A background whose light is another where
    there are no shadows at all is not of this photo, which then tells nothing; a little is another exposure.
    """
    lit = LINEAR.astype(np.float32).clip(DARK)
    ratio = lit[photo] / lit[background]
    hidden = grown(objects, APART)
    in_light = ratio[::THIN, ::THIN][(~hidden & (rest >= CLEAR).all(2))[::THIN, ::THIN]]
    if len(in_light):
        if np.median(np.abs(np.log(in_light))) > AGREES:
            return rest, False
        ratio /= np.median(in_light, axis=0)
    tint = ratio / rest
    hidden |= grown(tint.max(2) > TINT * tint.min(2), 2)
    shown = np.clip(ratio, *RATIOS) ** ((1 - rest) / (1 - rest + DOUBT))
    correction = membrane(np.log(shown / rest).astype(np.float32), ~hidden)
    return np.where(hidden[..., None], rest * np.exp(correction), shown).astype(np.float32), True
