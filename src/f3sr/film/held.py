"""Poses as a film shows them: what has hardly moved stays where it was drawn, for engines creep and tremble at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array, box_corners, transform
from f3sr.scene import Scene


class Held:
    """Called with the poses of one frame after another; each object's last pose is kept until a corner of its box is
    seen more than ``tolerance`` [px] from where it was seen in that."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._camera, self._tolerance = scene.camera, tolerance
        self._boxes = [o.scale * box_corners(o.mesh.bounds) for o in scene]
        count = len(self._boxes)
        self._poses, self._seen = np.full((count, 4, 4), np.nan), np.full((count, 8, 2), np.nan)

    def __call__(self, T_world_object: Array) -> Array:
        """The poses (N, 4, 4) to draw instead of ``T_world_object`` (N, 4, 4)."""
        seen = np.array([self._pixels(T, box) for T, box in zip(T_world_object, self._boxes, strict=True)])
        near = np.linalg.norm(seen - self._seen, axis=2).max(1, initial=0.0) <= self._tolerance
        self._poses = np.where(near[:, None, None], self._poses, T_world_object)
        self._seen = np.where(near[:, None, None], self._seen, seen)
        return self._poses

    def _pixels(self, T: Array, box: Array) -> NDArray[np.float64]:
        """Where corners (8, 3) are seen (8, 2); NaN, which is near nothing, behind the camera."""
        pixels, depth = self._camera.project(transform(T, box))
        return np.where(depth[:, None] > 0, pixels, np.nan)
