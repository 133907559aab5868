"""What is below each mask in the picture: the ground, or another object that carries it or stands before it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from f3sr.scene import GROUND

REACH = 4
"""Rows below the mask's underside that are read [px per 1000 of the photo's longer side, at least 3]."""
LOWEST = 0.12
"""Share of a mask's height whose lower edge may touch what it stands on."""
UNDER = 0.5
"""Share of the columns below which another object must lie to be a carrier or an occluder."""


def below(masks: Mapping[int, NDArray[np.bool_]]) -> dict[int, int]:
    """For every mask (H, W) by id, the id of the mask along most of its underside, or GROUND."""
    shape = next(iter(masks.values())).shape
    ids = np.full(shape, GROUND, np.int64)
    for id, mask in masks.items():
        ids[mask] = id
    reach = max(3, round(REACH * max(shape) / 1000))
    return {id: _under(mask, ids, id, reach) for id, mask in masks.items()}


def underside(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns (n,) of a mask (H, W) that end in its lowest eighth, and the first rows (n,) below them."""
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    ends = mask.shape[0] - np.argmax(mask[::-1, columns], axis=0)
    low = ends >= rows[-1] + 1 - LOWEST * (rows[-1] + 1 - rows[0])
    return columns[low], ends[low]


def _under(mask: NDArray[np.bool_], ids: NDArray[np.int64], id: int, reach: int) -> int:
    columns, ends = underside(mask)
    rows = np.minimum(ends + reach - 1, mask.shape[0] - 1)
    found = ids[rows, columns]
    names, counts = np.unique(found[found != id], return_counts=True)
    if not len(names):
        return GROUND
    objects = names != GROUND
    if not objects.any():
        return GROUND
    best = int(np.argmax(np.where(objects, counts, -1)))
    return int(names[best]) if counts[best] >= UNDER * len(columns) else GROUND
