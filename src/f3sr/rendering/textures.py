"""All materials of a scene as pictures in linear light at every level of detail, in one array."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr import raster
from f3sr.background.regions import squared
from f3sr.mesh import Material, Mesh
from f3sr.rendering.surface_kernels import UNIT, Textures
from f3sr.scene import SceneObject

Picture = NDArray[np.float32]
"""(h, w, 3) in linear light."""

WHITE = np.full((1, 1, 3), 255, np.uint8)


def linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB values of linear light in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def textures_of(objects: Sequence[SceneObject]) -> Textures:
    """The materials of some objects, in their order. Texels that no triangle shows take the colour of near ones that
    one does, or they would bleed into the borders of charts and into coarse levels."""
    pyramids = [list(_levels(o.mesh, k)) for o in objects for k in range(len(o.mesh.materials))]
    most = max((len(levels) for levels in pyramids), default=1)
    starts = np.zeros((len(pyramids), most), np.int64)
    sizes = np.ones((len(pyramids), most, 2), np.int32)
    total = 0
    for k, levels in enumerate(pyramids):
        for level, picture in enumerate(levels):
            starts[k, level], sizes[k, level] = total, picture.shape[:2]
            total += picture.shape[0] * picture.shape[1]
    texels = [np.zeros((0, 3), np.uint16), *(p.reshape(-1, 3) for levels in pyramids for p in levels)]
    return Textures(
        texels=raster.fixed(np.concatenate(texels), np.uint16),
        starts=raster.fixed(starts, np.int64),
        sizes=raster.fixed(sizes, np.int32),
        levels=raster.fixed([len(levels) for levels in pyramids], np.int32),
    )


def _levels(mesh: Mesh, material: int) -> Iterator[NDArray[np.uint16]]:
    shown = mesh.materials[material]
    picture = _linear_picture(mesh, shown)
    drawn = _drawn(mesh, material, picture.shape[:2])
    for level in _pyramid(*_bordered(picture, drawn)):
        yield np.rint(level * UNIT).astype(np.uint16)


def _linear_picture(mesh: Mesh, material: Material) -> Picture:
    """Base colour times texture, both sRGB values as the viewers of the field have it, as linear light."""
    texture = WHITE if mesh.uv is None or material.texture is None else material.texture
    table = np.arange(256)[:, None] / 255 * np.asarray(material.base_color)
    table = linear(np.clip(table, 0, 1)).astype(np.float32)
    return np.stack([table[texture[..., c], c] for c in range(3)], axis=2)


def _drawn(mesh: Mesh, material: int, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Texels (h, w) whose middle a triangle of the material shows, or that hold a corner of one with no such texel
    around; all, where they repeat the texture."""
    h, w = size
    uv = mesh.uv
    assert mesh.face_material is not None
    faces = mesh.faces[mesh.face_material == material]
    if uv is None or h * w == 1 or not len(faces) or not ((uv[faces] >= 0) & (uv[faces] <= 1)).all():
        return np.ones(size, np.bool_)
    flat = np.column_stack([uv[:, 0] * w, (1 - uv[:, 1]) * h, np.ones(len(uv))])
    drawn = raster.silhouette(flat, faces, np.eye(3), w, h)
    x, y = np.minimum(flat[np.unique(faces), :2].astype(int), [w - 1, h - 1]).T
    alone = ~squared(drawn, 3)[y, x]
    drawn[y[alone], x[alone]] = True
    return drawn


def _bordered(picture: Picture, drawn: NDArray[np.bool_]) -> tuple[Picture, NDArray[np.bool_]]:
    """The picture with the mean of drawn neighbours in each texel beside them, which bilinear samples touch, and which
    texels then are known."""
    h, w = drawn.shape
    weight = np.pad(drawn.astype(np.float32)[..., None], ((1, 1), (1, 1), (0, 0)))
    total = np.pad(picture, ((1, 1), (1, 1), (0, 0))) * weight
    around = [(slice(dy, dy + h), slice(dx, dx + w)) for dy in range(3) for dx in range(3)]
    count = np.sum([weight[a] for a in around], axis=0)
    mean = np.sum([total[a] for a in around], axis=0) / np.maximum(count, 1)
    return np.where(drawn[..., None], picture, mean).astype(np.float32), count[..., 0] > 0


def _pyramid(picture: Picture, used: NDArray[np.bool_]) -> list[Picture]:
    """Halves of halves down to one texel: means over the used texels; the others then take the coarser level's."""
    weights = [used.astype(np.float32)[..., None]]
    sums = [picture * weights[0]]
    while max(sums[-1].shape[:2]) > 1:
        sums.append(_halved(sums[-1]))
        weights.append(_halved(weights[-1]))
    levels = [_over(sums[-1], weights[-1])]
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        h, w = total.shape[:2]
        coarse = levels[-1].repeat(2, axis=0).repeat(2, axis=1)[:h, :w]
        levels.append(np.where(weight > 0, _over(total, weight), coarse))
    return levels[::-1]


def _over(total: Picture, weight: NDArray[np.float32]) -> Picture:
    return (total / np.maximum(weight, 1e-9)).astype(np.float32)


def _halved(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of two by two; the last row or column of an odd side counts twice."""
    h, w = values.shape[:2]
    even = np.pad(values, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge")
    return even.reshape((h + 1) // 2, 2, (w + 1) // 2, 2, -1).mean((1, 3), dtype=np.float32)
