"""Which objects may hide which, and where in the photo an object can be compared with its mask."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.depth_prior import sigma
from f3sr.vision.regions import nearest_in
from f3sr.vision.silhouette import Mask, resample, union_of

RESOLUTION = 384
"""Longer side [px] of the images that depths are compared in."""
ENOUGH = 20
"""Least number of common pixels at which rendered depths are compared there."""

BORDER = 3
"""Pixels of the geometry at the border of a mask whose depths may be mixed with its neighbour's."""


def nearer_objects(scene: Scene) -> dict[int, list[SceneObject]]:
    """Per object, those that may hide it: by the rendered depths where two objects overlap in the picture, else by
    their median depths. Two that cannot be ordered may hide each other."""
    small = scene.camera.limited(RESOLUTION)
    depths = {o.id: rasterizer.render([o], small).depth for o in scene}
    return {o.id: [p for p in scene if p.id != o.id and _nearer(depths[p.id], depths[o.id])] for o in scene}


def visible_region(o: SceneObject, nearer: Iterable[SceneObject]) -> Mask:
    """The pixels (H, W) where an object's silhouette must agree with its mask: not in a nearer object's mask."""
    return ~union_of((p.mask for p in nearer), o.mask.shape)


def comparable_region(o: SceneObject, nearer: Iterable[SceneObject], scene: Scene) -> Mask:
    """The pixels (H, W) where an object is compared with its mask: those of its ``visible_region`` without what the
    photo's geometry shows before it."""
    valid = visible_region(o, nearer)
    if scene.geometry:
        valid &= ~behind_the_photo(o, (p for p in scene if p.id != o.id), scene.geometry)
    return valid


def behind_the_photo(o: SceneObject, others: Iterable[SceneObject], geometry: Geometry) -> Mask:
    """The pixels (H, W) of other objects' masks where the geometry shows a surface before an object, as a bowl's wall
    before the fruit in it: there the object would be hidden.

    Before it is what is nearer than the object's own nearest pixel by more than the geometry's error. Where an object
    stands on another, depth goes on without a step.
    """
    mine = geometry.inside(o.mask)
    sure = _inner(mine)
    hidden = np.zeros_like(mine)
    if sure.any():
        around = _around(mine)
        depth = geometry.points[..., 2][around]
        rest = geometry.inside(union_of((p.mask for p in others), o.mask.shape))[around]
        hidden[around] = rest & (depth < (1 - sigma(geometry)) * depth[nearest_in(sure[around])])
    return resample(hidden, o.mask.shape[1], o.mask.shape[0])


def _inner(mask: Mask) -> Mask:
    """A mask without its border, where depths mix; of a small object what lies farthest from it."""
    from scipy.ndimage import binary_erosion

    inner = mask
    for _ in range(BORDER):
        less = np.asarray(binary_erosion(inner), np.bool_)
        if not less.any():
            break
        inner = less
    return inner


def _around(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns of a mask's box, with as much again on every side."""
    spans: list[slice] = []
    for axis in (1, 0):
        there = np.flatnonzero(mask.any(axis=axis))
        size = int(there[-1] - there[0]) + 1
        spans.append(slice(max(0, int(there[0]) - size), int(there[-1]) + size + 1))
    return spans[0], spans[1]


def _nearer(a: Array, b: Array) -> bool:
    """Whether depth image a (h, w) lies in front of b, inf where empty; True when unsure."""
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) > ENOUGH:
        return bool(np.median(a[both] - b[both]) < 0)
    if not np.isfinite(a).any() or not np.isfinite(b).any():
        return True
    return bool(np.median(a[np.isfinite(a)]) < np.median(b[np.isfinite(b)]))
