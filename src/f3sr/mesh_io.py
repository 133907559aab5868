"""Reads and writes mesh files: the only place where a mesh crosses the border of the program."""

from __future__ import annotations

import base64
import binascii
import hashlib
import io
import json
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.export.gltf import mesh_to_glb
from f3sr.frames import Array
from f3sr.mesh import Material, Mesh

FORMATS = (".glb", ".gltf", ".obj", ".ply")
MAX_FACES = 5_000_000
MAX_TEXTURE_PIXELS = 8192 * 8192
"""Over all base colour textures of one file."""

READABLE_EXTENSIONS = re.compile(r"KHR_materials_\w+|EXT_texture_webp")
"""glTF extensions that a file may require: the others change geometry or texture in ways we do not read."""


def load_mesh(path: Path, *, max_faces: int = MAX_FACES, max_texture_pixels: int = MAX_TEXTURE_PIXELS) -> Mesh:
    """Read a GLB, glTF with everything embedded, OBJ or PLY file as one mesh in the file's own axes.

    All geometries of the file come with their node transforms, in the order of
    ``trimesh.load(path, force="mesh", process=False)``. Nothing is merged, flipped or dropped.
    Raises InputError, naming the file, for what cannot be read or is not a finite triangle mesh.
    """
    import trimesh
    from trimesh.resolvers import FilePathResolver

    path = Path(path)
    data = _read_bytes(path)
    kind = path.suffix.lower()
    if kind in (".glb", ".gltf"):
        _check_gltf(path, data, max_faces=max_faces, max_texture_pixels=max_texture_pixels)
    else:
        _check_side_files(path, data)
    resolver = None if kind in (".glb", ".gltf") else FilePathResolver(str(path))
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind[1:], resolver=resolver, process=False)
        pieces = list(_pieces(scene))
    except Exception as error:  # trimesh raises whatever its parsers stumble over
        raise _refused(path, f"an unreadable file ({type(error).__name__}: {error})"[:300]) from error
    if not pieces:
        raise InputError(path, found="no faces", accepted="a mesh with at least one triangle")
    _check_pieces(path, pieces, max_faces=max_faces, max_texture_pixels=max_texture_pixels)
    return _joined(pieces)


def save_glb(mesh: Mesh, path: Path) -> None:
    """Write a mesh in its own frame; ``load_mesh`` gives it back, vertices rounded to float32."""
    Path(path).write_bytes(mesh_to_glb(mesh, name=Path(path).stem))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Piece:
    """One geometry of a file, already in the file's frame."""

    vertices: Array
    faces: NDArray[np.int64]
    uv: Array | None
    colors: NDArray[np.uint8] | None
    material: Material


def _read_bytes(path: Path) -> bytes:
    if path.suffix.lower() not in FORMATS:
        raise _refused(path, f"a file of type {path.suffix!r}")
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise _refused(path, "no such file") from None
    except OSError as error:
        raise _refused(path, f"an unreadable file ({error.strerror})") from error


def _refused(path: Path, found: str) -> InputError:
    return InputError(path, found=found, accepted=f"a mesh file ({', '.join(FORMATS)})")


def _check_gltf(path: Path, data: bytes, *, max_faces: int, max_texture_pixels: int) -> None:
    """Refuse, before anything is decoded, files that reach outside themselves or claim absurd sizes."""
    try:
        tree, binary = _gltf_parts(data)
        uris = [item.get("uri", "data:") for key in ("buffers", "images") for item in tree.get(key, [])]
        required = [str(name) for name in tree.get("extensionsRequired", [])]
        count = max((int(a.get("count", 0)) for a in tree.get("accessors", [])), default=0)
        pixels = sum(_texture_sizes(tree, binary))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, OSError, struct.error) as error:
        raise _refused(path, f"a broken glTF file ({error})"[:300]) from error
    if outside := [str(u) for u in uris if not str(u).startswith("data:")]:
        raise InputError(path, found=f"a reference to {outside[0][:80]!r}", accepted="glTF with all data embedded")
    if unknown := [name for name in required if not READABLE_EXTENSIONS.fullmatch(name)]:
        raise InputError(
            path,
            found=f"required glTF extension {unknown[0][:80]!r}",
            accepted="plain glTF 2 without compression",
        )
    if count > 3 * max_faces:
        raise InputError(path, found=f"an array of {count} elements", accepted=f"at most {max_faces} faces")
    if pixels > max_texture_pixels:
        raise _too_many_pixels(path, pixels, max_texture_pixels)


def _gltf_parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON tree and the binary chunk of GLB or glTF bytes."""
    if data[:4] != b"glTF":
        return json.loads(data), b""
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def _texture_sizes(tree: dict[str, Any], binary: bytes) -> Iterator[int]:
    """Pixels of each image used as a base colour. PIL.UnidentifiedImageError is an OSError."""
    from PIL import Image

    surfaces = (m.get("pbrMetallicRoughness", {}) for m in tree.get("materials", []))
    textures = {s["baseColorTexture"]["index"] for s in surfaces if "baseColorTexture" in s}
    for texture in (tree["textures"][i] for i in sorted(textures)):
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        image = tree["images"][webp.get("source", texture.get("source"))]
        with Image.open(io.BytesIO(_image_bytes(image, tree, binary))) as picture:
            yield picture.width * picture.height


def _image_bytes(image: dict[str, Any], tree: dict[str, Any], binary: bytes) -> bytes:
    if "bufferView" not in image:
        return _decoded(str(image["uri"]))
    view = tree["bufferViews"][image["bufferView"]]
    buffer = tree["buffers"][view["buffer"]]
    source = _decoded(str(buffer["uri"])) if "uri" in buffer else binary
    start = view.get("byteOffset", 0)
    return source[start : start + view["byteLength"]]


def _decoded(uri: str) -> bytes:
    """The bytes of a base64 data URI; any other URI counts as a tiny image, for it is refused by itself."""
    if not uri.startswith("data:"):
        return base64.b64decode("R0lGODlhAQABAAAAACwAAAAAAQABAAACAkQBADs=")
    try:
        return base64.b64decode(uri.partition(",")[2])
    except binascii.Error as error:
        raise ValueError("a data URI that is not base64") from error


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
            lines = side.read_text(errors="replace")
            for picture in re.findall(r"^\s*map_Kd\s+(.+)$", lines, flags=re.MULTILINE):
                _inside(path, picture.strip())


def _inside(path: Path, name: str) -> Path:
    folder = path.resolve().parent
    side = (folder / name).resolve()
    if not side.is_relative_to(folder) or not side.is_file():
        raise InputError(path, found=f"a reference to {name[:80]!r}", accepted="files that exist in the same folder")
    return side


def _pieces(scene: Any) -> Iterator[_Piece]:
    """Our view of the triangle meshes of a trimesh.Scene, in its order, each once per node that shows it."""
    import trimesh

    for geometry in scene.dump():
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            # The copies that dump() makes lose vertex colours beside a texture.
            yield _piece(geometry, scene.geometry[geometry.metadata["name"]].visual)


def _piece(geometry: Any, visual: Any) -> _Piece:
    n = len(geometry.vertices)
    uv = getattr(visual, "uv", None)
    return _Piece(
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


def _check_pieces(path: Path, pieces: list[_Piece], *, max_faces: int, max_texture_pixels: int) -> None:
    count = sum(len(p.faces) for p in pieces)
    if count > max_faces:
        raise InputError(path, found=f"{count} faces", accepted=f"at most {max_faces}")
    pixels = sum({_key(p.material): _pixels(p.material) for p in pieces}.values())
    if pixels > max_texture_pixels:
        raise _too_many_pixels(path, pixels, max_texture_pixels)
    for p in pieces:
        if not np.isfinite(p.vertices).all() or not (p.uv is None or np.isfinite(p.uv).all()):
            raise InputError(path, found="vertices that are NaN or infinite", accepted="finite coordinates")
        if p.faces.min() < 0 or p.faces.max() >= len(p.vertices):
            raise InputError(path, found="faces of vertices that do not exist", accepted="a consistent mesh")


def _too_many_pixels(path: Path, found: int, accepted: int) -> InputError:
    return InputError(path, found=f"textures of {found} pixels", accepted=f"at most {accepted} pixels")


def _pixels(material: Material) -> int:
    return 0 if material.texture is None else material.texture.shape[0] * material.texture.shape[1]


def _key(material: Material) -> tuple[Any, ...]:
    """Equal for equal appearance."""
    texture = material.texture
    if texture is None:
        return material.base_color, None
    return material.base_color, texture.shape, hashlib.sha256(texture.tobytes()).digest()


def _joined(pieces: list[_Piece]) -> Mesh:
    """All pieces as one mesh, equal materials once; what a piece lacks is filled with zeros (uv) or white."""
    starts = np.cumsum([0, *(len(p.vertices) for p in pieces)])
    materials: dict[tuple[Any, ...], tuple[int, Material]] = {}
    index = [materials.setdefault(_key(p.material), (len(materials), p.material))[0] for p in pieces]
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
