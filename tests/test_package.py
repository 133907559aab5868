"""Laws of the scene package: what goes in comes out, whole or not at all, and readable by strangers."""

from __future__ import annotations

import json
import os
import re
import struct
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image

from f3sr.cli.main import main
from f3sr.core.mesh import ConvexPart, Material, Mesh
from f3sr.core.transforms import pose, rotation_about, transform
from f3sr.errors import InputError, OutputError
from f3sr.exporters import mjcf
from f3sr.exporters.export_names import export_name
from f3sr.files.bounds import MAX_OBJECT_PARTS
from f3sr.goals.launch_limits import limits_of
from f3sr.goals.plan import SimulationPlan
from f3sr.goals.simulate import model_of
from f3sr.io.mesh_files import load_mesh, load_part, save_glb
from f3sr.language.reasoner import declared
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.physics.mujoco_model import PhysicsConfig, build_spec, engine
from f3sr.physics.release import RELEASE_MARGIN, release
from f3sr.physics.settling import settle
from f3sr.report import Decision, Measure, Report
from f3sr.runtime import atomic_folder
from f3sr.scene import Excluded, Scene
from f3sr.scene_package import package
from f3sr.scene_package.package import Package, read_package, scene_schema, write_package
from f3sr.stages.evaluate import evaluate
from scenes import HEIGHT, WIDTH, box, box_mesh, box_stack_scene, scene_of

SCHEMA = Path(__file__).parents[1] / "docs" / "scene.schema.json"
HOSTILE = ["../../x", "\"quotes\" & 'more'", "<tag attr='1'>", "x" * 300, "", "über\n\0\u202e日本", "\ud800"]


def settled(scene: Scene) -> Scene:
    poses = settle(scene.objects).T_world_object
    return scene.with_objects(*(replace(o, T_world_object=poses[o.id]) for o in scene))


@pytest.fixture(scope="module")
def stack() -> Scene:
    return settled(box_stack_scene(3))


def on_a_footing() -> tuple[Scene, Scene]:
    """A box on a slanted side, held by a wedge; and the same before that, without the wedge."""
    o = box(0, size=(0.1, 0.1, 0.2), scale=0.5, R=rotation_about([0, 1, 0], 0.1), at=(0, 0, 0.11))
    corners = transform(o.T_world_asset, o.mesh.vertices)
    low = corners[np.argsort(corners[:, 2])[:4]]
    wedge = ConvexPart.hull_of(np.concatenate([low, low * [1, 1, 0]])).moved(np.linalg.inv(o.T_world_asset))
    levelled = scene_of(replace(o, T_world_object=pose(t=[0.02, 0, 0.3]) @ o.T_world_object))
    return scene_of(replace(o, footing=(wedge,))), levelled


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


# --- meshes -----------------------------------------------------------------------------------------------


def two_materials() -> Mesh:
    """A textured box beside a smaller one of another texture and a base colour, over a third of none."""
    a, rng = box_mesh(textured=True), np.random.default_rng(3)
    assert a.uv is not None
    n, m = len(a.vertices), len(a.faces)
    return Mesh(
        vertices=np.concatenate([a.vertices, a.vertices * 0.5 + 0.2, a.vertices - 0.5]),
        faces=np.concatenate([a.faces, a.faces + n, a.faces + 2 * n]),
        uv=np.concatenate([a.uv, a.uv, a.uv]),
        vertex_colors=rng.integers(0, 256, (3 * n, 3), np.uint8),
        materials=(
            a.materials[0],
            Material(base_color=(1.0, 0.2, 0.0), texture=rng.integers(0, 256, (5, 7, 3), np.uint8)),
            Material(base_color=(0.0, 1.0, 0.0)),
        ),
        face_material=np.repeat(np.arange(3, dtype=np.int32), m),
    )


def colored_box() -> Mesh:
    colors = np.random.default_rng(2).integers(0, 256, (8, 3), np.uint8)
    return replace(box_mesh(), vertex_colors=colors)


@pytest.mark.parametrize("make", [lambda: box_mesh(textured=True), colored_box, two_materials])
def test_a_saved_mesh_comes_back(make: Callable[[], Mesh], tmp_path: Path) -> None:
    mesh = make()
    save_glb(mesh, tmp_path / "m.glb")
    again = load_mesh(tmp_path / "m.glb")
    assert np.array_equal(again.vertices, mesh.vertices.astype(np.float32))
    assert np.array_equal(again.faces, mesh.faces)
    assert np.array_equal(again.face_material, mesh.face_material)
    assert (mesh.vertex_colors is None) == (again.vertex_colors is None)
    if mesh.vertex_colors is not None:
        assert np.array_equal(again.vertex_colors, mesh.vertex_colors)
    if mesh.uv is not None:
        assert again.uv is not None and np.abs(again.uv - mesh.uv).max() < 1e-6
    for a, b in zip(mesh.materials, again.materials, strict=True):
        assert np.allclose(a.base_color, b.base_color, atol=1 / 255)
        assert (a.texture is None) == (b.texture is None)
        assert a.texture is None or np.array_equal(a.texture, b.texture)


def test_an_untextured_base_colour_is_read_by_all_as_vertex_colour(tmp_path: Path) -> None:
    save_glb(replace(box_mesh(), materials=(Material(base_color=(1.0, 0.6, 0.2)),)), tmp_path / "m.glb")
    visual = trimesh.load(tmp_path / "m.glb", force="mesh", process=False).visual
    assert np.array_equal(np.unique(visual.vertex_colors, axis=0), [[255, 153, 51, 255]])
    again = load_mesh(tmp_path / "m.glb")
    assert again.vertex_colors is not None and again.vertex_colors[0].tolist() == [255, 153, 51]


def test_faces_of_scattered_materials_keep_their_order(tmp_path: Path) -> None:
    mesh = replace(box_mesh(), materials=(Material(), Material(base_color=(0, 0, 0))))
    mesh = replace(mesh, face_material=(np.arange(12) % 2).astype(np.int32))
    save_glb(mesh, tmp_path / "m.glb")
    again = load_mesh(tmp_path / "m.glb")
    assert np.allclose(again.vertices[again.faces], mesh.vertices[mesh.faces], atol=1e-7)


def test_loading_agrees_with_trimesh_on_a_scene_graph(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for k in range(12):
        T = trimesh.transformations.rotation_matrix(0.3 * k, [1, k, 2], [k, 0, 0])
        scene.add_geometry(trimesh.creation.icosphere(1, 0.1 + 0.05 * k), transform=T)
    scene.export(tmp_path / "m.glb")
    mesh, expected = (
        load_mesh(tmp_path / "m.glb"),
        trimesh.load(tmp_path / "m.glb", force="mesh", process=False),
    )
    assert np.array_equal(mesh.vertices, expected.vertices) and np.array_equal(mesh.faces, expected.faces)


@pytest.mark.parametrize("suffix", ["obj", "glb", "gltf"])
def test_formats(suffix: str, tmp_path: Path) -> None:
    mesh = trimesh.Trimesh(box_mesh().vertices, box_mesh().faces, process=False)
    if suffix == "gltf":
        files = trimesh.exchange.gltf.export_gltf(mesh.scene(), merge_buffers=True, embed_buffers=True)
        (tmp_path / "m.gltf").write_bytes(files["model.gltf"])
    else:
        mesh.export(tmp_path / f"m.{suffix}")
    again = (load_part if suffix == "obj" else load_mesh)(tmp_path / f"m.{suffix}")
    assert np.allclose(again.vertices[again.faces], mesh.triangles, atol=1e-7)


def glb(tree: dict[str, Any], binary: bytes = b"") -> bytes:
    header = json.dumps(tree).encode()
    header += b" " * (-len(header) % 4)
    total = 28 + len(header) + len(binary)
    json_chunk = struct.pack("<II", len(header), 0x4E4F534A) + header
    return struct.pack("<III", 0x46546C67, 2, total) + json_chunk + struct.pack("<II", len(binary), 0x4E4942) + binary


def obj(text: str) -> bytes:
    return f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{text}\n".encode()


ASSET = {"version": "2.0"}
BROKEN = {
    "unknown.stl": (b"solid", "type '.stl'"),
    "missing.glb": (None, "no such file"),
    "garbage.glb": (b"\0" * 100, "broken glTF|unreadable"),
    "short.glb": (b"glTF", "broken glTF"),
    "empty.glb": (glb({"asset": ASSET, "scenes": [{"nodes": []}]}), "no faces"),
    "other.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", r"type '.obj'"),
    "uri.glb": (
        glb({"asset": ASSET, "buffers": [{"uri": "http://x/y.bin", "byteLength": 1}]}),
        "reference to",
    ),
    "image.gltf": (
        json.dumps({"asset": ASSET, "images": [{"uri": "a.png"}]}).encode(),
        "reference to 'a.png'",
    ),
    "bomb.glb": (
        glb(
            {
                "asset": ASSET,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [{"count": 3 * 10**12, "type": "VEC3", "componentType": 5126}],
            }
        ),
        "1,000,000,000,000 faces",
    ),
    "draco.glb": (glb({"asset": ASSET, "extensionsRequired": ["KHR_draco_mesh_compression"]}), "KHR_draco"),
    "list.glb": (glb({"asset": ASSET, "meshes": [[1]], "materials": 3}), "broken glTF|unreadable"),
}


BROKEN_PARTS = {
    "other.glb": (b"glTF", "type '.glb'"),
    "missing.obj": (None, "no such file"),
    "empty.obj": (b"", "unreadable|no faces"),
    "points.obj": (obj(""), "unreadable|no faces"),
    "nan.obj": (obj("v nan 0 0\nf 1 2 4"), "NaN|unreadable"),
    "far.obj": (obj("v 1e16 0 0\nf 1 2 4"), "beyond 1e"),
    "dangling.obj": (obj("f 1 2 9"), "do not exist|unreadable"),
}


@pytest.mark.parametrize("name", [*BROKEN, *BROKEN_PARTS])
def test_a_broken_mesh_is_refused_by_name(name: str, tmp_path: Path) -> None:
    content, found = (BROKEN | BROKEN_PARTS)[name]
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=found) as caught:
        (load_part if name in BROKEN_PARTS else load_mesh)(tmp_path / name)
    assert name in caught.value.where


@pytest.mark.timeout(20)
def test_a_part_is_read_without_any_file_that_it_names(tmp_path: Path) -> None:
    """Whoever opens the pipe for its material waits forever."""
    os.mkfifo(tmp_path / "pipe.mtl")
    (tmp_path / "m.obj").write_bytes(b"mtllib pipe.mtl\nusemtl a\n" + obj("f 1 2 3"))
    part = load_part(tmp_path / "m.obj")
    assert len(part.faces) == 1 and part.vertex_colors is None and part.uv is None
    with pytest.raises(InputError, match="1 faces; accepted: at most 0"):
        load_part(tmp_path / "m.obj", max_faces=0)


def test_limits_on_faces_and_pixels(tmp_path: Path) -> None:
    save_glb(box_mesh(textured=True), tmp_path / "m.glb")
    with pytest.raises(InputError, match="at most 10"):
        load_mesh(tmp_path / "m.glb", max_faces=10)
    with pytest.raises(InputError, match="48 pixels"):
        load_mesh(tmp_path / "m.glb", max_texture_pixels=47)


def test_a_broken_texture_is_not_left_out_silently(tmp_path: Path) -> None:
    save_glb(box_mesh(textured=True), tmp_path / "m.glb")
    data = (tmp_path / "m.glb").read_bytes().replace(b"\x89PNG", b"\x89BAD")
    (tmp_path / "m.glb").write_bytes(data)
    with pytest.raises(InputError, match="broken glTF"):
        load_mesh(tmp_path / "m.glb")


# --- what goes in comes out -------------------------------------------------------------------------------


def test_a_package_comes_back(stack: Scene, tmp_path: Path) -> None:
    graphless = replace(stack, excluded=(Excluded(mask="09_person.png", reason="cut by the border"),))
    out = write_package(graphless, tmp_path / "out", metrics={"mIoU": 0.5, "R_pen": float("nan")})
    read = read_package(out)
    assert isinstance(read, Package) and read.direct is None
    assert read.scene.excluded == graphless.excluded and read.scene.graph == stack.graph
    assert read.document.metrics == {"mIoU": 0.5, "R_pen": None}
    assert np.array_equal(read.scene.camera.K, stack.camera.K) and read.scene.ground.source == "test"
    for a, b in zip(stack, read.scene.objects, strict=True):
        assert (a.id, a.label, a.mask_name, a.supports, a.supported_by) == (
            (b.id, b.label, b.mask_name, b.supports, b.supported_by)
        )
        assert b.scale == 1 and np.array_equal(a.T_world_object, b.T_world_object)
        assert np.array_equal(a.mesh.faces, b.mesh.faces)
        assert np.abs(a.vertices_world - b.vertices_world).max() < 1e-7
        assert np.allclose(a.colliders_world[0].vertices, b.colliders_world[0].vertices, atol=1e-10)


def test_a_place_beyond_all_bounds_is_refused(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    document = json.loads((out / "scene.json").read_text())
    document["objects"][0]["T_world_object"][0][3] = 1e300
    (out / "scene.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match="less than or equal to 1000000"):
        read_package(out)


def test_photo_masks_and_direct_composition_come_back(stack: Scene, tmp_path: Path) -> None:
    T = pose(rotation_about([0, 0, 1], 0.1), [0.1, 0, 0])
    result = stack.with_objects(stack[1].moved(T, scale=1.25, stage="test", reason="test"))
    read = read_package(write_package(result, tmp_path / "out", direct=stack))
    assert np.array_equal(read.scene.photo.rgb, stack.photo.rgb)
    assert all(np.array_equal(read.scene[o.id].mask, o.mask) for o in stack)
    assert read.direct is not None
    for o in stack:
        assert np.abs(read.direct[o.id].vertices_world - o.vertices_world).max() < 1e-7


def test_direct_composition_of_what_is_held_on_something_unseen_may_move(stack: Scene, tmp_path: Path):
    """As when it was measured first, before anything was held."""
    held = stack.with_objects(stack[0].on_something_unseen())
    read = read_package(write_package(held, tmp_path / "out", direct=stack))
    assert (read.scene[0].mobility, read.scene[0].mobility_source) == ("fixed", "found") and read.direct is not None
    assert [o.mobility for o in read.direct] == [o.mobility for o in stack]


def test_a_footing_comes_back_and_direct_composition_has_none(tmp_path: Path) -> None:
    scene, levelled = on_a_footing()
    o = scene[0]
    read = read_package(write_package(scene, tmp_path / "out", direct=levelled))
    (again,) = read.scene
    for mine, theirs in ((o.parts, again.parts), (o.footing, again.footing)):
        assert len(mine) == len(theirs) == 1
        assert np.allclose(np.array(mine[0].vertices) * o.scale, theirs[0].vertices, atol=1e-9)
    assert read.document.objects[0].collision == ("collision/00/00.obj", "collision/00/01.obj")
    assert read.direct is not None and len(read.direct[0].parts) == 1 and not read.direct[0].footing
    twice = read_package(write_package(read.scene, tmp_path / "twice", direct=read.direct))
    assert twice.document.objects == read.document.objects and twice.document.direct == read.document.direct


def test_a_package_measures_as_the_scene_that_was_written(tmp_path: Path) -> None:
    scene, levelled = on_a_footing()
    stored = evaluate(scene, levelled)
    read = read_package(write_package(scene, tmp_path / "out", direct=levelled))
    measured = evaluate(read.scene, read.direct)
    assert stored.direct and stored.direct.D_max_cm > 1 > 10 * stored.result.D_max_cm, "only the result rests"
    for title, row in stored.rows().items():
        assert measured.rows()[title].as_dict() == pytest.approx(row.as_dict(), rel=1e-3, abs=1e-4), title


def test_a_package_without_marked_footings_is_read(tmp_path: Path) -> None:
    """Older packages name footings among their parts."""
    scene, _ = on_a_footing()
    out = write_package(scene, tmp_path / "out")
    spoiled(out, lambda t: t["objects"][0].pop("footing"))
    (o,) = read_package(out).scene
    assert len(o.parts) == 2 and not o.footing


def test_a_mask_of_another_size_is_refused_by_name(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    Image.new("L", (2, 3)).save(out / "masks/00_box.png")
    with pytest.raises(InputError, match=r"00_box\.png: found 2x3 pixels"):
        read_package(out)


def test_a_stranger_reads_the_same_world(stack: Scene, tmp_path: Path) -> None:
    """The package the way the referee reads it: trimesh and json alone."""
    out = write_package(stack, tmp_path / "out")
    tree = json.loads((out / "scene.json").read_text())
    for o, record in zip(stack, tree["objects"], strict=True):
        T = np.array(record["T_world_object"], float)
        mesh = trimesh.load(out / record["mesh"], force="mesh", process=False)
        mesh.apply_transform(T)
        assert np.abs(mesh.triangles - o.vertices_world[o.mesh.faces]).max() < 1e-7
        if (texture := o.mesh.materials[0].texture) is not None:
            assert np.array_equal(np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")), texture)
        else:
            assert len(mesh.visual.vertex_colors) == len(mesh.vertices)
        for file, part in zip(record["collision"], o.colliders_world, strict=True):
            hull = trimesh.load(out / file, force="mesh", process=False)
            hull.apply_transform(T)
            assert hull.convex_hull.volume == pytest.approx(part.volume, rel=1e-6)


def test_inertia_is_about_the_centre_of_mass_in_object_axes(tmp_path: Path) -> None:
    R = rotation_about([1, 2, 3], 0.7)
    o = box(0, size=(0.1, 0.2, 0.3), R=R, at=(1, 2, 3))
    o = replace(o, mesh=o.mesh.with_vertices(o.mesh.vertices + np.array([5, 0, 0])), parts=())
    record = read_package(write_package(scene_of(o), tmp_path / "out")).document.objects[0]
    assert record.mass == pytest.approx(3.6) and record.volume_source == "mesh"
    assert np.allclose(record.center_of_mass, [5, 0, 0])
    assert np.allclose(record.inertia, np.diag([0.13, 0.10, 0.05]) * 3.6 / 12, atol=1e-9)


def test_the_released_package_is_the_released_scene(stack: Scene, tmp_path: Path) -> None:
    read = read_package(write_package(stack, tmp_path / "out"))
    assert release(read.scene.objects) == pytest.approx(release(stack.objects), rel=1e-3)
    assert release(read.scene.objects).D_max < 4 * (2 * RELEASE_MARGIN - DEFAULT_MARGIN.clearance)


def test_a_package_tells_whose_colours_hold_the_light_of_the_photo(stack: Scene, tmp_path: Path) -> None:
    first, *others = stack.objects
    scene = replace(stack, objects=(replace(first, lifted=True), *others))
    read = read_package(write_package(scene, tmp_path / "out")).scene
    assert [o.lifted for o in read] == [True, *(False for _ in others)]


def test_the_published_schema_is_current_and_holds(stack: Scene, tmp_path: Path) -> None:
    assert json.loads(SCHEMA.read_text()) == scene_schema(), "run: python tests/test_package.py"
    out = write_package(stack, tmp_path / "out")
    assert json.loads((out / "scene.schema.json").read_text()) == scene_schema()
    jsonschema.validate(json.loads((out / "scene.json").read_text()), scene_schema())


def test_report_and_pictures(stack: Scene, tmp_path: Path) -> None:
    report = Report(
        stage="align",
        measures=(Measure(name="mIoU", before=0.5, after=float("inf"), unit="1"),),
        decisions=(Decision(choice="step: accepted", reason="better"),),
    )
    pictures = {"overlay": stack.photo.rgb}
    out = write_package(stack, tmp_path / "out", reports=[report], seconds={"align": 1.5}, pictures=pictures)
    read = json.loads((out / "report.json").read_text())
    assert read["seconds"] == {"align": 1.5}
    assert read["stages"][0]["measures"][0] == {
        "name": "mIoU",
        "before": 0.5,
        "after": None,
        "unit": "1",
        "about": None,
    }
    assert (out / "pictures/overlay.png").is_file()
    with pytest.raises(ValueError, match="picture name"):
        write_package(stack, tmp_path / "other", pictures={"../x": stack.photo.rgb})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_two_writes_are_equal_and_tell_nothing_of_the_machine(stack: Scene, tmp_path: Path) -> None:
    once = tree(write_package(stack, tmp_path / "a", seconds={"x": 1.0}))
    twice = tree(write_package(box_copy(stack), tmp_path / "deep" / "b", seconds={"x": 2.0}))
    assert {n: d for n, d in once.items() if n != "report.json"} == {
        n: d for n, d in twice.items() if n != "report.json"
    }
    host = os.uname().nodename.encode()
    for name, data in once.items():
        assert str(tmp_path).encode() not in data and (len(host) < 4 or host not in data), name


def box_copy(scene: Scene) -> Scene:
    """Equal values in other objects: no cache may show."""
    return replace(
        scene,
        objects=tuple(replace(o, mesh=replace(o.mesh, materials=tuple(map(replace, o.mesh.materials)))) for o in scene),
    )


# --- other programs ---------------------------------------------------------------------------------------


def test_scene_xml_rests_in_plain_mujoco_from_any_folder(
    stack: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write_package(stack, tmp_path / "out")
    monkeypatch.chdir("/")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for o in stack:
        body = data.body(export_name(o.id, o.label))
        assert np.allclose(body.xpos, o.T_world_object[:3, 3], atol=1e-12)
        assert np.allclose(body.xmat.reshape(3, 3), o.T_world_object[:3, :3], atol=1e-12)
    start = data.xipos.copy()
    assert not model.geom_margin.any(), "other engines refuse or drop contact margins"
    for _ in range(500):
        mujoco.mj_step(model, data)
    landed = data.xipos.copy()
    assert np.abs(landed - start).max() < 0.1 * DEFAULT_MARGIN.clearance, "nothing falls: its hulls are grown"
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert np.abs(data.xipos - landed).max() < 1e-5


def labelled(name: str, scene: Scene) -> str:
    """What scene.xml calls a geom of the product's own model."""
    for o in scene:
        name = name.replace(f"object_{o.id:02d}_", f"{export_name(o.id, o.label)}_")
    return name


def test_materials_are_the_same_in_the_package_scene_xml_and_goals(stack: Scene, tmp_path: Path) -> None:
    """Ten times as heavy, smooth, on a smooth ground: all three say so, with the reason."""
    slippery = [
        replace(o, density=6000.0, friction=0.1, material="steel", material_source="given", material_reason="weighed")
        for o in stack
    ]
    scene = replace(stack.with_objects(*slippery), ground=replace(stack.ground, friction=0.05))
    out = write_package(scene, tmp_path / "out")
    read = read_package(out).scene
    theirs = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    ours = model_of(read, [declared(o) for o in read], SimulationPlan(duration=1.0, margin=0.0))
    assert np.allclose(theirs.body_mass, ours.body_mass, rtol=1e-12) and theirs.body_mass[1] > 5
    for geom in (ours.geom(k) for k in range(ours.ngeom)):
        assert np.allclose(theirs.geom(labelled(geom.name, read)).friction, geom.friction)
    assert theirs.geom("ground").friction[0] == read.ground.friction == 0.05
    assert {(o.material, o.material_source, o.material_reason) for o in read} == {("steel", "given", "weighed")}


def test_scene_xml_is_the_model_of_the_product(stack: Scene, tmp_path: Path) -> None:
    scene = stack.with_objects(replace(stack[2], mobility="fixed", friction=0.3, rolling_friction=0.002))
    out = write_package(scene, tmp_path / "out")
    theirs = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    ours = build_spec(scene.objects, PhysicsConfig(contact=ContactMargin(body=0.0))).compile()
    assert theirs.njnt == ours.njnt == 2 and theirs.neq == theirs.nexclude == 0
    assert not theirs.dof_damping.any() and not theirs.opt.enableflags
    for name in (
        "timestep",
        "gravity",
        "cone",
        "impratio",
        "integrator",
        "disableflags",
        "noslip_iterations",
    ):
        assert np.array_equal(getattr(theirs.opt, name), getattr(ours.opt, name)), name
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos", "body_quat"):
        assert np.allclose(getattr(theirs, name), getattr(ours, name), rtol=1e-9, atol=1e-12), name
    for k in range(ours.ngeom):
        a, b = theirs.geom(labelled(ours.geom(k).name, scene)), ours.geom(k)
        for name in ("friction", "condim", "solref", "solimp", "margin", "contype", "priority"):
            assert np.allclose(getattr(a, name), getattr(b, name), atol=1e-7), name
        raised = [0, 0, DEFAULT_MARGIN.body] if b.name == "ground" else [0, 0, 0]
        assert np.allclose(a.pos, b.pos + raised, atol=1e-7), "the ground is grown as the boxes are"
    visual = [k for k in range(theirs.ngeom) if "_visual_" in theirs.geom(k).name]
    assert all(not theirs.geom_contype[k] and not theirs.geom_conaffinity[k] for k in visual)
    assert {int(theirs.geom_group[k]) for k in visual} == {2} and theirs.ntex == 3, "two of boxes, and the sky"


def test_scene_xml_shows_the_texture_upright(tmp_path: Path) -> None:
    """MuJoCo samples row v * height from the first row of its texture: v has to point down the picture."""
    o = box(0, textured=True)
    out = write_package(scene_of(o), tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    texture = o.mesh.materials[0].texture
    assert texture is not None and o.mesh.uv is not None
    start = int(model.tex("box_00_visual_00").adr[0])
    shown = np.asarray(model.tex_data)[start : start + texture.size]
    assert np.array_equal(shown.reshape(texture.shape), texture)
    corners = np.asarray(model.mesh_facetexcoord)[:12]
    shown = np.asarray(model.mesh_texcoord)[corners]
    assert np.allclose(shown, o.mesh.uv[o.mesh.faces] * [1, -1] + [0, 1], atol=1e-6)


def test_scene_xml_takes_tiny_and_degenerate_looks(tmp_path: Path) -> None:
    mesh = box_mesh()
    flat = np.concatenate([mesh.faces, [[0, 0, 1]]])
    material = np.array([1, *[0] * 11, 2], np.int32)
    mesh = replace(mesh, faces=flat, face_material=material, materials=(Material(), Material(), Material()))
    out = write_package(scene_of(replace(box(0), mesh=mesh)), tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    assert sum("_visual_" in model.geom(k).name for k in range(model.ngeom)) == 2


def test_scene_glb_stands_upright_in_gltf_axes(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    loaded = trimesh.load_scene(out / "scene.glb", process=False)
    assert len(loaded.graph.nodes_geometry) == 3
    for mesh, o in zip(sorted(loaded.dump(), key=lambda m: m.metadata["node"]), stack, strict=True):
        x, y, z = np.asarray(mesh.vertices).T
        shown = np.stack([x, -z, y], axis=1)[np.asarray(mesh.faces)]
        assert np.allclose(shown, o.vertices_world[o.mesh.faces], atol=1e-6), "the same corners, in their order"
    nodes = glb_tree(out)["nodes"]
    assert [n["extras"] for n in nodes if "mesh" in n] == [{"id": o.id, "label": o.label} for o in stack]


def glb_tree(out: Path) -> dict[str, Any]:
    data = (out / "scene.glb").read_bytes()
    return json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])


@pytest.mark.parametrize("label", HOSTILE)
def test_labels_are_text_and_nothing_else(label: str, tmp_path: Path) -> None:
    scene = scene_of(box(3, textured=True, label=label))
    out = write_package(scene, tmp_path / "out")
    names = sorted(tree(out))
    assert names == sorted(tree(write_package(scene_of(box(3, textured=True)), tmp_path / "plain")))
    stored = read_package(out).scene.objects[0].label
    assert stored == (label if label != "\ud800" else "?")
    mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    trimesh.load_scene(out / "scene.glb")
    node = glb_tree(out)["nodes"][0]
    assert node["name"].startswith("object_03") and node["name"].isascii() and len(node["name"]) < 80


# --- whole or not at all ----------------------------------------------------------------------------------


@pytest.mark.parametrize("point", ["mesh_to_glb", "to_mjcf", "to_json", "replace", "rename"])
@pytest.mark.parametrize("error", [RuntimeError("stop"), OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failing_write_leaves_the_old_package(
    point: str, error: BaseException, stack: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write_package(stack, tmp_path / "out")
    before = tree(out)

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    owner = {"replace": atomic_folder.Claim, "rename": Path, "to_mjcf": mjcf}.get(point, package)
    monkeypatch.setattr(owner, point, fail)
    with pytest.raises(OutputError if isinstance(error, OSError) else type(error)):
        write_package(box_stack_scene(2), out)
    assert tree(out) == before and [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_failing_second_rename_brings_the_old_package_back(
    stack: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = write_package(stack, tmp_path / "out")
    before, rename = tree(out), Path.rename

    def fail(source: Path, target: Path) -> None:
        if source.name == "new":
            raise OSError(5, "Input/output error")
        rename(source, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(OutputError, match="input/output"):
        write_package(box_stack_scene(2), out)
    assert tree(out) == before and [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_killed_run_is_tidied_up_by_the_next(stack: Scene, tmp_path: Path) -> None:
    """Every step of a kill is in test_atomic_folder.py."""
    out, building = write_package(stack, tmp_path / "out"), tmp_path / ".out.building"
    before = tree(out)
    for killed in ("building", "between", "deleting"):
        (building / "new").mkdir(parents=True)
        (building / atomic_folder.MARKER).write_bytes(atomic_folder.MARK)
        if killed == "between":
            out.rename(building / "previous")
        if killed == "deleting":
            (building / "new").rename(building / "previous")
        assert package.prepare_output(out) == out
        assert tree(out) == before and [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_second_writer_is_told_so(stack: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with atomic_folder.claimed(out, lambda _: None):
        for attempt in (write_package, lambda _, out: package.prepare_output(out)):
            with pytest.raises(OutputError, match="another run is writing it"):
                attempt(stack, out)
        assert (tmp_path / ".out.building" / atomic_folder.MARKER).exists()
    assert not list(tmp_path.iterdir())
    assert write_package(stack, out).exists()


def test_foreign_files_in_a_package_are_not_thrown_away(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    (out / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        write_package(stack, out, overwrite=True)
    assert (out / "notes.txt").read_text() == "mine"


def test_input_and_output_may_not_hold_one_another(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    for out, inputs in (("a", "a"), ("a", "a/b"), ("a/b", "a")):
        with pytest.raises(OutputError, match="may not hold"):
            package.prepare_output(tmp_path / out, inputs=tmp_path / inputs)
    assert package.prepare_output(tmp_path / "a" / "b", inputs=tmp_path / "c")


@pytest.mark.parametrize("content", [{"notes.txt": "mine"}, {"scene.json": "{}"}, {"scene.json": "[]", "a": ""}])
def test_a_folder_that_is_no_package_is_not_replaced(content: dict[str, str], stack: Scene, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name, text in content.items():
        (out / name).write_text(text)
    before = tree(out)
    accepted = "a new or empty folder, or an f3sr package"
    with pytest.raises(OutputError, match=f"found a folder with .*{next(iter(content))}; accepted: {accepted}"):
        write_package(stack, out, overwrite=True)
    assert tree(out) == before and [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_file_in_the_way_is_refused_and_an_empty_folder_used(stack: Scene, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="found a file; accepted: a new or empty folder"):
        write_package(stack, tmp_path / "file")
    (tmp_path / "empty").mkdir()
    assert read_package(write_package(stack, tmp_path / "empty")).scene.objects
    with pytest.raises(OutputError):
        write_package(stack, tmp_path / "file" / "below")


def test_rollouts_are_replaced_only_on_demand(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    (out / "rollouts" / "0").mkdir(parents=True)
    with pytest.raises(OutputError, match="--overwrite"):
        write_package(stack, out)
    write_package(stack, out, overwrite=True)
    assert not (out / "rollouts").exists()


# --- reading what others wrote ----------------------------------------------------------------------------


def spoiled(out: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    tree = json.loads((out / "scene.json").read_text())
    change(tree)
    (out / "scene.json").write_text(json.dumps(tree))


def first(**values: Any) -> Callable[[dict[str, Any]], Any]:
    """Of the first object."""
    return lambda t: t["objects"][0].update(values)


def placed(x: float) -> Callable[[dict[str, Any]], Any]:
    """The first object elsewhere."""
    return lambda t: t["objects"][0]["T_world_object"][0].__setitem__(3, x)


def camera(**values: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda t: t["camera"].update(values)


def focal(fx: float, *, last: tuple[float, ...] = (0, 0, 1)) -> Callable[[dict[str, Any]], Any]:
    return camera(K=[[fx, 0, 32], [0, fx, 24], last])


def direct(**values: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda t: t["direct"]["objects"][0].update(values)


def last_id(id: int) -> Callable[[dict[str, Any]], Any]:
    """The last object under another id, wherever it is named."""

    def change(t: dict[str, Any]) -> None:
        old = t["objects"][-1]["id"]
        t["objects"][-1]["id"] = t["direct"]["objects"][-1]["id"] = id
        for r in t["scene_graph"]["relations"]:
            r.update({k: id for k in ("subject", "object") if r[k] == old})

    return change


def diagonal(*values: float) -> list[list[float]]:
    return np.diag(values).tolist()


def nobody(t: dict[str, Any]) -> None:
    t.update(objects=[], direct=None, scene_graph={"relations": [], "source": "nobody"})


def repeated(count: int) -> Callable[[dict[str, Any]], Any]:
    """One part file named so many times in each object."""
    return lambda t: [o.update(collision=o["collision"][:1] * count) for o in t["objects"]]


SPOILS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "version": (lambda t: t.update(schema_version=2), "schema_version"),
    "true for a version": (lambda t: t.update(schema_version=True), "schema_version"),
    "a version with a point": (lambda t: t.update(schema_version=1.0), "schema_version"),
    "unknown key": (lambda t: t.update(more=1), "more"),
    "missing key": (lambda t: t.pop("camera"), "camera"),
    "path above": (lambda t: t["objects"][0].update(mesh="../m.glb"), "objects.0.mesh"),
    "absolute path": (lambda t: t["objects"][1].update(collision=["/etc/passwd"]), "objects.1.collision.0"),
    "mask with a folder": (lambda t: t["objects"][0].update(mask="a/b.png"), "objects.0.mask"),
    "scaled pose": (lambda t: t["objects"][0]["T_world_object"][0].__setitem__(0, 2.0), "rigid"),
    "not a number": (lambda t: t["objects"][0].update(mass=float("nan")), "NaN"),
    "twice an id": (lambda t: t["objects"][1].update(id=0), "unique"),
    "unknown support": (lambda t: t["objects"][1].update(supported_by=7), "7"),
    "support by itself": (lambda t: t["objects"][1].update(supported_by=t["objects"][1]["id"]), "without circles"),
    "supports in a circle": (
        lambda t: [t["objects"][k].update(supported_by=t["objects"][1 - k]["id"]) for k in (0, 1)],
        "by itself, directly",
    ),
    "mask twice": (lambda t: t["excluded"].append({"mask": t["objects"][0]["mask"], "reason": ""}), "twice"),
    "no objects": (nobody, "objects = .*at least 1 item"),
    "an id of 2^31": (last_id(2**31), "objects.2.id = 2147483648; accepted: less than or equal to 2147483647"),
    "an id of 2^63": (last_id(2**63), "objects.2.id"),
    "an id below zero": (last_id(-1), "objects.2.id"),
    "an id of true": (first(id=True), "objects.0.id"),
    "direct scale 1e300": (direct(scale=1e300), "direct.objects.0.scale"),
    "direct scale 1e-300": (direct(scale=1e-300), "direct.objects.0.scale"),
    "direct scale 1e5": (direct(scale=1e5), "direct object 0 of 1.73e[+]04 m; accepted"),
    "direct far away": (
        lambda t: t["direct"]["objects"][0]["T_world_object"][0].__setitem__(3, 9e5), "direct object 0 .* its own size",
    ),
    "mass 1e300": (first(mass=1e300), "objects.0.mass"),
    "mass 1e-300": (first(mass=1e-300), "objects.0.mass"),
    "mass of a mountain": (first(mass=1e13, density=1000), "of 1e[+]10 m3"),
    "density 1e-300": (first(density=1e-300), "objects.0.density"),
    "density 1e300": (first(density=1e300), "objects.0.density"),
    "a mass of no volume": (first(mass=1e-14, density=1000), "volume of 1e-17 m3"),
    "inertia 0": (first(inertia=diagonal(0, 0, 0)), "principal moments"),
    "inertia below zero": (first(inertia=diagonal(-1e-3, -1e-3, -1e-3)), "principal moments"),
    "inertia that no body has": (first(inertia=diagonal(1e-3, 1e-3, 3e-3)), "principal moments"),
    "inertia 1e300": (first(inertia=diagonal(1e300, 1e300, 1e300)), "objects.0.inertia"),
    "inertia 1e-16": (first(inertia=diagonal(1e-16, 1e-16, 1e-16)), "what can move"),
    "inertia of a wheel of ten kilometres": (first(inertia=diagonal(1e8, 1e8, 1e8)), "at most 2000 m"),
    "inertia not symmetric": (first(inertia=[[1e-3, 5e-4, 0], [0, 1e-3, 0], [0, 0, 1e-3]]), "not symmetric"),
    "centre of mass 1e300": (first(center_of_mass=[1e300, 0, 0]), "objects.0.center_of_mass"),
    "centre of mass a metre away": (first(center_of_mass=[1, 0, 0]), "center_of_mass away from its mesh"),
    "an object 900 km away": (placed(9e5), "object 0 5.2e[+]06 times its own size away"),
    "an object 1e300 m away": (placed(1e300), "T_world_object.0.3"),
    "a rotation of 1e200": (
        lambda t: t["objects"][0]["T_world_object"][0].__setitem__(0, 1e200), "T_world_object.0.0",
    ),
    "friction 1e300": (first(friction=1e300), "objects.0.friction"),
    "rolling friction of a metre": (first(rolling_friction=1.0), "objects.0.rolling_friction"),
    "a label of 40 kB": (first(label="x " * 20_000), "objects.0.label"),
    "a material of 40 kB": (first(material="x " * 20_000), "objects.0.material"),
    "K of zeros": (camera(K=[[0, 0, 0]] * 3), "K = .*accepted: .*0, 0, 1"),
    "K with a last row of zeros": (focal(60, last=(0, 0, 0)), "K = .*accepted: .*0, 0, 1"),
    "K of 1e300": (focal(1e300), "camera.K.0.0"),
    "K below zero": (focal(-60), "focal lengths -60"),
    "K of a focal length of a millionth": (focal(1e-6), "focal lengths 1e-06"),
    "K turned": (camera(K=[[60, 0, 32], [1, 60, 24], [0, 0, 1]]), "accepted: .*fy"),
    "K that looks elsewhere": (camera(K=[[60, 0, 1e7], [0, 60, 24], [0, 0, 1]]), "principal point"),
    "a camera of a billion pixels": (camera(width=10**9), "camera.width"),
    "a ground without direction": (lambda t: t["ground"].update(normal=[0, 0, 0]), "length 1"),
    "a ground 1e300 m below": (lambda t: t["ground"].update(offset=-1e300), "ground.offset"),
    "a motion that scales by 1e300": (
        first(motion=[{"stage": "x", "translation": [0, 0, 0], "rotation": 0, "scale": 1e300, "reason": ""}]), "scale",
    ),
    "20,000 parts of an object": (repeated(20_000), "objects.0.collision = .*at most 320 items"),
    "a footing of all parts": (first(footing=1), "objects.0.*a footing of 1 of 1 collision parts; accepted: at most 0"),
    "a footing of less than none": (first(footing=-1), "objects.0.footing"),
    "a footing of true": (first(footing=True), "objects.0.footing"),
    "a footing of 10,000 parts": (first(footing=10_000), "objects.0.footing"),
    "no parts": (first(collision=[]), "objects.0.collision"),
    "a provenance of 10,000 lists": (
        lambda t: t["provenance"].update(a=json.loads("[" * 400 + "]" * 400)), "provenance",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILS)
def test_a_spoiled_document_is_refused(name: str, stack: Scene, tmp_path: Path) -> None:
    change, found = SPOILS[name]
    out = write_package(stack, tmp_path / "out", direct=stack)
    read_package(out)
    spoiled(out, change)
    with warnings.catch_warnings(), pytest.raises(InputError, match=found) as caught:
        warnings.simplefilter("error")
        read_package(out)
    message = str(caught.value)
    assert caught.value.where.endswith("scene.json") and "\n" not in message and len(message) < 700


@pytest.mark.parametrize("change", [last_id(2**31 - 1), placed(1000.0), focal(5.0), first(friction=4.0)])
def test_what_is_just_within_the_bounds_is_a_package(
    change: Callable[[dict[str, Any]], Any], stack: Scene, tmp_path: Path
) -> None:
    out = write_package(stack, tmp_path / "out", direct=stack)
    spoiled(out, change)
    scene = read_package(out).scene
    assert release(scene.objects, seconds=0.1).D_max < 0.1
    assert limits_of(scene).lift <= 1e4


@pytest.mark.parametrize("command", [["evaluate"], ["simulate", "push the box"], ["goals"]])
@pytest.mark.parametrize("name", ["no objects", "an id of 2^63", "mass 1e300", "inertia 0", "an object 900 km away"])
def test_every_command_refuses_a_spoiled_package_in_one_line(
    name: str,
    command: list[str],
    stack: Scene,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    out = write_package(stack, tmp_path / "out", direct=stack)
    spoiled(out, SPOILS[name][0])
    before = tree(tmp_path)
    assert main([command[0], str(out), *command[1:]]) == 2
    out_text, error = capfd.readouterr()
    assert (out_text, error.count("\n")) == ("", 1) and "scene.json" in error
    assert tree(tmp_path) == before


def test_a_scene_that_no_package_may_hold_is_not_written(stack: Scene, tmp_path: Path) -> None:
    light = replace(stack[0], density=1e-3)
    with pytest.raises(OutputError, match=r"none that a package may hold.*objects.0.density"):
        write_package(stack.with_objects(light), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def sparse(file: Path, size: int) -> None:
    """A file that takes no room."""
    with file.open("wb") as stream:
        stream.truncate(size)


def into(name: str, target: str) -> Callable[[Path], None]:
    def change(out: Path) -> None:
        (out / name).unlink()
        (out / name).symlink_to(target)

    return change


def of_bytes(name: str, size: int) -> Callable[[Path], None]:
    return lambda out: sparse(out / name, size)


def flat(out: Path) -> None:
    mesh = load_mesh(out / "meshes/00.glb")
    save_glb(mesh.with_vertices(mesh.vertices * [1, 1, 0]), out / "meshes/00.glb")


def of_another_size(factor: float) -> Callable[[Path], None]:
    def change(out: Path) -> None:
        mesh = load_mesh(out / "meshes/00.glb")
        save_glb(mesh.with_vertices(mesh.vertices * factor), out / "meshes/00.glb")

    return change


def pipe(out: Path) -> None:
    (out / "collision/00/00.obj").unlink()
    os.mkfifo(out / "collision/00/00.obj")


def part_elsewhere(out: Path) -> None:
    text = (out / "collision/00/00.obj").read_text()
    moved = re.sub(r"^v (\S+)", lambda m: f"v {float(m[1]) + 9}", text, flags=re.MULTILINE)
    (out / "collision/00/00.obj").write_text(moved)


def part_of(*size: float) -> Callable[[Path], None]:
    """A box of that size [m] for the first part."""

    def change(out: Path) -> None:
        part = box_mesh(size).hull
        lines = [f"v {x} {y} {z}" for x, y, z in part.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (part.faces + 1).tolist()]
        (out / "collision/00/00.obj").write_text("\n".join(lines) + "\n")

    return change


LARGE = 3_000_000_000
FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "scene.json of 3 GB": (of_bytes("scene.json", LARGE), r"scene\.json: found 3,000,000,000 bytes"),
    "scene.json of 70 MB": (of_bytes("scene.json", 70_000_000), r"scene\.json: found 70,000,000 bytes"),
    "a part of 3 GB": (of_bytes("collision/00/00.obj", LARGE), r"00\.obj: found 3,000,000,000 bytes"),
    "a part of 60 MB": (of_bytes("collision/00/00.obj", 60_000_000), r"00\.obj: found 60,000,000 bytes"),
    "a mesh of 3 GB": (of_bytes("meshes/00.glb", LARGE), r"00\.glb: found 3,000,000,000 bytes"),
    "a photo of 3 GB": (of_bytes("photo.png", LARGE), r"photo\.png: found 3,000,000,000 bytes"),
    "a photo that is a device": (into("photo.png", "/dev/zero"), "photo.png"),
    "a part that is a pipe": (
        pipe,
        r"00\.obj: found a pipe",
    ),
    "a flat mesh": (flat, r"00\.glb: found a flat mesh"),
    "a mesh of a tenth of a millimetre": (of_another_size(1e-3), "object 0 of 0.000173 m"),
    "a mesh of 17 km": (of_another_size(1e5), "object 0 of 1.73e[+]04 m"),
    "a mesh far smaller than its mass": (of_another_size(0.3), "mass of 0.001 m3|away from its mesh"),
    "a part away from its mesh": (part_elsewhere, "collision parts away from its mesh"),
    "a part that is a sheet": (part_of(0.1, 0.1, 1e-10), r"00\.obj: found a part thinner than single"),
    "a part that is a needle": (part_of(1e-6, 0.1, 1e-6), r"00\.obj: found a part thinner than single"),
    "a part of half its mesh": (part_of(0.1, 0.1, 0.05), "do not reach its mesh's bounds"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_spoiled_file_of_a_package_is_refused_at_once(name: str, stack: Scene, tmp_path: Path) -> None:
    change, found = FILES[name]
    out = write_package(stack, tmp_path / "out")
    change(out)
    start = time.process_time()
    with pytest.raises(InputError, match=found):
        read_package(out)
    assert time.process_time() - start < 2


def test_a_part_named_often_is_read_once(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    spoiled(out, repeated(MAX_OBJECT_PARTS))
    start = time.process_time()
    parts = read_package(out).scene[0].parts
    assert len(parts) == MAX_OBJECT_PARTS and len(set(map(id, parts))) == 1 and time.process_time() - start < 2


def test_missing_and_linked_files_are_refused_by_name(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    (out / "meshes/01.glb").unlink()
    with pytest.raises(InputError, match=r"01\.glb: found no such file"):
        read_package(out)
    (tmp_path / "outside.glb").write_bytes((out / "meshes/00.glb").read_bytes())
    (out / "meshes/01.glb").symlink_to(tmp_path / "outside.glb")
    with pytest.raises(InputError, match="leaves the package"):
        read_package(out)
    with pytest.raises(InputError, match=r"found a folder without scene\.json; accepted: an f3sr package"):
        read_package(tmp_path)


def test_a_scene_document_elsewhere_is_refused(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    (out / "scene.json").rename(tmp_path / "outside.json")
    (out / "scene.json").symlink_to(tmp_path / "outside.json")
    with pytest.raises(InputError, match=r"scene\.json: found a path that leaves the package"):
        read_package(out)


@pytest.mark.parametrize("path", ["x" * 100_000, "x y/" * 25_000 + "x", "\u202e" * 50_000, "../" * 30_000])
def test_what_is_overlong_is_cut_in_messages(
    path: str, stack: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = write_package(stack, tmp_path / "out")
    spoiled(out, lambda t: t["objects"][0].update(mesh=path))
    for call in (["goals", str(out)], ["goals", str(out / path)]):
        assert main(call) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and len(error) < 1200 and "accepted" in error


def test_a_flat_collision_part_is_refused_by_name(stack: Scene, tmp_path: Path) -> None:
    out = write_package(stack, tmp_path / "out")
    (out / "collision/00/00.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"00\.obj: found 3 points span no volume"):
        read_package(out)


def test_moved_world_moves_only_the_poses(stack: Scene, tmp_path: Path) -> None:
    """The same objects elsewhere: equal mesh and collision files, poses moved alike."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_about([0, 0, 1], 0.5), [1, 2, 0]
    elsewhere = stack.with_objects(*(o.moved(T, stage="test", reason="test") for o in stack))
    a, b = write_package(stack, tmp_path / "a"), write_package(elsewhere, tmp_path / "b")
    for name, data in tree(a).items():
        if name.startswith(("meshes", "collision", "visual")):
            assert (b / name).read_bytes() == data
    for p, q in zip(read_package(a).scene, read_package(b).scene, strict=True):
        assert np.allclose(transform(T, p.vertices_world), q.vertices_world, atol=1e-12)
        assert q.motion[0].stage == "test"


def test_sizes_of_the_test_scene() -> None:
    scene = box_stack_scene(2)
    assert scene.photo.rgb.shape == (HEIGHT, WIDTH, 3)
    assert isinstance(scene[0].parts[0], ConvexPart)


if __name__ == "__main__":
    SCHEMA.write_bytes(package.dump_json(scene_schema()))


def test_what_is_read_is_to_physics_what_was_written(tmp_path: Path) -> None:
    """Masses, centres, inertias and the corners of parts, to the bit: a rollout magnifies every difference."""
    scene = box_stack_scene(3)
    out = write_package(scene, tmp_path / "out")
    mine = build_spec(read_package(out).scene.objects, PhysicsConfig(contact=ContactMargin(body=0.0))).compile()
    plain = engine().MjModel.from_xml_path(str(out / "scene.xml"))
    shown = np.flatnonzero(plain.geom_contype)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat"):
        assert np.abs(getattr(mine, name) - getattr(plain, name)).max() < 1e-15
    for name in ("geom_quat", "geom_friction", "geom_solref", "geom_margin"):
        assert np.abs(getattr(mine, name) - getattr(plain, name)[shown]).max() < 1e-15
    grown = plain.geom_size[shown][1:] - mine.geom_size[1:]
    assert np.allclose(grown, DEFAULT_MARGIN.body, rtol=1e-3), "boxes: every face one margin further out"
