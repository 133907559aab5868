"""Pixels whose ground takes shadows, and the photo's own shadows on it with the scene at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.rendering.textures import LINEAR
from f3sr.vision.regions import Mask, grown

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
"""Least share of light that a drawn shadow takes where a darker photo counts as shadow, not as grain."""
THIN = 4
"""Every how many pixels along each side ground in light is looked at."""
AGREES = 0.2
"""Largest median of |log(photo / background)| outside shadows for the two to have the same place and light."""


def ground_seen(camera: Camera, limit: Mask | None, ball: tuple[Array, float]) -> NDArray[np.float32]:
    """(h, w): the share in [0, 1] of its shadows that the ground z = 0 shows at each pixel.

    It is 1 where the pixel's ray meets the ground from above, inside ``limit`` if that is known. Without it the share
    falls from ``NEAR`` to ``FAR`` radii of the scene's ``ball``: farther away the surface may not be the ground."""
    h, w = camera.height, camera.width
    x, y = np.arange(w) + 0.5, np.arange(h)[:, None] + 0.5
    to_world = camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K)
    # x (w,), y (h, 1): each component broadcasts to (h, w), with unit depth along the camera's axis.
    ray = [row[0] * x + row[1] * y + row[2] for row in to_world]
    seen = (ray[2] < 0) & (camera.center[2] > 0)
    # -1 only keeps the division defined; ``seen`` drops the result.
    along = -camera.center[2] / np.where(seen, ray[2], -1)
    away = np.hypot(*(camera.center[k] + along * ray[k] - ball[0][k] for k in range(2))) / ball[1]
    # A linear ramp: 1 up to NEAR, 0 from FAR on.
    shown = np.clip((FAR - away) / (FAR - NEAR), 0, 1) * seen
    return (shown if limit is None else shown * limit).astype(np.float32)


def light_shown(
    rest: NDArray[np.float32], photo: NDArray[np.uint8], background: NDArray[np.uint8], objects: Mask
) -> tuple[NDArray[np.float32], bool]:
    """(h, w, 3): the ground's share of the background's light with the scene at rest, and whether the photo gives it.

    ``rest`` (h, w, 3) is the share under the drawn shadows. Inside them, on visible ground, the result is photo over
    background, so that the film begins with the photo's shadows. Outside it is 1: a darker place there is no shadow
    that could leave with an object. Under and next to objects it is ``rest`` times the correction around them. If the
    background's light differs where there are no shadows, it is from another photo, and ``rest`` is returned. A small
    difference counts as exposure.
    """
    lit = LINEAR.astype(np.float32).clip(DARK)
    ratio = lit[photo] / lit[background]
    hidden = grown(objects, APART)
    # Visible ground that no drawn shadow touches: there photo and background must agree, up to one exposure per
    # channel.
    in_light = ratio[::THIN, ::THIN][(~hidden & (rest >= CLEAR).all(2))[::THIN, ::THIN]]
    if len(in_light):
        if np.median(np.abs(np.log(in_light))) > AGREES:
            return rest, False
        ratio /= np.median(in_light, axis=0)
    # A shadow scales all channels about alike. Where the channels part, the pixel is an object's colour or its
    # reflection.
    tint = ratio / rest
    hidden |= grown(tint.max(2) > TINT * tint.min(2), 2)
    # The exponent is about 1 in a drawn shadow, where the photo's ratio is taken, and 0 outside, where x^0 = 1. DOUBT
    # sets the depth of shadow at which it is one half.
    shown = np.clip(ratio, *RATIOS) ** ((1 - rest) / (1 - rest + DOUBT))
    # Shadows multiply light, so logarithms are interpolated: the smooth membrane through the visible ground's
    # correction.
    correction = membrane(np.log(shown / rest).astype(np.float32), ~hidden)
    return np.where(hidden[..., None], rest * np.exp(correction), shown).astype(np.float32), True
