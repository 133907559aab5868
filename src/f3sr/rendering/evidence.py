"""What the photo tells about light: samples of objects at rest with their colours in it, and of ground in shadow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr import raster
from f3sr.background.regions import grown
from f3sr.frames import Array, Camera
from f3sr.rendering.surface_kernels import Shapes, Textures, View, seen_at
from f3sr.rendering.textures import linear
from f3sr.scene import Scene
from f3sr.silhouette import union_of

Mask = NDArray[np.bool_]

BLUR = 7
"""Side [px] of the square over which colours of photo and texture are compared: details lie a few pixels apart."""
INSIDE = 2
"""Pixels from the border of what shows an object, where colours mix."""
APART = 3
"""Pixels from the masks at which ground is looked at: their borders hold mixed colours."""
REACH = 1.5
"""How far from the middle of the scene ground is looked at, in its radii."""
FEW = 60
"""Samples below which an object tells nothing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Samples (n,) in linear light; ``group`` is the index of the object, or the number of objects for the ground."""

    group: NDArray[np.int64]
    albedo: Array
    """(n, 3) of textures, or of the background."""
    photo: Array
    """(n, 3)"""
    points: Array
    """(n, 3) in the world."""
    normals: Array
    """(n, 3)"""

    def thinned(self, step: int) -> Evidence:
        s = slice(None, None, max(step, 1))
        return Evidence(
            group=self.group[s],
            albedo=self.albedo[s],
            photo=self.photo[s],
            points=self.points[s],
            normals=self.normals[s],
        )


def evidence_of(
    scene: Scene,
    background: NDArray[np.uint8],
    *,
    shapes: Shapes,
    textures: Textures,
    view: View,
    face: NDArray[np.int32],
    near: float,
    ball: tuple[Array, float],
    samples: int,
) -> Evidence:
    """``view`` and ``face`` (h, w) are of the photo's camera with one sample a pixel, ``ball`` holds the scene."""
    table = linear(np.arange(256) / 255)
    photo, behind = table[scene.photo.rgb], table[background]
    parts = [_of_objects(scene, photo, shapes, textures, view, face, near, samples)]
    parts.append(_of_ground(scene, photo, behind, np.any(scene.photo.rgb != background, axis=2), ball, samples))
    return Evidence(
        **{
            name: np.concatenate([getattr(p, name) for p in parts])
            for name in ("group", "albedo", "photo", "points", "normals")
        }
    )


def _of_objects(
    scene: Scene,
    photo: Array,
    shapes: Shapes,
    textures: Textures,
    view: View,
    face: NDArray[np.int32],
    near: float,
    samples: int,
) -> Evidence:
    shown = np.where(face >= 0, shapes.object[np.maximum(face, 0)], -1)
    found: list[tuple[int, NDArray[np.int64], Array]] = []
    for k, o in enumerate(scene.objects):
        whole = (shown == k) & o.mask
        inner = whole & ~grown(~whole, INSIDE)
        pixels = np.argwhere(inner if np.count_nonzero(inner) >= FEW else whole)
        if len(pixels) >= FEW:
            found.append((k, pixels, _blurred(photo, whole, pixels)))
    step = max(1, int((sum(len(p) for _, p, _ in found) / samples) ** 0.5))
    groups, albedos, photos, places, normals = [], [], [], [], []
    for k, pixels, seen in found:
        whole = (shown == k) & scene.objects[k].mask
        albedo, place, normal = _seen(shapes, textures, view, near, np.argwhere(whole), face)
        picture = np.zeros((*face.shape, 3), np.float32)
        picture[whole] = albedo
        lookup = np.full(face.shape, -1, np.int64)
        lookup[whole] = np.arange(len(place))
        kept = (pixels[:, 0] % step == 0) & (pixels[:, 1] % step == 0)
        kept = kept if np.count_nonzero(kept) >= FEW else np.ones(len(pixels), np.bool_)
        chosen = pixels[kept]
        rows = lookup[chosen[:, 0], chosen[:, 1]]
        groups.append(np.full(len(chosen), k))
        albedos.append(_blurred(picture, whole, chosen))
        photos.append(seen[kept])
        places.append(place[rows])
        normals.append(normal[rows])
    empty = np.zeros((0, 3))
    return Evidence(
        group=np.concatenate([np.zeros(0, np.int64), *groups]),
        albedo=np.concatenate([empty, *albedos]),
        photo=np.concatenate([empty, *photos]),
        points=np.concatenate([empty, *places]),
        normals=np.concatenate([empty, *normals]),
    )


def _seen(
    shapes: Shapes, textures: Textures, view: View, near: float, pixels: NDArray[np.int64], face: NDArray[np.int32]
) -> tuple[Array, Array, Array]:
    albedo, place, normal = (np.empty((len(pixels), 3)) for _ in range(3))
    fixed = raster.fixed(pixels, np.int64), raster.fixed(face, np.int32)
    seen_at(shapes, textures, view, near, *fixed, albedo, place, normal)
    return albedo, place, normal


def _blurred(picture: NDArray[np.floating], where: Mask, pixels: NDArray[np.int64]) -> Array:
    """Means (n, 3) of the picture around some pixels, over ``where`` only."""
    from scipy.ndimage import uniform_filter

    (y0, x0), (y1, x1) = np.argwhere(where).min(0), np.argwhere(where).max(0) + 1
    window = where[y0:y1, x0:x1, None].astype(np.float32)
    stacked = np.concatenate([picture[y0:y1, x0:x1].astype(np.float32) * window, window], axis=2)
    sums = np.stack([uniform_filter(stacked[..., c], BLUR, mode="constant") for c in range(4)], axis=2)
    own = sums[pixels[:, 0] - y0, pixels[:, 1] - x0].astype(float)
    return own[:, :3] / np.maximum(own[:, 3:], 1e-6)


def ground_points(camera: Camera, pixels: NDArray[np.int64]) -> Array:
    """Where rays through pixel centres (n, 2) [row, column] meet z = 0 (n, 3); NaN where they do not, ahead."""
    rays = np.column_stack([pixels[:, 1] + 0.5, pixels[:, 0] + 0.5, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.T_world_camera[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        far = -camera.center[2] / rays[:, 2]
    far = np.where((rays[:, 2] != 0) & (far > 0), far, np.nan)
    return camera.center + far[:, None] * rays


def _of_ground(
    scene: Scene, photo: Array, behind: Array, changed: Mask, ball: tuple[Array, float], samples: int
) -> Evidence:
    """Ground that was completed, outside the objects: there alone photo and background differ."""
    masks = grown(union_of([o.mask for o in scene.objects], changed.shape), APART)
    pixels = np.argwhere(changed & ~masks)
    points = ground_points(scene.camera, pixels)
    near = np.linalg.norm(points[:, :2] - ball[0][:2], axis=1) < REACH * ball[1]
    step = max(1, int(np.ceil(np.count_nonzero(near) / samples)))
    pixels, points = pixels[near][::step], points[near][::step]
    y, x = pixels.T
    return Evidence(
        group=np.full(len(pixels), len(scene.objects)),
        albedo=behind[y, x],
        photo=photo[y, x],
        points=points,
        normals=np.tile([0.0, 0.0, 1.0], (len(pixels), 1)),
    )
