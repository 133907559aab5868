"""The unit of a scene from one photo: known lengths, usual sizes and the usual height of a camera, weighed together.

A photo alone has no unit. All lengths have one common factor, so each object of known size tells the same number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.settings import constants

REACH, STEPS = 7.0, 28001
"""Range of the factor's logarithm, either way, and the places at which its density is taken."""
FLAT = 1e-9
"""Log density below its largest value that counts as the same: between two lengths all is as likely."""


@constants
class ScaleModel:
    """How far what tells the unit may be off; standard errors of logarithms."""

    height: float = 0.5
    """Of a camera's usual height: 0.7 m over tables is 0.3 to 1.6 m in nineteen of twenty photos."""
    given_height: float = 0.05
    """Of a height that the user measured, with the error of the tilt."""
    shape: float = 0.1
    """Of an object's longest side as found in one photo, whose far side is not seen: the mean of 79 rendered things,
    whose errors have heavy tails. What a user measured with a ruler is exact beside it."""
    common: float = 0.08
    """The same of all of them together: one way of lifting makes them all too deep, or too flat."""


@dataclass(frozen=True, kw_only=True)
class LengthClue:
    """An object's longest side, found in the scene [its unit] and true [m]."""

    id: int
    name: str
    found: float
    true: float
    sigma: float = 0.0
    """Standard error of the true one's logarithm, where it is a usual size."""
    given: bool = False
    """By the user."""

    @property
    def factor(self) -> float:
        return self.true / self.found


@dataclass(frozen=True, kw_only=True)
class SceneScale:
    """Metres per unit of the scene, and one standard error of its logarithm."""

    factor: float
    error: float


def scene_scale(
    clues: Sequence[LengthClue], *, height_given: bool = False, model: ScaleModel | None = None
) -> SceneScale:
    """The factor on all lengths of a scene, whose camera stands at its usual height or at a given one.

    The likeliest. Errors of found lengths are double exponential, so a wrong shape, a toy or a wrong label among others
    does not pull: of three given lengths the middle one decides. Beside a given length, usual sizes and the usual
    height have no say; beside a given height, usual sizes have none."""
    model = model or ScaleModel()
    x = np.linspace(-REACH, REACH, STEPS)
    given = [c for c in clues if c.given]
    used = given or (() if height_given else clues)
    log_density = np.zeros(STEPS)
    if height_given or not given:
        log_density -= 0.5 * (x / (model.given_height if height_given else model.height)) ** 2
    for clue in used:
        log_density -= np.abs(x - math.log(clue.factor)) / math.hypot(clue.sigma, model.shape)
    log_density -= log_density.max()
    best = float(x[log_density > -FLAT].mean())
    weights = np.exp(log_density) / np.exp(log_density).sum()
    spread = math.sqrt(float(weights @ (x - best) ** 2))
    return SceneScale(factor=math.exp(best), error=math.hypot(spread, model.common if used else 0.0))
