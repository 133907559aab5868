"""The figure like the report's: two scenes by four methods, in the photo's view and from the side.

All panels of a row show the same part of the world. Renders are unlit, on paper and not over the photo, so that nothing
of the photo hides an error; the given masks are outlined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import PIL.Image
from PIL import ImageDraw, ImageFont

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.io.images import resized
from f3sr.scene import Scene
from f3sr.vision import rasterizer
from f3sr.vision.pictures import PAPER, Image, side_camera, side_view
from f3sr.vision.silhouette import Mask, union_of

SCENES = ("dev_00_stack", "dev_09_pile")
"""A stack and a pile, all of whose objects are of the YCB set."""
METHODS = ("direct composition", "TabletopGen", "PAT3D", "f3sr")
"""Those of the report's table without its ablation."""
REIMPLEMENTED = ("TabletopGen", "PAT3D")
WIDTH, GAP, LINE = 1600, 8, 24
"""Of the figure, between its panels, and of a line of text [px]."""
SIDE = 0.5
"""Height of a side view over its width."""
MARGIN = 0.04
"""Around what a panel shows [share of its longer side]."""
OUTLINE = (220, 0, 130)
"""Colour of the masks' outlines."""
QUALITY = 84


@dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """One scene by method, with its measures."""

    scenes: Mapping[str, Scene]
    rows: Mapping[str, Mapping[str, float]]
    true: Scene
    """The true objects, where the last method's camera sees them."""


def save(blocks: Sequence[Block], file: Path) -> None:
    picture = np.concatenate([drawn(block, with_names=k == 0) for k, block in enumerate(blocks)])
    PIL.Image.fromarray(picture).save(file, quality=QUALITY, optimize=True)


def drawn(block: Block, *, with_names: bool) -> Image:
    """The photo and the methods in its view; below the true scene and the methods from the side."""
    each = (WIDTH - GAP * len(METHODS)) // (len(METHODS) + 1)
    some = block.scenes[METHODS[-1]]
    crop = common_crop(block)
    front = [cropped_photo(some, crop, each), *(front_view(block.scenes[m], crop, each) for m in METHODS)]
    side = common_side(block, 2 * each, round(SIDE * 2 * each))
    scenes = [block.true, *(block.scenes[m] for m in METHODS)]
    sides = [resized(side_view(scene, side), each, round(SIDE * each)) for scene in scenes]
    names = ["photo", *(f"{m} (re-implemented)" if m in REIMPLEMENTED else m for m in METHODS)]
    return np.concatenate([
        *([texts(names, each)] if with_names else [np.full((2 * GAP, WIDTH, 3), 255, np.uint8)]),
        panels(front),
        texts(["outlines: given masks", *(likeness(block.rows[m]) for m in METHODS)], each),
        panels(sides),
        texts(["truth, from the side", *(physics(block.rows[m]) for m in METHODS)], each),
    ])  # fmt: skip


def likeness(row: Mapping[str, float]) -> str:
    return f"mIoU {row['mIoU']:.3f}   PSNR {row['PSNR']:.1f} dB"


def physics(row: Mapping[str, float]) -> str:
    return f"R_pen {row['R_pen']:.2g}   K {row['K_max_J']:.1g} J   D {row['D_max_cm']:.2g} cm"


def common_crop(block: Block) -> tuple[int, int, int, int]:
    """Columns and rows [start, stop) around all masks and all that any method shows of the objects."""
    some = next(iter(block.scenes.values()))
    shown = union_of((o.mask for o in some), some.photo.rgb.shape[:2])
    for scene in block.scenes.values():
        shown |= rasterizer.visible_ids(scene.objects, scene.camera) != rasterizer.EMPTY
    spans: list[int] = []
    for axis, size in ((0, some.photo.width), (1, some.photo.height)):
        there = np.flatnonzero(shown.any(axis=axis))
        margin = round(MARGIN * size)
        spans += [max(0, int(there[0]) - margin), min(size, int(there[-1]) + 1 + margin)]
    return spans[0], spans[1], spans[2], spans[3]


def front_view(scene: Scene, crop: tuple[int, int, int, int], width: int) -> Image:
    """The scene in the photo's view, on paper, with the outlines of the given masks."""
    left, right, top, bottom = crop
    height = round(width * (bottom - top) / (right - left))
    camera = scene.camera.cropped(left, top, right - left, bottom - top).resized(2 * width, 2 * height)
    picture = resized(textured(scene, camera), width, height).copy()
    for o in scene:
        picture[outline(resample(o.mask[top:bottom, left:right], width, height))] = OUTLINE
    return picture


def textured(scene: Scene, camera: Camera) -> Image:
    fragments = rasterizer.render(scene.objects, camera)
    covered = fragments.ids != rasterizer.EMPTY
    picture = np.full((camera.height, camera.width, 3), PAPER, np.uint8)
    picture[covered] = (255 * rasterizer.shade(fragments, scene.objects)[covered]).round()
    return picture


def cropped_photo(scene: Scene, crop: tuple[int, int, int, int], width: int) -> Image:
    left, right, top, bottom = crop
    return resized(scene.photo.rgb[top:bottom, left:right], width, round(width * (bottom - top) / (right - left)))


def outline(mask: Mask) -> Mask:
    """Pixels whose right or lower neighbour is on the other side of a mask's border."""
    edge = np.zeros_like(mask)
    edge[:, :-1] |= mask[:, :-1] != mask[:, 1:]
    edge[:-1] |= mask[:-1] != mask[1:]
    return edge


def common_side(block: Block, width: int, height: int) -> Camera:
    """One camera to the side that holds the scene of every method."""
    first, *others = (block.scenes[m] for m in reversed(METHODS))
    return side_camera(first, *others, block.true, width=width, height=height)


def panels(pictures: Sequence[Image]) -> Image:
    height = pictures[0].shape[0]
    row = np.full((height, WIDTH, 3), 255, np.uint8)
    each = pictures[0].shape[1]
    for k, picture in enumerate(pictures):
        row[:, k * (each + GAP) : k * (each + GAP) + each] = picture
    return row


def texts(words: Sequence[str], each: int) -> Image:
    canvas = PIL.Image.new("RGB", (WIDTH, LINE), "white")
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(17)
    for k, word in enumerate(words):
        draw.text((k * (each + GAP) + 2, 1), word, fill="black", font=font)
    return np.asarray(canvas)
