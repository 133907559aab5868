"""What the photo's geometry says of an object's distance, which its silhouette does not show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.scene import Geometry, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled
from f3sr.vision.silhouette import Mask


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthResidual:
    """log(rendered depth / depth of the geometry) over the pixels that show an object: ``median``, ``spread``, the
    median distance from it, and ``size``, the median distance from 0; ``pixels`` is how many were compared."""

    median: float
    spread: float
    size: float
    pixels: int


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthEvidence:
    """``depth`` (h, w) [m] along the axis of ``camera``, nan where the geometry knows nothing of the object."""

    depth: NDArray[np.float32]
    camera: Camera

    @classmethod
    def of(cls, geometry: Geometry, camera: Camera, window: Camera, shown: Mask) -> DepthEvidence:
        """``shown`` (h, w): the window's pixels that show the object. ``camera`` is the one of the whole photo."""
        z = np.where(geometry.valid, geometry.points[..., 2], np.float32(np.nan))
        depth = sampled(z, camera, window, fill=np.nan)
        # Not ``depth <= NEAR``: the negated comparison also catches NaN.
        depth[~shown | ~(depth > rasterizer.NEAR)] = np.nan
        return cls(depth=depth, camera=window)

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
        )
