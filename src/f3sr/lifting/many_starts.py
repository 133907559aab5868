"""Robust least squares from many starts at once: all starts take their steps in the same arrays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from f3sr.core.transforms import Array

Residuals = Callable[[Array], Array]
"""Residuals (s, m) in standard errors, for parameters (s, p)."""

BEHIND_CAMERA = 1e3
"""Residual of a shape that reaches behind the camera."""
STEP = 1e-4
"""Step of the numeric derivatives: parameters are of the order of one."""
DAMPING = (1e-4, 1e-2, 1e4)
"""Least, first and most damping, as a share of the curvature's diagonal."""


def cost(residuals: Array) -> Array:
    """Sum (s,) of the soft l1 loss of residuals (s, m): a few far outliers do not pull."""
    return (2 * (np.sqrt(1 + residuals**2) - 1)).sum(1)


def gaussian(errors: Array) -> Array:
    """Residuals whose ``cost`` is the square of ``errors``: no outliers, as what is known before."""
    return errors * np.sqrt(1 + errors**2 / 4)


def refined(residuals: Residuals, x: Array, *, iterations: int) -> tuple[Array, Array]:
    """Parameters (s, p) from starts ``x`` (s, p) after some Levenberg-Marquardt steps, each start with damping of its
    own (Marquardt 1963), and their costs (s,)."""
    here = residuals(x)
    value = cost(here)
    damping = np.full(len(x), DAMPING[1])
    for _ in range(iterations):
        J = _jacobian(residuals, x, here)
        weights = 1 / np.sqrt(1 + here**2)
        gradient = np.einsum("smp,sm->sp", J, weights * here)
        curvature = np.einsum("smp,sm,smq->spq", J, weights, J)
        diagonal = np.einsum("spp->sp", curvature)
        eye = np.eye(x.shape[1])
        damped = curvature + eye * (damping[:, None] * diagonal + 1e-9)[:, None]
        trial = x - np.clip(np.linalg.solve(damped, gradient[..., None])[..., 0], -0.5, 0.5)
        there = residuals(trial)
        reached = cost(there)
        better = reached < value
        x, here = np.where(better[:, None], trial, x), np.where(better[:, None], there, here)
        gained = value - reached
        value = np.where(better, reached, value)
        damping = np.clip(np.where(better, damping / 5, damping * 5), DAMPING[0], DAMPING[2])
        if not (better & (gained > 1e-4 * value)).any() and (damping > 1).all():
            break
    return x, value


def _jacobian(residuals: Residuals, x: Array, here: Array) -> Array:
    """Derivatives (s, m, p) by forward differences."""
    s, p = x.shape
    moved = (x[:, None] + STEP * np.eye(p)).reshape(s * p, p)
    return np.moveaxis((residuals(moved).reshape(s, p, -1) - here[:, None]) / STEP, 1, 2)
