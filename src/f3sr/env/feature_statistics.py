"""Statistics of recorded features as LeRobot keeps them: of an episode, and of all episodes from those of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from f3sr.core.transforms import Array

Statistics = Mapping[str, Array]
"""min, max, mean, std and quantiles, each of a feature's shape, and ``count`` (1,)."""
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
"""Named q01 to q99, as LeRobot names them."""
LEVELS = 256
"""Of a channel of a picture."""


def statistics_of(values: ArrayLike) -> Statistics:
    """Of the rows (n, k) of one episode."""
    rows = np.asarray(values, float)
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    found |= zip(_names(), np.quantile(rows, QUANTILES, axis=0), strict=True)
    return {**found, "count": np.array([len(rows)])}


class PictureStatistics:
    """Of pictures (h, w, 3) uint8 that come one at a time: counts of levels tell all of it, exactly."""

    def __init__(self) -> None:
        self._levels = np.zeros((3, LEVELS), np.int64)
        self._count = 0

    def add(self, rgb: NDArray[np.uint8]) -> None:
        self._levels += [np.bincount(rgb[..., k].ravel(), minlength=LEVELS) for k in range(3)]
        self._count += 1

    @property
    def statistics(self) -> Statistics:
        """In [0, 1], of shape (3, 1, 1). A quantile is the least level that as many pixels reach; count is pictures."""
        value, total = np.arange(LEVELS) / (LEVELS - 1), self._levels.sum(1)
        mean = self._levels @ value / total
        std = np.sqrt(np.maximum((self._levels * (value - mean[:, None]) ** 2).sum(1) / total, 0))
        reached = np.cumsum(self._levels, axis=1) / total[:, None]
        least = [np.array([value[np.searchsorted(row, q)] for row in reached]) for q in QUANTILES]
        low = value[(self._levels > 0).argmax(1)]
        high = value[LEVELS - 1 - (self._levels[:, ::-1] > 0).argmax(1)]
        found = {"min": low, "max": high, "mean": mean, "std": std, **dict(zip(_names(), least, strict=True))}
        return {**{name: row.reshape(3, 1, 1) for name, row in found.items()}, "count": np.array([self._count])}


def joined(episodes: Sequence[Statistics]) -> Statistics:
    """Of all episodes. Quantiles are the mean of the episodes', by their counts, as LeRobot joins them."""
    of = {name: np.stack([np.asarray(e[name], float) for e in episodes]) for name in episodes[0]}
    count = of["count"].ravel()
    weight = (count / count.sum()).reshape(-1, *[1] * (of["mean"].ndim - 1))
    mean = (weight * of["mean"]).sum(0)
    std = np.sqrt((weight * (of["std"] ** 2 + (of["mean"] - mean) ** 2)).sum(0))
    found = {"min": of["min"].min(0), "max": of["max"].max(0), "mean": mean, "std": std}
    found |= {name: (weight * of[name]).sum(0) for name in _names()}
    return {**found, "count": np.array([int(count.sum())])}


def _names() -> list[str]:
    return [f"q{round(100 * q):02d}" for q in QUANTILES]
