"""What is below each mask in the picture: the ground, or another object that carries it or stands before it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from f3sr.scene import GROUND

REACH = 4
"""Rows below the mask's underside that are read [px per 1000 of the photo's longer side, at least 3]."""
UNDER = 0.5
"""Share of the columns below which another object must lie to be a carrier or an occluder."""


def below(masks: Mapping[int, NDArray[np.bool_]]) -> dict[int, int]:
    """For every mask (H, W) by id, the id of the mask along most of its underside, or GROUND.

    The underside is the lower edge of every column in the middle four fifths of the mask."""
    shape = next(iter(masks.values())).shape
    ids = np.full(shape, GROUND, np.int64)
    for id, mask in masks.items():
        ids[mask] = id
    reach = max(3, round(REACH * max(shape) / 1000))
    return {id: _under(mask, ids, id, reach) for id, mask in masks.items()}


def _under(mask: NDArray[np.bool_], ids: NDArray[np.int64], id: int, reach: int) -> int:
    columns = np.flatnonzero(mask.any(0))
    columns = columns[len(columns) // 10 : max(1, len(columns) - len(columns) // 10)]
    lowest = mask.shape[0] - 1 - np.argmax(mask[::-1, columns], axis=0)
    rows = np.minimum(lowest + reach, mask.shape[0] - 1)
    found = ids[rows, columns]
    names, counts = np.unique(found[found != id], return_counts=True)
    if not len(names):
        return GROUND
    objects = names != GROUND
    if not objects.any():
        return GROUND
    best = int(np.argmax(np.where(objects, counts, -1)))
    return int(names[best]) if counts[best] >= UNDER * len(columns) else GROUND
