"""The order of numbers by quicksort, with one order of equal ones on every machine: results depend on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.runtime.kernels import kernel

SHORT = 15
"""Numbers more than which are parted; fewer are sorted by insertion."""
DEPTH = 64
"""Parts that wait at most: the longer one waits, so there are no more than the binary digits of a length."""


def sort_order(keys: Array) -> NDArray[np.int64]:
    """Indices (n,) that sort ``keys`` (n,), which hold no NaN."""
    # numpy's sorts compile for a second within kernels, and outside of kernels order equal keys otherwise.
    order = np.arange(len(keys))
    sort_kernel(keys, order, np.empty((DEPTH, 2), np.int64))
    return order


@kernel
def sort_kernel(keys: Array, order: NDArray[np.int64], waiting: NDArray[np.int64]) -> None:
    """Sort ``order`` by ``keys``; ``waiting`` (DEPTH, 2) is room for the first and last place of parts."""
    waiting[0, 0], waiting[0, 1] = 0, len(order) - 1
    n = 1
    while n > 0:
        n -= 1
        low, high = waiting[n, 0], waiting[n, 1]
        if high - low < SHORT:
            for i in range(low + 1, high + 1):
                k, j = order[i], i
                while j > low and keys[k] < keys[order[j - 1]]:
                    order[j] = order[j - 1]
                    j -= 1
                order[j] = k
            continue
        # The pivot is the median of the first, middle and last; it waits at the end.
        middle = (low + high) >> 1
        if keys[order[middle]] < keys[order[low]]:
            order[low], order[middle] = order[middle], order[low]
        if keys[order[high]] < keys[order[middle]]:
            order[high], order[middle] = order[middle], order[high]
        if keys[order[middle]] < keys[order[low]]:
            order[low], order[middle] = order[middle], order[low]
        pivot = keys[order[middle]]
        order[high], order[middle] = order[middle], order[high]
        i, j = low, high - 1
        while True:
            while i < high and keys[order[i]] < pivot:
                i += 1
            while j >= low and pivot < keys[order[j]]:
                j -= 1
            if i >= j:
                break
            order[i], order[j] = order[j], order[i]
            i += 1
            j -= 1
        order[i], order[high] = order[high], order[i]
        first = high - i > i - low
        waiting[n, 0], waiting[n, 1] = (i + 1, high) if first else (low, i - 1)
        waiting[n + 1, 0], waiting[n + 1, 1] = (low, i - 1) if first else (i + 1, high)
        n += 2
