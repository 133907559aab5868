"""Levenberg-Marquardt inside a box, on an objective that gives its value, gradient and curvature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array

SMALLEST_STEP = 1e-6
"""Least step, as a share of the box's width per parameter: below it the search has arrived."""
DAMPING = (1e-6, 1e-3, 1e3)
"""Least, first and most damping, as a share of the curvature's diagonal."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Local:
    """An objective near a point: ``value``, ``gradient`` (p,), positive semidefinite ``curvature`` (p, p)."""

    value: float
    gradient: Array
    curvature: Array

    def __add__(self, other: Local) -> Local:
        """The sum of two objectives at the same point."""
        return Local(
            value=self.value + other.value,
            gradient=self.gradient + other.gradient,
            curvature=self.curvature + other.curvature,
        )

    def weighted(self, weight: float) -> Local:
        """The objective times ``weight``."""
        return Local(value=weight * self.value, gradient=weight * self.gradient, curvature=weight * self.curvature)

    def plus_squares(self, weights: Array, x: Array) -> Local:
        """The objective with a quadratic prior sum(weights * x^2) added."""
        return Local(
            value=self.value + float(weights @ x**2),
            gradient=self.gradient + 2 * weights * x,
            curvature=self.curvature + np.diag(2 * weights),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Minimum:
    """Where a search ended, at ``x`` (p,)."""

    x: Array
    value: float


def minimise(
    objective: Callable[[Array], Local],
    start: Array,
    *,
    bounds: tuple[Array, Array],
    iterations: int = 15,
    tolerance: float = 1e-5,
) -> Minimum:
    """The least value reached from ``start`` (p,) with lower and upper ``bounds`` (p,), each step accepted only if
    the objective falls (Marquardt 1963, with steps clipped to the box and bounds that press outward held).

    Ends after ``iterations`` trials, or when a step gains less than ``tolerance``.
    """
    low, high = bounds
    least, damping, most = DAMPING
    x = np.clip(start, low, high)
    here = objective(x)
    for _ in range(iterations):
        # A bound holds a parameter while the descent direction points out of the box.
        free = ~(((x <= low) & (here.gradient > 0)) | ((x >= high) & (here.gradient < 0)))
        trial = np.clip(x + _step(here, free, damping), low, high)
        if not np.any(np.abs(trial - x) > SMALLEST_STEP * (high - low)):
            break
        there = objective(trial)
        if there.value < here.value:
            gain = here.value - there.value
            x, here, damping = trial, there, max(0.3 * damping, least)
            if gain < tolerance:
                break
        else:
            # At least 1e-2: from the least damping, eight-fold steps would take five rejected trials to get there.
            damping = max(8 * damping, 1e-2)
            if damping > most:
                break
    return Minimum(x=x, value=here.value)


def _step(here: Local, free: NDArray[np.bool_], damping: float) -> Array:
    """The damped Newton step (p,) in the free directions, 0 in the others."""
    step = np.zeros(len(free))
    if free.any():
        H = here.curvature[np.ix_(free, free)]
        # Marquardt's scaling: damping by the diagonal does not depend on the parameters' units.
        D = np.diag(np.diag(H) + 1e-12)
        step[free] = -np.linalg.solve(H + damping * D, here.gradient[free])
    return step
