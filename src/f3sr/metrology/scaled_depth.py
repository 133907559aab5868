"""Depths up to one factor made absolute: the ground's points lie a known height below the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.vision.ground_plane import fit_plane, plane_errors

POINTS = 20_000
"""Most points of the ground that a plane is fitted to."""
TOLERANCE = 0.02
"""Largest distance of a ground point from the plane [share of the median ground depth]: twice what ``level`` allows, as
a network without metres also bends planes."""
LEAST_POINTS = 64
LEAST_SHARE = 0.5
"""Least share of the ground's points on one plane: of fewer no plane is the ground."""


@dataclass(frozen=True, kw_only=True)
class DepthScale:
    """The factor on depths that puts the ground at its known height below the camera."""

    factor: float
    error: float
    """One jackknife error, as a share."""
    inliers: float
    """Share of the ground's points on the plane."""


def fit_scale(points: NDArray[np.floating], height: float, where: str) -> DepthScale:
    """The factor for points (n, 3) of the ground in the camera frame and the camera's ``height`` above it.

    Raises InputError, which names ``where`` they come from, for too few points and for points on no plane."""
    rng = np.random.default_rng(0)
    if len(points) < LEAST_POINTS:
        raise _unfit(where, f"{len(points)} points of the ground", f"at least {LEAST_POINTS}")
    chosen: Array = points.astype(float)
    if len(chosen) > POINTS:
        chosen = chosen[np.sort(rng.choice(len(chosen), POINTS, replace=False))]
    tolerance = TOLERANCE * float(np.median(chosen[:, 2]))
    plane = fit_plane(chosen, rng, tolerance)
    found = -plane.offset
    if plane.inliers < LEAST_SHARE or not found > tolerance:
        said = f"{100 * plane.inliers:.0f} % of the ground's points on a plane, {found:.3g} below the camera"
        raise _unfit(where, said, f"at least {100 * LEAST_SHARE:.0f} % on one that the camera is above")
    on_plane = chosen[np.abs(chosen @ plane.normal - plane.offset) < tolerance]
    tilt, amid = plane_errors(on_plane)
    # The plane's height below the camera turns with its normal, about the middle of its points.
    away = float(np.linalg.norm(np.median(on_plane, axis=0)))
    error = float(np.hypot(amid, tilt * away)) / 2 / found
    return DepthScale(factor=height / found, error=error, inliers=plane.inliers)


def _unfit(where: str, found: str, accepted: str) -> InputError:
    return InputError(where, found=found, accepted=f"{accepted}, to give its depths a scale")
