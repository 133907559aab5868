"""One object alone against its mask in the photo: pictures in the report's colours, and how well the two agree."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.io.images import resized
from f3sr.scene import Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.pictures import BOTH, MASK_ONLY, RENDER_ONLY, TINT, Image
from f3sr.vision.silhouette import Mask, iou

MARGIN = 0.12
"""Around what a panel shows, as a share of its longer side."""
REACH = 0.6
"""How far a panel reaches beyond the mask's box at most, as a share of that box's longer side: a render that lies far
off would leave the mask a dot."""
PAPER, FADED = (235, 235, 235), 0.7
"""What is not compared fades into this colour, by this share,"""
STRIPE, HATCH = (120, 120, 120), 9
"""and carries thin stripes of this one, so many pixels apart."""

Window = tuple[slice, slice]
"""Rows and columns of the photo."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskPanels:
    """One object in several states of a scene.

    ``pictures``: photo mask red, render green, overlap blue over the greyed photo, all of one window; hatched where
    it is hidden. ``ious`` and ``hidden`` by state: IoU of the whole render with the mask where nothing hides it, exact
    at the photo's pixels, and the share of the render that is hidden.
    """

    pictures: tuple[Image, ...]
    ious: tuple[float, ...]
    hidden: tuple[float, ...]


def mask_panels(id: int, scenes: Sequence[Scene], hidden: Mask, *, longest: int, drawn: Collection[int]) -> MaskPanels:
    """The object ``id`` in some states of a scene, ``hidden`` in some pixels (H, W). Those numbered in ``drawn`` get
    pictures, of at most ``longest`` pixels a side."""
    mask, rgb = scenes[0][id].mask, scenes[0].photo.rgb
    window = _around([_box_of(mask), *(_seen(s[id], s.camera) for s in scenes)], mask.shape)
    renders = [_silhouette(s[id], s.camera, window) for s in scenes]
    hidden = hidden[window]
    part = _near(_box_of(mask), window)
    rows, columns = (slice(p.start - w.start, p.stop - w.start) for p, w in zip(part, window, strict=True))
    shown = [renders[k][rows, columns] for k in sorted(drawn)]
    return MaskPanels(
        pictures=tuple(_panel(rgb[part], mask[part], r, hidden[rows, columns], longest) for r in shown),
        ious=tuple(iou(r, mask[window], ~hidden) for r in renders),
        hidden=tuple(np.count_nonzero(r & hidden) / max(np.count_nonzero(r), 1) for r in renders),
    )


def _panel(rgb: Image, mask: Mask, render: Mask, hidden: Mask, longest: int) -> Image:
    scale = longest / max(mask.shape)
    height, width = (max(1, round(scale * n)) for n in mask.shape)
    mask, render, hidden = (resample(m, width, height) for m in (mask, render, hidden))
    grey = resized(rgb, width, height).mean(axis=2, dtype=np.float32)
    picture = np.repeat(grey[..., None], 3, axis=2)
    stripes = np.add.outer(np.arange(height), np.arange(width)) % HATCH < 2
    for where, color, share in (
        (mask & ~render & ~hidden, MASK_ONLY, TINT),
        (render & ~mask & ~hidden, RENDER_ONLY, TINT),
        (render & mask & ~hidden, BOTH, TINT),
        (hidden, PAPER, FADED),
        (hidden & render, RENDER_ONLY, TINT / 2),
        (hidden & stripes, STRIPE, TINT),
    ):
        picture[where] = (1 - share) * picture[where] + share * np.array(color, np.float32)
    return picture.round().astype(np.uint8)


# --- windows ------------------------------------------------------------------------------------------------------


def _box_of(mask: Mask) -> Window:
    """The rows and columns that a mask has pixels in, none where it is empty."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _seen(o: SceneObject, camera: Camera) -> Window:
    """Rows and columns around an object's projection, inside the image; the whole image where it comes too near."""
    pixels, z = camera.project(o.vertices_world)
    if z.min() <= rasterizer.NEAR:
        return slice(0, camera.height), slice(0, camera.width)
    low = np.clip(np.floor(pixels.min(0)), 0, [camera.width, camera.height]).astype(int)
    high = np.clip(np.ceil(pixels.max(0)), 0, [camera.width, camera.height]).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _around(windows: Sequence[Window], shape: tuple[int, ...]) -> Window:
    """The window that holds all that are not empty, with a margin; the whole image where all are."""
    filled = [w for w in windows if all(s.start < s.stop for s in w)] or [(slice(0, shape[0]), slice(0, shape[1]))]
    rows, columns = (slice(min(s.start for s in axis), max(s.stop for s in axis)) for axis in zip(*filled, strict=True))
    grow = 1 + round(MARGIN * max(rows.stop - rows.start, columns.stop - columns.start))
    whole = slice(0, shape[0]), slice(0, shape[1])
    return _grown(rows, grow, whole[0]), _grown(columns, grow, whole[1])


def _near(box: Window, window: Window) -> Window:
    """The part of a window that lies around a mask's box; all of it where the mask is empty."""
    rows, columns = box
    side = max(rows.stop - rows.start, columns.stop - columns.start)
    if not side:
        return window
    grow = 1 + round(REACH * side)
    return _grown(rows, grow, window[0]), _grown(columns, grow, window[1])


def _grown(part: slice, by: int, limits: slice) -> slice:
    return slice(max(limits.start, part.start - by), min(limits.stop, part.stop + by))


def _silhouette(o: SceneObject, camera: Camera, window: Window) -> Mask:
    rows, columns = window
    view = camera.cropped(columns.start, rows.start, columns.stop - columns.start, rows.stop - rows.start)
    return rasterizer.silhouette(view.to_camera(o.vertices_world), o.mesh.faces, view.K, view.width, view.height)
