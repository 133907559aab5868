"""level: find the ground plane in the geometry, turn it up by one rotation and move it to z = 0 (equations 4 to 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.core.transforms import Array, pose, rotation_angle, rotation_between
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Geometry, Ground, Scene
from f3sr.settings import settings
from f3sr.vision.silhouette import union_of

GROUPS = 4
"""Strips along each of two axes that split the ground's points into groups for the jackknife: 16 in all."""


MAX_POINTS = 50_000
"""Most ground points used; more do not move the plane. The report samples as many."""
HYPOTHESES = 400
"""RANSAC planes tried. With half the points on the plane all of them miss it with p < 1e-23."""
NORMAL_ANGLE = math.radians(35)
"""Largest angle [rad] between the plane's normal and a surface normal that votes."""
NORMAL_WEIGHT = 0.55
"""Lambda of equation 5: weight of the surface normals against the plane's."""
LOWER_REGION = 0.4
"""Share of the image height, from below, searched for ground where there is no ground mask."""


@settings
class LevelConfig:
    seed: Annotated[int, Interval(ge=0)] = 0
    """Seed of the random choice of ground points."""
    tolerance: Annotated[float, Interval(gt=0, le=0.1)] = 0.01
    """Largest distance of a ground point from the ground plane [share of the median ground depth]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundPlane:
    """``normal . x = offset`` in the camera frame; ``inliers`` is the share of points on it, ``residual`` [m] their
    root mean square distance."""

    normal: Array
    offset: float
    inliers: float
    residual: float


@dataclass(frozen=True, kw_only=True)
class GroundFit:
    """How well the ground plane is known: shares of 1, angles [rad], lengths [m]."""

    tilt: float
    """Removed by levelling."""
    inliers: float
    """Of the ground's points."""
    residual: float
    agreement: float
    """Share of the normals that agree with the plane's."""
    lowest: float
    """Height of the lowest vertex."""
    tilt_error: float
    """Not finite where it was not measured, as the next."""
    height_error: float


@dataclass(frozen=True, kw_only=True)
class Levelled(Outcome):
    stage: ClassVar[str] = "level"
    fit: GroundFit | None = None
    """None without ground points."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return _measures(self.fit) if self.fit else ()


def level(scene: Scene, config: LevelConfig | None = None) -> tuple[Scene, Levelled]:
    """Turn and shift the whole scene, camera included, so that the support surface is z = 0 (equations 4 to 6).

    Without any ground point the scene's lowest vertex becomes z = 0, a fallback.
    """
    config = config or LevelConfig()
    rng = np.random.default_rng(config.seed)
    points, normals, source = _ground_points(scene, rng)
    if len(points) < 3:
        return _lowest_vertex(scene)
    plane = fit_plane(points, rng, config)
    normal_camera, agreement = vote(plane.normal, normals)
    on_plane = np.abs(points @ plane.normal - plane.offset) < config.tolerance * _depth(points)
    height = -float(np.median(points[on_plane] @ normal_camera))
    R_g = rotation_between(scene.camera.T_world_camera[:3, :3] @ normal_camera, [0, 0, 1])
    T = pose(R_g, [0, 0, height - (R_g @ scene.camera.center)[2]])
    ground = Ground(source=source, confidence=plane.inliers, friction=scene.ground.friction)
    if scene.has_measured_depth:
        tilt_error, height_error = plane_errors(points[on_plane])
        ground = replace(ground, tilt_error=tilt_error, height_error=height_error)
    moved = _move_all(scene, T, ground)
    lowest = min(o.bounds_world[0, 2] for o in moved)
    fit = GroundFit(
        tilt=rotation_angle(R_g),
        inliers=plane.inliers,
        residual=plane.residual,
        agreement=agreement,
        lowest=float(lowest),
        tilt_error=ground.tilt_error,
        height_error=ground.height_error,
    )
    decision = Decision(choice=f"ground plane from {source}", reason=f"{len(points)} points")
    return moved, Levelled(fit=fit, decisions=(decision, *_upside_down(plane)))


def fit_plane(points: Array, rng: np.random.Generator, config: LevelConfig) -> GroundPlane:
    """Robust plane through points (n, 3) in camera axes, its normal towards the camera, which sees its upper side
    (equation 4).

    RANSAC finds the points on the plane; SVD about their median refines it, twice, so that strays have no weight.
    """
    tolerance = config.tolerance * _depth(points)
    sample = points[rng.choice(len(points), min(len(points), 2000), replace=False)]
    a, b, c = (points[rng.integers(len(points), size=HYPOTHESES)] for _ in range(3))
    normals = np.cross(b - a, c - a)
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
    center = points.mean(0)
    axes = np.linalg.svd((points - center).T @ (points - center))[0]
    u, v, height = ((points - center) @ axes).T
    strip = _ranks(u) * GROUPS // len(points)
    rows = np.column_stack([u, v, np.ones_like(u)])
    groups = strip * GROUPS
    for k in range(GROUPS):
        groups[strip == k] += _ranks(v[strip == k]) * GROUPS // np.count_nonzero(strip == k)
    fits: list[Array] = []
    for k in np.unique(groups):
        left = groups != k
        fits.append(np.linalg.lstsq(rows[left], height[left])[0])
    G = len(fits)
    slope_u, slope_v, offset = np.sqrt((G - 1) / G * ((np.array(fits) - np.mean(fits, axis=0)) ** 2).sum(0))
    return 2 * float(np.hypot(slope_u, slope_v)), 2 * float(offset)


def _ranks(values: Array) -> NDArray[np.int64]:
    """The place of each value (n,) in their ascending order."""
    return np.argsort(np.argsort(values, kind="stable"))


def _measures(fit: GroundFit) -> tuple[Measure, ...]:
    errors = (
        Measure(name="ground tilt error", after=np.degrees(fit.tilt_error), unit="deg"),
        Measure(name="ground height error", after=1000 * fit.height_error, unit="mm"),
    )
    return (
        Measure(name="tilt removed", after=np.degrees(fit.tilt), unit="deg"),
        Measure(name="ground points on the plane", after=100 * fit.inliers, unit="%"),
        Measure(name="ground residual", after=1000 * fit.residual, unit="mm"),
        *(errors if np.isfinite(fit.tilt_error) else ()),
        Measure(name="normals that agree", after=100 * fit.agreement, unit="%"),
        Measure(name="lowest vertex", after=1000 * fit.lowest, unit="mm"),
    )


def _upside_down(plane: GroundPlane) -> list[Decision]:
    """A warning where up in the scene is down in the photo."""
    if plane.normal[1] <= 0:
        return []
    reason = "the ground's upper side, which the camera sees, faces the photo's lower edge"
    return [Decision(choice="the photo is taken as upside down, or as looking up", reason=reason, fallback=True)]


def vote(normal: Array, normals: Array | None) -> tuple[Array, float]:
    """Blend the plane's normal with the median of the surface normals that agree with it (equation 5).

    Returns the unit normal and the share of normals within ``NORMAL_ANGLE``. Fewer than half agreeing: no vote.
    """
    if normals is None or not len(normals):
        return normal, 0.0
    cosines = normals @ normal
    normals = np.where(cosines[:, None] < 0, -normals, normals)
    agree = np.abs(cosines) > np.cos(NORMAL_ANGLE)
    share = float(agree.mean())
    if share < 0.5:
        return normal, share
    median = np.median(normals[agree], axis=0)
    blended = (1 - NORMAL_WEIGHT) * normal + NORMAL_WEIGHT * median / np.linalg.norm(median)
    return blended / np.linalg.norm(blended), share


def _ground_points(scene: Scene, rng: np.random.Generator) -> tuple[Array, Array | None, str]:
    """Ground points (n, 3) and normals in the camera frame, and where they come from."""
    geometry = scene.geometry
    if geometry is None:
        return np.zeros((0, 3)), None, "none"
    if scene.ground_mask is not None and geometry.inside(scene.ground_mask).any():
        where, source = geometry.inside(scene.ground_mask), "ground mask"
    else:
        where, source = _lower_region(scene, geometry), "lower image region"
    index = np.flatnonzero(where.ravel())
    if len(index) > MAX_POINTS:
        index = np.sort(rng.choice(index, MAX_POINTS, replace=False))
    points = geometry.points.reshape(-1, 3)[index].astype(float)
    if geometry.normals is None:
        return points, None, source
    normals = geometry.normals.reshape(-1, 3)[index].astype(float)
    lengths = np.linalg.norm(normals, axis=1)
    good = np.isfinite(lengths) & (lengths > 0.5)
    return points, normals[good] / lengths[good, None], source


def _lower_region(scene: Scene, geometry: Geometry) -> NDArray[np.bool_]:
    objects = union_of((o.mask for o in scene), (scene.photo.height, scene.photo.width))
    region = np.zeros_like(objects)
    region[round((1 - LOWER_REGION) * scene.photo.height) :] = True
    return geometry.inside(region & ~objects)


def _depth(points: Array) -> float:
    return float(np.median(points[:, 2]))


def _move_all(scene: Scene, T: Array, ground: Ground) -> Scene:
    """Move the camera and every object by one rigid world transform; the picture stays as it was."""
    camera = scene.camera.moved(T @ scene.camera.T_world_camera)
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in scene)
    return replace(scene, camera=camera, objects=objects, ground=ground)


def _lowest_vertex(scene: Scene) -> tuple[Scene, Levelled]:
    lowest = min(o.bounds_world[0, 2] for o in scene)
    ground = Ground(source="lowest vertex", confidence=0.0, friction=scene.ground.friction)
    moved = _move_all(scene, pose(t=[0, 0, -lowest]), ground)
    decision = Decision(
        choice="the lowest vertex is the ground; the camera is taken as level",
        reason="no valid ground point",
        fallback=True,
    )
    return moved, Levelled(decisions=(decision,))
