"""Minimum cuts on a grid of pixels: which of them are object where colours speak per pixel and edges per pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array

Mask = NDArray[np.bool_]

STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Half of a pixel's eight neighbours, as rows and columns; the others are these, seen from the neighbour."""
QUANTA = 1000
"""Steps of a unit of cost: maximum flow counts in whole numbers."""
MOST = 2_000.0
"""Largest cost of a pixel that counts: beyond any sum over its neighbours, and in steps far within 32 bits."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PixelGrid:
    """Pairs of neighbouring pixels of a picture (h, w), with what it costs to cut each pair apart."""

    shape: tuple[int, int]
    pairs: NDArray[np.int32]
    """(n, 2) numbers of pixels, row by row."""
    prices: Array
    """(n,) of a cut between the two of a pair."""

    def cut(self, cost: Array) -> Mask:
        """The object (h, w) of least price (Boykov and Jolly 2001).

        ``cost`` (h, w) is what a pixel costs as object beyond its cost as surroundings; infinite ones decide. Of
        several best objects it is the smallest."""
        flat = cost.ravel()
        free = np.isfinite(flat)
        mask = flat < 0
        if free.any():
            mask[free] = _least_cut(*self._reduced(flat, free))
        return mask.reshape(self.shape)

    def price(self, mask: Mask) -> float:
        """Of the border of a mask (h, w)."""
        flat = mask.ravel()
        return float(self.prices[flat[self.pairs[:, 0]] != flat[self.pairs[:, 1]]].sum())

    def _reduced(self, cost: Array, free: Mask) -> tuple[Array, NDArray[np.int32], Array]:
        """The same problem of free pixels alone: a pair with a decided one is part of the free one's cost."""
        first, second = self.pairs.T
        both, one = free[first] & free[second], free[first] != free[second]
        inner = np.where(free[first], first, second)[one]
        decided = np.where(free[first], second, first)[one]
        toll = np.where(cost[decided] < 0, -self.prices[one], self.prices[one])
        total = np.where(free, cost, 0.0) + np.bincount(inner, weights=toll, minlength=len(cost)).astype(float)
        number = (np.cumsum(free) - 1).astype(np.int32)
        return total[free], number[self.pairs[both]], self.prices[both]


def pixel_grid(picture: Array, *, weight: float, floor: float) -> PixelGrid:
    """The grid of a picture (h, w, c): a cut costs ``weight`` between equal pixels, less across contrast, divided by
    their distance. ``floor`` is the least mean square of differences that counts as contrast: noise is below it."""
    h, w = picture.shape[:2]
    number = np.arange(h * w, dtype=np.int32).reshape(h, w)
    pairs, squares, lengths = list[Any](), list[Array](), list[Array]()
    for rows, columns in STEPS:
        here = np.s_[: h - rows, max(0, -columns) : w - max(0, columns)]
        there = np.s_[rows:, max(0, columns) : w + min(0, columns)]
        pairs.append(np.stack([number[here].ravel(), number[there].ravel()], 1))
        squares.append(((picture[here] - picture[there]) ** 2).sum(-1).ravel())
        lengths.append(np.full(len(pairs[-1]), float(np.hypot(rows, columns))))
    square, length = np.concatenate(squares), np.concatenate(lengths)
    usual = max(float(square.mean()), floor)
    return PixelGrid(shape=(h, w), pairs=np.concatenate(pairs), prices=weight * np.exp(-square / (2 * usual)) / length)


def _least_cut(cost: Array, pairs: NDArray[np.int32], prices: Array) -> Mask:
    """Which of n pixels are object: those that the source still reaches once the maximum flow runs."""
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    graph, count = _graph(cost, pairs, prices), len(cost)
    left = graph - maximum_flow(graph, count, count + 1).flow
    left.eliminate_zeros()
    side = np.zeros(count + 2, np.bool_)
    side[breadth_first_order(left, count, return_predecessors=False)] = True
    return side[:count]


def _graph(cost: Array, pairs: NDArray[np.int32], prices: Array) -> Any:
    """Capacities (n + 2, n + 2): pixels, then the source, which is object, and the sink."""
    from scipy.sparse import coo_array

    count = len(cost)
    first, second = pairs.T
    every = np.arange(count, dtype=np.int32)
    source, sink = np.full(count, count, np.int32), np.full(count, count + 1, np.int32)
    whole = np.rint(cost.clip(-MOST, MOST) * QUANTA).astype(np.int32)
    between, none = np.rint(prices * QUANTA).astype(np.int32), np.zeros(count, np.int32)
    capacity = np.concatenate([between, between, np.maximum(-whole, 0), none, np.maximum(whole, 0), none])
    rows = np.concatenate([first, second, source, every, every, sink])
    columns = np.concatenate([second, first, every, source, sink, every])
    graph: Any = coo_array((capacity, (rows, columns)), shape=(count + 2, count + 2)).tocsr()
    graph.indices, graph.indptr = graph.indices.astype(np.int32), graph.indptr.astype(np.int32)
    return graph
