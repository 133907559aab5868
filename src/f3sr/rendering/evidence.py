"""What the photo tells about light: samples of objects at rest with their colours in it, and of ground in shadow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array
from f3sr.rendering.surface_kernels import FrameGeometry, Shapes, Textures, seen_at
from f3sr.rendering.textures import LINEAR
from f3sr.scene import Scene
from f3sr.vision import rasterizer
from f3sr.vision.regions import grown
from f3sr.vision.silhouette import union_of

Mask = NDArray[np.bool_]
Samples = tuple[NDArray[np.int64], Array, Array, Array, Array]
"""Group (n,), albedo, photo, points and normals (n, 3): fields of ``Evidence`` in their order."""

BLUR = 7
"""Side [px] of the square over which colours of photo and texture are compared: details lie a few pixels apart."""
INSIDE = 2
"""Pixels from the border of what shows an object that are left out: colours mix there."""
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
    """(n, 3) colour without light: of the objects' textures, or of the background."""
    photo: Array
    """(n, 3) colour in the photo."""
    points: Array
    """(n, 3) places in the world [m]."""
    normals: Array
    """(n, 3) unit normals in the world, of the side that is seen."""

    @classmethod
    def of(cls, parts: Sequence[Samples]) -> Self:
        """Some samples, one after the other."""
        group = np.concatenate([np.zeros(0, np.int64), *(p[0] for p in parts)])
        rest = (np.concatenate([np.zeros((0, 3)), *(p[k] for p in parts)]) for k in range(1, 5))
        albedo, photo, points, normals = (rasterizer.fixed(values, np.float64) for values in rest)
        return cls(group=rasterizer.fixed(group, np.int64), albedo=albedo, photo=photo, points=points, normals=normals)

    @cached_property
    def slope(self) -> Array:
        """(n, 3) of sRGB values over linear light, at the photo's."""
        # d/dx of 1.055 x^(1 / 2.4) - 0.055. Below .01 the slope would grow without bound, and dark pixels are noisy.
        return rasterizer.fixed(np.maximum(self.photo, 0.01) ** (1 / 2.4 - 1) * 1.055 / 2.4, np.float64)

    def thinned(self, step: int) -> Evidence:
        """Every ``step``-th sample, in order."""
        s = slice(None, None, max(step, 1))
        return Evidence.of([(self.group[s], self.albedo[s], self.photo[s], self.points[s], self.normals[s])])


def evidence_of(
    scene: Scene,
    background: NDArray[np.uint8],
    *,
    shapes: Shapes,
    textures: Textures,
    view: FrameGeometry,
    face: NDArray[np.int32],
    near: float,
    ball: tuple[Array, float],
    samples: int,
) -> Evidence:
    """Samples of what the photo and a render of the objects at rest both show, and of shaded ground.

    ``background`` (h, w, 3) is the completed photo in sRGB. ``view`` and ``face`` (h, w) are of the photo's camera with
    one sample a pixel. ``ball``, middle (3,) and radius [m], holds the scene. Pixels of objects are thinned on a grid
    so that about ``samples`` remain; ground has at most as many."""
    # maximum: face -1 would read the last face; ``where`` drops what it read.
    shown = np.where(face >= 0, shapes.object[np.maximum(face, 0)], -1)
    patches = [_MaskWindow.of((shown == k) & o.mask) for k, o in enumerate(scene.objects)]
    inner = {k: pixels for k, patch in enumerate(patches) if len(pixels := patch.inner()) >= FEW}
    # Every step-th row and column keeps one in step^2 pixels.
    step = max(1, int((sum(map(len, inner.values())) / samples) ** 0.5))
    masks = [o.mask for o in scene.objects]
    middle, reach = ball[0], REACH * ball[1]
    shaded = of_shaded_ground(
        scene.photo.rgb, background, masks, camera=scene.camera, middle=middle, reach=reach, samples=samples
    )
    parts = [shaded]
    for k, pixels in inner.items():
        kept = (pixels % step == 0).all(1)
        chosen = pixels[kept] if np.count_nonzero(kept) >= FEW else pixels
        # Means need all of the object's pixels, thinned ones or not.
        everywhere = patches[k].pixels()
        albedo, place, normal = _seen(shapes, textures, view, near, everywhere, face)
        seen = LINEAR[scene.photo.rgb[tuple(everywhere.T)]]
        rows = patches[k].rows(chosen)
        means = patches[k].means(albedo, chosen), patches[k].means(seen, chosen)
        parts.append((np.full(len(chosen), k), *means, place[rows], normal[rows]))
    return Evidence.of(parts)


@dataclass(frozen=True, eq=False)
class _MaskWindow:
    """What shows an object: a mask within a window of the picture."""

    corner: NDArray[np.int64]
    """(2,) first row and column of the window."""
    mask: Mask

    @classmethod
    def of(cls, whole: Mask) -> Self:
        """The window is ``INSIDE`` pixels wider than what a mask (h, w) holds, within the picture."""
        # any over columns tells the rows, any over rows the columns.
        spans = [np.flatnonzero(whole.any(axis)) for axis in (1, 0)]
        if not len(spans[0]):
            return cls(np.zeros(2, np.int64), whole[:0, :0])
        (top, bottom), (left, right) = ((max(s[0] - INSIDE, 0), s[-1] + 1 + INSIDE) for s in spans)
        return cls(np.array([top, left]), whole[top:bottom, left:right])

    def inner(self) -> NDArray[np.int64]:
        """Pixels (n, 2) of the picture away from the mask's border, or all where these are few."""
        inner = self.mask & ~grown(~self.mask, INSIDE)
        return np.argwhere(inner if np.count_nonzero(inner) >= FEW else self.mask) + self.corner

    def pixels(self) -> NDArray[np.int64]:
        """All (n, 2) of the picture, in rows."""
        return np.argwhere(self.mask) + self.corner

    def rows(self, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
        """Which of ``pixels`` some are."""
        # The rank of a pixel in the order of ``argwhere`` is the count of mask pixels before it.
        number = np.cumsum(self.mask).reshape(self.mask.shape) - 1
        return number[tuple((chosen - self.corner).T)]

    def means(self, colors: Array, chosen: NDArray[np.int64]) -> Array:
        """Means (n, 3) of the ``colors`` of all pixels over the squares around some of them."""
        from scipy.ndimage import uniform_filter

        # Colours and a one, filtered alike: their ratio is the mean over the mask's pixels in the square.
        picture = np.zeros((*self.mask.shape, 4), np.float32)
        picture[self.mask, :3], picture[self.mask, 3] = colors, 1
        sums = uniform_filter(picture, BLUR, axes=(0, 1), mode="constant")
        own = sums[tuple((chosen - self.corner).T)].astype(float)
        return own[:, :3] / np.maximum(own[:, 3:], 1e-6)


def _seen(
    shapes: Shapes,
    textures: Textures,
    view: FrameGeometry,
    near: float,
    pixels: NDArray[np.int64],
    face: NDArray[np.int32],
) -> tuple[Array, Array, Array]:
    albedo, place, normal = (np.empty((len(pixels), 3)) for _ in range(3))
    fixed = rasterizer.fixed(pixels, np.int64), rasterizer.fixed(face, np.int32)
    seen_at(shapes, textures, view, near, *fixed, albedo, place, normal)
    return albedo, place, normal


def ground_points(camera: Camera, pixels: NDArray[np.int64]) -> Array:
    """Where rays through pixel centres (n, 2) [row, column] meet z = 0 (n, 3); NaN where they do not, ahead."""
    rays = np.column_stack([pixels[:, 1] + 0.5, pixels[:, 0] + 0.5, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.T_world_camera[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        # eye + far ray has z = 0; behind the camera (far <= 0) or along the ground there is no such point.
        far = -camera.center[2] / rays[:, 2]
    far = np.where((rays[:, 2] != 0) & (far > 0), far, np.nan)
    return camera.center + far[:, None] * rays


def of_shaded_ground(
    photo: NDArray[np.uint8],
    background: NDArray[np.uint8],
    masks: Sequence[Mask],
    *,
    camera: Camera,
    middle: Array,
    reach: float,
    samples: int,
) -> Samples:
    """At most about ``samples`` of the ground that was completed, outside objects (``masks`` (h, w)): there alone the
    photo (h, w, 3) and the ``background`` (h, w, 3) differ. Within ``reach`` [m] of the ``middle`` (3,)."""
    changed = np.any(photo != background, axis=2)
    pixels = np.argwhere(changed & ~grown(union_of(masks, changed.shape), APART))
    points = ground_points(camera, pixels)
    # NaN compares as False: pixels above the horizon drop out here.
    near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < reach
    step = max(1, int(np.ceil(np.count_nonzero(near) / samples)))
    pixels, points = pixels[near][::step], points[near][::step]
    group, up = np.full(len(pixels), len(masks)), np.tile(UP, (len(pixels), 1))
    return group, LINEAR[background[tuple(pixels.T)]], LINEAR[photo[tuple(pixels.T)]], points, up
