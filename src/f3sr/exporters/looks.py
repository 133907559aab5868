"""How an exported object looks: its visual mesh in metres, in pieces of one material each, with textures as PNG.

Most formats know no vertex colours: they become a texture where the material has none, else their mean stands for them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Material, Mesh, area_vectors
from f3sr.core.transforms import Array
from f3sr.exporters.colour_atlas import bake_colours
from f3sr.io.gltf_writer import png_of
from f3sr.scene import SceneObject

LEAST_AREA = 1e-12
"""[m2]: faces of one material with less than this cannot be seen, and MuJoCo refuses a mesh of them."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ExportedLook:
    """The faces of an object that share a material, in the object frame, metres; no vertex is unused."""

    number: int
    """Of the material in its mesh."""
    mesh: Mesh
    """Only these faces, in metres."""
    whole: Mesh
    """The whole mesh, in metres."""
    rgb: tuple[float, float, float]
    """Factor on the texture, or the colour itself, sRGB values in [0, 1]."""

    @property
    def vertices(self) -> Array:
        return self.mesh.vertices

    @property
    def faces(self) -> NDArray[np.int32]:
        return self.mesh.faces

    @property
    def uv(self) -> Array | None:
        """Texture coordinates (n, 2), v upwards; None without a texture."""
        return self.mesh.uv if self._material.texture is not None else None

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals (m, 3, 3) of the faces' corners, smooth across materials; sharp edges stay sharp."""
        return corner_normals(self.whole)[self.whole.face_material == self.number]

    @cached_property
    def png(self) -> bytes | None:
        """Its texture, None without one."""
        return None if self.uv is None else png_of(self._material)

    @property
    def mean_rgb(self) -> tuple[float, float, float]:
        """Its mean colour, for viewers that draw no textures."""
        texture = self._material.texture if self.uv is not None else None
        mean = np.ones(3) if texture is None else texture.reshape(-1, 3).mean(0) / 255
        r, g, b = (mean * self.rgb).tolist()
        return r, g, b

    @property
    def _material(self) -> Material:
        return self.mesh.materials[self.number]


def looks_of(o: SceneObject) -> tuple[ExportedLook, ...]:
    """The visual mesh of an object, one piece per material in use."""
    return tuple(_looks(o.mesh, o.scale))


def _looks(mesh: Mesh, scale: float) -> Iterator[ExportedLook]:
    assert mesh.face_material is not None
    shown = mesh.with_vertices(scale * mesh.vertices)
    for k in np.unique(mesh.face_material):
        chosen = mesh.face_material == k
        faces = mesh.faces[chosen]
        if np.linalg.norm(area_vectors(shown.vertices[faces]), axis=1).sum() / 2 < LEAST_AREA:
            continue
        part, mean = _part(shown, chosen), np.ones(3)
        if part.vertex_colors is not None:
            baked = _baked(part, int(k))
            part, mean = (part, part.vertex_colors.mean(0) / 255) if baked is None else (baked, mean)
        r, g, b = (np.asarray(mesh.materials[k].base_color) * mean).tolist()
        yield ExportedLook(number=int(k), mesh=part, whole=shown, rgb=(r, g, b))


def _baked(part: Mesh, k: int) -> Mesh | None:
    """The mesh with its vertex colours as the texture of material ``k``: vertices are there once for each place in the
    atlas. None where the material has a texture, the colours are all one, or nothing fits."""
    colours, material = part.vertex_colors, part.materials[k]
    assert colours is not None
    if (material.texture is not None and part.uv is not None) or (colours == colours[0]).all():
        return None
    baked = bake_colours(part.vertices, part.faces, colours)
    if baked is None:
        return None
    pairs = np.stack([part.faces, baked.uv_faces], axis=2).reshape(-1, 2)
    (vertex, place), corner = _distinct(pairs)
    return Mesh(
        vertices=part.vertices[vertex],
        faces=corner.reshape(-1, 3).astype(np.int32),
        uv=baked.uv[place],
        materials=(*part.materials[:k], replace(material, texture=baked.texture), *part.materials[k + 1 :]),
        face_material=part.face_material,
    )


def _distinct(pairs: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The distinct rows of pairs (c, 2), as (2, n), and which of them each is."""
    high = int(pairs[:, 1].max()) + 1
    keys, which = np.unique(pairs[:, 0].astype(np.int64) * high + pairs[:, 1], return_inverse=True)
    return np.stack([keys // high, keys % high]), which.astype(np.int64)


def _part(mesh: Mesh, chosen: NDArray[np.bool_]) -> Mesh:
    """The chosen faces (m,) of a mesh alone."""
    assert mesh.face_material is not None
    part = Mesh(
        vertices=mesh.vertices,
        faces=mesh.faces[chosen],
        uv=mesh.uv,
        vertex_colors=mesh.vertex_colors,
        materials=mesh.materials,
        face_material=mesh.face_material[chosen],
    )
    return part.without_unused()
