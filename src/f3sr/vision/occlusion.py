"""Which objects may hide which, and where in the photo an object can be compared with its mask."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import Mask, union_of

RESOLUTION = 384
"""Longer side [px] of the images that depths are compared in."""
ENOUGH = 20
"""Least number of common pixels at which rendered depths are compared there."""


def nearer_objects(scene: Scene) -> dict[int, list[SceneObject]]:
    """Per object, those that may hide it: by the rendered depths where two objects overlap in the picture, else by
    their median depths. Two that cannot be ordered may hide each other."""
    small = scene.camera.limited(RESOLUTION)
    depths = {o.id: rasterizer.render([o], small).depth for o in scene}
    return {o.id: [p for p in scene if p.id != o.id and _nearer(depths[p.id], depths[o.id])] for o in scene}


def visible_region(o: SceneObject, nearer: Iterable[SceneObject]) -> Mask:
    """The pixels (H, W) where an object's silhouette must agree with its mask: not in a nearer object's mask."""
    return ~union_of((p.mask for p in nearer), o.mask.shape)


def _nearer(a: Array, b: Array) -> bool:
    """Whether depth image a (h, w) lies in front of b, inf where empty; True when unsure."""
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) > ENOUGH:
        return bool(np.median(a[both] - b[both]) < 0)
    if not np.isfinite(a).any() or not np.isfinite(b).any():
        return True
    return bool(np.median(a[np.isfinite(a)]) < np.median(b[np.isfinite(b)]))
