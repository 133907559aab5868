"""Which way the axes of a network's normals point: right or left, down or up, forwards or back.

Networks differ in that, and their authors contradict each other. Where points are known, their own normals tell each
axis. Else the photo does: what is seen faces the camera, the ground faces up, and the sides of an object face outward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.resampling import resample
from f3sr.core.transforms import Array, cross

LETTERS = ("rl", "du", "fb")
"""Of each axis, in OpenCV's axes: the letter of its own way, and of the other."""
BLOCKS = 4
"""Blocks along each side of the photo, whose sums are jackknifed: neighbours have like errors."""
SURE = 3.0
"""Standard errors from which on an axis is told."""
STEP = 1 / 128
"""Distance of the points on either side that tell a normal [longer side of the geometry]: noise of depth is less."""
JUMP = 0.1
"""Largest difference of their depths [share]: beyond it they are of two surfaces."""


@dataclass(frozen=True, eq=False, kw_only=True)
class AxisSigns:
    """Per axis (3,) the factor 1 or -1 that turns a network's normals into OpenCV's axes, 0 where nothing tells it."""

    signs: Array

    def or_else(self, other: AxisSigns) -> AxisSigns:
        """With the axes of another for those that are not told."""
        return AxisSigns(signs=np.where(self.signs == 0, other.signs, self.signs))

    @property
    def letters(self) -> str:
        """As "rdf", with a question mark where nothing tells it."""
        return "".join(
            {1.0: own, -1.0: other}.get(float(s), "?") for s, (own, other) in zip(self.signs, LETTERS, strict=True)
        )


def axis_signs(letters: str) -> AxisSigns | None:
    """Of three letters, as "rdf"; None where they are none."""
    if len(letters) != 3 or any(c not in pair for c, pair in zip(letters, LETTERS, strict=True)):
        return None
    return AxisSigns(signs=np.array([1.0 if c == pair[0] else -1.0 for c, pair in zip(letters, LETTERS, strict=True)]))


def signs_by_points(values: NDArray[np.floating], points: NDArray[np.floating], valid: NDArray[np.bool_]) -> AxisSigns:
    """By points (h, w, 3) in camera axes where ``valid`` (h, w); ``values`` (any size, 3) are the network's normals.

    An axis along which no surface's normal extends stays untold; then it matters little."""
    theirs, own, use = _pairs(values, points, valid)
    return AxisSigns(signs=_told(theirs * own, own**2, _blocks(*valid.shape)[use]))


def angle_to_points(values: NDArray[np.floating], points: NDArray[np.floating], valid: NDArray[np.bool_]) -> float:
    """Median angle [rad] of normals (any size, 3) in camera axes to those of points, likewise; NaN without any."""
    theirs, own, _ = _pairs(values, points, valid)
    return float(np.median(np.arccos(np.clip((theirs * own).sum(1), -1, 1)))) if len(own) else float("nan")


def signs_by_outlines(
    values: NDArray[np.floating], masks: Sequence[NDArray[np.bool_]], ground: NDArray[np.bool_] | None
) -> AxisSigns:
    """By masks (H, W) of objects and of the ground, for normals (h, w, 3) of the whole photo.

    Normals to the right of an object's middle point right, on the whole, and likewise for the other three sides."""
    h, w = values.shape[:2]
    blocks = _blocks(h, w)
    votes, where = [values * [0, 0, -1]], [blocks]
    for mask in masks:
        rows, columns = np.nonzero(resample(mask, w, h))
        if len(rows):
            sides = np.column_stack([_sides(columns), _sides(rows), np.zeros(len(rows))])
            votes.append(values[rows, columns] * sides)
            where.append(blocks[rows, columns])
    if ground is not None:
        at = resample(ground, w, h)
        votes.append(values[at] * [0, -1, 0])
        where.append(blocks[at])
    rows_of = [v.reshape(-1, 3) for v in votes]
    every: Array = np.concatenate(rows_of).astype(float)
    return AxisSigns(signs=_told(every, np.abs(every), np.concatenate([b.ravel() for b in where])))


def normals_of_points(points: NDArray[np.floating], valid: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Unit normals (h, w, 3) towards the camera of points (h, w, 3) in camera axes, and where there are some (h, w)."""
    h, w = valid.shape
    step = max(1, round(STEP * max(h, w)))
    normals, found = np.zeros((h, w, 3)), np.zeros((h, w), np.bool_)
    if h <= 2 * step or w <= 2 * step:
        return normals, found
    p = np.where(valid[..., None], points, np.nan).astype(float)
    inner = (slice(step, -step), slice(step, -step))
    left, right = p[step:-step, : -2 * step], p[step:-step, 2 * step :]
    above, below = p[: -2 * step, step:-step], p[2 * step :, step:-step]
    with np.errstate(invalid="ignore", divide="ignore"):
        across = cross(right - left, below - above)
        unit = across / np.linalg.norm(across, axis=2, keepdims=True)
        unit *= np.where((unit * p[inner]).sum(2) > 0, -1, 1)[..., None]
        depths = np.stack([left[..., 2], right[..., 2], above[..., 2], below[..., 2]])
        smooth = np.ptp(depths, axis=0) < JUMP * p[inner][..., 2]
    ok = smooth & np.isfinite(unit).all(2)
    normals[inner], found[inner] = np.where(ok[..., None], unit, 0), ok
    return normals, found


def _pairs(
    values: NDArray[np.floating], points: NDArray[np.floating], valid: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The network's normals and those of points (n, 3), where both are (h, w)."""
    h, w = valid.shape
    own, found = normals_of_points(points, valid)
    theirs = np.asarray(resample(values, w, h), np.float64)
    use = found & (np.abs(theirs).sum(2) > 0)
    return theirs[use], own[use], use


def _sides(places: NDArray[np.int64]) -> Array:
    """Places (n,) along one axis about their middle, -1 to 1."""
    low, high = float(places.min()), float(places.max())
    return np.asarray((places - (low + high) / 2) / max((high - low) / 2, 1), np.float64)


def _blocks(h: int, w: int) -> NDArray[np.int64]:
    """The block (h, w) of each pixel."""
    return (np.arange(h) * BLOCKS // h)[:, None] * BLOCKS + np.arange(w) * BLOCKS // w


def _told(votes: Array, most: Array, blocks: NDArray[np.int64]) -> Array:
    """The sign (3,) of the sums of votes (n, 3), each of which could be ``most`` (n, 3); 0 where the share of what they
    could be is within ``SURE`` jackknife errors of 0."""
    sums, wholes = (
        np.stack([np.bincount(blocks, values[:, k], BLOCKS**2) for k in range(3)], 1) for values in (votes, most)
    )
    n = np.maximum((wholes > 0).sum(0), 1)
    share = sums.sum(0) / np.maximum(wholes.sum(0), 1e-12)
    error = np.sqrt(n / np.maximum(n - 1, 0.5) * ((sums - share * wholes) ** 2).sum(0))
    return np.where((n > 1) & (np.abs(sums.sum(0)) > SURE * error), np.sign(share), 0.0)
