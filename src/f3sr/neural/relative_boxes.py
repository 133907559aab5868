"""Boxes of detectors, in shares of their input, as detections in pixels of the photo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from f3sr.backends.protocols import Detection
from f3sr.core.transforms import Array
from f3sr.scene import Photo


def detections(
    photo: Photo, labels: Sequence[str], scores: Array, boxes: Array, size: tuple[float, float]
) -> Iterator[Detection]:
    """Detections of n ``labels``, ``scores`` (n,) and ``boxes`` (n, 4), clipped to the photo.

    A box is centre x, y, width and height as shares of ``size`` (x, y) [px]. One wholly outside of the photo is none.
    """
    whole = np.array([photo.width, photo.height] * 2, float)
    corners = np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1)
    for label, score, (left, top, right, bottom) in zip(
        labels, scores, np.clip(corners * [*size, *size], 0, whole).tolist(), strict=True
    ):
        if not (right <= left or bottom <= top):  # NaN goes on, for the caller to refuse
            yield Detection(label=label, score=float(score), box=(left, top, right, bottom))
