"""The pinhole camera, in the project's one convention."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from f3sr.core.transforms import Array, frozen, invert_pose, pose, transform


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """A pinhole camera with an exact, possibly off-centre K.

    ``K`` (3, 3) in pixels, ``T_world_camera`` (4, 4) rigid, ``width`` and ``height`` in pixels. Axes are OpenCV's:
    x right, y down, z forward. Pixel (0, 0) is the top-left corner of the image, so pixel centres lie at +0.5.
    """

    width: int
    height: int
    K: Array
    T_world_camera: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "K", frozen(self.K))
        object.__setattr__(self, "T_world_camera", frozen(self.T_world_camera))

    @cached_property
    def T_camera_world(self) -> Array:
        """(4, 4), maps world points into camera axes."""
        return invert_pose(self.T_world_camera)

    @property
    def center(self) -> Array:
        """The camera's centre in the world (3,) [m]."""
        return self.T_world_camera[:3, 3]

    def to_camera(self, points_world: Array) -> Array:
        """World points (n, 3) in camera axes (n, 3) [m]."""
        return transform(self.T_camera_world, points_world)

    def project(self, points_world: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) and z-depths (n,) [m] of world points (n, 3). Pixels are not finite at depth 0."""
        points_camera = self.to_camera(points_world)
        z = points_camera[:, 2]
        # Points are rows: row @ K.T is (K p).T.
        homogeneous = points_camera @ self.K.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return homogeneous[:, :2] / homogeneous[:, 2:], z

    def share_in_frame(self, points_world: Array) -> float:
        """Share of world points (n, 3) that lie before the camera and within its frame."""
        pixels, depth = self.project(points_world)
        inside = (pixels >= 0).all(1) & (pixels[:, 0] <= self.width) & (pixels[:, 1] <= self.height) & (depth > 0)
        return float(inside.mean())

    def homothety(self, k: float) -> Array:
        """The rigid T (4, 4) for which x -> T (k x) equals X -> C + k (X - C), with C the camera centre.

        Every point stays on its viewing ray, so no silhouette changes. Pass it to ``SceneObject.moved`` with scale k.
        """
        return pose(t=(1 - k) * self.center)

    def moved(self, T_world_camera: Array) -> Self:
        """The same lens in another pose (4, 4)."""
        return replace(self, T_world_camera=T_world_camera)

    def zoomed(self, factor: float) -> Self:
        """The same pose and pixels with ``factor`` times the focal lengths."""
        K = self.K.copy()
        K[:2, :2] *= factor
        return replace(self, K=K)

    def resized(self, width: int, height: int) -> Self:
        """The same view sampled with another number of pixels; they need not stay square."""
        # Rows of K scale whole: with corners at whole numbers, focal length and centre scale alike.
        scale = np.array([[width / self.width], [height / self.height], [1.0]])
        return replace(self, width=width, height=height, K=self.K * scale)

    def limited(self, longest: int) -> Self:
        """The same view with at most ``longest`` pixels on its longer side."""
        scale = min(1.0, longest / max(self.width, self.height))
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))

    def cropped(self, x: int, y: int, width: int, height: int) -> Self:
        """The view of ``width`` x ``height`` pixels from column ``x`` and row ``y`` on; it may exceed the image."""
        K = self.K.copy()
        K[:2, 2] -= [x, y]
        return replace(self, width=width, height=height, K=K)
