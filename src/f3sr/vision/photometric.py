"""What a photo's colours say of an object's turn, where its silhouette is blind: a can, a bottle, a ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.mesh import mass_properties
from f3sr.core.transforms import Array
from f3sr.scene import Photo, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled
from f3sr.vision.silhouette import Mask

FINE, COARSE = 0.7, 8.0
"""Widths [px] of the Gaussians between which detail is compared: noise is finer, shading and shadows are coarser."""
TRUNCATED = 2.5
"""Standard deviations at which those Gaussians end."""
ENOUGH = 100
"""Least pixels for a correlation."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Appearance:
    """The photo's detail (h, w, 3) where it shows an object, ``shown`` (h, w), in a window with a ``camera``.

    Detail is the band of colours in [0, 1] between the blurs FINE and COARSE."""

    detail: NDArray[np.float32]
    shown: Mask
    camera: Camera

    @classmethod
    def of(cls, photo: Photo, camera: Camera, window: Camera, shown: Mask) -> Appearance:
        """``shown`` (h, w): the window's pixels that show the object. ``camera`` is the one of the whole photo."""
        rgb = sampled(photo.rgb, camera, window, fill=0).astype(np.float32) / np.float32(255)
        return cls(detail=_detail(rgb, shown), shown=shown, camera=window)

    def correlation(self, o: SceneObject) -> float:
        """Of the photo's detail with that of the object's textured render, in [-1, 1]; 0 where little is in common."""
        rendered, both, _ = self._rendered(o)
        if np.count_nonzero(both) < ENOUGH:
            return 0.0
        return float((_unit(self.detail, both)[0] * _unit(rendered, both)[0]).sum())

    def mismatch(self, o: SceneObject, velocities: Array) -> Local:
        """1 - correlation, with derivatives by parameters that move the surface by ``velocities`` (p, 3, 4).

        With unit vectors a of the photo's detail and b of the render's it is |a - b|^2 / 2. A pixel's colour changes by
        -grad(b) . (motion of the surface in that pixel). So the Gauss-Newton terms are those of direct image alignment
        (Baker and Matthews, "Lucas-Kanade 20 years on", 2004). The unit length removes the change of b along b.
        """
        rendered, both, depth = self._rendered(o)
        p = len(velocities)
        if np.count_nonzero(both) < ENOUGH:
            return Local(value=1.0, gradient=np.zeros(p), curvature=np.zeros((p, p)))
        a, _ = _unit(self.detail, both)
        b, norm = _unit(rendered, both)
        flow = _flow(np.argwhere(both), depth[both], self.camera.K, velocities)
        # At the border of the compared region central differences would read what is not compared: there the change is
        # 0.
        inside = _inner(both)[both]
        dy, dx = (np.gradient(rendered, axis=k)[both].T * inside for k in (0, 1))
        # Brightness constancy: (p, 3, n), how each pixel's colour changes per parameter, over the render's length.
        change = -(flow[:, :1] * dx + flow[:, 1:] * dy) / norm
        # b keeps mean 0 and length 1 whatever moves: what a change has along either is taken off.
        change -= change.mean(2, keepdims=True)
        change = change.reshape(p, -1)
        flat = b.reshape(-1)
        change -= np.outer(change @ flat, flat)
        return Local(
            value=1 - float((a * b).sum()),
            gradient=-change @ a.reshape(-1),
            curvature=change @ change.T,
        )

    def _rendered(self, o: SceneObject) -> tuple[NDArray[np.float32], Mask, Array]:
        """Detail (h, w, 3) of the render, where it can be compared (h, w), and its depth (h, w)."""
        fragments = rasterizer.render([o], self.camera)
        covered = fragments.ids != rasterizer.EMPTY
        rgb = rasterizer.shade(fragments, [o]).astype(np.float32)
        return _detail(rgb, covered), covered & self.shown, fragments.depth


def _flow(pixels: NDArray[np.int64], depth: Array, K: Array, velocities: Array) -> Array:
    """(p, 2, n) [px]: how the surface seen at pixels (n, 2), row and column, at some depths (n,) moves in the image."""
    y, x = pixels.T + 0.5
    Y = (y - K[1, 2]) / K[1, 1]
    X = (x - K[0, 2] - K[0, 1] * Y) / K[0, 0]
    points = np.stack([X * depth, Y * depth, depth, np.ones_like(depth)])
    # (p, 3, 4) @ (4, n) = (p, 3, n): velocities of the points in camera axes, per parameter.
    d = velocities @ points
    # Quotient rule of X / z and Y / z; then K, whose third column has no part in a difference.
    u, v = (d[:, 0] - X * d[:, 2]) / depth, (d[:, 1] - Y * d[:, 2]) / depth
    return np.stack([K[0, 0] * u + K[0, 1] * v, K[1, 1] * v], axis=1)


def _unit(detail: NDArray[np.float32], where: Mask) -> tuple[NDArray[np.float32], float]:
    """Colours (3, n) of some pixels without their mean, together of length 1; and the length that they had."""
    colours = np.ascontiguousarray(detail[where].T)
    colours -= colours.mean(1, keepdims=True)
    length = max(float(np.linalg.norm(colours)), 1e-9)
    return colours / length, length


def _inner(where: Mask) -> Mask:
    """Pixels whose four neighbours are there too."""
    inner = np.zeros_like(where)
    inner[1:-1, 1:-1] = where[1:-1, 1:-1] & where[:-2, 1:-1] & where[2:, 1:-1] & where[1:-1, :-2] & where[1:-1, 2:]
    return inner


def _detail(rgb: NDArray[np.float32], where: Mask) -> NDArray[np.float32]:
    """Colours between two blurs, each over the given pixels only; 0 elsewhere."""
    from scipy.ndimage import find_objects

    detail = np.zeros_like(rgb)
    for box in find_objects(where.astype(np.uint8)):
        detail[box] = _blurred(rgb[box], where[box], FINE) - _blurred(rgb[box], where[box], COARSE)
    return detail


def _blurred(rgb: NDArray[np.float32], where: Mask, sigma: float) -> NDArray[np.float32]:
    """Colours under a Gaussian that counts the given pixels only (normalised convolution, Knutsson and Westin 1993)."""
    from scipy.ndimage import gaussian_filter

    # Colours and the weight 1, masked and blurred alike: their ratio is the mean over given pixels.
    weighted = np.concatenate([rgb, np.ones_like(rgb[..., :1])], axis=2) * where[..., None]
    sums = gaussian_filter(weighted, (sigma, sigma, 0), mode="constant", truncate=TRUNCATED)
    return np.where(where[..., None], sums[..., :3] / np.maximum(sums[..., 3:], 1e-6), 0)


def principal_axes(o: SceneObject) -> Array:
    """Unit axes (3, 3), as rows, of the inertia of an object's hull in the world."""
    hull = o.mesh.hull
    axes = np.linalg.eigh(mass_properties(hull.vertices, hull.faces).inertia)[1]
    return (o.T_world_object[:3, :3] @ axes).T
