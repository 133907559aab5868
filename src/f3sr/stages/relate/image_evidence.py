"""What the photo's masks and the rendered objects say of each other: who hides whom, what is seen below a mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.rasterizer import EMPTY

RESOLUTION = 512
"""Longer side [px] of the pictures that relations are read from."""
BEYOND = 0.5
"""How far beyond the photo's border an object still counts, in pictures: what lies farther is cut in any case."""
SAMPLES = 600
"""Pixels in common of two objects that their depths are compared at, at most."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectRender:
    """One object rendered alone: ``depth`` (h, w) [m], inf where it is not, from ``row`` and ``column`` on."""

    row: int
    column: int
    depth: Array

    @cached_property
    def covers(self) -> NDArray[np.bool_]:
        return np.isfinite(self.depth)

    @cached_property
    def pixels(self) -> int:
        return int(np.count_nonzero(self.covers))

    @cached_property
    def range(self) -> tuple[float, float]:
        """Near and far depth [m], of all but the outermost pixels."""
        near, far = np.percentile(self.depth[self.covers], [2, 98]) if self.pixels else (np.nan, np.nan)
        return float(near), float(far)

    @property
    def box(self) -> tuple[int, int, int, int]:
        """First and last row, first and last column; the last ones excluded."""
        return self.row, self.row + self.depth.shape[0], self.column, self.column + self.depth.shape[1]

    @property
    def window(self) -> tuple[slice, slice]:
        top, bottom, left, right = self.box
        return slice(top, bottom), slice(left, right)


@dataclass(frozen=True, eq=False, kw_only=True)
class Common:
    """Where two objects' silhouettes overlap: how much of the smaller one, and at some pixels both depths and who the
    photo's masks show."""

    pixels: int
    share: float
    ratio: Array
    """log(depth of the second / depth of the first) (n,)."""
    first_seen: NDArray[np.bool_]
    """(n,) True where the mask of the first shows, False where that of the second does."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """The photo's masks and every object's view at one resolution."""

    camera: Camera
    labels: NDArray[np.int32]
    """(H, W) the id that the photo shows, GROUND for the ground, EMPTY for what is neither."""
    views: Mapping[int, ObjectRender]

    @classmethod
    def of(cls, scene: Scene) -> Picture:
        camera = scene.camera.limited(RESOLUTION)
        return cls(camera=camera, labels=_labels(scene, camera), views={o.id: _view(o, camera) for o in scene})

    def visibilities(self, scene: Scene) -> dict[int, float]:
        """The share of each object's silhouette that no other one hides and the photo's border does not cut."""
        nearest = np.full(self.labels.shape, np.inf)
        ids = np.full(self.labels.shape, EMPTY, np.int32)
        for id, view in self.views.items():
            window = view.window
            nearer = view.depth < nearest[window]
            nearest[window][nearer], ids[window][nearer] = view.depth[nearer], id
        whole = {o.id: _whole(o, self.camera, self.views[o.id]) for o in scene}
        return {id: min(1.0, float(np.count_nonzero(ids == id)) / n) if n else 0.0 for id, n in whole.items()}

    def common(self, a: int, b: int) -> Common | None:
        """What two objects' views have in common, None where nothing."""
        first, second = self.views[a], self.views[b]
        top, left = max(first.row, second.row), max(first.column, second.column)
        bottom, right = (min(first.box[k], second.box[k]) for k in (1, 3))
        if top >= bottom or left >= right:
            return None
        za, zb = (v.depth[top - v.row : bottom - v.row, left - v.column : right - v.column] for v in (first, second))
        both = np.isfinite(za) & np.isfinite(zb)
        pixels = int(np.count_nonzero(both))
        if not pixels:
            return None
        shown = self.labels[top:bottom, left:right][both]
        known = np.flatnonzero((shown == a) | (shown == b))
        known = known[:: max(1, len(known) // SAMPLES)]
        return Common(
            pixels=pixels,
            share=pixels / max(1, min(first.pixels, second.pixels)),
            ratio=np.log(zb[both][known] / za[both][known]),
            first_seen=shown[known] == a,
        )

    def seen_below(self, o: SceneObject, step: int, part: float) -> dict[int, float]:
        """What the photo shows just below the lower edge of a mask, ``step`` pixels along gravity: the share of its
        edge over each id, the edge within the lowest ``part`` of the mask counting most. Empty where the photo ends."""
        rows, columns = np.nonzero(self.labels == o.id)
        if not len(rows):
            return {}
        down = self._down(o)
        to_row, to_column = (
            np.rint(x + step * d).astype(int) for x, d in zip((rows, columns), down[::-1], strict=True)
        )
        height, width = self.labels.shape
        inside = (to_row >= 0) & (to_row < height) & (to_column >= 0) & (to_column < width)
        seen = np.full(len(rows), o.id)
        seen[inside] = self.labels[to_row[inside], to_column[inside]]
        depth = columns * down[0] + rows * down[1]
        room = max(part * float(np.ptp(depth)), 1.0)
        weight = np.where(seen == o.id, 0.0, np.clip((depth - depth.max() + room) / room, 0, 1))
        total = weight.sum()
        return {int(id): float(weight[seen == id].sum() / total) for id in np.unique(seen) if id != o.id and total > 0}

    def _down(self, o: SceneObject) -> Array:
        """Unit vector (2,) of gravity in the picture at an object's middle."""
        middle = o.middle
        points, _ = self.camera.project(np.stack([middle, middle - [0, 0, 0.05 * o.size]]))
        d = points[1] - points[0]
        length = float(np.linalg.norm(d))
        return d / length if np.isfinite(length) and length > 1e-9 else np.array([0.0, 1.0])


def _labels(scene: Scene, camera: Camera) -> NDArray[np.int32]:
    """With a ground mask, what is neither ground nor object is EMPTY; without one all that is no object is ground."""
    size = camera.width, camera.height
    if scene.ground_mask is None:
        labels = np.full(size[::-1], GROUND, np.int32)
    else:
        labels = np.where(resample(scene.ground_mask, *size), GROUND, EMPTY).astype(np.int32)
    for o in scene:
        labels[resample(o.mask, *size)] = o.id
    return labels


def _view(o: SceneObject, camera: Camera) -> ObjectRender:
    """Rendered in a window around its projection only."""
    row, stop_row, column, stop_column = _window(o, camera, 0.0)
    window = camera.cropped(column, row, stop_column - column, stop_row - row)
    return ObjectRender(row=row, column=column, depth=rasterizer.render([o], window).depth)


def _whole(o: SceneObject, camera: Camera, view: ObjectRender) -> int:
    """Pixels of an object's silhouette, also those beyond the border of the picture."""
    row, stop_row, column, stop_column = _window(o, camera, BEYOND)
    if row >= 0 and column >= 0 and stop_row <= camera.height and stop_column <= camera.width:
        return view.pixels
    wide = camera.cropped(column, row, stop_column - column, stop_row - row)
    vertices = wide.to_camera(o.vertices_world)
    return int(np.count_nonzero(rasterizer.silhouette(vertices, o.mesh.faces, wide.K, wide.width, wide.height)))


def _window(o: SceneObject, camera: Camera, beyond: float) -> tuple[int, int, int, int]:
    """Rows and columns, at least one of each, that an object may cover in the picture and ``beyond`` its border; all
    of them where it reaches behind the camera."""
    x, y = beyond * camera.width, beyond * camera.height
    low, high = np.array([-x, -y]), np.array([camera.width + x, camera.height + y])
    pixels, z = camera.project(o.vertices_world)
    first, last = low, high
    if z.min() > rasterizer.NEAR:
        first = np.clip(np.floor(pixels.min(0)) - 1, low, high - 1)
        last = np.clip(np.ceil(pixels.max(0)) + 1, first + 1, high)
    (column, row), (stop_column, stop_row) = (np.rint(p).astype(int).tolist() for p in (first, last))
    return row, stop_row, column, stop_column
