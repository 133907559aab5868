"""Reads glTF 2 and GLB files, hostile until checked: sizes, indices and references before anything is decoded."""

from __future__ import annotations

import base64
import binascii
import io
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.core.mesh import Material
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.io.images import decode_image
from f3sr.runtime.extras import library

MAX_PARTS = 10_000
"""Most nodes, and most primitives shown: a generated mesh has one of each; assembled scenes have hundreds."""
MAX_TREE_BYTES = 32_000_000
"""Longest JSON part of a file, far more than MAX_PARTS nodes, primitives and their accessors need."""
TEXTURE_FORMATS = ("PNG", "JPEG", "WEBP")

READABLE_EXTENSIONS = re.compile(
    r"KHR_materials_\w+|EXT_texture_webp|KHR_mesh_quantization|KHR_texture_transform|(EXT|KHR)_meshopt_compression"
)
"""glTF extensions that a file may require: the others change geometry or texture in ways we do not read."""
SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
MOVED_TEXTURE = "KHR_texture_transform"
COMPRESSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_UNPACKED_BYTES = 2_000_000_000
"""Most bytes of all compressed views together, once unpacked: as much as the largest file."""
TRIANGLES = 4
"""glTF's mode of a primitive of separate triangles."""
DTYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""numpy types by glTF's componentType, little-endian."""
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
"""Numbers per element by glTF's accessor type; matrices are not read."""

T = TypeVar("T")
Index = Annotated[int, Field(ge=0)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Primitive:
    """One geometry of a mesh file, in the file's frame and unit."""

    vertices: Array
    """(n, 3)"""
    faces: NDArray[np.int64]
    """(m, 3), outward as the file winds them; indices are not checked yet."""
    uv: Array | None
    """(n, 2), origin at the image's bottom left."""
    colors: NDArray[np.uint8] | None
    """(n, 3) sRGB."""
    material: Material


class _BrokenError(ValueError):
    """What is wrong with the file, in a few words."""


def read_gltf(path: Path, data: bytes, *, max_faces: int, max_texture_pixels: int) -> list[Primitive]:
    """The triangles of the file's default scene, a piece per node and primitive.

    Pieces come in the order of ``trimesh.load_scene``; nothing is merged, turned or dropped. InputError for all that is
    broken, too large, or would be read wrongly.
    """
    try:
        tree, binary = _parts(data)
        document = _document(tree)
        _require_plain(path, document)
        reader = _Reader(document, binary, max_texture_pixels=max_texture_pixels)
        with np.errstate(all="ignore"):  # numbers beyond the floats' range become infinite, which is refused
            shown = list(reader.shown())
            _require_size(path, reader, shown, max_faces)
            return [reader.piece(primitive, T_file_node) for primitive, T_file_node in shown]
    except _BrokenError as error:
        raise InputError(path, found=f"a broken glTF file ({error})", accepted="a valid GLB or glTF 2 file") from error


# --- the JSON part ------------------------------------------------------------------------------------------------


class _GltfRecord(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Asset(_GltfRecord):
    version: str


class _Buffer(_GltfRecord):
    byteLength: Index
    uri: str | None = None
    extensions: dict[str, Any] = {}

    @property
    def is_fallback(self) -> bool:
        """Whether it only says how large unpacked views are, and has no bytes."""
        return self.uri is None and any(name in self.extensions for name in COMPRESSIONS)


class _BufferView(_GltfRecord):
    buffer: Index
    byteLength: Index
    byteOffset: Index = 0
    byteStride: Annotated[int, Field(ge=4, le=252)] | None = None
    extensions: dict[str, Any] = {}


class _Compressed(_GltfRecord):
    """A buffer view packed by meshoptimizer (the extension EXT_meshopt_compression)."""

    buffer: Index
    byteLength: Index
    byteStride: Annotated[int, Field(ge=1, le=256)]
    count: Index
    mode: Literal["ATTRIBUTES", "TRIANGLES", "INDICES"]
    byteOffset: Index = 0
    filter: Literal["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"] = "NONE"


class _Accessor(_GltfRecord):
    componentType: int
    count: Index
    type: str
    bufferView: Index | None = None
    byteOffset: Index = 0
    normalized: bool = False
    sparse: dict[str, Any] | None = None


class _Image(_GltfRecord):
    uri: str | None = None
    bufferView: Index | None = None


class _Texture(_GltfRecord):
    source: Index | None = None
    extensions: dict[str, Any] = {}


class _TextureInfo(_GltfRecord):
    index: Index
    texCoord: Index = 0
    extensions: dict[str, Any] = {}


class _TextureTransform(_GltfRecord):
    """KHR_texture_transform: coordinates scaled, turned, then moved."""

    offset: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0]
    rotation: float = 0.0
    scale: Annotated[list[float], Field(min_length=2, max_length=2)] = [1.0, 1.0]
    texCoord: Index = 0

    def moved(self, uv: Array) -> Array:
        """Coordinates (n, 2) as the file has them, origin at the top left."""
        c, s = np.cos(self.rotation), np.sin(self.rotation)
        u, v = (uv * self.scale).T
        return np.column_stack([c * u + s * v, -s * u + c * v]) + self.offset


class _Surface(_GltfRecord):
    baseColorFactor: Annotated[list[float], Field(min_length=4, max_length=4)] | None = None
    baseColorTexture: _TextureInfo | None = None


class _Diffuse(_GltfRecord):
    diffuseFactor: Annotated[list[float], Field(min_length=4, max_length=4)] | None = None
    diffuseTexture: _TextureInfo | None = None


class _Material(_GltfRecord):
    pbrMetallicRoughness: _Surface = _Surface()
    extensions: dict[str, Any] = {}


class _Primitive(_GltfRecord):
    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: int = TRIANGLES


class _Mesh(_GltfRecord):
    primitives: Annotated[list[_Primitive], Field(min_length=1)]


class _Node(_GltfRecord):
    children: list[Index] = []
    mesh: Index | None = None
    matrix: Annotated[list[float], Field(min_length=16, max_length=16)] | None = None
    translation: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    rotation: Annotated[list[float], Field(min_length=4, max_length=4)] = [0.0, 0.0, 0.0, 1.0]
    scale: Annotated[list[float], Field(min_length=3, max_length=3)] = [1.0, 1.0, 1.0]


class _Scene(_GltfRecord):
    nodes: list[Index] = []


class _Document(_GltfRecord):
    asset: _Asset
    scene: Index = 0
    scenes: list[_Scene] = []
    nodes: list[_Node] = []
    meshes: list[_Mesh] = []
    accessors: list[_Accessor] = []
    bufferViews: list[_BufferView] = []
    buffers: list[_Buffer] = []
    materials: list[_Material] = []
    textures: list[_Texture] = []
    images: list[_Image] = []
    extensionsRequired: list[str] = []


def _parts(data: bytes) -> tuple[Any, bytes]:
    """The JSON tree and the binary chunk of GLB or glTF bytes."""
    text, binary = _chunks(data) if data[:4] == b"glTF" else (data, b"")
    if len(text) > MAX_TREE_BYTES:
        raise _BrokenError(f"{len(text):,} bytes of JSON, more than {MAX_TREE_BYTES:,}")
    try:
        return strict_json.loads(text), binary
    except ValueError as error:
        raise _BrokenError(str(error)) from None


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk, if the lengths that the file claims are its own."""
    if len(data) < 20:
        raise _BrokenError(f"a GLB of {len(data)} bytes")
    # After the magic: version, length of the file, then length and type of the first chunk ("JSON").
    version, total, length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or kind != 0x4E4F534A:
        raise _BrokenError(f"GLB version {version}" if version != 2 else "no JSON chunk")
    if total != len(data) or 20 + length > total:
        raise _BrokenError(f"a claimed length of {max(total, 20 + length)} bytes in a file of {len(data)}")
    start = 20 + length
    if start == total:
        return data[20:start], b""
    if start + 8 > total:
        raise _BrokenError("half a chunk at its end")
    length, kind = struct.unpack_from("<II", data, start)
    if kind != 0x004E4942 or start + 8 + length > total:
        raise _BrokenError("a second chunk that is no binary data, or longer than the file")
    return data[20:start], data[start + 8 : start + 8 + length]


def _document(tree: Any) -> _Document:
    try:
        document = _Document.model_validate(tree)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the document"
        raise _BrokenError(f"{place}: {first['msg']}") from None
    if not re.fullmatch(r"2(\.\d+)?", document.asset.version):
        raise _BrokenError(f"glTF version {document.asset.version[:20]!r}")
    return document


def _require_plain(path: Path, document: _Document) -> None:
    """All data embedded, nothing required that we cannot read, no claim of absurd sizes."""
    uris = [item.uri for item in (*document.buffers, *document.images) if item.uri is not None]
    if outside := [u for u in uris if not u.startswith("data:")]:
        raise InputError(path, found=f"a reference to {outside[0][:80]!r}", accepted="glTF with all data embedded")
    if unknown := [name for name in document.extensionsRequired if not READABLE_EXTENSIONS.fullmatch(name)]:
        found = f"required glTF extension {unknown[0][:80]!r}"
        raise InputError(path, found=found, accepted="glTF 2, plain or packed by meshoptimizer")
    if len(document.nodes) > MAX_PARTS:
        raise InputError(path, found=f"{len(document.nodes):,} nodes", accepted=f"at most {MAX_PARTS:,}")


def _require_size(path: Path, reader: _Reader, shown: list[tuple[_Primitive, Array]], max_faces: int) -> None:
    """Counts of what the scene shows, before any of it is decoded."""
    if len(shown) > MAX_PARTS:
        raise InputError(path, found=f"more than {MAX_PARTS:,} primitives", accepted=f"at most {MAX_PARTS:,}")
    vertices = sum(reader.count(p.attributes.get("POSITION")) for p, _ in shown)
    faces = sum(reader.count(p.attributes.get("POSITION") if p.indices is None else p.indices) for p, _ in shown) // 3
    for name, count, most in (("faces", faces, max_faces), ("vertices", vertices, 3 * max_faces)):
        if count > most:
            raise InputError(path, found=f"{count:,} {name}", accepted=f"at most {most:,}")
    pixels, most = reader.texture_pixels(shown), reader.max_texture_pixels
    if pixels > most:
        raise InputError(path, found=f"textures of {pixels:,} pixels", accepted=f"at most {most:,}")


# --- what it describes --------------------------------------------------------------------------------------------


class _Reader:
    """Looks up and decodes parts of one document, every index and range checked."""

    def __init__(self, document: _Document, binary: bytes, *, max_texture_pixels: int) -> None:
        self.document, self.max_texture_pixels = document, max_texture_pixels
        self._buffers = [self._buffer(k, b, binary) for k, b in enumerate(document.buffers)]
        self._materials: dict[int | None, Material] = {None: Material()}
        self._textures: dict[int, NDArray[np.uint8]] = {}
        self._unpacked: dict[int, memoryview] = {}

    def shown(self) -> Iterator[tuple[_Primitive, Array]]:
        """Every primitive of the default scene and the transform of its node, at most MAX_PARTS + 1."""
        if not self.document.scenes:
            return
        roots = _at(self.document.scenes, self.document.scene, "scene").nodes
        stack = [(node, np.eye(4)) for node in roots]
        visited: set[int] = set()
        count = 0
        while stack:
            index, T_file_parent = stack.pop()
            if index in visited:
                raise _BrokenError(f"node {index} reached twice, no tree")
            visited.add(index)
            node = _at(self.document.nodes, index, "node")
            T_file_node = T_file_parent @ _matrix(node)
            stack += [(child, T_file_node) for child in node.children]
            if node.mesh is None:
                continue
            for primitive in _at(self.document.meshes, node.mesh, "mesh").primitives:
                yield primitive, T_file_node
                count += 1
                if count > MAX_PARTS:
                    return

    def count(self, accessor: int | None) -> int:
        """Elements of an accessor; none for None."""
        return 0 if accessor is None else _at(self.document.accessors, accessor, "accessor").count

    def texture_pixels(self, shown: list[tuple[_Primitive, Array]]) -> int:
        """Pixels of all base colour textures shown, told from the pictures' headers."""
        images = {i for p, _ in shown if (i := self._image_of(p.material)) is not None}
        return sum(w * h for w, h in (self._picture(i, size_only=True) for i in sorted(images)))

    def piece(self, primitive: _Primitive, T_file_node: Array) -> Primitive:
        """One primitive in the file's frame."""
        if primitive.mode != TRIANGLES:
            raise _BrokenError(f"a primitive of mode {primitive.mode}, no triangles")
        if "POSITION" not in primitive.attributes:
            raise _BrokenError("a primitive without positions")
        vertices = self._numbers(primitive.attributes["POSITION"], ("VEC3",))
        faces = self._faces(primitive, len(vertices))
        if not np.array_equal(T_file_node, np.eye(4)):
            vertices = np.dot(T_file_node, np.column_stack([vertices, np.ones(len(vertices))]).T).T[:, :3]
            if np.linalg.det(T_file_node[:3, :3]) < 0:  # a mirror turns triangles around; glTF says turn them back
                faces = faces[:, ::-1]
        return Primitive(
            vertices=vertices,
            faces=faces,
            uv=self._uv(primitive, len(vertices)),
            colors=self._colors(primitive, len(vertices)),
            material=self._material(primitive.material),
        )

    def _faces(self, primitive: _Primitive, n: int) -> NDArray[np.int64]:
        if primitive.indices is None:
            corners = np.arange(n)
        else:
            corners = self._values(primitive.indices, ("SCALAR",), "u").astype(np.int64)[:, 0]
        if len(corners) % 3:
            raise _BrokenError(f"{len(corners)} corners, no whole triangles")
        return corners.reshape(-1, 3)

    def _uv(self, primitive: _Primitive, n: int) -> Array | None:
        """(n, 2), origin at the bottom left; None for a primitive without material or coordinates."""
        if primitive.material is None or "TEXCOORD_0" not in primitive.attributes:
            return None
        uv = self._numbers(primitive.attributes["TEXCOORD_0"], ("VEC2",))
        self._require_length("texture coordinates", uv, n)
        if transform := self._transform_of(primitive.material):
            uv = transform.moved(uv)
        return np.stack([uv[:, 0], np.float32(1) - uv[:, 1].astype(np.float32)], axis=1).astype(float)

    def _colors(self, primitive: _Primitive, n: int) -> NDArray[np.uint8] | None:
        """(n, 3) sRGB from the vertex colours."""
        if "COLOR_0" not in primitive.attributes:
            return None
        colors = self._values(primitive.attributes["COLOR_0"], ("VEC3", "VEC4"), "fu")[:, :3]
        self._require_length("vertex colours", colors, n)
        if colors.dtype == np.uint8:
            return np.array(colors)
        levels = colors.astype(float) if colors.dtype.kind == "f" else colors / 65535.0
        return np.nan_to_num(255 * levels, nan=0, posinf=0, neginf=0).clip(0, 255).round().astype(np.uint8)

    def _require_length(self, what: str, values: NDArray[Any], n: int) -> None:
        if len(values) != n:
            raise _BrokenError(f"{len(values)} {what} for {n} vertices")

    def _values(self, index: int, types: tuple[str, ...], kinds: str) -> NDArray[Any]:
        """The (count, columns) array of an accessor, a view of its buffer."""
        a = _at(self.document.accessors, index, "accessor")
        dtype = np.dtype(DTYPES.get(a.componentType, "V1"))
        if a.type not in types or dtype.kind not in kinds:
            raise _BrokenError(f"accessor {index} of {a.type[:10]!r}, component type {a.componentType}")
        if a.bufferView is None or a.sparse is not None:
            raise _BrokenError(f"accessor {index} that is sparse or without data")
        view = _at(self.document.bufferViews, a.bufferView, "bufferView")
        block, columns = self._bytes(a.bufferView), COLUMNS[a.type]
        row = columns * dtype.itemsize
        stride = view.byteStride or row
        # The last element ends here; an interleaved view has elements ``stride`` bytes apart.
        if a.byteOffset + max(a.count - 1, 0) * stride + row * bool(a.count) > len(block):
            raise _BrokenError(f"accessor {index} of {a.count} elements beyond its {len(block)} bytes")
        if not a.count:
            return np.zeros((0, columns), dtype)
        return np.ndarray((a.count, columns), dtype, block, a.byteOffset, (stride, dtype.itemsize))

    def _numbers(self, index: int, types: tuple[str, ...]) -> Array:
        """The (count, columns) floats of an accessor, quantised or not (KHR_mesh_quantization)."""
        values = self._values(index, types, "fiu")
        if values.dtype.kind != "f" and self.document.accessors[index].normalized:
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values.astype(float)

    def _bytes(self, view_index: int) -> memoryview:
        view = _at(self.document.bufferViews, view_index, "bufferView")
        packed = next((view.extensions[name] for name in COMPRESSIONS if name in view.extensions), None)
        if packed is not None:
            if view_index not in self._unpacked:
                self._unpacked[view_index] = self._unpack(view_index, packed)
            return self._unpacked[view_index]
        return self._stored(view_index, view)

    def _unpack(self, view_index: int, extension: Any) -> memoryview:
        """The bytes of a view that meshoptimizer packed. F3srError where its decoder is not installed."""
        try:
            packed = _Compressed.model_validate(extension)
        except ValidationError:
            raise _BrokenError(f"bufferView {view_index}: a compression that cannot be read") from None
        if packed.mode != "ATTRIBUTES" and packed.byteStride not in (2, 4):
            raise _BrokenError(f"bufferView {view_index}: indices of {packed.byteStride} bytes")
        size = packed.count * packed.byteStride
        if size + sum(map(len, self._unpacked.values())) > MAX_UNPACKED_BYTES:
            raise _BrokenError(f"more than {MAX_UNPACKED_BYTES:,} bytes once unpacked")
        stored = self._stored(view_index, packed)
        decoder = library("meshopt", extra="meshopt", why="a GLB packed by meshoptimizer")
        try:
            unpacked = decoder.decode_gltf_buffer(
                bytes(stored), packed.count, packed.byteStride, packed.mode, packed.filter
            )
        except (ValueError, RuntimeError):
            raise _BrokenError(f"bufferView {view_index}: bytes that do not unpack") from None
        if packed.mode != "ATTRIBUTES":
            unpacked = unpacked.astype(f"<u{packed.byteStride}")
        return memoryview(np.ascontiguousarray(unpacked).tobytes())

    def _stored(self, view_index: int, view: _BufferView | _Compressed) -> memoryview:
        buffer = _at(self._buffers, view.buffer, "buffer")
        if view.byteOffset + view.byteLength > len(buffer):
            raise _BrokenError(f"bufferView {view_index} beyond the {len(buffer)} bytes of its buffer")
        return buffer[view.byteOffset : view.byteOffset + view.byteLength]

    def _buffer(self, index: int, buffer: _Buffer, binary: bytes) -> memoryview:
        if buffer.is_fallback:
            return memoryview(b"")
        embedded = binary if index == 0 else b""
        data = embedded if buffer.uri is None else _decoded(buffer.uri)
        if buffer.byteLength > len(data):
            raise _BrokenError(f"buffer {index} claims {buffer.byteLength} bytes, has {len(data)}")
        return memoryview(data)[: buffer.byteLength]

    def _material(self, index: int | None) -> Material:
        """Base colour and texture, decoded once."""
        if index not in self._materials:
            assert index is not None
            factor, _ = self._surface(index)
            r, g, b, _ = (np.clip(factor or [1.0] * 4, 0, 1) * 255).round() / 255
            image = self._image_of(index)
            texture = None if image is None else self._texture(image)
            self._materials[index] = Material(base_color=(float(r), float(g), float(b)), texture=texture)
        return self._materials[index]

    def _surface(self, index: int) -> tuple[list[float] | None, _TextureInfo | None]:
        """Factor and texture of a material's base colour, or of its diffuse colour in the older extension."""
        material = _at(self.document.materials, index, "material")
        surface = material.pbrMetallicRoughness
        if SPECULAR_GLOSSINESS not in material.extensions:
            return surface.baseColorFactor, surface.baseColorTexture
        try:
            diffuse = _Diffuse.model_validate(material.extensions[SPECULAR_GLOSSINESS])
        except ValidationError:
            raise _BrokenError(f"material {index}: {SPECULAR_GLOSSINESS}") from None
        return diffuse.diffuseFactor, diffuse.diffuseTexture

    def _image_of(self, material: int | None) -> int | None:
        """Index of the image that a material shows, if any."""
        info = None if material is None else self._surface(material)[1]
        if info is None:
            return None
        moved = self._transform_of(material)
        if info.texCoord or (moved is not None and moved.texCoord):
            raise _BrokenError("a texture with coordinates of its own")
        texture = _at(self.document.textures, info.index, "texture")
        webp = texture.extensions.get("EXT_texture_webp")
        source = webp.get("source") if isinstance(webp, dict) else texture.source
        if not isinstance(source, int) or isinstance(source, bool) or source < 0:
            raise _BrokenError(f"texture {info.index} without an image that can be read")
        return source

    def _transform_of(self, material: int | None) -> _TextureTransform | None:
        """How a material's texture moves its coordinates, if it does."""
        info = None if material is None else self._surface(material)[1]
        if info is None or MOVED_TEXTURE not in info.extensions:
            return None
        try:
            return _TextureTransform.model_validate(info.extensions[MOVED_TEXTURE])
        except ValidationError:
            raise _BrokenError(f"material {material}: {MOVED_TEXTURE}") from None

    def _texture(self, image: int) -> NDArray[np.uint8]:
        if image not in self._textures:
            self._textures[image] = self._picture(image, size_only=False)
        return self._textures[image]

    def _picture(self, index: int, *, size_only: bool) -> Any:
        """Width and height, or the pixels (h, w, 3), of an image."""
        image = _at(self.document.images, index, "image")
        if image.bufferView is not None:
            data = bytes(self._bytes(image.bufferView))
        elif image.uri is not None:
            data = _decoded(image.uri)
        else:
            raise _BrokenError(f"image {index} without data")
        try:
            picture = decode_image(io.BytesIO(data), TEXTURE_FORMATS, size_only=size_only)
        except ValueError as error:
            raise _BrokenError(f"image {index} is no readable {', '.join(TEXTURE_FORMATS)}: {error}") from None
        return picture.size if size_only else np.asarray(picture.convert("RGB"), np.uint8)


def _at(items: list[T], index: int, what: str) -> T:
    if not 0 <= index < len(items):
        raise _BrokenError(f"{what} {index} of {len(items)}")
    return items[index]


def _decoded(uri: str) -> bytes:
    """The bytes of a base64 data URI."""
    head, comma, body = uri.partition(",")
    try:
        if not comma or not head.endswith(";base64"):
            raise ValueError
        return base64.b64decode(body, validate=True)
    except (ValueError, binascii.Error):
        raise _BrokenError("a data URI that is not base64") from None


def _matrix(node: _Node) -> Array:
    """The node's transform: its matrix, or translation @ rotation @ scale."""
    if node.matrix is not None:
        # glTF stores matrices by columns.
        return np.array(node.matrix, float).reshape(4, 4).T
    x, y, z, w = node.rotation
    n = x * x + y * y + z * z + w * w
    T = np.eye(4)
    if n > 1e-12:
        # 2 / |q|^2 normalises the quaternion on the way; a zero one leaves the identity.
        s = 2.0 / n
        T[:3, :3] = [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    # Broadcast over columns: R @ diag(scale).
    T[:3, :3] *= np.array(node.scale)
    T[:3, 3] = node.translation
    return T
