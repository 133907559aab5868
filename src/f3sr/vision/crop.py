"""A part of the photo at a resolution of its own: the camera that sees it, and what images show there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.scene import SceneObject

MARGIN = 0.15
"""Of the window's longer side, around what it is to show: room for an object to move in."""


def window_around(o: SceneObject, camera: Camera, resolution: int) -> Camera:
    """The camera of a window around an object's mask and its render, of at most ``resolution`` pixels a side.

    It may reach beyond the photo, but by no more than the photo's size. The object lies in front of the camera.
    """
    pixels, _ = camera.project(o.vertices_world)
    low, high = pixels.min(0), pixels.max(0)
    if o.mask.any():
        rows, columns = (np.flatnonzero(o.mask.any(axis=axis)) for axis in (1, 0))
        # Pixel edges: the last pixel of the mask ends one after its index.
        low, high = np.minimum(low, [columns[0], rows[0]]), np.maximum(high, [columns[-1] + 1, rows[-1] + 1])
    limit = np.array([camera.width, camera.height])
    low, high = np.clip(low, -limit, 2 * limit), np.clip(high, -limit, 2 * limit)
    margin = MARGIN * (high - low).max()
    x, y = np.floor(low - margin).astype(int)
    width, height = np.ceil(high + margin).astype(int) - (x, y)
    return camera.cropped(x, y, width, height).limited(resolution)


def sampled(image: NDArray[Any], camera: Camera, window: Camera, *, fill: Any) -> NDArray[Any]:
    """Nearest-pixel samples of an image (h, w, ...) of ``camera`` at the pixel centres of a window of it.

    The image may have any resolution. Beyond its border the value is ``fill``."""
    rows, out_y = _nearest(camera.K[1], window.K[1], window.height, camera.height, image.shape[0])
    columns, out_x = _nearest(camera.K[0], window.K[0], window.width, camera.width, image.shape[1])
    values = image[np.ix_(rows, columns)]
    values[out_y] = fill
    values[:, out_x] = fill
    return values


def _nearest(
    row: Array, window_row: Array, count: int, length: int, samples: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Along one axis: the sample (count,) at each pixel centre of the window, and which lie outside.

    The two cameras' rows of K tell scale and shift: they differ by nothing else.
    """
    # Row 0 of K has its focal length in column 0, row 1 in column 1.
    axis = int(np.argmax(np.abs(row[:2])))
    scale = row[axis] / window_row[axis]
    # Window pixel to ray to photo pixel: (x' - c') / f' = (x - c) / f. Then to the image's own resolution.
    at = (np.arange(count) + 0.5 - window_row[2]) * scale + row[2]
    index = np.floor(at * samples / length).astype(np.int64)
    return np.clip(index, 0, samples - 1), (index < 0) | (index >= samples)
