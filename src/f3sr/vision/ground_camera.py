"""The photo's camera over its ground plane, before any stage has levelled the scene."""

from __future__ import annotations

import numpy as np

from f3sr.backends.protocols import PromptedImage
from f3sr.core.camera import Camera
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose, rotation_between
from f3sr.scene import Geometry
from f3sr.vision.ground_plane import fit_plane

TOLERANCE = 0.01
"""Largest distance of a ground point from the ground plane [share of its median depth]."""
LOWER = 0.4
"""Share of the geometry from below that is searched for ground where none is outlined."""
PLANE = 3
"""Points that a plane needs."""
SEED = 0


def camera_over_ground(image: PromptedImage, geometry: Geometry, K: Array) -> Camera:
    """The photo's camera in a world whose z = 0 is the ground, below the camera's centre [m].

    Where no ground is seen, it is as low as the lowest point of the objects, and the camera is level: so does
    ``level``, which tells it."""
    region = image.ground_mask
    if region is None or not geometry.inside(region).any():
        region = np.zeros((image.photo.height, image.photo.width), bool)
        region[round((1 - LOWER) * image.photo.height) :] = True
        region &= ~np.any([i.mask for i in image.instances], axis=0)
    points = geometry.points[geometry.inside(region)].astype(float)
    if len(points) < PLANE:
        return _level_camera(image, geometry, K)
    tolerance = TOLERANCE * float(np.median(points[:, 2]))
    plane = fit_plane(points, np.random.default_rng(SEED), tolerance)
    R = rotation_between(T_UP_FROM_CAMERA[:3, :3] @ plane.normal, [0, 0, 1]) @ T_UP_FROM_CAMERA[:3, :3]
    T_world_camera = pose(R, [0, 0, -plane.offset])
    return Camera(width=image.photo.width, height=image.photo.height, K=K, T_world_camera=T_world_camera)


def _level_camera(image: PromptedImage, geometry: Geometry, K: Array) -> Camera:
    shown = geometry.inside(np.any([i.mask for i in image.instances], axis=0))
    points = geometry.points[shown if shown.any() else geometry.valid].astype(float)
    height = max(float(points[:, 1].max()), TOLERANCE * float(np.median(points[:, 2])))
    T_world_camera = pose(T_UP_FROM_CAMERA[:3, :3], [0, 0, height])
    return Camera(width=image.photo.width, height=image.photo.height, K=K, T_world_camera=T_world_camera)
