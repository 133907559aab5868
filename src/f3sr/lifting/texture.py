"""Colours of lifted meshes: the photo where it shows the object, and the same colours on the side behind."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Material, Mesh
from f3sr.core.transforms import Array
from f3sr.lifting.solids import Solid
from f3sr.scene import Photo
from f3sr.vision.regions import shrunk

LONGEST = 1024
"""Longer side of a texture [px]."""
ERODED = 2
"""Width of the mask's border whose colours are mixed with what is behind [px]."""


def textured(solid: Solid, origin: Array, photo: Photo, mask: NDArray[np.bool_], camera: Camera) -> Mesh:
    """A solid about ``origin`` (3,), in world axes, its texture the photo inside the mask (H, W).

    A ray meets front and back at one colour: the object's mirror image about the sheet that faces the camera. Outside
    the mask the nearest colour inside it goes on, so nothing of other objects is seen."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    pad = 2 + math.ceil(0.1 * max(len(rows), len(columns)))
    top, bottom = max(0, rows[0] - pad), min(photo.height, rows[-1] + 1 + pad)
    left, right = max(0, columns[0] - pad), min(photo.width, columns[-1] + 1 + pad)
    crop, shown = photo.rgb[top:bottom, left:right], mask[top:bottom, left:right]
    inner = shrunk(shown, ERODED)
    shown = inner if inner.sum() > 0.5 * shown.sum() else shown
    nearest = np.asarray(cast(Any, distance_transform_edt)(~shown, return_distances=False, return_indices=True))
    image = Image.fromarray(np.ascontiguousarray(crop[nearest[0], nearest[1]]))
    if (scale := LONGEST / max(image.size)) < 1:
        image = image.resize((round(image.width * scale), round(image.height * scale)), Image.Resampling.BOX)
    pixels, _ = camera.project(solid.vertices)
    uv = (pixels - [left, top]) / [right - left, bottom - top]
    uv = np.clip(np.column_stack([uv[:, 0], 1 - uv[:, 1]]), 0, 1)
    return Mesh(
        vertices=solid.vertices - origin,
        faces=solid.faces,
        uv=uv,
        materials=(Material(texture=np.asarray(image)),),
        pieces=tuple(ConvexPart.hull_of(corners - origin) for corners in solid.pieces),
    )
