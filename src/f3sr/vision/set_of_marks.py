"""The photo with its objects outlined and numbered, and crops of them: how a vision model is shown which is which.

Set-of-Mark prompting (Yang et al. 2023, arXiv:2310.11441): the number on an object is its id.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from f3sr.io.images import encode_png, resized
from f3sr.scene import Instance, SceneObject

LONGEST = 1024
"""Longer side of a picture for a model [px]: services scale larger ones down."""
LARGEST_CROP = 384
"""Longer side of a crop [px]."""
BORDER = 0.15
"""Of a crop around an object, in its own sizes: what it stands on and beside."""
COLORS = ((230, 60, 60), (40, 120, 230), (30, 150, 70), (220, 140, 20), (150, 60, 200), (20, 160, 170))

Marked = Instance | SceneObject
Picture = NDArray[np.uint8]


def shown(rgb: Picture, objects: Sequence[Marked], cropped: Sequence[Marked], most: int) -> list[str | bytes]:
    """What a model reads: the photo (H, W, 3), the same with ids, and crops of at most so many of the largest masks.

    Texts name the PNG pictures that follow them."""
    seen = sorted((o for o in cropped if o.mask.any()), key=lambda o: (-int(o.mask.sum()), o.id))[:most]
    parts: list[str | bytes] = ["The photo:", encode_png(limited(rgb, LONGEST))]
    parts += ["The same photo with the id of every object:", encode_png(marked(rgb, objects))]
    for o in sorted(seen, key=lambda o: o.id):
        parts += [f"Object {o.id}:", encode_png(crop(rgb, o.mask, LARGEST_CROP))]
    return parts


def marked(rgb: Picture, objects: Sequence[Marked], longest: int = LONGEST) -> Picture:
    """The photo (H, W, 3), at most so large, with every mask's outline and its object's id at its thickest place."""
    small = limited(rgb, longest)
    picture = Image.fromarray(small)
    letters = ImageFont.load_default(max(12, round(min(small.shape[:2]) / 28)))
    draw = ImageDraw.Draw(picture)
    for k, o in enumerate(objects):
        mask = np.asarray(Image.fromarray(o.mask).resize(picture.size, Image.Resampling.NEAREST))
        if not mask.any():
            continue
        color = COLORS[k % len(COLORS)]
        edge = mask & ~np.asarray(ndimage.binary_erosion(mask, iterations=2), bool)
        draw.bitmap((0, 0), Image.fromarray(edge), fill=color)
        depth = np.asarray(ndimage.distance_transform_edt(np.pad(mask, 1)))[1:-1, 1:-1]
        y, x = np.unravel_index(int(np.argmax(depth)), mask.shape)
        box = draw.textbbox((int(x), int(y)), str(o.id), font=letters, anchor="mm")
        draw.rectangle((box[0] - 3, box[1] - 3, box[2] + 3, box[3] + 3), fill=color)
        draw.text((int(x), int(y)), str(o.id), fill=(255, 255, 255), font=letters, anchor="mm")
    return np.asarray(picture)


def crop(rgb: Picture, mask: NDArray[np.bool_], longest: int = LONGEST) -> Picture:
    """The part of the photo (h, w, 3) around a mask (H, W), which is not empty, with a border."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    pad = max(4, round(BORDER * max(np.ptp(rows), np.ptp(columns))))
    top, left = max(0, int(rows[0]) - pad), max(0, int(columns[0]) - pad)
    return limited(rgb[top : int(rows[-1]) + pad + 1, left : int(columns[-1]) + pad + 1], longest)


def limited(rgb: Picture, longest: int) -> Picture:
    """A picture (h, w, 3) with at most so many pixels on its longer side."""
    height, width = rgb.shape[:2]
    scale = longest / max(height, width)
    return rgb if scale >= 1 else resized(rgb, max(1, round(scale * width)), max(1, round(scale * height)))
