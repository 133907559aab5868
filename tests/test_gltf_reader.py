"""Our glTF reader against trimesh's, on what generators and tools write."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from broken_inputs import glb
from f3sr.io.mesh_files import load_mesh
from scenes import box_mesh


class Builder:
    """A GLB put together accessor by accessor."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "accessors": [], "bufferViews": []}

    def view(self, data: bytes, **more: Any) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **more})
        self.binary += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, kind: str, **more: Any) -> int:
        component = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121, "i2": 5122, "i1": 5120}[values.dtype.str[1:]]
        given = {"bufferView": self.view(values.tobytes()), "componentType": component, "type": kind} | more
        self.tree["accessors"].append({"count": len(values), **given})
        return len(self.tree["accessors"]) - 1

    def write(self, path: Path, **tree: Any) -> Path:
        whole = {**self.tree, **tree, "buffers": [{"byteLength": len(self.binary)}]}
        path.write_bytes(glb(whole, self.binary))
        return path


def primitive(build: Builder, size: float, **more: Any) -> dict[str, Any]:
    box = box_mesh((size, 2 * size, 3 * size))
    position = build.accessor(box.vertices.astype("f4"), "VEC3")
    indices = build.accessor(box.faces.ravel().astype("u2"), "SCALAR")
    attributes = {"POSITION": position, **more.pop("attributes", {})}
    return {"attributes": attributes, "indices": indices, **more}


def agree(path: Path) -> Any:
    mesh, expected = load_mesh(path), trimesh.load(path, force="mesh", process=False)
    assert np.array_equal(mesh.faces, expected.faces)
    assert np.abs(mesh.vertices - expected.vertices).max() < 1e-12
    return mesh


def test_nested_turned_and_mirrored_nodes(tmp_path: Path):
    build = Builder()
    meshes = [{"primitives": [primitive(build, 0.1), primitive(build, 0.2)]}, {"primitives": [primitive(build, 0.3)]}]
    turn = [0.18257419, 0.36514837, 0.54772256, 0.73029674]
    nodes = [
        {"children": [1, 2], "translation": [1, 2, 3], "rotation": turn, "scale": [2, 2, 2]},
        {"mesh": 0, "scale": [-1, 1, 1], "rotation": turn},
        {"mesh": 1, "children": [3], "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]},
        {"mesh": 0, "translation": [0, 0, 9]},
        {"mesh": 1},
    ]
    mesh = agree(build.write(tmp_path / "m.glb", meshes=meshes, nodes=nodes, scenes=[{"nodes": [0, 4]}]))
    assert len(mesh.faces) == 12 * 6


def test_interleaved_data_and_no_indices(tmp_path: Path):
    build, box = Builder(), box_mesh((1, 2, 3))
    rows = np.zeros((36, 8), "f4")
    rows[:, 1:4] = box.vertices[box.faces.ravel()]
    rows[:, 4:6] = np.linspace(0, 1, 72).reshape(36, 2)
    view = build.view(rows.tobytes(), byteStride=32)
    shared = {"bufferView": view, "componentType": 5126, "count": 36}
    build.tree["accessors"] = [
        {**shared, "type": "VEC3", "byteOffset": 4},
        {**shared, "type": "VEC2", "byteOffset": 16},
    ]
    shown = {"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}
    tree = {"meshes": [{"primitives": [shown]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "materials": [{}]}
    mesh = agree(build.write(tmp_path / "m.glb", **tree))
    expected = trimesh.load(tmp_path / "m.glb", force="mesh", process=False).visual.uv
    assert mesh.uv is not None and np.allclose(mesh.uv, expected)


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4"])
def test_vertex_colours_of_every_type(dtype: str, tmp_path: Path):
    build, levels = Builder(), np.random.default_rng(0).random((8, 4))
    top = {"u1": 255, "u2": 65535, "f4": 1}[dtype]
    color = build.accessor((levels * top).astype(dtype), "VEC4", normalized=dtype != "f4")
    tree = {"meshes": [{"primitives": [primitive(build, 1, attributes={"COLOR_0": color})]}]}
    mesh = load_mesh(build.write(tmp_path / "m.glb", **tree, nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}]))
    assert mesh.vertex_colors is not None
    assert np.abs(mesh.vertex_colors - 255 * levels[:, :3]).max() <= 1


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "older"])
def test_textures_and_factors_of_every_kind(kind: str, tmp_path: Path):
    build, stream = Builder(), io.BytesIO()
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8))
    picture.save(stream, "PNG" if kind == "older" else kind)
    uv = build.accessor(np.zeros((8, 2), "f4"), "VEC2")
    shown = primitive(build, 1, attributes={"TEXCOORD_0": uv}, material=0)
    texture = {"extensions": {"EXT_texture_webp": {"source": 0}}} if kind == "WEBP" else {"source": 0}
    color = [1.0, 0.5, 0.25, 1.0]
    material: dict[str, Any] = {"pbrMetallicRoughness": {"baseColorFactor": color, "baseColorTexture": {"index": 0}}}
    if kind == "older":
        older = {"diffuseFactor": color, "diffuseTexture": {"index": 0}}
        material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": older}}
    tree = {"meshes": [{"primitives": [shown]}], "nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}]}
    images = [{"bufferView": build.view(stream.getvalue())}]
    path = build.write(tmp_path / "m.glb", **tree, materials=[material], textures=[texture], images=images)
    read = agree(path).materials[0]
    expected = np.asarray(Image.open(io.BytesIO(stream.getvalue())).convert("RGB"))
    assert np.array_equal(read.texture, expected) and read.base_color == pytest.approx((1, 0.5, 0.25), abs=0.003)


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2"])
@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions_come_back_by_the_scale_of_their_node(dtype: str, normalized: bool, tmp_path: Path):
    build = Builder()
    most = np.iinfo(dtype).max
    box = box_mesh((1.0, 2.0, 3.0))
    low = 0.0 if dtype[0] == "u" else -1.0
    share = (box.vertices - box.bounds[0]) / 3.0 * (1 - low) + low
    position = build.accessor((share * most).round().astype(dtype), "VEC3", normalized=normalized)
    indices = build.accessor(box.faces.ravel().astype("u2"), "SCALAR")
    grow = 3.0 / (1 - low) / (1.0 if normalized else most)
    moved = box.bounds[0] - 3.0 * low / (1 - low)
    file = build.write(
        tmp_path / "q.glb",
        extensionsRequired=["KHR_mesh_quantization"],
        meshes=[{"primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}],
        nodes=[{"mesh": 0, "scale": [grow] * 3, "translation": moved.tolist()}],
        scenes=[{"nodes": [0]}],
    )
    assert np.abs(load_mesh(file).vertices - box.vertices).max() <= 3.0 / (most * (1 - low)) * 0.51


@pytest.mark.parametrize("index", ["u2", "u4"])
@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_views_packed_by_meshoptimizer(index: str, name: str, tmp_path: Path):
    meshopt = pytest.importorskip("meshopt", reason="packing needs meshopt")
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = ball.vertices.astype("f4"), ball.faces.astype(index)
    packs = [(meshopt.encode_gltf_buffer(vertices, "ATTRIBUTES"), "ATTRIBUTES", 12, len(vertices)),
             (meshopt.encode_gltf_buffer(faces.ravel().astype("u4"), "TRIANGLES"), "TRIANGLES", faces.itemsize,
              faces.size)]  # fmt: skip
    binary, views = b"", list[dict[str, Any]]()
    for data, mode, stride, count in packs:
        packed = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "byteStride": stride}
        views.append({"buffer": 1, "byteOffset": 0, "byteLength": stride * count,
                      "extensions": {name: {**packed, "mode": mode, "count": count}}})  # fmt: skip
        binary += data + b"\0" * (-len(data) % 4)
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "extensionsRequired": [name],
        "buffers": [{"byteLength": len(binary)}, {"byteLength": 10**6, "extensions": {name: {"fallback": True}}}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3"},
            {"bufferView": 1, "componentType": {"u2": 5123, "u4": 5125}[index], "count": faces.size, "type": "SCALAR"},
        ],
    }  # fmt: skip
    (tmp_path / "p.glb").write_bytes(glb(tree, binary))
    mesh = load_mesh(tmp_path / "p.glb")
    assert np.array_equal(mesh.vertices, vertices.astype(float))
    assert {tuple(np.roll(f, -int(np.argmin(f)))) for f in mesh.faces.tolist()} == {
        tuple(np.roll(f, -int(np.argmin(f)))) for f in faces.tolist()
    }


def test_a_texture_transform_moves_the_coordinates(tmp_path: Path):
    build = Builder()
    uv = build.accessor(np.array([[0, 0], [1, 0], [1, 1], [0, 1]] * 2, "f4"), "VEC2")
    pixels = io.BytesIO()
    Image.new("RGB", (2, 2), (9, 8, 7)).save(pixels, "PNG")
    image = {"bufferView": build.view(pixels.getvalue()), "mimeType": "image/png"}
    transform = {"offset": [0.25, 0.5], "rotation": np.pi / 2, "scale": [0.5, 2.0]}
    info = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    file = build.write(
        tmp_path / "t.glb",
        meshes=[{"primitives": [primitive(build, 1.0, attributes={"TEXCOORD_0": uv}, material=0)]}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": info}}],
        textures=[{"source": 0}],
        images=[image],
        nodes=[{"mesh": 0}],
        scenes=[{"nodes": [0]}],
    )
    found = load_mesh(file).uv
    # By the extension: scale, then a turn that takes u to -v, then the offset; our v counts from the bottom.
    wanted = np.array([[0.25 + 2 * v, 0.5 - 0.5 * u] for u, v in [(0, 0), (1, 0), (1, 1), (0, 1)] * 2])
    assert np.allclose(found, np.column_stack([wanted[:, 0], 1 - wanted[:, 1]]), atol=1e-6)


def test_ten_thousand_parts_take_seconds(tmp_path: Path):
    build = Builder()
    meshes = [{"primitives": [primitive(build, 0.1)]}]
    nodes = [{"mesh": 0, "translation": [k, 0, 0]} for k in range(10_000)]
    path = build.write(tmp_path / "m.glb", meshes=meshes, nodes=nodes, scenes=[{"nodes": list(range(10_000))}])
    assert len(load_mesh(path).faces) == 120_000


def test_real_meshes_are_what_trimesh_reads(shared_data: Path):
    for path in sorted((shared_data / "objects").glob("*.glb"))[:5]:
        mesh, expected = agree(path), trimesh.load(path, force="mesh", process=False)
        assert mesh.uv is not None and np.array_equal(mesh.uv, expected.visual.uv)
