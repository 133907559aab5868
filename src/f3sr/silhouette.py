"""Silhouettes against masks: overlap, distance fields and the losses of equations 7 and 9."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.frames import Array
from f3sr.settings import settings

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


def resample(mask: Mask, width: int, height: int) -> Mask:
    """A mask (h, w) read at the pixel centres of another resolution, nearest."""
    rows = ((np.arange(height) + 0.5) * mask.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * mask.shape[1] / width).astype(int)
    return mask[rows][:, columns]


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """A mask prepared for comparison: what the losses need of it, computed once.

    ``mask``, ``valid`` (h, w); ``distance`` (h, w) is D: the distance to the mask, 0 inside, over the longer image
    side. ``area`` [px] and ``centroid`` (2,) [px] are of the valid mask.
    """

    mask: Mask
    valid: Mask
    distance: NDArray[np.float32]
    area: float
    centroid: Array

    @classmethod
    def of(cls, mask: Mask, valid: Mask | None = None) -> Target:
        from scipy.ndimage import distance_transform_edt

        valid = np.ones_like(mask) if valid is None else valid
        visible = mask & valid
        outside = np.asarray(distance_transform_edt(~mask), np.float32) / max(mask.shape)
        return cls(
            mask=mask,
            valid=valid,
            distance=outside,
            area=float(max(visible.sum(), 1)),
            centroid=centroid(visible),
        )


@settings
class LossWeights:
    """Weights of equations 7 and 9; the L1 and distance terms are per mask pixel, so that scenes compare."""

    distance: Annotated[float, Interval(ge=0, le=10)] = 1.0
    """lambda_dt."""
    centroid: Annotated[float, Interval(ge=0, le=100)] = 4.0
    """lambda_c; centroids in shares of the longer image side."""
    area: Annotated[float, Interval(ge=0, le=10)] = 0.1
    """lambda_a."""


def loss(silhouette: Mask, target: Target, weights: LossWeights) -> float:
    """Equation 9 without its priors, over the valid region; equation 7 with zero centroid and area weights."""
    s = silhouette & target.valid
    area = float(np.count_nonzero(s))
    mismatch = np.count_nonzero(s ^ (target.mask & target.valid)) / target.area
    leak = float(target.distance[s].sum()) / target.area
    value = mismatch + weights.distance * leak
    if weights.centroid and area:
        offset = (centroid(s) - target.centroid) / max(s.shape)
        value += weights.centroid * float(offset @ offset)
    if weights.area:
        value += weights.area * float(np.log(max(area, 1.0) / target.area) ** 2)
    return value


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
