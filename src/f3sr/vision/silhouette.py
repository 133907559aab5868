"""Silhouettes against masks: overlap, targets and the losses of equations 7 and 9 with their derivatives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.transforms import Array, transform
from f3sr.settings import constants
from f3sr.vision import rasterizer, silhouette_integrals
from f3sr.vision.silhouette_integrals import MISMATCH, MOMENT_X, MOMENT_Y, VALID, Integrals

Mask = NDArray[np.bool_]


def iou(a: Mask, b: Mask, valid: Mask | None = None) -> float:
    """Intersection over union of two masks, inside ``valid`` where given; 0 when both are empty."""
    both, either = a & b, a | b
    if valid is not None:
        both, either = both & valid, either & valid
    total = int(np.count_nonzero(either))
    return np.count_nonzero(both) / total if total else 0.0


def union_of(masks: Iterable[Mask], shape: tuple[int, ...]) -> Mask:
    """Pixels (h, w) in any of some masks, one mask at a time: a stack of many is large."""
    union = np.zeros(shape, np.bool_)
    for mask in masks:
        union |= mask
    return union


@constants
class LossWeights:
    """Weights of equations 7 and 9; the L1 and distance terms are per mask pixel, so that scenes compare."""

    distance: float = 1.0
    """lambda_dt."""
    centroid: float = 4.0
    """lambda_c; centroids are shares of the longer image side."""
    area: float = 0.1
    """lambda_a."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskDistances:
    """The distances of pixels from a mask's outline, found when they are first asked for."""

    mask: Mask

    @cached_property
    def distances(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(h, w) [px]: to the mask from outside, and to its complement from inside; one of both is 0 everywhere."""
        from scipy.ndimage import distance_transform_edt

        outside, inside = (np.asarray(distance_transform_edt(m), np.float32) for m in (~self.mask, self.mask))
        return outside, inside


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """A mask prepared for comparison: what the losses need of it, computed once.

    ``mask``, ``valid`` (h, w); ``area`` [px] and ``centroid`` (2,) [px] are of the valid mask.
    """

    mask: Mask
    valid: Mask
    area: float
    centroid: Array
    weights: LossWeights
    outline: MaskDistances
    pulls: bool = True
    """Whether pixels outside of the mask cost more, the farther they are."""

    @classmethod
    def of(cls, mask: Mask, valid: Mask | None = None, weights: LossWeights | None = None) -> Target:
        """``valid`` (h, w), everywhere by default, is where a silhouette is compared with the mask."""
        valid = np.ones_like(mask) if valid is None else valid
        visible = mask & valid
        return cls(
            mask=mask,
            valid=valid,
            area=float(max(np.count_nonzero(visible), 1)),
            centroid=centroid(visible),
            weights=weights or LossWeights(),
            outline=MaskDistances(mask=mask),
        )

    @cached_property
    def fields(self) -> silhouette_integrals.Fields:
        """What is integrated over a silhouette. Many targets are only compared with one: they need no distances.

        D is the distance to the mask over the longer image side (0 inside). The L1 and distance terms of a silhouette S
        are a constant plus the sum over S of ``valid (1 - 2 mask + lambda_dt D)``. At a distance d from the mask's
        outline the L1 term has the curvature of |d|: 1 / |d| (iteratively reweighted squares), |d| at least a pixel.
        Outside, the distance term has the curvature lambda_dt over the longer side.
        """
        mask, valid = self.mask, self.valid
        outside, inside = self.outline.distances
        leak = np.float32(self.weights.distance / max(mask.shape))
        pull = leak if self.pulls else np.float32(0)
        # The sum of both is the distance |d| to the mask's outline.
        stiffness = 1 / np.maximum(outside + inside, 1) + np.where(mask, np.float32(0), leak)
        return silhouette_integrals.Fields(
            valid=valid.astype(np.float32),
            mismatch=(valid * (1 - 2 * mask.astype(np.float32) + pull * outside)).astype(np.float32),
            stiffness=(valid * stiffness).astype(np.float32),
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Surface:
    """Triangles and their edges: what silhouettes are drawn from.

    ``vertices`` (n, 3) [m] in the world, ``faces`` (m, 3), ``edges`` (e, 2) each once."""

    vertices: Array
    faces: NDArray[np.int32]
    edges: NDArray[np.int32]

    @classmethod
    def of(cls, meshes: Sequence[tuple[Array, NDArray[np.int32]]]) -> Surface:
        """Several meshes, vertices (n, 3) [m] and faces (m, 3) each, as one."""
        starts = np.cumsum([0] + [len(v) for v, _ in meshes])
        faces = np.concatenate([f + n for (_, f), n in zip(meshes, starts, strict=False)]).astype(np.int32)
        return cls(
            vertices=np.concatenate([v for v, _ in meshes]), faces=faces, edges=silhouette_integrals.unique_edges(faces)
        )

    def moved(self, T: Array, scale: float) -> Surface:
        """The surface under x -> T (scale x), with ``T`` (4, 4) in the world."""
        return replace(self, vertices=transform(T, scale * self.vertices))

    def silhouette(self, camera: Camera) -> Mask:
        """(h, w) pixels whose centres it covers."""
        points = camera.to_camera(self.vertices)
        return rasterizer.silhouette(points, self.faces, camera.K, camera.width, camera.height)

    def sums(self, camera: Camera, fields: silhouette_integrals.Fields) -> Array:
        """(5,) ``silhouette_integrals.of_pixels`` over the silhouette."""
        return silhouette_integrals.of_pixels(self.silhouette(camera), fields)

    def integrals(self, camera: Camera, fields: silhouette_integrals.Fields, velocities: Array) -> Integrals:
        """``silhouette_integrals.integrate`` over the silhouette; ``velocities`` (p, 3, 4) in camera axes."""
        points = camera.to_camera(self.vertices)
        mask = rasterizer.silhouette(points, self.faces, camera.K, camera.width, camera.height)
        return silhouette_integrals.integrate(
            points, self.edges, mask, camera.K, fields, velocities, near=rasterizer.NEAR
        )


def loss(integrals: Integrals, target: Target) -> Local:
    """Equation 9 without its priors, over the valid region, with derivatives.

    With zero weights of centroid and area it is equation 7. These two terms have Gauss-Newton curvatures."""
    F, G, weights = integrals.value, integrals.gradient, target.weights
    area, offset, ratio = _area_offset_ratio(F, target)
    # Centroid and area of the visible silhouette are ratios of its integrals; derivatives follow the quotient rule.
    middle = F[[MOMENT_X, MOMENT_Y]] / area
    d_offset = (G[[MOMENT_X, MOMENT_Y]] - np.outer(middle, G[VALID])) / (area * max(target.mask.shape))
    d_ratio = G[VALID] / area
    lambda_c, lambda_a = weights.centroid, weights.area
    return Local(
        value=loss_value(F, target),
        gradient=G[MISMATCH] / target.area + 2 * lambda_c * offset @ d_offset + 2 * lambda_a * ratio * d_ratio,
        curvature=integrals.curvature / target.area
        + 2 * lambda_c * d_offset.T @ d_offset
        + 2 * lambda_a * np.outer(d_ratio, d_ratio),
    )


def loss_value(F: Array, target: Target) -> float:
    """Equation 9 without its priors, of integrals (5,) over a silhouette."""
    _, offset, ratio = _area_offset_ratio(F, target)
    lambda_c, lambda_a = target.weights.centroid, target.weights.area
    # |S xor mask| = area + the sum over S of (1 - 2 mask): divided by the mask's area, its constant part is 1.
    return 1 + float(F[MISMATCH]) / target.area + lambda_c * float(offset @ offset) + lambda_a * float(ratio**2)


def _area_offset_ratio(F: Array, target: Target) -> tuple[float, Array, float]:
    """Of a silhouette with integrals (5,): its visible area [px], the offset (2,) of its centroid over the window's
    longer side, and the logarithm of the ratio of areas, which treats twice and half the area alike."""
    area = max(float(F[VALID]), 1.0)
    offset = (F[[MOMENT_X, MOMENT_Y]] / area - target.centroid) / max(target.mask.shape)
    return area, offset, float(np.log(area / target.area))


def centroid(mask: Mask) -> Array:
    """Mean pixel centre (x, y) of a mask [px]; the image's middle when it is empty."""
    total = np.count_nonzero(mask)
    if not total:
        return np.array([mask.shape[1], mask.shape[0]]) / 2
    columns, rows = np.count_nonzero(mask, axis=0), np.count_nonzero(mask, axis=1)
    return np.array([
        columns @ (np.arange(mask.shape[1]) + 0.5) / total,
        rows @ (np.arange(mask.shape[0]) + 0.5) / total,
    ])  # fmt: skip
