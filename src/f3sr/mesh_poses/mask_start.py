"""Where an object stands by its mask and what the geometry sees there, whatever its pose: the start of a search."""

from __future__ import annotations

import math

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, pose
from f3sr.scene import Geometry, SceneObject
from f3sr.vision.depth_prior import GEOMETRY_PIXELS
from f3sr.vision.silhouette import Mask

LEAST_SLOPE = 1e-3
"""Of a ray that meets the ground, down over forward."""
LEAST_DISTANCE = 0.01
"""Of an object whose distance nothing tells [m]."""
SAMPLES = 1_000
"""Points of a mesh whose spread is compared with the geometry's."""
STRAYS = (2, 98)
"""Percentiles beyond which points are drawn in, along every axis: masks leak onto what lies behind."""


def at_its_mask(
    o: SceneObject, geometry: Geometry | None, camera: Camera, *, stage: str, reason: str = ""
) -> SceneObject:
    """An object, turned as it is, at its mask and of the mask's size; ``camera`` is in a world whose z = 0 is the
    ground."""
    depth = seen_distance(o.mask, geometry, camera)
    rows, columns = np.nonzero(o.mask)
    seen = math.hypot(np.ptp(rows) + 1, np.ptp(columns) + 1) * depth / float(camera.K[0, 0])
    points = seen_points(o.mask, geometry)
    spread = 0.0 if points is None else _spread(points) / _spread(_surface(o))
    # Both are least sizes: what points away from the camera is short in the picture, what is hidden in both.
    scale = max(seen / o.size, spread)
    ray = np.linalg.solve(camera.K, [columns.mean() + 0.5, rows.mean() + 0.5, 1.0])
    # The geometry shows the front: the middle is behind it by about a third of the size.
    middle = camera.T_world_camera[:3, :3] @ (ray * (depth + seen / 3)) + camera.center
    return o.moved(pose(t=middle - scale * o.middle), scale=scale, stage=stage, reason=reason)


def seen_distance(mask: Mask, geometry: Geometry | None, camera: Camera) -> float:
    """Depth of what a mask (H, W) shows [m]: the geometry's in it, else the ground's below its lowest pixels."""
    if geometry is not None and (inside := geometry.inside(mask)).any():
        return float(np.median(geometry.points[inside][:, 2]))
    rows, columns = np.nonzero(mask)
    lowest = rows >= rows.max() - 1
    pixel = np.array([columns[lowest].mean() + 0.5, rows.max() + 1.0, 1.0])
    ray = camera.T_world_camera[:3, :3] @ np.linalg.solve(camera.K, pixel)
    height = float(camera.center[2])
    if height > 0 and ray[2] < -LEAST_SLOPE:
        return height / -float(ray[2])
    # It does not meet the ground in front of the camera: as far as the camera is from that.
    return max(abs(height), LEAST_DISTANCE)


def seen_points(mask: Mask, geometry: Geometry | None) -> Array | None:
    """What the geometry sees in a mask (n, 3), in the camera; None for less than tells a distance."""
    if geometry is None:
        return None
    points = geometry.points[geometry.inside(mask)].astype(float)
    return points if len(points) >= GEOMETRY_PIXELS else None


def drawn_in(points: Array) -> Array:
    """Points (n, 3) with the outermost at the others' border."""
    low, high = np.percentile(points, STRAYS, axis=0)
    return np.clip(points, low, high)


def _surface(o: SceneObject) -> Array:
    return sample_surface(o.vertices_world, o.mesh.faces, SAMPLES)


def _spread(points: Array) -> float:
    """Root of the mean squared distance of points (n, 3) from their mean, a few strays drawn in."""
    return float(np.linalg.norm(drawn_in(points).std(axis=0)))
