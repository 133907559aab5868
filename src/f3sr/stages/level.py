"""level: find the ground plane in the geometry, turn it up by one rotation and move it to z = 0 (equations 4 to 6).

Where a network estimated the geometry, its normals tell the focal length too."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.core.transforms import Array, pose, rotation_angle, rotation_between
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Geometry, Ground, Scene, SceneObject
from f3sr.settings import settings
from f3sr.vision.ground_plane import (
    ALIKE,
    LEAN,
    FocalLength,
    GroundNormal,
    GroundPlane,
    agreeing,
    combined,
    fit_plane,
    focal_length,
    normal_of,
    plane_errors,
)
from f3sr.vision.seen_through import HIGH, seen_through, without_depth_of
from f3sr.vision.silhouette import union_of

MAX_POINTS = 50_000
"""Most ground points used; more do not move the plane. The report samples as many."""
SEED = 0
"""Of the random choice of these points and of RANSAC's hypotheses."""
CENTER = 5e-3
"""One standard error of a principal point, which networks take for the middle [longer image sides]. In ten rendered
scenes it is .45 %."""
FLAT = 0.6
"""Least share of the ground's points on its plane: fewer may be no ground, as under an inverted ground.png. Of 720 runs
the least is .81."""
LOWER_REGION = 0.4
"""Share of the image height, from below, searched for ground where there is no ground mask."""


@settings
class LevelConfig:
    tolerance: Annotated[float, Interval(gt=0, le=0.1)] = 0.01
    """Largest distance of a ground point from the ground plane [share of the median ground depth]."""
    focal_sigma: Annotated[float, Interval(ge=0, le=0.3)] = 0.03
    """One standard error of an estimated geometry's focal length [share]. 0 takes it as exact."""


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
    """Not finite where nothing measured it, as the next."""
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
    rng = np.random.default_rng(SEED)
    points, normals, source = _ground_points(scene, rng)
    if len(points) < 3:
        return _lowest_vertex(scene)
    tolerance = config.tolerance * _depth(points)
    plane = fit_plane(points, rng, tolerance)
    agree, normals, agreement = agreeing(normals, plane.normal)
    seen, decisions = None, list[Decision]()
    if agreement >= 0.5:  # fewer agree with it than not: no vote
        seen = normal_of(points[agree], normals[agree], lean=_lean(scene.geometry))
        center = CENTER * max(scene.camera.width, scene.camera.height) / float(scene.camera.K[0, 0])
        focal = focal_length(points[agree], seen, center=center) if config.focal_sigma else None
        if focal:
            factor = 1.0 if focal.contradicts(config.focal_sigma) else focal.shrunk(config.focal_sigma)
            decisions.append(_focal_decision(scene, focal, factor))
            scene, points = _zoomed(scene, factor), points / [factor, factor, 1.0]
            plane = fit_plane(points, rng, tolerance)
    on_plane = np.abs(points @ plane.normal - plane.offset) < tolerance
    found, height_error = _weighed(scene, plane, points[on_plane], seen, config)
    height = -float(np.median(points[on_plane] @ found.normal))
    R_g = rotation_between(scene.camera.T_world_camera[:3, :3] @ found.normal, [0, 0, 1])
    T = pose(R_g, [0, 0, height - (R_g @ scene.camera.center)[2]])
    ground = Ground(
        source=source,
        confidence=plane.inliers,
        friction=scene.ground.friction,
        tilt_error=found.error,
        height_error=height_error,
    )
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
    reason = f"{100 * plane.inliers:.0f} % of {len(points)} points lie on it"
    decision = Decision(choice=f"ground plane from {source}", reason=reason, fallback=plane.inliers < FLAT)
    through = seen_through(moved, plane.residual)
    decisions += [_through_decision(id, height) for id, height in through.items()]
    return without_depth_of(moved, through), Levelled(fit=fit, decisions=(decision, *decisions, *_upside_down(plane)))


def _weighed(
    scene: Scene, plane: GroundPlane, points: Array, seen: GroundNormal | None, config: LevelConfig
) -> tuple[GroundNormal, float]:
    """The ground's normal by all evidence, and two standard errors of its height [m].

    Points (n, 3) on the plane and the normals ``seen`` weigh by their inverse variances. A wrong focal length turns
    estimated points, and shows in no residual. So without normals the error of an estimate is not known, unless it
    tells it."""
    measured, (tilt_error, height_error) = scene.has_measured_depth, plane_errors(points)
    if measured and seen is None:
        return GroundNormal(normal=plane.normal, error=tilt_error), height_error
    if seen is None:
        told = scene.geometry.up_error if scene.geometry else None
        return GroundNormal(normal=plane.normal, error=np.inf if told is None else told), np.inf
    cosine = min(1.0, abs(float(plane.normal[2])))
    by_focal = 0.0 if measured else 2 * config.focal_sigma * cosine * math.sqrt(1 - cosine**2)
    error = tilt_error if measured else math.hypot(ALIKE * tilt_error, by_focal)
    both = combined(GroundNormal(normal=plane.normal, error=error), seen)
    return both, height_error if measured else np.inf


def _focal_decision(scene: Scene, focal: FocalLength, factor: float) -> Decision:
    was = float(scene.camera.K[0, 0])
    if factor == 1.0:
        reason = f"points and normals of the ground agree at {focal.factor * was:.0f} px only, which is too far off"
        return Decision(choice=f"focal length {was:.0f} px kept", reason=reason, fallback=True)
    agree = f"points and normals of the ground agree at {focal.factor * was:.0f} px +- {100 * focal.error:.1f} %"
    return Decision(choice=f"focal length {was:.0f} -> {factor * was:.0f} px", reason=agree)


def _through_decision(id: int, height: float) -> Decision:
    reason = (
        f"it shows the ground through the object: {HIGH} % of it are at most {1000 * height:.0f} mm over the ground"
    )
    return Decision(choice="its depth is left out", reason=reason, about=id, fallback=True)


def _zoomed(scene: Scene, factor: float) -> Scene:
    """The scene under another focal length: depths, and places and sizes in the picture, stay."""
    camera, geometry = scene.camera.zoomed(factor), scene.geometry and scene.geometry.zoomed(factor)
    objects = list[SceneObject]()
    for o in scene:
        T_camera_object = camera.T_camera_world @ o.T_world_object
        T_camera_object[:2, 3] /= factor
        objects.append(replace(o, T_world_object=camera.T_world_camera @ T_camera_object, scale=o.scale / factor))
    return replace(scene, camera=camera, geometry=geometry, objects=tuple(objects))


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


def _ground_points(scene: Scene, rng: np.random.Generator) -> tuple[Array, Array, str]:
    """Ground points and unit normals (n, 3) in the camera frame, normals not finite where there is none, and where they
    come from."""
    geometry = scene.geometry
    if geometry is None:
        return np.zeros((0, 3)), np.zeros((0, 3)), "none"
    if scene.ground_mask is not None and geometry.inside(scene.ground_mask).any():
        where, source = geometry.inside(scene.ground_mask), "ground mask"
    else:
        where, source = _lower_region(scene, geometry), "lower image region"
    index = np.flatnonzero(where.ravel())
    if len(index) > MAX_POINTS:
        index = np.sort(rng.choice(index, MAX_POINTS, replace=False))
    points = geometry.points.reshape(-1, 3)[index].astype(float)
    if geometry.normals is None:
        return points, np.full_like(points, np.nan), source
    normals = geometry.normals.reshape(-1, 3)[index].astype(float)
    lengths = np.linalg.norm(normals, axis=1)
    lengths[~(lengths > 0.5)] = np.nan
    return points, normals / lengths[:, None], source


def _lean(geometry: Geometry | None) -> float:
    """Two standard errors of the normals that are alike in all places [rad]."""
    return LEAN if geometry is None or geometry.normals_error is None else 2 * geometry.normals_error


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
