"""Depth that shows the ground through an object: sensors see through glass and clear plastic."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import transform
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.photometric import principal_axes

HIGH = 90
"""Percentile of the heights of what the geometry shows of an object that has to be on the ground: masks leak."""
THROUGH = 0.45
"""That height as a share of the object's least width, up to which it is the ground behind it. 677 of 678 opaque objects
with given meshes have .61 and more. The last, a thin wrench, has .38 and is as thin as the geometry errs."""
NOISE = 2.0
"""Standard deviations of the ground's points from their plane that this height may be off."""
LARGER = 2.0
"""An object's size in the picture over that of its mask, up to which its least width is known."""
ENOUGH = 50
"""Least number of points that tell it."""


def seen_through(scene: Scene, noise: float) -> Mapping[int, float]:
    """Objects through which the geometry shows the ground z = 0: the height of most of what it shows [m], by id.

    ``noise`` is the standard deviation of the ground's points from their plane [m]. Solids that were fitted to masks
    may be far too thick, so they are left out, as is what came far larger than its mask."""
    geometry = scene.geometry
    if geometry is None or geometry.source == "ground":
        return {}
    heights = {o.id: height for o in scene if not o.lifted and (height := _height(o, scene, geometry)) is not None}
    low = {id: h for id, h in heights.items() if h + NOISE * noise < THROUGH * _least_width(scene[id])}
    return {id: h for id, h in low.items() if _has_size_of_mask(scene[id], scene.camera)}


def without_depth_of(scene: Scene, ids: Collection[int]) -> Scene:
    """The scene with a geometry that knows nothing of some objects."""
    geometry = scene.geometry
    if geometry is None or not ids:
        return scene
    valid = geometry.valid & ~np.any([geometry.inside(scene[id].mask) for id in ids], axis=0)
    return replace(scene, geometry=replace(geometry, valid=valid))


def _height(o: SceneObject, scene: Scene, geometry: Geometry) -> float | None:
    points = geometry.points[geometry.inside(o.mask)].astype(float)
    heights = transform(scene.camera.T_world_camera, points)[:, 2]
    return float(np.percentile(heights, HIGH)) if len(heights) >= ENOUGH else None


def _has_size_of_mask(o: SceneObject, camera: Camera) -> bool:
    """Whether the size of an object is that of something its mask may show."""
    pixels, z = camera.project(o.vertices_world)
    if z.min() <= rasterizer.NEAR:
        return False
    mask = np.argwhere(o.mask)
    return bool(np.linalg.norm(np.ptp(pixels, axis=0)) <= LARGER * np.linalg.norm(np.ptp(mask, axis=0) + 1))


def _least_width(o: SceneObject) -> float:
    """Least extent along a principal axis [m]."""
    return float(np.ptp(o.vertices_world @ principal_axes(o).T, axis=0).min())
