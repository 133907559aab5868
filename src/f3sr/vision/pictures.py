"""Pictures of a scene: masks against renders over the photo, textured renders, and a side view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array, cross, pose, turn_about
from f3sr.io.images import resized
from f3sr.scene import Scene
from f3sr.vision import rasterizer

Image = NDArray[np.uint8]
"""(h, w, 3) sRGB."""

LONGEST = 1600
"""Longest side [px] of a package's pictures; a larger photo is drawn smaller."""
MASK_ONLY, RENDER_ONLY, BOTH = (230, 60, 50), (60, 190, 80), (70, 110, 235)
"""The report's colours: photo mask red, render green, overlap blue."""
TINT = 0.55
"""Share of those colours over the greyed photo."""
SWAPPED = 0.4
"""Brightness where an object is drawn over another's mask, so that swapped ids show."""
GROUND_LINE = (40, 170, 60)
"""Colour of the line z = 0 in side views."""
MUCH_LARGER = 2.5
"""Two states share a side camera while together they are at most so many times larger than each alone."""
FRAME = 1.2
"""Size of a side view over that of what it shows."""
PAPER = 245
"""Grey behind a scene without its photo."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Backdrop:
    """The photo and the masks at the size that pictures are drawn in: the same for every stage's scene.

    ``rgb`` (h, w, 3); ``wanted`` (h, w): the id of the mask at every pixel, EMPTY where there is none.
    """

    rgb: Image
    wanted: NDArray[np.int32]

    @classmethod
    def of(cls, scene: Scene, longest: int = LONGEST) -> Self:
        camera = scene.camera.limited(longest)
        wanted = np.full((camera.height, camera.width), rasterizer.EMPTY, np.int32)
        for o in scene:
            wanted[resample(o.mask, camera.width, camera.height)] = o.id
        return cls(rgb=resized(scene.photo.rgb, camera.width, camera.height), wanted=wanted)

    def camera(self, scene: Scene) -> Camera:
        """The scene's camera with the backdrop's pixels."""
        return scene.camera.resized(self.rgb.shape[1], self.rgb.shape[0])


def pictures_of(before: Scene, after: Scene) -> Mapping[str, Image]:
    """What a package shows of a reconstruction, by file stem."""
    backdrop = Backdrop.of(after)
    overlays = [overlay(s, backdrop) for s in (before, after)]
    sides = _sides(before, after, width=960, height=540)
    return {
        "sheet": sheet(backdrop, overlays, _sides(before, after, width=1440, height=480)),
        "overlay_before": overlays[0],
        "overlay_after": overlays[1],
        "render_before": composite(before, backdrop),
        "render_after": composite(after, backdrop),
        "side_before": sides[0],
        "side_after": sides[1],
    }


def sheet(backdrop: Backdrop, overlays: Sequence[Image], sides: Sequence[Image], *, width: int = 1800) -> Image:
    """Everything at a glance: the photo, masks against renders before and after; below, both from the side."""
    return np.concatenate([_row([backdrop.rgb, *overlays], width), _row(sides, width)])


def _row(pictures: Sequence[Image], width: int, gap: int = 8) -> Image:
    """Pictures of one size in a row of ``width`` pixels, with white gaps."""
    each = (width - gap * (len(pictures) - 1)) // len(pictures)
    height = round(each * pictures[0].shape[0] / pictures[0].shape[1])
    row = np.full((height + gap, width, 3), 255, np.uint8)
    for k, picture in enumerate(pictures):
        row[:height, k * (each + gap) : k * (each + gap) + each] = resized(picture, each, height)
    return row


def overlay(scene: Scene, backdrop: Backdrop | None = None) -> Image:
    """Masks against visible renders over the greyed photo: red only mask, green only render, blue both.

    A render over another object's mask is dark, so that swapped ids show."""
    backdrop = backdrop or Backdrop.of(scene)
    ids, wanted = rasterizer.visible_ids(scene.objects, backdrop.camera(scene)), backdrop.wanted
    has_mask, has_render = wanted != rasterizer.EMPTY, ids != rasterizer.EMPTY
    # 0 neither, 1 mask only, 2 render only, 3 both, 4 both of different objects: an index into the three tables.
    kind = has_mask + 2 * has_render.astype(np.uint8)
    kind[has_mask & has_render & (wanted != ids)] = 4
    colors = np.array([(0, 0, 0), MASK_ONLY, RENDER_ONLY, BOTH, np.multiply(SWAPPED, BOTH)], np.float32)
    share = np.array([0, TINT, TINT, TINT, TINT], np.float32)
    light = np.array([1, 1 - TINT, 1 - TINT, 1 - TINT, (1 - TINT) * SWAPPED], np.float32)
    grey = backdrop.rgb.mean(axis=2, dtype=np.float32) * light[kind]
    picture = (share[:, None] * colors)[kind]
    picture += grey[..., None]
    picture[_borders(ids) & has_render] = 255
    return picture.round().astype(np.uint8)


def composite(scene: Scene, backdrop: Backdrop | None = None) -> Image:
    """The textured, unlit render over the photo."""
    backdrop = backdrop or Backdrop.of(scene)
    return _textured(scene, backdrop.camera(scene), backdrop.rgb)


def _sides(before: Scene, after: Scene, *, width: int, height: int) -> list[Image]:
    return [
        side_view(s, camera)
        for s, camera in zip((before, after), side_cameras(before, after, width, height), strict=True)
    ]


def side_view(scene: Scene, camera: Camera, *, ground: bool = True) -> Image:
    """The scene as a side camera sees it, the line z = 0 green: what floats or sinks shows."""
    picture = _textured(scene, camera, np.full((camera.height, camera.width, 3), PAPER, np.uint8))
    row = ground_row(camera)
    if ground and 0 < row < camera.height:
        picture[max(0, row - 1) : row + 1] = GROUND_LINE
    return picture


def turned_view(scene: Scene, *, turn: float, width: int, height: int) -> Image:
    """The scene alone, its camera turned about the vertical through its middle by ``turn`` [rad]."""
    middle = _box(scene).mean(0)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    T = turn_about(middle, R) @ scene.camera.T_world_camera
    camera = scene.camera.resized(width, height).moved(T)
    return _textured(scene, camera, np.full((height, width, 3), PAPER, np.uint8))


def side_cameras(before: Scene, after: Scene, width: int, height: int) -> tuple[Camera, Camera]:
    """One side camera for two states of a scene, so that they compare.

    Two cameras if one state is so much larger that the other would be invisible."""
    sizes = [np.linalg.norm(np.ptp(_box(*scenes), axis=0)) for scenes in ((before,), (after,), (before, after))]
    if sizes[2] > MUCH_LARGER * min(sizes):
        return side_camera(before, width=width, height=height), side_camera(after, width=width, height=height)
    both = side_camera(after, before, width=width, height=height)
    return both, both


def side_camera(scene: Scene, *others: Scene, width: int, height: int, ground: bool = True) -> Camera:
    """A level camera 90 degrees to the side of the photo's, far enough away for a nearly parallel view.

    Its height is that of the ground, or of the lowest point where there is no ground yet. Its view holds the scene
    and ``others``.
    """
    # Look against the photo's x axis, level: from the photo's right.
    forward = scene.camera.T_world_camera[:3, 0] * [1, 1, 0]
    forward = -forward / np.linalg.norm(forward)
    down = np.array([0.0, 0, -1])
    R = np.stack([cross(down, forward), down, forward], axis=1)
    # Rows times R is R' x: points in the side camera's axes, unshifted. y runs down.
    seen = np.concatenate([o.vertices_world @ R for s in (scene, *others) for o in s])
    low, high = seen.min(0), seen.max(0)
    base = 0.0 if ground else high[1]
    bottom, top = max(base, high[1]), min(base, low[1])
    distance = 8 * float(np.linalg.norm(high - low))
    eye = R @ [(low[0] + high[0]) / 2, base, (low[2] + high[2]) / 2 - distance]
    focal = distance / FRAME / max((high[0] - low[0]) / width, (bottom - top) / height)
    # A level camera at the ground's height sees z = 0 as one row; the principal point moves it to frame the scene.
    horizon = height / 2 + focal * (2 * base - bottom - top) / 2 / distance
    K = np.array([[focal, 0, width / 2], [0, focal, horizon], [0, 0, 1]])
    return Camera(width=width, height=height, K=K, T_world_camera=pose(R, eye))


def ground_row(camera: Camera) -> int:
    """The pixel row of z = 0 in a side view: its camera stands at that height and is level."""
    return int(camera.K[1, 2])


def _textured(scene: Scene, camera: Camera, behind: Image) -> Image:
    """The textured, unlit render over a picture of the camera's size."""
    picture = behind.copy()
    for rows, fragments in rasterizer.strips(scene.objects, camera):
        covered = fragments.ids != rasterizer.EMPTY
        picture[rows][covered] = (255 * rasterizer.shade(fragments, scene.objects)[covered]).round()
    return picture


def _box(*scenes: Scene) -> Array:
    """(2, 3) around all objects [m]."""
    corners = np.concatenate([o.bounds_world for scene in scenes for o in scene])
    return np.stack([corners.min(0), corners.max(0)])


def _borders(ids: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Pixels whose right or lower neighbour belongs to something else."""
    edge = np.zeros(ids.shape, bool)
    edge[:, :-1] |= ids[:, :-1] != ids[:, 1:]
    edge[:-1] |= ids[:-1] != ids[1:]
    return edge
