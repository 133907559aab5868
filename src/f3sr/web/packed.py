"""Meshes, textures and cameras packed small, as ``view3d.js`` reads them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import Array
from f3sr.io.images import resized
from f3sr.web.data_uri import jpeg_uri

TEXTURE_QUALITY = 80
LARGEST = 32767
"""Vertices are 16-bit: a mesh's box is cut into 65534 steps per side."""


@dataclass
class TextureIndex:
    """Every texture once, by identity."""

    longest: int
    uris: list[str] = field(default_factory=list)
    known: dict[int, int] = field(default_factory=dict)

    def index(self, texture: NDArray[np.uint8]) -> int:
        if id(texture) not in self.known:
            self.known[id(texture)] = len(self.uris)
            scale = min(1.0, self.longest / max(texture.shape[:2]))
            height, width = (max(1, round(scale * n)) for n in texture.shape[:2])
            self.uris.append(jpeg_uri(resized(texture, width, height), TEXTURE_QUALITY))
        return self.known[id(texture)]


def packed_camera(camera: Camera) -> dict[str, Any]:
    K, T = camera.K.ravel().tolist(), camera.T_world_camera.ravel().tolist()
    return {"width": camera.width, "height": camera.height, "K": K, "T": T}


def packed_mesh(mesh: Mesh, texture_index: Any) -> dict[str, Any]:
    """Quantised vertices, texture coordinates and colours, and per material a run of triangles."""
    assert mesh.face_material is not None
    order = np.argsort(mesh.face_material, kind="stable")
    counts = np.bincount(mesh.face_material, minlength=len(mesh.materials))
    runs = [
        {
            "count": int(3 * count),
            "color": [float(c) for c in material.base_color],
            "texture": None if material.texture is None or mesh.uv is None else texture_index(material.texture),
        }
        for material, count in zip(mesh.materials, counts, strict=False)
        if count
    ]
    packed = {**_quantised(mesh.vertices), "faces": _indices(mesh.faces[order], len(mesh.vertices)), "runs": runs}
    if mesh.uv is not None:
        low, high = mesh.uv.min(0), mesh.uv.max(0)
        span = np.where(high > low, high - low, 1.0)
        steps = np.round((mesh.uv - low) / span * 65535).astype("<u2")
        packed |= {"uv": _base64(steps), "uvBox": [*low.tolist(), *span.tolist()]}
    if mesh.vertex_colors is not None:
        packed["colors"] = _base64(np.pad(mesh.vertex_colors, ((0, 0), (0, 1)), constant_values=255))
    return packed


def packed_parts(parts: Sequence[ConvexPart]) -> dict[str, Any] | None:
    """All convex parts as one mesh, a run of triangles each."""
    if not parts:
        return None
    vertices = np.concatenate([p.vertices for p in parts])
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=False)])
    counts = [{"count": 3 * len(p.faces)} for p in parts]
    return {**_quantised(vertices), "faces": _indices(faces, len(vertices)), "runs": counts}


def _quantised(vertices: Array) -> dict[str, Any]:
    low, high = vertices.min(0), vertices.max(0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-12)
    steps = np.round((vertices - middle) / half * LARGEST).astype("<i2")
    padded = np.pad(steps, ((0, 0), (0, 1)))
    return {"vertices": _base64(padded), "box": [*middle.tolist(), *half.tolist()]}


def _indices(faces: NDArray[Any], vertices: int) -> dict[str, Any]:
    wide = vertices > 65535
    return {"wide": wide, "data": _base64(faces.astype("<u4" if wide else "<u2"))}


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
