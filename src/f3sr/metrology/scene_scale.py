"""The unit of a scene from one photo: known lengths, usual sizes and the usual height of a camera, weighed together.

A photo alone has no unit. All lengths have one common factor, so each object of known size tells the same number.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.settings import constants

REACH, STEPS = 7.0, 2801
"""Range of the factor's logarithm, either way, and the places at which its density is taken."""


@constants
class ScaleModel:
    """How far what tells the unit may be off; standard errors of logarithms."""

    height: float = 0.5
    """Of a camera's usual height: 0.7 m over tables is 0.3 to 1.6 m in nineteen of twenty photos."""
    given_height: float = 0.05
    """Of a height that the user measured, with the error of the tilt."""
    known: float = 0.03
    """Of a length that the user measured."""
    shape: float = 0.18
    """Of an object's longest side as found in one photo, whose far side is not seen: measured on 79 rendered things."""
    common: float = 0.08
    """The same of all of them together: one way of lifting makes them all too deep, or too flat."""
    strange: float = 0.15
    """Share of labelled things that have another size: toys, models, pictures, wrong labels."""
    odd: float = 1.2
    """The same of their sizes."""


@dataclass(frozen=True, kw_only=True)
class LengthClue:
    """An object's longest side, found in the scene [its unit] and true [m]; ``sigma`` is its logarithm's standard
    error."""

    id: int
    name: str
    found: float
    true: float
    sigma: float
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

    The posterior's mean. A usual size is right, or its thing is one of few of quite another size. A given length is
    right, and then usual ones have no say."""
    model = model or ScaleModel()
    x = np.linspace(-REACH, REACH, STEPS)
    log_density = -0.5 * (x / (model.given_height if height_given else model.height)) ** 2
    given = [c for c in clues if c.given]
    for clue in given or (() if height_given else clues):
        off = x - math.log(clue.factor)
        if clue.given:
            log_density -= 0.5 * (off / model.known) ** 2
        else:
            log_density += np.log(_usual(off, math.hypot(clue.sigma, model.shape), model))
    weights = np.exp(log_density - log_density.max())
    weights /= weights.sum()
    mean = float(weights @ x)
    usual = 0.0 if height_given or not clues else model.common
    common = model.shape / math.sqrt(len(given)) if given else usual
    return SceneScale(factor=math.exp(mean), error=math.hypot(math.sqrt(float(weights @ (x - mean) ** 2)), common))


def _usual(off: Array, sigma: float, model: ScaleModel) -> Array:
    """Density of a usual size off by a logarithm: of its kind, or of the strange ones."""
    wide = math.hypot(sigma, model.odd)
    kind = (1 - model.strange) / sigma * np.exp(-0.5 * (off / sigma) ** 2)
    return kind + model.strange / wide * np.exp(-0.5 * (off / wide) ** 2)
