"""Binary glTF: meshes with their appearance, nodes and cameras."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array
from f3sr.io.images import encode_png

FLOAT, UINT8, UINT16, UINT32 = 5126, 5121, 5123, 5125
"""glTF's component types."""
COMPONENT = {np.float32: FLOAT, np.uint8: UINT8, np.uint16: UINT16, np.uint32: UINT32}
SHORT = 0xFFFF
"""Most vertices that indices of two bytes reach: glTF keeps the highest one for itself."""
VERTEX_BUFFER, INDEX_BUFFER = 34962, 34963
"""glTF's targets of buffer views."""
LINEAR_REPEAT = {"magFilter": 9729, "minFilter": 9729, "wrapS": 10497, "wrapT": 10497}
"""The one sampler: bilinear, repeating, as our own renderers draw textures."""


def mesh_to_glb(mesh: Mesh, *, name: str = "mesh") -> bytes:
    """One mesh in its own frame: no axis flip, faces and vertices in their order, vertices as float32."""
    glb = GlbBuilder()
    glb.add_node(name, mesh=glb.add_mesh(mesh, name))
    return glb.to_bytes()


def safe_name(text: str, *, longest: int = 60) -> str:
    """Letters, digits, ``_`` and ``-`` of a text; everything else, and what is too long, is left out."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in text[: 4 * longest])
    return kept[:longest].strip("_") or "unnamed"


class GlbBuilder:
    """Collects meshes and nodes and lays them out as one GLB file; equal calls give equal bytes."""

    def __init__(self) -> None:
        self._tree: dict[str, list[Any]] = {
            k: [] for k in ("nodes", "meshes", "cameras", "materials", "textures", "images", "accessors", "bufferViews")
        }
        self._chunks: list[bytes] = []
        self._offset = 0
        self._materials: dict[int, int] = {}

    def add_node(
        self,
        name: str,
        *,
        mesh: int | None = None,
        camera: int | None = None,
        T: Array | None = None,
        extras: Mapping[str, Any] | None = None,
    ) -> None:
        """A root node with the mesh or the camera of that index under the transform T (4, 4)."""
        node: dict[str, Any] = {"name": name}
        node |= {key: index for key, index in (("mesh", mesh), ("camera", camera)) if index is not None}
        if T is not None:
            # glTF stores matrices by columns.
            node["matrix"] = T.T.ravel().tolist()
        if extras:
            node["extras"] = dict(extras)
        self._tree["nodes"].append(node)

    def add_camera(self, name: str, *, yfov: float, aspect: float, near: float) -> int:
        """Index of a new perspective camera: opening angle from top to bottom [rad], width over height of the window,
        and distance of the near plane [m]. It sees to infinity."""
        perspective = {"yfov": yfov, "aspectRatio": aspect, "znear": near}
        self._tree["cameras"].append({"name": name, "type": "perspective", "perspective": perspective})
        return len(self._tree["cameras"]) - 1

    def add_mesh(self, mesh: Mesh, name: str, normals: NDArray[np.float32] | None = None) -> int:
        """Index of a new glTF mesh, one primitive per run of faces of one material.

        ``normals`` (n, 3), unit, are those of the vertices; without, readers shade every face for itself.
        An untextured mesh carries its base colour in its vertex colours and has no material: that is what all
        readers, trimesh included, agree on.
        """
        textured = any(m.texture is not None for m in mesh.materials)
        primitives = [
            self._primitive(mesh, normals, faces, mesh.materials[index], textured=textured)
            for index, faces in _runs(mesh)
        ]
        self._tree["meshes"].append({"name": name, "primitives": primitives})
        return len(self._tree["meshes"]) - 1

    def to_bytes(self) -> bytes:
        """The GLB file: header, JSON chunk padded with blanks, binary chunk."""
        tree: dict[str, Any] = {"asset": {"version": "2.0", "generator": "f3sr"}, "scene": 0}
        tree["scenes"] = [{"nodes": list(range(len(self._tree["nodes"])))}]
        tree |= {key: values for key, values in self._tree.items() if values}
        if self._tree["textures"]:
            tree["samplers"] = [LINEAR_REPEAT]
        tree["buffers"] = [{"byteLength": self._offset}]
        header = json.dumps(tree, separators=(",", ":")).encode()
        header += b" " * (-len(header) % 4)
        total = 12 + 8 + len(header) + 8 + self._offset
        return b"".join(
            (
                struct.pack("<III", 0x46546C67, 2, total),
                struct.pack("<II", len(header), 0x4E4F534A),
                header,
                struct.pack("<II", self._offset, 0x004E4942),
                *self._chunks,
            )
        )

    def _primitive(
        self,
        mesh: Mesh,
        normals: NDArray[np.float32] | None,
        faces: NDArray[np.int32] | None,
        material: Material,
        *,
        textured: bool,
    ) -> dict[str, Any]:
        """One primitive: ``faces`` of one material, or all of the mesh when None."""
        if faces is None:
            used, local = np.arange(len(mesh.vertices)), mesh.faces
        else:
            used, inverse = np.unique(faces, return_inverse=True)
            local = inverse.reshape(-1, 3)
        attributes = {"POSITION": self._accessor(mesh.vertices[used].astype(np.float32), "VEC3", bounds=True)}
        if normals is not None:
            attributes["NORMAL"] = self._accessor(normals[used], "VEC3")
        colors = None if mesh.vertex_colors is None else mesh.vertex_colors[used]
        primitive: dict[str, Any] = {"attributes": attributes, "mode": 4}
        if textured:
            # v -> 1 - v: glTF's origin is at the top left.
            uv = np.zeros((len(used), 2)) if mesh.uv is None else mesh.uv[used] * [1, -1] + [0, 1]
            attributes["TEXCOORD_0"] = self._accessor(uv.astype(np.float32), "VEC2")
            primitive["material"] = self._material(material)
        else:
            white = np.full((len(used), 3), 255, np.uint8)
            colors = np.rint((white if colors is None else colors) * material.base_color)
        if colors is not None:
            rgba = np.full((len(used), 4), 255, np.uint8)
            rgba[:, :3] = colors
            attributes["COLOR_0"] = self._accessor(rgba, "VEC4")
        index = np.uint16 if len(used) <= SHORT else np.uint32
        primitive["indices"] = self._accessor(local.astype(index).ravel(), "SCALAR", target=INDEX_BUFFER)
        return primitive

    def _material(self, material: Material) -> int:
        """Index of a glTF material; equal values are written once."""
        key = id(material)
        if key in self._materials:
            return self._materials[key]
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        surface["baseColorFactor"] = [*map(float, material.base_color), 1.0]
        if material.texture is not None:
            view = self._view(png_of(material))
            self._tree["images"].append({"bufferView": view, "mimeType": "image/png"})
            self._tree["textures"].append({"sampler": 0, "source": len(self._tree["images"]) - 1})
            surface["baseColorTexture"] = {"index": len(self._tree["textures"]) - 1}
        self._tree["materials"].append({"pbrMetallicRoughness": surface, "doubleSided": True})
        self._materials[key] = len(self._tree["materials"]) - 1
        return self._materials[key]

    def _accessor(self, values: NDArray[Any], kind: str, *, bounds: bool = False, target: int = VERTEX_BUFFER) -> int:
        component = COMPONENT[values.dtype.type]
        accessor: dict[str, Any] = {"bufferView": self._view(values.tobytes(), target), "type": kind}
        accessor |= {"componentType": component, "count": len(values)}
        if component == UINT8:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self._tree["accessors"].append(accessor)
        return len(self._tree["accessors"]) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        view = {"buffer": 0, "byteOffset": self._offset, "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._tree["bufferViews"].append(view)
        padding = b"\0" * (-len(data) % 4)
        self._chunks += [data, padding]  # not one: pictures are shared with their cache
        self._offset += len(data) + len(padding)
        return len(self._tree["bufferViews"]) - 1


def _runs(mesh: Mesh) -> Iterator[tuple[int, NDArray[np.int32] | None]]:
    """(material, faces) of each maximal run of faces of one material; faces None: the whole mesh."""
    material = mesh.face_material
    assert material is not None
    # -1 is no material: the first face always starts a run.
    starts = np.flatnonzero(np.diff(material, prepend=-1))
    if len(starts) == 1:
        yield int(material[0]), None
        return
    for start, faces in zip(starts, np.split(mesh.faces, starts[1:]), strict=True):
        yield int(material[start]), faces


_PNGS: WeakKeyDictionary[Material, bytes] = WeakKeyDictionary()


def png_of(material: Material) -> bytes:
    """The texture of a material as PNG, encoded once however many files it goes to."""
    if material not in _PNGS:
        assert material.texture is not None
        _PNGS[material] = encode_png(material.texture)
    return _PNGS[material]


def encode_pngs(meshes: Iterable[Mesh]) -> None:
    """Encode the textures of some meshes for ``png_of``, one per processor at a time."""
    textured = [m for mesh in meshes for m in mesh.materials if m.texture is not None]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(png_of, textured))
