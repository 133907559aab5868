"""The ground's normal by a network's normals: their median where the ground is, and how far its parts differ."""

from __future__ import annotations

import numpy as np

from f3sr.backends.protocols import PromptedImage
from f3sr.core.resampling import resample
from f3sr.vision.ground_plane import GroundNormal, agreeing, normal_of
from f3sr.vision.silhouette import union_of

LOWER = 0.4
"""Share of the photo from below that is taken for ground where none is outlined."""
LEAST_PIXELS = 64
"""Least number of normals that tell a plane's, in 16 groups."""
MAJORITY = 0.5
"""Least share of them that agree with their median: fewer are of several surfaces."""


def ground_normal(image: PromptedImage) -> GroundNormal | None:
    """Of the image's normals, in camera axes; None where they are few, or of several surfaces."""
    if image.normals is None:
        return None
    values = np.asarray(image.normals.values, float)
    h, w = values.shape[:2]
    objects = union_of((i.mask for i in image.instances), image.photo.rgb.shape[:2])
    where = image.ground_mask
    if where is None:
        where = np.zeros_like(objects)
        where[round((1 - LOWER) * image.photo.height) :] = True
    rows, columns = np.nonzero(resample(where & ~objects, w, h) & (np.abs(values).sum(2) > 0))
    if len(rows) < LEAST_PIXELS:
        return None
    normals, places = values[rows, columns], np.column_stack([columns, rows, np.zeros(len(rows))]).astype(float)
    first = normal_of(places, normals).normal
    agree, normals, share = agreeing(normals, first)
    return normal_of(places[agree], normals[agree], lean=2 * image.normals.error) if share >= MAJORITY else None
