"""Reads and writes mesh files: the only place where a mesh crosses the border of the program."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from f3sr.core.mesh import Material, Mesh
from f3sr.errors import InputError
from f3sr.files import limited_file
from f3sr.files.limited_file import MAX_FILE_BYTES
from f3sr.io.gltf_reader import Primitive, read_gltf
from f3sr.io.gltf_writer import mesh_to_glb

MESHES, PARTS = (".glb", ".gltf"), (".obj",)
"""Types of files with visual meshes, and with collision parts."""
MAX_FACES = 5_000_000
"""Of one file: twenty times what generators make. Vertices may be three times as many, for faces may share none."""
MAX_TEXT_BYTES = 200_000_000
"""Of a file that is no GLB: reading text takes fifteen times its size; two million triangles."""
MAX_COORDINATE = 1e15
"""Largest coordinate: single precision holds its square."""
MAX_TEXTURE_PIXELS = 8192 * 8192
"""Over all base colour textures of one file: a single one of the largest size that graphics cards must take."""


def load_mesh(path: Path, *, max_faces: int = MAX_FACES, max_texture_pixels: int = MAX_TEXTURE_PIXELS) -> Mesh:
    """Read a GLB, or a glTF with everything embedded, as one mesh in the file's own axes.

    All geometries of the file come with their node transforms, in the order of
    ``trimesh.load(path, force="mesh", process=False)``. Nothing is merged or flipped, no triangle dropped.
    Raises InputError, naming the file, for what cannot be read or is not a finite triangle mesh.
    """
    path = Path(path)
    data = _read_bytes(path, MESHES, MAX_FILE_BYTES if path.suffix.lower() == ".glb" else MAX_TEXT_BYTES)
    return mesh_of_glb(data, path, max_faces=max_faces, max_texture_pixels=max_texture_pixels)


def mesh_of_glb(
    data: bytes, where: Path, *, max_faces: int = MAX_FACES, max_texture_pixels: int = MAX_TEXTURE_PIXELS
) -> Mesh:
    """The same of bytes that are no file yet; ``where`` names them in errors."""
    pieces = read_gltf(where, data, max_faces=max_faces, max_texture_pixels=max_texture_pixels)
    return _joined(_checked(where, pieces))


def load_part(path: Path, *, max_faces: int = MAX_FACES, max_bytes: int = MAX_TEXT_BYTES) -> Mesh:
    """Read the vertices and triangles of an OBJ file, in its own axes; no file that it names is opened.

    Raises InputError, naming the file, for what cannot be read or is not a finite triangle mesh.
    """
    path = Path(path)
    data = _read_bytes(path, PARTS, max_bytes)
    try:
        piece = _shape(data)
    except Exception as error:  # trimesh raises whatever its parser stumbles over
        raise _refused(path, f"an unreadable file ({type(error).__name__}: {error})"[:300], PARTS) from error
    if len(piece.faces) > max_faces:
        raise InputError(path, found=f"{len(piece.faces):,} faces", accepted=f"at most {max_faces:,}")
    return _joined(_checked(path, [piece]))


def save_glb(mesh: Mesh, path: Path) -> None:
    """Write a mesh in its own frame as GLB; ``load_mesh`` gives it back, vertices rounded to float32.

    Raises OSError where the file cannot be written."""
    Path(path).write_bytes(mesh_to_glb(mesh, name=Path(path).stem))


def _read_bytes(path: Path, formats: Sequence[str], most: int) -> bytes:
    if path.suffix.lower() not in formats:
        raise _refused(path, f"a file of type {path.suffix!r}", formats)
    return limited_file.read(path, most=most, accepted=_accepted(formats))


def _refused(path: Path, found: str, formats: Sequence[str]) -> InputError:
    return InputError(path, found=found, accepted=_accepted(formats))


def _accepted(formats: Sequence[str]) -> str:
    return f"a mesh file ({', '.join(formats)})"


def _shape(data: bytes) -> Primitive:
    """The vertices and triangles of an OBJ file."""
    import trimesh

    shape: Any = trimesh.load(io.BytesIO(data), file_type="obj", force="mesh", process=False, skip_materials=True)
    vertices, faces = np.array(shape.vertices, float), np.array(shape.faces, np.int64)
    return Primitive(vertices=vertices, faces=faces.reshape(-1, 3), uv=None, colors=None, material=Material())


def _checked(path: Path, pieces: Sequence[Primitive]) -> list[Primitive]:
    """Those that have faces."""
    pieces = [p for p in pieces if len(p.faces)]
    if not pieces:
        raise InputError(path, found="no faces", accepted="a mesh with at least one triangle")
    for p in pieces:
        numbers = [p.vertices] if p.uv is None else [p.vertices, p.uv]
        if not all((np.abs(v) <= MAX_COORDINATE).all() for v in numbers):  # NaN is not
            found = f"coordinates that are NaN, infinite or beyond {MAX_COORDINATE:.0e}"
            raise InputError(path, found=found, accepted="finite coordinates")
        if p.faces.min() < 0 or p.faces.max() >= len(p.vertices):
            raise InputError(path, found="faces of vertices that do not exist", accepted="a consistent mesh")
    return pieces


def _key(material: Material) -> tuple[Any, ...]:
    """Equal for equal appearance."""
    texture = material.texture
    if texture is None:
        return material.base_color, None
    return material.base_color, texture.shape, hashlib.sha256(texture.tobytes()).digest()


def _joined(pieces: list[Primitive]) -> Mesh:
    """All pieces as one mesh, equal materials once; what a piece lacks is filled with zeros (uv) or white."""
    starts = np.cumsum([0, *(len(p.vertices) for p in pieces)])
    materials: dict[tuple[Any, ...], tuple[int, Material]] = {}
    keys = {id(p.material): _key(p.material) for p in pieces}
    index = [materials.setdefault(keys[id(p.material)], (len(materials), p.material))[0] for p in pieces]
    uv, colors = None, None
    if any(p.uv is not None for p in pieces):
        uv = np.concatenate([np.zeros((len(p.vertices), 2)) if p.uv is None else p.uv for p in pieces])
    if any(p.colors is not None for p in pieces):
        white = [np.full((len(p.vertices), 3), 255, np.uint8) for p in pieces]
        colors = np.concatenate([w if p.colors is None else p.colors for p, w in zip(pieces, white, strict=True)])
    return Mesh(
        vertices=np.concatenate([p.vertices for p in pieces]),
        faces=np.concatenate([p.faces + start for p, start in zip(pieces, starts, strict=False)]).astype(np.int32),
        uv=uv,
        vertex_colors=colors,
        materials=tuple(m for _, m in materials.values()),
        face_material=np.repeat(np.array(index, np.int32), [len(p.faces) for p in pieces]),
    )
