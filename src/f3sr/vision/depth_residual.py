"""What the photo's geometry says of an object's distance, which its silhouette does not show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.transforms import Array, cross
from f3sr.scene import Geometry, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled
from f3sr.vision.silhouette import Mask

SMALLEST = 1e-3
"""Deviation of depth [share of the distance] below which the curvature of its absolute value does not grow."""
GRAZING = 0.1
"""Least cosine between a viewing ray and a surface's normal that is reckoned with: at 0 its depth is undefined."""
BEFORE = 0.05
"""Distance [size] by which an object lies before what the photo shows, from which on the photo would show the object:
what is nested comes within some millimetres, and poses are off by a little more."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthResidual:
    """log(rendered depth / depth of the geometry) over the pixels that show an object: ``median``, ``spread``, the
    median distance from it, and ``size``, the median distance from 0; ``pixels`` is how many were compared.

    ``before`` is the share of the object's pixels where it is nearer than what may hide it there."""

    median: float
    spread: float
    size: float
    pixels: int
    before: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthEvidence:
    """``depth`` (h, w) [m] along the axis of ``camera``, nan where the geometry knows nothing of the object.
    ``hiding`` (h, w) is that of what may hide it, nan elsewhere; None where that is not asked."""

    depth: NDArray[np.float32]
    hiding: NDArray[np.float32] | None
    camera: Camera

    @classmethod
    def of(
        cls, geometry: Geometry, camera: Camera, window: Camera, shown: Mask, hidden: Mask | None = None
    ) -> DepthEvidence:
        """``shown`` (h, w): the window's pixels that show the object; ``hidden`` (h, w): those that may hide it.
        ``camera`` is the one of the whole photo."""
        z = np.where(geometry.valid, geometry.points[..., 2], np.float32(np.nan))
        depth = sampled(z, camera, window, fill=np.nan)
        # Not ``depth <= NEAR``: the negated comparison also catches NaN.
        depth[~(depth > rasterizer.NEAR)] = np.nan
        hiding = None if hidden is None else np.where(hidden & ~shown, depth, np.float32(np.nan))
        depth[~shown] = np.nan
        return cls(depth=depth, hiding=hiding, camera=window)

    def residual(self, o: SceneObject) -> DepthResidual:
        """The residual of an object where it is; spread and size are inf where no pixel can be compared."""
        rendered = rasterizer.render([o], self.camera).depth
        both = np.isfinite(rendered) & np.isfinite(self.depth)
        if not both.any():
            return DepthResidual(median=0.0, spread=np.inf, size=np.inf, pixels=0)
        # A log ratio, as errors of monocular depth are shares of it; medians, as masks leak onto what lies behind.
        ratio = np.log(rendered[both] / self.depth[both])
        median = float(np.median(ratio))
        return DepthResidual(
            median=median,
            spread=float(np.median(np.abs(ratio - median))),
            size=float(np.median(np.abs(ratio))),
            pixels=len(ratio),
            before=self._before(np.exp(-median) * rendered, BEFORE * o.size),
        )

    def within(self, hiding: Mask) -> DepthEvidence:
        """With only some pixels (h, w) of what may hide the object."""
        return replace(self, hiding=None if self.hiding is None else np.where(hiding, self.hiding, np.float32(np.nan)))

    def _before(self, depth: Array, least: float) -> float:
        """The share of a depth image (h, w), inf where it is empty, that is before what hides it by ``least`` [m]."""
        if self.hiding is None:
            return 0.0
        covered = np.isfinite(depth)
        return float(np.count_nonzero(depth[covered] < self.hiding[covered] - least) / np.count_nonzero(covered))

    def mismatch(self, o: SceneObject, velocities: Array, *, most: float) -> Local:
        """Mean of |log(rendered / measured depth) - its median|, each at most ``most``, with derivatives by parameters
        that move the surface by ``velocities`` (p, 3, 4) in camera axes.

        Its distance along the rays is free, as the median is taken off. A pixel sees the plane n . x = d of a
        triangle; as that moves by v, log depth changes by n . v / n . x. Absolute values have the curvature of
        iteratively reweighted squares."""
        fragments = rasterizer.render([o], self.camera)
        both = np.isfinite(fragments.depth) & np.isfinite(self.depth)
        p = len(velocities)
        if not both.any():
            return Local(value=most, gradient=np.zeros(p), curvature=np.zeros((p, p)))
        z = fragments.depth[both]
        ratio = np.log(z / self.depth[both])
        off = ratio - np.median(ratio)
        change = self._change(o, fragments.face[both], np.argwhere(both), z, velocities)
        near = np.abs(off) < most
        change = (change - change[:, near].mean(1, keepdims=True)) * near if near.any() else 0 * change
        weight = 1 / np.maximum(np.abs(off), SMALLEST)
        return Local(
            value=float(np.minimum(np.abs(off), most).mean()),
            gradient=change @ (weight * off) / len(off),
            curvature=(change * weight) @ change.T / len(off),
        )

    def _change(
        self, o: SceneObject, faces: NDArray[np.int32], pixels: NDArray[np.int64], z: Array, velocities: Array
    ) -> Array:
        """(p, n): how log depth changes in pixels (n, 2), row and column, that see some faces (n,) at z (n,)."""
        y, x = pixels.T + 0.5
        rays = np.linalg.solve(self.camera.K, np.stack([x, y, np.ones_like(x)]))  # (3, n)
        corners = self.camera.to_camera(o.vertices_world)[o.mesh.faces[faces]]
        normals = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).T
        normals /= np.maximum(np.linalg.norm(normals, axis=0), 1e-30)
        normals *= np.where((normals * rays).sum(0) < 0, -1.0, 1.0)
        along = np.maximum((normals * rays).sum(0), GRAZING * np.linalg.norm(rays, axis=0))
        moved = velocities @ np.concatenate([z * rays, np.ones((1, len(z)))])  # (p, 3, n)
        return (moved * normals).sum(1) / (z * along)
