"""All materials of a scene as pictures in linear light at every level of detail, in one array."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Material, Mesh
from f3sr.core.srgb import linear
from f3sr.rendering.surface_kernels import Textures
from f3sr.rendering.texture_kernels import border, halve, settle
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer

WHITE = np.full((1, 1, 3), 255, np.uint8)
"""The texture of a material that has none: one white texel."""


LINEAR = rasterizer.fixed(linear(np.arange(256) / 255), np.float64)
"""Linear light of the 256 sRGB values."""


def textures_of(objects: Sequence[SceneObject]) -> Textures:
    """The materials of some objects, in their order.

    Texels that no triangle shows take the colour of shown ones nearby. Otherwise they would bleed into chart borders
    and coarse mip levels."""
    shown = [(o.mesh, k) for o in objects for k in range(len(o.mesh.materials))]
    shapes = [_level_shapes(*_texture(mesh, mesh.materials[k]).shape[:2]) for mesh, k in shown]
    most = max(map(len, shapes), default=1)
    # Ragged levels in rectangular arrays: what a small texture lacks stays 1 x 1 and is never read (``levels``).
    sizes = np.ones((len(shown), most, 2), np.int32)
    for k, levels in enumerate(shapes):
        sizes[k, : len(levels)] = levels
    counts = [np.prod(levels, axis=1) for levels in shapes]
    starts = np.zeros((len(shown), most), np.int64)
    total = 0
    for k, count in enumerate(counts):
        # cumsum minus own count: where each level begins in the one array of texels.
        starts[k, : len(count)] = total + np.cumsum(count) - count
        total += int(count.sum())
    texels = np.zeros((total, 3), np.uint16)

    def fill(k: int) -> None:
        levels = [
            texels[start : start + h * w].reshape(h, w, 3)
            for start, (h, w) in zip(starts[k].tolist(), shapes[k], strict=False)
        ]
        _fill(*shown[k], levels)

    rasterizer.share(fill, range(len(shown)))
    return Textures(
        texels=rasterizer.fixed(texels, np.uint16),
        starts=rasterizer.fixed(starts, np.int64),
        sizes=rasterizer.fixed(sizes, np.int32),
        levels=rasterizer.fixed([len(levels) for levels in shapes], np.int32),
    )


def _level_shapes(height: int, width: int) -> list[tuple[int, int]]:
    """Halves of halves, down to one texel."""
    shapes = [(height, width)]
    while max(shapes[-1]) > 1:
        h, w = shapes[-1]
        shapes.append(((h + 1) // 2, (w + 1) // 2))
    return shapes


def _fill(mesh: Mesh, material: int, levels: Sequence[NDArray[np.uint16]]) -> None:
    """Fill the levels (h, w, 3) of a material, finest first: means over the texels that are shown."""
    shown = mesh.materials[material]
    texture = _texture(mesh, shown)
    sums = [np.empty(level.shape, np.float32) for level in levels]
    weights = [np.empty(level.shape[:2], np.float32) for level in levels]
    drawn = rasterizer.fixed(_drawn(mesh, material, texture.shape[:2]), np.bool_)
    border(rasterizer.fixed(texture, np.uint8), _colors(shown), drawn, sums[0], weights[0])
    for fine in range(len(levels) - 1):
        halve(sums[fine], weights[fine], sums[fine + 1], weights[fine + 1])
    # Coarsest first: ``settle`` reads the next coarser level, which for the coarsest is itself.
    for level in range(len(levels) - 1, -1, -1):
        settle(sums[level], weights[level], levels[min(level + 1, len(levels) - 1)], levels[level])


def _texture(mesh: Mesh, material: Material) -> NDArray[np.uint8]:
    return WHITE if mesh.uv is None or material.texture is None else material.texture


def _colors(material: Material) -> NDArray[np.float32]:
    """(256, 3) linear light of base colour times texture, both sRGB values as the viewers of the field have it."""
    table = np.arange(256)[:, None] / 255 * np.asarray(material.base_color)
    return rasterizer.fixed(linear(np.clip(table, 0, 1)), np.float32)


def _drawn(mesh: Mesh, material: int, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Texels (h, w) that triangles of the material show at their centre; all of them if the texture repeats.

    A triangle without such a texel marks the texels of its corners."""
    h, w = size
    uv = mesh.uv
    assert mesh.face_material is not None
    faces = mesh.faces[mesh.face_material == material]
    if uv is None or h * w == 1 or not len(faces) or not ((uv[faces] >= 0) & (uv[faces] <= 1)).all():
        return np.ones(size, np.bool_)
    # The z-buffer draws the chart: at depth 1 with K = 1, uv in texels are pixels.
    flat = np.column_stack([uv[:, 0] * w, (1 - uv[:, 1]) * h, np.ones(len(uv))])
    drawn = rasterizer.silhouette(flat, faces, np.eye(3), w, h)
    # uv = 1 is the last texel's far side.
    x, y = np.minimum(flat[np.unique(faces), :2].astype(int), [w - 1, h - 1]).T
    around = np.pad(drawn, 1)
    # After padding by 1, i and j in 0..2 are the 3 x 3 texels around (y, x). Corners next to drawn texels need no mark.
    alone = ~np.any([around[y + i, x + j] for i in range(3) for j in range(3)], axis=0)
    drawn[y[alone], x[alone]] = True
    return drawn
