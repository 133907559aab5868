"""How an exported object looks: its visual mesh in metres, in pieces of one material each, with textures as PNG.

This is the one place that decides it. A mesh whose colours are in its vertices has no texture yet: their mean stands
for them, as formats other than USD know no vertex colours. A baked texture enters in ``textured``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Material, Mesh, area_vectors
from f3sr.core.transforms import Array
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
        from f3sr.rendering.config import RenderConfig
        from f3sr.rendering.shapes import smooth_normals  # of films: packages are written without

        return smooth_normals(self.whole, RenderConfig().crease)[self.whole.face_material == self.number]

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
    return tuple(_looks(textured(o.mesh), o.scale))


def textured(mesh: Mesh) -> Mesh:
    """The mesh as formats without vertex colours get it."""
    return mesh


def _looks(mesh: Mesh, scale: float) -> Iterator[ExportedLook]:
    assert mesh.face_material is not None
    shown = mesh.with_vertices(scale * mesh.vertices)
    for k in np.unique(mesh.face_material):
        chosen = mesh.face_material == k
        faces = mesh.faces[chosen]
        if np.linalg.norm(area_vectors(shown.vertices[faces]), axis=1).sum() / 2 < LEAST_AREA:
            continue
        material = mesh.materials[k]
        mean = np.ones(3) if mesh.vertex_colors is None else mesh.vertex_colors[np.unique(faces)].mean(0) / 255
        r, g, b = (np.asarray(material.base_color) * mean).tolist()
        yield ExportedLook(number=int(k), mesh=_part(shown, chosen), whole=shown, rgb=(r, g, b))


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
