"""Reads and writes mesh files: the only place where a mesh crosses the border of the program."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr import limited_file
from f3sr.errors import InputError
from f3sr.export.gltf import mesh_to_glb
from f3sr.gltf import Piece, read_gltf
from f3sr.limited_file import MAX_FILE_BYTES, MAX_JSON_BYTES
from f3sr.mesh import Material, Mesh

FORMATS = (".glb", ".gltf", ".obj", ".ply")
ACCEPTED = f"a mesh file ({', '.join(FORMATS)})"
MAX_FACES = 5_000_000
"""Of one file: twenty times what generators make. Vertices may be three times as many, for faces may share none."""
MAX_TEXT_BYTES = 200_000_000
"""Of a file that is no GLB, or that one names: reading text takes fifteen times its size; two million triangles."""
MAX_COORDINATE = 1e15
"""Largest coordinate: single precision holds its square."""
MAX_TEXTURE_PIXELS = 8192 * 8192
"""Over all base colour textures of one file: a single one of the largest size that graphics cards must take."""


def load_mesh(
    path: Path,
    *,
    max_faces: int = MAX_FACES,
    max_texture_pixels: int = MAX_TEXTURE_PIXELS,
    max_bytes: int = MAX_FILE_BYTES,
) -> Mesh:
    """Read a GLB, glTF with everything embedded, OBJ or PLY file as one mesh in the file's own axes.

    All geometries of the file come with their node transforms, in the order of
    ``trimesh.load(path, force="mesh", process=False)``. Nothing is merged or flipped, no triangle dropped.
    Raises InputError, naming the file, for what cannot be read or is not a finite triangle mesh.
    """
    path = Path(path)
    data = _read_bytes(path, max_bytes)
    if path.suffix.lower() in (".glb", ".gltf"):
        pieces = read_gltf(path, data, max_faces=max_faces, max_texture_pixels=max_texture_pixels)
    else:
        pieces = _read_with_trimesh(path, data)
    pieces = [p for p in pieces if len(p.faces)]
    if not pieces:
        raise InputError(path, found="no faces", accepted="a mesh with at least one triangle")
    _check_pieces(path, pieces, max_faces=max_faces, max_texture_pixels=max_texture_pixels)
    return _joined(pieces)


def save_glb(mesh: Mesh, path: Path) -> None:
    """Write a mesh in its own frame; ``load_mesh`` gives it back, vertices rounded to float32."""
    Path(path).write_bytes(mesh_to_glb(mesh, name=Path(path).stem))


def _read_bytes(path: Path, max_bytes: int) -> bytes:
    if path.suffix.lower() not in FORMATS:
        raise _refused(path, f"a file of type {path.suffix!r}")
    most = MAX_FILE_BYTES if path.suffix.lower() == ".glb" else MAX_TEXT_BYTES
    return limited_file.read(path, most=min(most, max_bytes), accepted=ACCEPTED)


def _refused(path: Path, found: str) -> InputError:
    return InputError(path, found=found, accepted=ACCEPTED)


def _read_with_trimesh(path: Path, data: bytes) -> list[Piece]:
    """The geometries of an OBJ or PLY file."""
    import trimesh
    from trimesh.resolvers import FilePathResolver

    _check_side_files(path, data)
    kind, resolver = path.suffix.lower()[1:], FilePathResolver(str(path))
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, resolver=resolver, process=False)
        return list(_pieces(scene))
    except Exception as error:  # trimesh raises whatever its parsers stumble over
        raise _refused(path, f"an unreadable file ({type(error).__name__}: {error})"[:300]) from error


def _check_side_files(path: Path, data: bytes) -> None:
    """What an OBJ or PLY names must lie in its folder: trimesh would leave it out silently."""
    text = data.decode("utf-8", errors="replace")
    if path.suffix.lower() == ".ply":
        header = text.partition("end_header")[0]
        names = re.findall(r"^comment TextureFile (.+)$", header, flags=re.MULTILINE)
    else:
        names = re.findall(r"^\s*mtllib\s+(.+)$", text, flags=re.MULTILINE)
    for name in (n.strip() for n in names):
        side = _inside(path, name)
        if side.suffix.lower() == ".mtl":
            lines = limited_file.read(side, most=MAX_JSON_BYTES).decode(errors="replace")
            for picture in re.findall(r"^\s*map_Kd\s+(.+)$", lines, flags=re.MULTILINE):
                _inside(path, picture.strip())


def _inside(path: Path, name: str) -> Path:
    folder = path.resolve().parent
    side = (folder / name).resolve()
    if not side.is_relative_to(folder) or not side.is_file():
        raise InputError(path, found=f"a reference to {name[:80]!r}", accepted="files that exist in the same folder")
    if side.stat().st_size > MAX_TEXT_BYTES:
        raise InputError(side, found=f"{side.stat().st_size:,} bytes", accepted=f"at most {MAX_TEXT_BYTES:,} bytes")
    return side


def _pieces(scene: Any) -> Iterator[Piece]:
    """Our view of the triangle meshes of a trimesh.Scene, in its order, each once per node that shows it."""
    import trimesh

    for geometry in scene.dump():
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            # The copies that dump() makes lose vertex colours beside a texture.
            yield _piece(geometry, scene.geometry[geometry.metadata["name"]].visual)


def _piece(geometry: Any, visual: Any) -> Piece:
    n = len(geometry.vertices)
    uv = getattr(visual, "uv", None)
    return Piece(
        vertices=np.array(geometry.vertices, float),
        faces=np.array(geometry.faces, np.int64),
        uv=np.array(uv, float)[:, :2] if uv is not None and len(uv) == n else None,
        colors=_vertex_colors(visual, n),
        material=_material(visual),
    )


def _vertex_colors(visual: Any, n: int) -> NDArray[np.uint8] | None:
    """(n, 3) sRGB. Colours per face are averaged onto the vertices."""
    from trimesh.visual.color import to_rgba

    if visual.kind in ("vertex", "face"):
        colors = visual.vertex_colors
    else:
        colors = getattr(visual, "vertex_attributes", {}).get("color")
    if colors is None or len(colors) != n:
        return None
    colors = np.array(colors)
    if colors.dtype == np.uint16:
        colors = colors / 65535.0
    return np.array(to_rgba(colors)[:, :3], np.uint8)


def _material(visual: Any) -> Material:
    """Base colour and texture. An OBJ's diffuse colour does not tint its picture: exporters leave it grey."""
    material = getattr(visual, "material", None)
    if material is None:
        return Material()
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = material.baseColorFactor if hasattr(material, "baseColorFactor") else None
    if factor is None and picture is None:
        factor = getattr(material, "diffuse", None)
    color = (255, 255, 255) if factor is None else (int(c) for c in factor[:3])
    r, g, b = (c / 255 for c in color)
    texture = None if picture is None else np.asarray(picture.convert("RGB"), np.uint8)
    return Material(base_color=(r, g, b), texture=texture)


def _check_pieces(path: Path, pieces: list[Piece], *, max_faces: int, max_texture_pixels: int) -> None:
    count = sum(len(p.faces) for p in pieces)
    if count > max_faces:
        raise InputError(path, found=f"{count:,} faces", accepted=f"at most {max_faces:,}")
    pixels = sum({id(p.material): _pixels(p.material) for p in pieces}.values())
    if pixels > max_texture_pixels:
        raise _too_many_pixels(path, pixels, max_texture_pixels)
    for p in pieces:
        numbers = [p.vertices] if p.uv is None else [p.vertices, p.uv]
        if not all((np.abs(v) <= MAX_COORDINATE).all() for v in numbers):  # NaN is not
            found = f"coordinates that are NaN, infinite or beyond {MAX_COORDINATE:.0e}"
            raise InputError(path, found=found, accepted="finite coordinates")
        if p.faces.min() < 0 or p.faces.max() >= len(p.vertices):
            raise InputError(path, found="faces of vertices that do not exist", accepted="a consistent mesh")


def _too_many_pixels(path: Path, found: int, accepted: int) -> InputError:
    return InputError(path, found=f"textures of {found:,} pixels", accepted=f"at most {accepted:,}")


def _pixels(material: Material) -> int:
    return 0 if material.texture is None else material.texture.shape[0] * material.texture.shape[1]


def _key(material: Material) -> tuple[Any, ...]:
    """Equal for equal appearance."""
    texture = material.texture
    if texture is None:
        return material.base_color, None
    return material.base_color, texture.shape, hashlib.sha256(texture.tobytes()).digest()


def _joined(pieces: list[Piece]) -> Mesh:
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
