"""Poses as a film shows them: what has hardly moved stays where it was drawn, for engines creep and tremble at rest."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import Array, box_corners, transform
from f3sr.scene import Scene


class Held:
    """A dead band on motion, called with the poses (N, 4, 4) of one frame after another.

    Each object keeps its last pose, at first that of the scene at rest. A new pose is taken when a corner of its box
    has moved by more than ``tolerance`` [px] in the picture."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._camera, self._tolerance = scene.camera, tolerance
        self._boxes = [o.scale * box_corners(o.mesh.bounds) for o in scene]
        self._poses = np.array([o.T_world_object for o in scene])
        self._seen = self._pixels(self._poses)

    def __call__(self, T_world_object: Array) -> Array:
        """The poses (N, 4, 4) to draw instead of ``T_world_object`` (N, 4, 4)."""
        seen = self._pixels(T_world_object)
        near = np.linalg.norm(seen - self._seen, axis=2).max(1, initial=0.0) <= self._tolerance
        self._poses = np.where(near[:, None, None], self._poses, T_world_object)
        self._seen = np.where(near[:, None, None], self._seen, seen)
        return self._poses

    def _pixels(self, poses: Array) -> Array:
        """Where the corners of the boxes are seen (N, 8, 2); NaN, which is near nothing, behind the camera."""
        corners = np.concatenate([transform(T, box) for T, box in zip(poses, self._boxes, strict=True)])
        pixels, depth = self._camera.project(corners)
        return np.where(depth[:, None] > 0, pixels, np.nan).reshape(-1, 8, 2)
