"""Pictures of a scene: masks against renders over the photo, textured renders, and a side view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from f3sr import raster
from f3sr.frames import Array, Camera, pose
from f3sr.scene import Scene

Image = NDArray[np.uint8]

MASK_ONLY, RENDER_ONLY, BOTH = (230, 60, 50), (60, 190, 80), (70, 110, 235)
"""The report's colours: photo mask red, render green, overlap blue."""


def pictures_of(before: Scene, after: Scene) -> Mapping[str, Image]:
    """What a package shows of a reconstruction, by file stem."""
    return {
        "sheet": sheet(before, after),
        "overlay_before": overlay(before),
        "overlay_after": overlay(after),
        "render_before": composite(before),
        "render_after": composite(after),
        "side_before": side_view(before),
        "side_after": side_view(after),
    }


def sheet(before: Scene, after: Scene, *, width: int = 1800) -> Image:
    """Everything at a glance: the photo, masks against renders before and after; below, both from the side."""
    top = [before.photo.rgb, overlay(before), overlay(after)]
    bottom = [side_view(s, width=1440, height=480) for s in (before, after)]
    return np.concatenate([_row(top, width), _row(bottom, width)])


def _row(pictures: Sequence[Image], width: int, gap: int = 8) -> Image:
    """Pictures of one size beside each other, white gaps between them, ``width`` pixels wide."""
    each = (width - gap * (len(pictures) - 1)) // len(pictures)
    height = round(each * pictures[0].shape[0] / pictures[0].shape[1])
    row = np.full((height + gap, width, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        resized = PIL.Image.fromarray(picture).resize((each, height), PIL.Image.Resampling.LANCZOS)
        row[:height, k * (each + gap) : k * (each + gap) + each] = np.asarray(resized)
    return row


def overlay(scene: Scene) -> Image:
    """Masks against visible renders over the greyed photo: red only mask, green only render, blue both; what lies
    between two objects' pixels is drawn dark, so that swapped ids show."""
    ids = raster.render(scene.objects, scene.camera).ids
    wanted = np.full(ids.shape, raster.EMPTY, np.int32)
    for o in scene:
        wanted[o.mask] = o.id
    photo = scene.photo.rgb.mean(axis=2, keepdims=True).repeat(3, axis=2)
    has_mask, has_render = wanted != raster.EMPTY, ids != raster.EMPTY
    picture = photo.copy()
    for where, color in (
        (has_mask & ~has_render, MASK_ONLY),
        (has_render & ~has_mask, RENDER_ONLY),
        (has_mask & has_render, BOTH),
    ):
        picture[where] = 0.45 * photo[where] + 0.55 * np.array(color)
    picture[has_mask & has_render & (wanted != ids)] *= 0.4
    picture[_borders(ids) & has_render] = 255
    return picture.round().astype(np.uint8)


def composite(scene: Scene) -> Image:
    """The textured, unlit render over the photo."""
    fragments = raster.render(scene.objects, scene.camera)
    colors = raster.shade(fragments, scene.objects)
    covered = (fragments.ids != raster.EMPTY)[..., None]
    return np.where(covered, (255 * colors).round(), scene.photo.rgb).astype(np.uint8)


def side_view(scene: Scene, *, width: int = 960, height: int = 540) -> Image:
    """The scene from the side, level with it, the line z = 0 green: what floats or sinks shows."""
    camera = side_camera(scene, width=width, height=height)
    fragments = raster.render(scene.objects, camera)
    picture = np.full((height, width, 3), 245, np.uint8)
    covered = fragments.ids != raster.EMPTY
    picture[covered] = (255 * raster.shade(fragments, scene.objects)).round()[covered]
    ends, _ = camera.project(np.array([[0.0, 0, 0], [0, 0, 1e-6]]) + _ground_point(scene))
    row = int(np.clip(ends[0, 1], 0, height - 1))
    picture[max(0, row - 1) : row + 1] = (40, 170, 60)
    return picture


def side_camera(scene: Scene, *, width: int, height: int) -> Camera:
    """A camera at ground level, 90 degrees to the side of the photo's, far enough away to look almost parallel."""
    corners = np.concatenate([o.bounds_world for o in scene])
    low, high = corners.min(0), corners.max(0)
    middle = (low + high) / 2
    forward = scene.camera.T_world_camera[:3, 0] * [1, 1, 0]
    forward = -forward / np.linalg.norm(forward)
    down = np.array([0.0, 0, -1])
    R = np.stack([np.cross(down, forward), down, forward], axis=1)
    distance = 8 * float(np.linalg.norm(high - low))
    eye = np.array([middle[0], middle[1], 0.0]) - distance * forward
    span = 1.15 * max(float(np.linalg.norm((high - low)[:2])), float(high[2] - low[2]) * width / height)
    focal = width * distance / span
    K = np.array([[focal, 0, width / 2], [0, focal, 0.9 * height], [0, 0, 1]])
    return Camera(width=width, height=height, K=K, T_world_camera=pose(R, eye))


def _ground_point(scene: Scene) -> Array:
    """A point of the ground below the middle of the scene (3,)."""
    corners = np.concatenate([o.bounds_world for o in scene])
    return (corners.min(0) + corners.max(0)) / 2 * [1, 1, 0]


def _borders(ids: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels whose right or lower neighbour belongs to something else."""
    edge = np.zeros(ids.shape, bool)
    edge[:, :-1] |= ids[:, :-1] != ids[:, 1:]
    edge[:-1] |= ids[:-1] != ids[1:]
    return edge
