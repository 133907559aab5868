"""The nearest camera whose axis goes through the middle of its picture, for formats that know no other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose, rotation_between

SIDE = 9
"""Places along each side of the picture at which the two cameras are compared."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SymmetricCamera:
    """A camera without skew whose principal point is the middle of its picture."""

    camera: Camera
    farthest: float
    """Most that a ray of the given camera moves in the picture [px], to six decimals; 0 where that one is symmetric."""

    @property
    def yfov(self) -> float:
        """Opening angle from top to bottom [rad]."""
        return float(2 * np.arctan(self.camera.height / 2 / self.camera.K[1, 1]))

    @property
    def aspect(self) -> float:
        """Width of the window over its height, at equal distance: pixels need not be square."""
        fx, fy = self.camera.K[0, 0], self.camera.K[1, 1]
        return float(self.camera.width * fy / (self.camera.height * fx))


def symmetric(camera: Camera) -> SymmetricCamera:
    """The camera turned, without roll, to look through the middle of its picture, with focal lengths by least squares.

    What an off-centre principal point then leaves is a keystone: the offset times the square of half the view's angle.
    The camera's place, width and height stay."""
    middle = np.array([camera.width, camera.height]) / 2
    x, y = np.meshgrid(np.linspace(0, camera.width, SIDE), np.linspace(0, camera.height, SIDE))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    turn = rotation_between([0, 0, 1.0], _rays(camera, middle[None])[0])
    rays = _rays(camera, pixels) @ turn
    slopes, places = rays[:, :2] / rays[:, 2:], pixels - middle
    focal = (slopes * places).sum(0) / (slopes**2).sum(0)
    K = np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1.0]])
    return SymmetricCamera(
        camera=replace(camera, K=K, T_world_camera=camera.T_world_camera @ pose(turn)),
        farthest=round(float(np.linalg.norm(slopes * focal - places, axis=1).max()), 6),
    )


def _rays(camera: Camera, pixels: Array) -> Array:
    """(n, 3) through pixels (n, 2), in camera axes, of depth 1."""
    return np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T
