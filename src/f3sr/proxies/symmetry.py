"""The axis of a surface that is nearly one of revolution: a bowl, a plate, a can, a pan but for its handle.

All normals of a surface of revolution meet its axis. That is linear in the axis' Plücker coordinates (Pottmann,
Randrup: Rotational and helical surface approximation for reverse engineering, Computing 60, 1998). What does not
belong to it, as a handle, gets little weight in the next round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.proxies.surface import Samples

ROUNDS = 12
"""Rounds of weighted least squares."""
NEAR = 0.012
"""Distance from the axis within which a normal meets it [size]: bumps turn normals."""
TELLING = 0.3
"""Sine between a normal and the axis from which on the normal tells where the axis is."""
LEAST_TELLING = 0.2
"""Least share of the surface with such normals; a flat box has few."""
MEETING = 0.35
"""Least share of those that meet the axis. A proposal is all that follows from it: parts compete by their loss."""
BINS = 12
"""Sectors about the axis, all but one of which must hold some of the surface."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Axis:
    """A line through ``point`` (3,) along the unit ``direction`` (3,), and a typical large radius about it."""

    point: Array
    direction: Array
    radius: float

    def fan(self, count: int) -> Array:
        """Unit normals (count, 3) of half planes that start at the axis, evenly around it."""
        across = np.cross(self.direction, np.eye(3)[int(np.argmin(np.abs(self.direction)))])
        u: Array = np.asarray(across / np.linalg.norm(across), np.float64)
        v: Array = np.cross(self.direction, u)
        angles: Array = 2 * np.pi * np.arange(count)[:, None] / count
        return np.cos(angles) * u + np.sin(angles) * v

    def surrounds(self, points: Array) -> bool:
        """Whether points (n, 3) lie all around the axis."""
        u, v = self.fan(4)[:2]
        angles = np.arctan2((points - self.point) @ v, (points - self.point) @ u)
        return len(np.unique(np.floor(angles / (2 * np.pi) * BINS))) >= BINS - 1


def axis_of(samples: Samples) -> Axis | None:
    """The axis of revolution of a sampled surface; None where it has none."""
    # Directions as first guesses: the frame's and the body's. Each guess weighs normals by where they meet it.
    centered = samples.points - samples.points.mean(0)
    guesses = [*np.eye(3), *np.linalg.svd(centered, full_matrices=False)[2]]
    found = [_fitted(samples, guess) for guess in guesses]
    shares = [_share(samples, axis) for axis in found]
    best = int(np.argmax(shares))
    if shares[best] < MEETING or not found[best].surrounds(
        samples.points[_meets(samples, found[best].point, found[best].direction)]
    ):
        return None
    return found[best]


def _fitted(samples: Samples, guess: Array) -> Axis:
    """The axis that most normals meet, starting at a guessed direction (3,)."""
    normals, moments = samples.normals, np.cross(samples.points, samples.normals)
    rows = np.hstack([moments, normals])
    telling = np.linalg.norm(np.cross(normals, guess), axis=1)
    direction, point = guess, _crossing(samples, guess, telling)
    for _ in range(ROUNDS):
        off = _off(samples, point, direction)
        weight = 1 / (1 + (off / max(NEAR, float(np.median(off)))) ** 2)
        line = np.linalg.eigh(np.einsum("n,ni,nj->ij", weight, rows, rows))[1][:, 0]
        if (length := float(np.linalg.norm(line[:3]))) < 1e-6:
            break
        a, b = line[:3] / length, line[3:] / length
        if abs(a @ direction) < 0.5:  # another solution, as of a ball
            break
        direction, point = a, np.cross(a, b)
    return Axis(point=point, direction=direction, radius=_radius(samples, point, direction))


def _crossing(samples: Samples, u: Array, weight: Array) -> Array:
    """The point (3,) nearest to all normals, seen along ``u``."""
    across = np.cross(samples.normals, u)
    A = np.einsum("n,ni,nj->ij", weight, across, across) + np.outer(u, u)
    return np.linalg.solve(A, np.einsum("n,ni,n->i", weight, across, np.einsum("ni,ni->n", across, samples.points)))


def _off(samples: Samples, point: Array, direction: Array) -> Array:
    """How far normals pass the axis (n,) [size], times the sine between them."""
    return np.abs(np.cross(samples.points - point, samples.normals) @ direction)


def _meets(samples: Samples, point: Array, direction: Array) -> NDArray[np.bool_]:
    """Which normals (n,) tell where the axis is and meet it."""
    sine = np.linalg.norm(np.cross(samples.normals, direction), axis=1)
    return (_off(samples, point, direction) <= NEAR) & (sine > TELLING)


def _share(samples: Samples, axis: Axis) -> float:
    """Of the normals that tell where the axis is, how many meet it; 0 where too few tell."""
    sine = np.linalg.norm(np.cross(samples.normals, axis.direction), axis=1)
    telling = sine > TELLING
    meets = _meets(samples, axis.point, axis.direction)
    return float(meets.sum() / telling.sum()) if telling.mean() >= LEAST_TELLING else 0.0


def _radius(samples: Samples, point: Array, direction: Array) -> float:
    """The distance from the axis within which 80% lies of what meets it: a rim, but no handle."""
    some = samples.points[_meets(samples, point, direction)] - point
    return float(np.quantile(np.linalg.norm(np.cross(some, direction), axis=1), 0.8)) if len(some) else 0.0
