"""Masks made wider, narrower or whole, and their connected parts: SciPy's morphology under plain names and types."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def grown(mask: Mask, steps: int, within: Mask | None = None) -> Mask:
    """The region (h, w) grown by some steps [px] to neighbours up, down, left or right, all ``within`` a mask (h,
    w)."""
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(mask, iterations=steps, mask=within), np.bool_)


def joined_to(seeds: Mask, within: Mask) -> Mask:
    """What of a mask (h, w) is connected to seeds (h, w) in it."""
    from scipy.ndimage import binary_propagation

    return np.asarray(binary_propagation(seeds, mask=within), np.bool_)


def squared(mask: Mask, side: int) -> Mask:
    """Pixels (h, w) whose square of an odd ``side`` [px] meets the mask."""
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(mask, np.ones((side, side))), np.bool_)


def opened(mask: Mask, steps: int) -> Mask:
    """Without what is narrower than twice some steps."""
    from scipy.ndimage import binary_opening

    return np.asarray(binary_opening(mask, iterations=steps), np.bool_)


def closed(mask: Mask, steps: int) -> Mask:
    """With what is narrower than twice some steps between its parts; the border is as if the rest went on."""
    from scipy.ndimage import binary_closing

    if not steps:
        return mask
    whole = np.asarray(binary_closing(np.pad(mask, steps), iterations=steps), np.bool_)
    return whole[steps:-steps, steps:-steps]


def without_holes(mask: Mask) -> Mask:
    """The mask (h, w) with all that it surrounds."""
    from scipy.ndimage import binary_fill_holes

    return np.asarray(binary_fill_holes(mask), np.bool_)


def without_small_holes(mask: Mask, share: float) -> Mask:
    """The mask (h, w) with what it surrounds, but for holes larger than a share of it."""
    holes = parts_of(without_holes(mask) & ~mask)
    sizes = np.bincount(holes.ravel())
    small = sizes <= share * float(mask.sum())
    small[0] = False
    return mask | small[holes]


def without_strays(mask: Mask, others: Mask, *, gap: int, share: float) -> Mask:
    """The mask (h, w) without pieces of at most a ``share`` of it that lie apart from its largest piece: farther than
    ``gap`` [px], with nothing of ``others`` (h, w) between that might hide what joins them."""
    pieces = parts_of(mask)
    sizes = np.bincount(pieces.ravel())[1:]
    if len(sizes) < 2:
        return mask
    joined = parts_of(grown(mask | others, gap // 2))
    largest = joined[pieces == 1 + int(np.argmax(sizes))][0]
    small = np.concatenate([[False], sizes <= share * float(sizes.sum())])
    return mask & ~(small[pieces] & (joined != largest))


def distance_to(mask: Mask) -> NDArray[np.float32]:
    """Distance (h, w) [px] of every pixel to the nearest one of a mask; infinite for an empty mask."""
    from scipy.ndimage import distance_transform_edt

    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return np.asarray(distance_transform_edt(~mask), np.float32)


def shrunk(mask: Mask, steps: int) -> Mask:
    """The region (h, w) without what is within some steps [px] of its outside; the border is as if the rest were."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(mask, iterations=steps), np.bool_)


def nearest_in(mask: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row and column (h, w) of the pixel of a mask, which has one, that is nearest to every pixel."""
    from scipy.ndimage import distance_transform_edt

    rows, columns = np.asarray(distance_transform_edt(~mask, return_distances=False, return_indices=True))
    return rows, columns


def depth_inside(mask: Mask) -> NDArray[np.float64]:
    """Distance (h, w) [px] of every pixel's centre to the mask's outline, negative outside the mask."""
    inner, outer = distance_to(~mask).astype(float), distance_to(mask).astype(float)
    return np.where(mask, np.minimum(inner, sum(mask.shape)) - 0.5, 0.5 - outer)


def interpolated(image: NDArray[Any], pixels: NDArray[np.float64], *, cubic: bool = False) -> NDArray[np.float64]:
    """Values of an image (h, w) at pixels (n, 2), bilinear, of the nearest border beyond. ``cubic`` splines keep
    details that a second interpolation would blur."""
    from scipy.ndimage import map_coordinates

    at = [pixels[:, 1] - 0.5, pixels[:, 0] - 0.5]
    return np.asarray(map_coordinates(image, at, order=3 if cubic else 1, mode="nearest"), np.float64)


def smooth_step(share: NDArray[Any]) -> NDArray[Any]:
    """A step from 0 at 0 to 1 at 1 without a kink, of any shape and precision."""
    t = np.clip(share, 0, 1)
    return t * t * (3 - 2 * t)


def smoothed(image: NDArray[Any], sigma: float | tuple[float, float]) -> NDArray[np.float64]:
    """An image (h, w) under a Gaussian [px]."""
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(np.asarray(image, float), sigma), np.float64)


def parts_of(mask: Mask, *, diagonal: bool = False) -> NDArray[np.int32]:
    """(h, w) numbers from 1 of the connected parts, 0 outside; ``diagonal``: pixels that share a corner are
    connected."""
    from scipy.ndimage import label

    return np.asarray(cast(Any, label(mask, np.ones((3, 3)) if diagonal else None))[0], np.int32)


def parts_alike(mask: Mask, unit: NDArray[Any], least: float) -> NDArray[np.int32]:
    """(h, w) numbers from 1 of the parts of a mask, 0 outside: neighbours are connected where their ``unit`` vectors
    (h, w, 3) have a cosine of more than ``least``."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    place, count = np.full(mask.shape, -1, np.int32), np.count_nonzero(mask)
    place[mask] = np.arange(count)
    pairs = list[NDArray[np.int32]]()
    for a, b in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        joined = mask[a] & mask[b] & ((unit[a] * unit[b]).sum(-1) > least)
        pairs.append(np.stack([place[a][joined], place[b][joined]]))
    rows, columns = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(rows), np.bool_), (rows, columns)), shape=(count, count))
    parts = np.zeros(mask.shape, np.int32)
    parts[mask] = 1 + connected_components(graph, directed=False)[1] if count else 0
    return parts
