"""Images read at the pixel centres of another resolution."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

P = TypeVar("P", bound=np.generic)


def resample(image: NDArray[P], width: int, height: int) -> NDArray[P]:
    """A mask, or any values (h, w, ...), read at the pixel centres of another resolution (height, width, ...), nearest.

    The result is the caller's own."""
    if image.shape[:2] == (height, width):
        return image.copy()
    rows = ((np.arange(height) + 0.5) * image.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * image.shape[1] / width).astype(int)
    # ``take`` is up to five times as fast as indexing by arrays, and its result is contiguous.
    return image.take(rows, axis=0).take(columns, axis=1)
