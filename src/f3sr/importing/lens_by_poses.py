"""The focal length of a photo whose masks and poses are known: the one by which objects are where their masks are.

A side of an object's box in the picture lies at the principal point plus f times a slope X / Z. f is the weighted
median of their ratios, which is least absolute deviations; sides that others hide are outliers.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import GivenPose
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.io.geometry import MAX_FOCAL, MIN_FOCAL
from f3sr.io.pose_conventions import all_conventions
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.vision.rasterizer import NEAR

PIXEL = 1.0
"""Mean error of sides [px] below which readings do not differ: masks are known to a pixel."""


def fitted_focal(
    meshes: Mapping[int, Mesh], poses: Mapping[int, GivenPose], masks: Mapping[int, NDArray[np.bool_]]
) -> float | None:
    """The focal length [px], by the reading of the poses that leaves least; None where no reading gives one.

    Of readings that leave as little, the usual one. All by object id; masks (H, W), the principal point in their
    middle."""
    sides = {id: _sides(mask) for id, mask in masks.items()}
    hulls = {id: meshes[id].hull.vertices for id in masks}
    places = CandidatePlaces.of_poses({id: poses[id] for id in masks}, all_conventions())
    found = [
        fit
        for k in range(len(places))
        if (fit := _fit({id: _slopes(hulls[id], places, k, v) for v, id in enumerate(masks)}, sides)) is not None
    ]
    height, width = next(iter(masks.values())).shape
    longest = max(height, width)
    usable = [(missed, f) for missed, f in found if MIN_FOCAL * longest <= f <= MAX_FOCAL * longest]
    least = min((missed for missed, _ in usable), default=0.0)
    return next((f for missed, f in usable if missed <= least + PIXEL), None)


def _fit(slopes: Mapping[int, Array | None], sides: Mapping[int, Array]) -> tuple[float, float] | None:
    """Mean absolute error of the sides [px], and the focal length; None for objects behind the camera."""
    rows = [(s, sides[id]) for id, s in slopes.items() if s is not None]
    if len(rows) < len(slopes):
        return None
    x = np.concatenate([s for s, _ in rows])
    y = np.concatenate([pixels for _, pixels in rows])
    use = np.isfinite(y) & (np.abs(x) > 1e-6)
    if not use.any():
        return None
    x, y = x[use], y[use]
    order = np.argsort(y / x)
    weights = np.cumsum(np.abs(x)[order])
    f = float((y / x)[order][np.searchsorted(weights, weights[-1] / 2)])
    return float(np.mean(np.abs(y - f * x))), f


def _slopes(vertices: Array, places: CandidatePlaces, k: int, v: int) -> Array | None:
    """Least and largest X / Z, then Y / Z (4,), of an object in the camera; None where it is not before it."""
    p = vertices @ (places.scale[k, v] * places.R[k, v]).T + places.t[k, v]
    if p[:, 2].min() <= NEAR:
        return None
    slopes = p[:, :2] / p[:, 2:]
    low, high = slopes.min(0), slopes.max(0)
    return np.array([low[0], high[0], low[1], high[1]])


def _sides(mask: NDArray[np.bool_]) -> Array:
    """Left, right, top and bottom (4,) from the middle [px]; NaN at the border, where the object may go on."""
    height, width = mask.shape
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    ends = np.array([columns[0], columns[-1] + 1, rows[0], rows[-1] + 1], float)
    at_border = (ends <= 0) | (ends >= [width, width, height, height])
    return np.where(at_border, np.nan, ends - np.array([width, width, height, height]) / 2)
