"""The ground plane in the camera frame: what points say, what normals say, how well, and for which focal length.

A network estimates points and normals apart. A wrong focal length turns the plane of the points, as it stretches them
across the optical axis; normals do not depend on it. So the two planes agree for the right focal length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, cross

GROUPS = 4
"""Strips along each of two axes that split the ground's points into groups for the jackknife: 16 in all."""
ALIKE = 2.0
"""Factor on jackknife errors of estimated points, whose errors reach across groups. In eleven scenes focal lengths
were off by 1.98 of their jackknife errors, root mean square."""
HYPOTHESES = 400
"""RANSAC planes tried. With half the points on the plane all of them miss it with p < 1e-23."""
NORMAL_ANGLE = math.radians(35)
"""Largest angle [rad] between the plane's normal and a surface normal that votes."""
TRIMMED = 3.0
"""Residual, in robust standard deviations, from which on a point is not of the plane: at edges depths are mixed."""
TRIMS = 3
"""Rounds of trimming."""
LEAN = math.radians(0.6)
"""Two standard errors of a network's normals that are alike in all places, so that no spread shows them. Not measured:
a bound on what normals of the ground may decide, which are good to .03 degrees in the ten rendered scenes."""
POSE_LEAN = math.radians(6)
"""Standard deviation of the lean of a generated pose about each horizontal axis [rad], by which objects tell the
ground's normal: up to ten degrees occur."""
BEYOND = 3.0
"""Standard errors by which a focal length that points and normals tell may be off the given one."""
LEAST_POINTS = 64
"""Least number of points that tell a focal length."""
LEAST_EXTENT = 0.01
"""Least extent of the points that tell a focal length, across, as a share of their distance."""
LEAST_TILT = math.radians(5)
"""Least angle [rad] of the ground's normal to the optical axis at which it tells the focal length."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundPlane:
    """``normal . x = offset`` in the camera frame; ``inliers`` is the share of points on it, ``residual`` [m] their
    root mean square distance."""

    normal: Array
    offset: float
    inliers: float
    residual: float


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundNormal:
    """A unit normal (3,) in the camera frame and two standard errors of it [rad]."""

    normal: Array
    error: float


@dataclass(frozen=True, kw_only=True)
class FocalLength:
    """The factor on a focal length for which points and normals have one ground plane, and one standard error of its
    logarithm."""

    factor: float
    error: float

    def contradicts(self, sigma: float) -> bool:
        """Whether it is farther from 1 than it may be: ``BEYOND`` standard errors of both together."""
        return abs(math.log(self.factor)) > BEYOND * math.hypot(sigma, self.error)

    def shrunk(self, sigma: float) -> float:
        """The factor, weighed against 1 with a standard error ``sigma`` of the logarithm (inverse variances)."""
        return self.factor ** (sigma**2 / (sigma**2 + self.error**2))


def fit_plane(points: Array, rng: np.random.Generator, tolerance: float) -> GroundPlane:
    """Robust plane through points (n, 3) in camera axes, its normal towards the camera, which sees its upper side
    (equation 4).

    RANSAC finds the points within ``tolerance`` [m]; SVD about their median refines it, twice, so that strays have no
    weight.
    """
    sample = points[rng.choice(len(points), min(len(points), 2000), replace=False)]
    a, b, c = (points[rng.integers(len(points), size=HYPOTHESES)] for _ in range(3))
    normals = cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 1e-12)
    offsets = np.einsum("ij,ij->i", normals, a)
    votes = (np.abs(sample @ normals.T - offsets) < tolerance).sum(0) * (lengths[:, 0] > 1e-12)
    best = int(np.argmax(votes))
    normal, offset = normals[best], offsets[best]
    on_plane = np.abs(points @ normal - offset) < tolerance
    for _ in range(3):
        inliers = points[on_plane]
        center = np.median(inliers, axis=0)
        normal = np.linalg.svd(inliers - center, full_matrices=False)[2][2]
        offset = float(np.median(inliers @ normal))
        distance = np.abs(points @ normal - offset)
        spread = 1.4826 * float(np.median(distance[on_plane]))
        on_plane = distance < np.clip(3 * spread, 0.1 * tolerance, tolerance)
    if offset > 0:
        normal, offset = -normal, -offset
    share = float((np.abs(points @ normal - offset) < tolerance).mean())
    residual = float(np.sqrt(np.mean((points[on_plane] @ normal - offset) ** 2)))
    return GroundPlane(normal=normal, offset=offset, inliers=share, residual=residual)


def plane_errors(points: Array) -> tuple[float, float]:
    """Two standard errors of a plane fitted to points (n, 3): of its normal [rad] and of its height amid them [m].

    Delete-a-group jackknife (Efron 1982) over ``GROUPS`` squared contiguous groups of equally many points: neighbours
    have like errors, so the residual over the square root of n would be far too small.
    """
    u, v, height = _axes(points)
    groups = _groups(u, v)
    rows = np.column_stack([u, v, np.ones_like(u)])
    fits = [np.linalg.lstsq(rows[groups != k], height[groups != k])[0] for k in np.unique(groups)]
    slope_u, slope_v, offset = _jackknife_errors(np.array(fits))
    return 2 * float(np.hypot(slope_u, slope_v)), 2 * float(offset)


def agreeing(normals: Array, normal: Array) -> tuple[NDArray[np.bool_], Array, float]:
    """Which surface normals (n, 3) lie within ``NORMAL_ANGLE`` of a plane's, all of them turned to its side, and their
    share. Rows that are not finite do not vote."""
    cosines = normals @ normal
    known = np.isfinite(cosines)
    agree = known & (np.abs(cosines) > np.cos(NORMAL_ANGLE))
    share = float(agree.sum() / max(1, known.sum()))
    return agree, np.where(cosines[:, None] < 0, -normals, normals), share


def normal_of(points: Array, normals: Array, *, lean: float = LEAN) -> GroundNormal:
    """The median of surface normals (n, 3) at points (n, 3). Its error is the spread of the medians of contiguous
    groups, and ``lean``, two standard errors [rad]: what a network gets wrong in one place it may get wrong in all."""
    groups = _groups(*_axes(points)[:2])
    medians = np.array([_unit(np.median(normals[groups == k], axis=0)) for k in np.unique(groups)])
    error = float(np.linalg.norm(medians.std(0, ddof=1))) if len(medians) > 1 else np.inf
    return GroundNormal(normal=_unit(np.median(normals, axis=0)), error=math.hypot(2 * error, lean))


def combined(one: GroundNormal, other: GroundNormal) -> GroundNormal:
    """Two normals weighed by inverse variances (in place of the fixed weight of equation 5)."""
    a, b = max(one.error, 1e-9), max(other.error, 1e-9)
    share = 1 / (1 + (a / b) ** 2)
    return GroundNormal(
        normal=_unit(share * one.normal + (1 - share) * other.normal), error=1 / math.sqrt(a**-2 + b**-2)
    )


def focal_length(points: Array, normal: GroundNormal, *, center: float = 0.0) -> FocalLength | None:
    """The factor on the focal length of points (n, 3) in camera axes for which their plane has a normal (3,).

    x and y of the points go with 1 / factor, so the tangent of the plane's angle to the image plane goes with factor.
    The plane is a . p = 1 with least relative residuals: noise of depths is in proportion to them. The error is that of
    the jackknife, of the normal, and of the principal point, ``center`` [rad], which turns the rays. None where the
    camera looks straight down on the ground, or along it, and where points are few or not on a plane.
    """
    tangent = float(np.hypot(*normal.normal[:2]) / max(abs(normal.normal[2]), 1e-9))
    if not math.tan(LEAST_TILT) < tangent < 1 / math.tan(LEAST_TILT):
        return None
    kept = np.ones(len(points), bool)
    a = np.zeros(3)
    for _ in range(TRIMS):
        a = _relative_plane(points[kept])
        residuals = np.abs(points @ a - 1)
        kept = residuals < TRIMMED * 1.4826 * np.median(residuals) + 1e-9
    points = points[kept]
    if len(points) < LEAST_POINTS or np.linalg.cond(points) > 1 / LEAST_EXTENT:
        return None
    groups = _groups(*_axes(points)[:2])
    fits = np.array([a, *(_relative_plane(points[groups != k]) for k in np.unique(groups))])
    slopes = np.log(np.hypot(fits[:, 0], fits[:, 1]) / np.maximum(np.abs(fits[:, 2]), 1e-12))
    (error,) = _jackknife_errors(slopes[1:, None])
    if not (np.isfinite(slopes[0]) and np.isfinite(error)):
        return None
    from_normal = normal.error / 2 * (tangent + 1 / tangent)
    return FocalLength(
        factor=tangent / math.exp(slopes[0]), error=math.hypot(ALIKE * float(error), from_normal, tangent * center)
    )


def _relative_plane(points: Array) -> Array:
    """a (3,) with a . p = 1 for points (n, 3), least squares."""
    return np.linalg.lstsq(points, np.ones(len(points)))[0].astype(np.float64)


def _axes(points: Array) -> Array:
    """Coordinates (3, n) of points (n, 3) about their mean, along the axes in which they extend, farthest first."""
    centred = points - points.mean(0)
    return (centred @ np.linalg.svd(centred.T @ centred)[0]).T


def _groups(u: Array, v: Array) -> NDArray[np.int64]:
    """The contiguous group (n,) of each of n points, by two coordinates (n,) of them."""
    strip = _ranks(u) * GROUPS // len(u)
    groups = strip * GROUPS
    for k in range(GROUPS):
        groups[strip == k] += _ranks(v[strip == k]) * GROUPS // max(1, np.count_nonzero(strip == k))
    return groups


def _ranks(values: Array) -> NDArray[np.int64]:
    """The place of each value (n,) in their ascending order."""
    return np.argsort(np.argsort(values, kind="stable"))


def _jackknife_errors(fits: Array) -> Array:
    """One standard error of each column of fits (groups, k), each without one group."""
    G = len(fits)
    return np.sqrt((G - 1) / G * ((fits - fits.mean(0)) ** 2).sum(0))


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)
