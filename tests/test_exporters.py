"""Exports: every format says the same as scene.json, whatever labels hold; other programs' readers are the judges."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import trimesh

from f3sr.cli.main import main
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import Array, box_corners, pose, rotation_about, rotation_angle, transform
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.exporters.drake_contact import STIFFNESS
from f3sr.exporters.export_names import export_name, export_text, id_of
from f3sr.exporters.exported_scene import GROUND_DEPTH, ExportedScene
from f3sr.exporters.glb import T_CAMERA_GLTF, T_YUP_ZUP, scene_to_glb, with_normals
from f3sr.exporters.grown_hulls import grown
from f3sr.exporters.thumbnail import SIDE, thumbnail
from f3sr.exporters.xml_text import document
from f3sr.importing.glb_nodes import read_glb_scene
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.runtime.file_date import date_of
from f3sr.scene_export import export_package, exporters_of
from f3sr.scene_package.package import Package, read_package, write_package
from foreign_packages import install
from labelled_boxes import labelled_boxes
from scenes import box, scene_of

HOSTILE = [
    "../../x",
    "\"quotes\" & 'more'",
    "<tag attr='1'>",
    "x" * 300,
    "",
    "über\n\0\u202e日本",
    "7 up",
    "con",
    "a_1",
]
DRAKE = "http://drake.mit.edu"
FORMATS = ["glb", "mjcf", "robosuite", "sdf", "urdf"]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return read_package(write_package(labelled_boxes(), tmp_path_factory.mktemp("exports") / "table"))


@pytest.fixture(scope="module")
def exported(package: Package, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_package(package, tmp_path_factory.mktemp("exported") / "out", FORMATS)


def records(package: Package) -> dict[str, Any]:
    """scene.json's records by exported name."""
    return {export_name(o.id, o.label): o for o in package.document.objects}


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- names ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", HOSTILE)
def test_names_are_safe_and_tell_their_id(label: str) -> None:
    name = export_name(3, label)
    assert re.fullmatch(r"[a-z][a-z0-9_]*_03", name) and len(name) <= 50
    assert id_of(name) == 3
    assert name == export_name(3, label)


@pytest.mark.parametrize("label", ["red\xa0mug", "赤い\u3000マグ", "لیوان می\u200cشود", "👩\u200d🍳", "日本"])
def test_labels_of_any_script_are_kept(label: str) -> None:
    assert export_text(label) == label


def test_labels_hold_nothing_that_xml_and_usd_cannot() -> None:
    every = "".join(map(chr, [*range(0x3000), *range(0xD7F0, 0xE010), 0xFEFF, *range(0xFFF0, 0x10010), 0xE0001]))
    kept = export_text(every)
    assert kept == export_text(kept) and "\\x00" in kept and "\\u202e" in kept and "\\ud800" in kept
    root = ET.Element("a", b=kept)
    root.text = kept
    again = ET.fromstring(document(root))
    assert again.text == again.get("b") == kept


def test_sdf_keeps_spaces_of_other_scripts(tmp_path: Path) -> None:
    written = read_package(write_package(scene_of(box(3, label="赤い\u3000マグ")), tmp_path / "table"))
    out = export_package(written, tmp_path / "out", ["sdf"])
    (config,) = out.rglob("model.config")
    assert ET.parse(config).findtext("description") == "object 3: 赤い\u3000マグ"


def test_names_differ_where_ids_do() -> None:
    labels = [*HOSTILE, "a", "a_1", "a_1_02", "A 1", "a-1"]
    names = [export_name(id, label) for id, label in enumerate(labels * 20)]
    assert len(set(names)) == len(names) and [id_of(n) for n in names] == list(range(len(names)))
    assert export_name(3, "Red  mug!") == "red_mug_03" and export_name(7, "Café") == "cafe_07"


def test_the_index_leads_from_names_to_labels(package: Package, exported: Path) -> None:
    index = json.loads((exported / "export.json").read_text())
    assert index["formats"] == FORMATS
    assert [(o["id"], o["label"]) for o in index["objects"]] == [(o.id, o.label) for o in package.scene]
    assert [o["name"] for o in index["objects"]] == list(records(package))


# --- one truth in every format ----------------------------------------------------------------------------------


def test_principal_inertia_is_the_inertia(package: Package) -> None:
    from f3sr.core.transforms import rotation_from_quaternion

    for o in ExportedScene.of(package.scene).objects:
        moments, quaternion = o.principal_inertia
        R = rotation_from_quaternion(quaternion)
        assert np.allclose(R @ np.diag(moments) @ R.T, o.body.inertia, rtol=1e-12, atol=1e-18)
        assert np.isclose(np.linalg.det(R), 1) and (np.diff(moments) >= 0).all()


def test_urdf_says_what_scene_json_says(package: Package, exported: Path) -> None:
    poses = json.loads((exported / "urdf/poses.json").read_text())
    assert [(o["id"], o["fixed"]) for o in poses["objects"]] == [(0, True), (1, False), (12, False)]
    for place in poses["objects"]:
        file = exported / "urdf" / place["urdf"]
        record, link = records(package)[place["name"]], ET.parse(file).getroot().find("link")
        assert link is not None
        assert_inertial(link, record)
        shapes = {kind: [m.get("filename", "") for m in link.iterfind(f"{kind}//mesh")] for kind in KINDS}
        assert len(shapes["collision"]) == len(record.collision)
        assert {m.get("scale") for m in link.iterfind("collision//mesh")} == {"0.001 0.001 0.001"}
        assert_meshes(file.parent, shapes, package.scene[record.id], hull_unit=1e-3)
        position = np.array(record.T_world_object)[:3, 3]
        assert np.array_equal(place["position"], position)


def test_sdf_says_what_scene_json_says(package: Package, exported: Path) -> None:
    world = ET.parse(exported / "sdf/scene.sdf").getroot().find("world")
    assert world is not None
    for name, record in records(package).items():
        alone = ET.parse(exported / f"sdf/{name}/model.sdf").getroot().find("model")
        placed = world.find(f"model[@name='{name}']")
        assert alone is not None and placed is not None
        for model, folder in ((alone, exported / "sdf" / name), (placed, exported / "sdf")):
            assert (model.findtext("static") == "true") == (record.mobility == "fixed")
            link = model.find("link")
            assert link is not None
            assert float(link.findtext("inertial/mass", "")) == record.mass
            moments = {i.tag: float(i.text or "") for i in link.iterfind("inertial/inertia/*")}
            assert np.array_equal(inertia_matrix(moments), record.inertia)
            assert floats(link.findtext("inertial/pose", ""))[:3] == list(record.center_of_mass)
            shapes = {kind: [u.text or "" for u in link.iterfind(f"{kind}//uri")] for kind in KINDS}
            assert_meshes(folder, shapes, package.scene[record.id])
            assert {m.text for m in link.iter("mu")} == {repr(record.friction)}
        x, y, z, *rpy = floats(placed.findtext("pose", ""))
        T = np.array(record.T_world_object)
        assert np.allclose(from_rpy(*rpy), T[:3, :3], atol=1e-12) and np.array_equal([x, y, z], T[:3, 3])


def test_mjcf_objects_say_what_scene_json_says(package: Package, exported: Path) -> None:
    whole = mujoco.MjModel.from_xml_path(str(exported / "mjcf/scene.xml"))
    for name, record in records(package).items():
        for file in (f"{name}/{name}.xml", f"{name}/scene.xml"):
            model = mujoco.MjModel.from_xml_path(str(exported / "mjcf" / file))
            for seen in (model, whole):
                k = seen.body(name).id
                assert seen.body_mass[k] == pytest.approx(record.mass, rel=1e-12)
                axes = matrix_of(seen.body_iquat[k])
                assert np.allclose(axes @ np.diag(seen.body_inertia[k]) @ axes.T, record.inertia, rtol=1e-9, atol=1e-15)
        assert model.nkey == (record.mobility == "dynamic")
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        rotation = data.body(name).xmat.reshape(3, 3)
        corners = package.scene[record.id].mesh.vertices @ rotation.T
        gap = data.body(name).xpos[2] + corners[:, 2].min()
        clearance = DEFAULT_MARGIN.clearance
        assert clearance - 1e-8 <= gap <= 1.5 * clearance, "grown corners reach the ground, which is grown too"


def test_the_package_and_its_export_are_one_model(package: Package, exported: Path) -> None:
    ours = mujoco.MjModel.from_xml_path(str(package.folder / "scene.xml"))
    theirs = mujoco.MjModel.from_xml_path(str(exported / "mjcf/scene.xml"))
    for name in ("body_mass", "body_pos", "body_quat", "geom_friction", "mesh_vert", "mesh_texcoord", "key_qpos"):
        assert np.array_equal(getattr(ours, name), getattr(theirs, name)), name


def test_the_lamp_leaves_no_specks_on_the_ground(exported: Path) -> None:
    """MuJoCo's shadow map has its axes along x and across it. It moves depths by 1.5 texels of the steeper slope. Where
    a lamp leans along both axes, neighbours differ by the sum of two slopes, and level ground shades itself."""
    light = mujoco.MjModel.from_xml_path(str(exported / "mjcf/scene.xml")).light("lamp")
    slopes = np.abs(light.dir[:2] / light.dir[2])
    assert slopes.max() > 0.2 and slopes.sum() < 1.5 * slopes.max() - 0.1
    sdf = ET.parse(exported / "sdf/scene.sdf").findtext("world/light/direction", "")
    assert np.allclose(floats(sdf) / np.linalg.norm(floats(sdf)), light.dir, atol=1e-6)


@pytest.mark.parametrize("far", [0.0, 30.0])
def test_all_formats_have_one_ground_around_their_objects(tmp_path: Path, far: float) -> None:
    """Also of objects far from the origin and from each other."""
    scene = scene_of(box(0, at=(far, 5, 0.05)), box(1, at=(2 * far, 5, 0.05)))
    out = export_package(
        read_package(write_package(scene, tmp_path / "table")), tmp_path / "out", ["mjcf", "sdf", "urdf"]
    )
    model = mujoco.MjModel.from_xml_path(str(out / "mjcf/scene.xml"))
    middle, sides = model.geom("ground").pos, 2 * model.geom("ground").size
    sdf = ET.parse(out / "sdf/scene.sdf").find("world/model[@name='ground']/link/collision")
    robot = ET.parse(out / "urdf/ground.urdf")
    urdf, joint = robot.find("link[@name='ground']/collision"), robot.find("joint[@type='fixed']")
    ends = [] if joint is None else [e.get("link") for e in joint if e.tag in ("parent", "child")]
    assert ends == ["world", "ground"], "a free ground falls with all that stands on it"
    origin, shape = (None, None) if urdf is None else (urdf.find("origin"), urdf.find("geometry/box"))
    assert sdf is not None and origin is not None and shape is not None
    assert floats(sdf.findtext("pose", ""))[:3] == floats(origin.get("xyz", "")) == pytest.approx(list(middle))
    assert floats(sdf.findtext("geometry/box/size", "")) == floats(shape.get("size", "")) == pytest.approx(list(sides))
    corners = np.concatenate([o.bounds_world for o in scene])[:, :2]
    assert (np.abs(corners - middle[:2]) < sides[:2] / 2 - 1.5).all(), "something may roll before it falls off"
    assert middle[2] + sides[2] / 2 == pytest.approx(DEFAULT_MARGIN.body)
    alone = mujoco.MjModel.from_xml_path(str(out / "mjcf/box_01/scene.xml"))
    assert np.allclose(alone.geom("ground").pos[:2], 0, atol=1e-6), "an object alone stands above the origin"


def test_all_surfaces_are_equally_stiff_in_drake(package: Package, exported: Path) -> None:
    """Boxes and the ground: pressure in the middle over half of the least side."""
    wanted = {
        o.name: np.ptp(o.colliders[0].vertices, axis=0).min() / 2 for o in ExportedScene.of(package.scene).objects
    }
    for model in ET.parse(exported / "sdf/scene.sdf").iterfind("world/model"):
        name = model.get("name", "")
        for collision in model.iterfind("link/collision"):
            modulus = float(collision.findtext(f"{{{DRAKE}}}proximity_properties/{{{DRAKE}}}hydroelastic_modulus", ""))
            half = wanted.get(name, GROUND_DEPTH / 2)
            assert modulus / half == pytest.approx(STIFFNESS, rel=1e-5), name


def test_a_can_on_the_ground_of_exported_mjcf_comes_to_rest(tmp_path: Path) -> None:
    """Its bottom is flat to a micrometre, as that of a scan. On a plane it trembles for good, at .1 mrad/s: MuJoCo
    changes between corners."""
    turns, noise = 2 * np.pi * np.arange(16) / 16, np.random.default_rng(1).normal(size=16)
    bottom = np.column_stack([0.02 * np.cos(turns), 0.02 * np.sin(turns), 1e-6 * noise])
    can = ConvexPart.hull_of(np.concatenate([bottom, bottom * [1.5, 1.5, 0] + [0, 0, 0.1]]))
    mesh = Mesh(vertices=can.vertices, faces=can.faces)
    o = replace(box(0), mesh=mesh, parts=(can,), T_world_object=pose(t=[0, 0, DEFAULT_MARGIN.clearance]))
    package = read_package(write_package(scene_of(o), tmp_path / "can"))
    out = export_package(package, tmp_path / "out", ["mjcf"])
    model = mujoco.MjModel.from_xml_path(str(out / "mjcf/scene.xml"))
    data = mujoco.MjData(model)
    velocities = np.empty((1000, 6))
    for row in velocities:
        mujoco.mj_step(model, data)
        row[:] = data.qvel
    assert np.abs(velocities[500:]).mean() < 1e-6
    assert data.body("box_00").xpos[2] == pytest.approx(DEFAULT_MARGIN.clearance, abs=1e-4)


def test_what_leans_in_the_scene_stands_alone_at_rest(package: Package, exported: Path) -> None:
    """Its pose is turned no further than to the nearest side that carries it."""
    for name, record in records(package).items():
        if record.mobility == "fixed":
            continue
        model = mujoco.MjModel.from_xml_path(str(exported / "mjcf" / name / "scene.xml"))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        at, R = data.body(name).xpos.copy(), data.body(name).xmat.reshape(3, 3).copy()
        leaning = np.array(record.T_world_object)[:3, :3]
        assert rotation_angle(leaning.T @ R) <= np.arccos(1 / np.sqrt(3)) + 1e-6, "no box is further from a side"
        mujoco.mj_step(model, data, nstep=1000)
        assert np.linalg.norm(data.body(name).xpos - at) < 1e-4
        assert rotation_angle(R.T @ data.body(name).xmat.reshape(3, 3)) < 1e-3


def test_the_flat_on_which_a_body_stands_is_plane() -> None:
    """Beside it lies a larger one that leans by .4 degrees. A corner of that is 12 micrometres behind it, so both flats
    cannot have their shared corners as engines want them."""

    def right(x: float, y: float, up: float = 0.0) -> list[float]:
        return [x, y, (x - 0.02) * np.tan(np.radians(0.4)) + up]

    below = [[x, y, 0.0] for x in (-0.04, 0.02) for y in (-0.02, 0.02)]
    beside = [right(0.09, -0.02), right(0.09, 0.02), right(0.055, 0.022, 1.2e-5), right(0.055, -0.022)]
    above = [[x, y, 0.06] for x in (-0.04, 0.0) for y in (-0.02, 0.02)]
    part = ConvexPart.hull_of(np.array(below + beside + above))
    assert np.ptp(np.sort(grown(part, DEFAULT_MARGIN.body).vertices[:, 2])[:4]) > 5e-6, "else this shows nothing"
    o = replace(box(0), mesh=Mesh(vertices=part.vertices, faces=part.faces), parts=(part,), T_world_object=np.eye(4))
    (alone,) = ExportedScene.of(scene_of(o)).objects
    lowest = np.sort(alone.colliders[0].vertices[:, 2])[:4]
    assert np.allclose(lowest, -DEFAULT_MARGIN.body, rtol=0, atol=1e-9)


# --- the first sight --------------------------------------------------------------------------------------------


def test_the_keyframe_is_the_package(package: Package) -> None:
    model = mujoco.MjModel.from_xml_path(str(package.folder / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("rest").id)
    mujoco.mj_forward(model, data)
    for name, record in records(package).items():
        assert np.allclose(data.body(name).xpos, np.array(record.T_world_object)[:3, 3], atol=1e-12)


def test_the_viewer_sees_all_objects(package: Package) -> None:
    """MuJoCo's free camera stands 1.5 extents away and sees 45 degrees of it."""
    model = mujoco.MjModel.from_xml_path(str(package.folder / "scene.xml"))
    reach = np.sin(np.radians(model.vis.global_.fovy / 2)) * 1.5 * model.stat.extent
    corners = np.concatenate([o.vertices_world for o in package.scene])
    away = np.linalg.norm(corners - model.stat.center, axis=1).max()
    assert away <= reach * (1 + 1e-6) and away > 0.3 * reach, "all of it, and no speck"
    a, e = np.radians([model.vis.global_.azimuth, model.vis.global_.elevation])
    forward = package.scene.camera.T_world_camera[:3, 2]
    assert np.allclose([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], forward)
    assert model.vis.global_.offwidth >= package.scene.camera.width


def test_the_camera_is_the_photo_s(package: Package) -> None:
    """Points are where the photo has them in the window that MuJoCo's renderer gets."""
    model = mujoco.MjModel.from_xml_path(str(package.folder / "scene.xml"))
    camera, k = package.scene.camera, model.cam("photo").id
    data, shown, view = mujoco.MjData(model), mujoco.MjvScene(model, maxgeom=100), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, k
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_ALL, shown)
    window = shown.camera[0]
    left, right = window.frustum_center - window.frustum_width, window.frustum_center + window.frustum_width
    left, right, bottom, top = np.array([left, right, window.frustum_bottom, window.frustum_top]) / window.frustum_near
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3)) + np.array([0, 0, 0.1])
    seen = (points - data.cam_xpos[k]) @ data.cam_xmat[k].reshape(3, 3)
    x, y = seen[:, 0] / -seen[:, 2], seen[:, 1] / -seen[:, 2]
    pixels = np.column_stack([camera.width * (x - left) / (right - left), camera.height * (top - y) / (top - bottom)])
    assert np.allclose(pixels, camera.project(points)[0], atol=1e-3)


def test_the_glb_has_smooth_normals_with_sharp_edges(package: Package, exported: Path) -> None:
    loaded = trimesh.load_scene(exported / "glb/scene.glb", process=False)
    for o in package.scene:
        mesh = loaded.geometry[next(name for name in loaded.geometry if name.startswith(f"object_{o.id:02d}"))]
        normals = np.asarray(mesh.vertex_normals)[mesh.faces]
        assert np.allclose(normals, corner_normals(o.mesh), atol=2e-3)


def test_a_round_mesh_keeps_its_vertices_in_the_glb() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3)
    mesh = Mesh(vertices=np.array(ball.vertices), faces=np.array(ball.faces, np.int32))
    split, normals = with_normals(mesh)
    assert len(split.vertices) == len(mesh.vertices) and np.allclose(normals, split.vertices, atol=0.03)
    assert np.array_equal(split.vertices[split.faces], mesh.vertices[mesh.faces])
    flat = Mesh(vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 2]], np.int32))
    assert np.array_equal(with_normals(flat)[1], np.tile([0, 0, 1], (3, 1)))


@pytest.mark.parametrize("offset", [(0, 0), (9, -4)])
def test_the_glb_s_camera_is_the_photo_s(package: Package, tmp_path: Path, offset: tuple[float, float]) -> None:
    """Read by the importer of other programs' files."""
    camera = package.scene.camera
    K = camera.K.copy()
    K[:2, 2] = np.array([camera.width, camera.height]) / 2 + offset
    given = replace(camera, K=K)
    (tmp_path / "scene.glb").write_bytes(scene_to_glb(replace(package.scene, camera=given)))
    (found,) = read_glb_scene(tmp_path / "scene.glb").cameras
    fy = given.height / 2 / np.tan(found.yfov / 2)
    assert found.aspect is not None
    fx = fy * given.width / given.height / found.aspect
    lens = np.array([[fx, 0, given.width / 2], [0, fy, given.height / 2], [0, 0, 1]])
    seen = replace(given, K=lens, T_world_camera=np.linalg.inv(T_YUP_ZUP) @ found.T_file_camera @ T_CAMERA_GLTF)
    corners = np.concatenate([box_corners(o.bounds_world) for o in package.scene])
    off = np.linalg.norm(seen.project(corners)[0] - given.project(corners)[0], axis=1).max()
    node = json_of(tmp_path / "scene.glb")["nodes"][-1]["extras"]
    assert off <= node["farthest_from_the_photo_px"] + 1e-6 and (off < 1e-6) == (offset == (0, 0))
    exact = replace(given, K=np.array(node["K"]), T_world_camera=np.linalg.inv(T_YUP_ZUP) @ node["T_gltf_camera"])
    assert np.allclose(exact.project(corners)[0], given.project(corners)[0])


def test_the_khronos_validator_has_no_finding(exported: Path) -> None:
    """It runs where its npm package is: GLTF_VALIDATOR names the folder that holds node_modules."""
    place = os.environ.get("GLTF_VALIDATOR")
    if not place or shutil.which("node") is None:
        pytest.skip("npm's gltf-validator is not installed, or GLTF_VALIDATOR does not name its folder")
    told = subprocess.run(
        ["node", "-e", VALIDATE, exported / "glb/scene.glb"], cwd=place, capture_output=True, text=True, check=True
    )
    assert json.loads(told.stdout) == []


VALIDATE = """
require("gltf-validator").validateBytes(new Uint8Array(require("fs").readFileSync(process.argv[1])))
  .then(report => console.log(JSON.stringify(report.issues.messages.filter(m => m.severity < 2))))
"""


def json_of(glb: Path) -> dict[str, Any]:
    data = glb.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_robosuite_objects_say_what_scene_json_says(package: Package, exported: Path) -> None:
    for o in ExportedScene.of(package.scene).objects:
        file = exported / "robosuite_objects" / o.name / "model.xml"
        model = mujoco.MjModel.from_xml_path(str(file))
        body = model.body("object").id
        record = records(package)[o.name]
        assert model.body_mass[body] == pytest.approx(record.mass, rel=1e-12)
        assert np.allclose(np.sort(model.body_inertia[body]), o.principal_inertia[0], rtol=1e-9)
        groups = [
            (model.geom(k).name, int(model.geom_group[k]), bool(model.geom_contype[k])) for k in range(model.ngeom)
        ]
        touching = [name for name, _, touches in groups if touches]
        assert len(touching) == len(o.body.parts) and all(group == (not touches) for _, group, touches in groups)
        assert all(g.get("group") for g in ET.parse(file).iter("geom")), "robosuite reads it from every geom"


def test_robosuite_objects_rest_on_their_bottom_site(package: Package, exported: Path) -> None:
    """Turned about z as samplers turn them; the sites and the region are the box around all that touches."""
    for o in ExportedScene.of(package.scene).objects:
        spec = mujoco.MjSpec.from_file(str(exported / "robosuite_objects" / o.name / "model.xml"))
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
        outer = spec.body("object").parent
        bottom, top, radius = (spec.site(f"{n}_site").pos for n in ("bottom", "top", "horizontal_radius"))
        outer.add_freejoint()
        outer.pos, outer.quat = -np.array(bottom), [np.cos(0.3), 0, 0, np.sin(0.3)]
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        corners = np.concatenate([transform(T_of(data, k), mesh_of(model, k)) for k in touching(model)])
        assert corners[:, 2].min() == pytest.approx(0, abs=1e-6)
        assert corners[:, 2].max() <= top[2] - bottom[2] + 1e-6
        assert np.linalg.norm(corners[:, :2], axis=1).max() <= radius[0] + 1e-6 == radius[1] + 1e-6
        region = model.geom("reg_bbox")
        assert np.allclose([region.size[2], -region.size[2]], [top[2], bottom[2]])
        start = data.qpos.copy()
        for _ in range(1000):
            mujoco.mj_step(model, data)
        assert np.abs(data.qpos - start).max() < 1e-3, o.name


def touching(model: Any) -> list[int]:
    """Mesh geoms that touch."""
    return [k for k in range(model.ngeom) if model.geom_contype[k] and model.geom_dataid[k] >= 0]


def mesh_of(model: Any, geom: int) -> Array:
    mesh = model.geom_dataid[geom]
    start = model.mesh_vertadr[mesh]
    return np.asarray(model.mesh_vert[start : start + model.mesh_vertnum[mesh]], float)


def T_of(data: Any, geom: int) -> Array:
    return pose(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])


LOAD = """
import sys
import mujoco, numpy as np
from robosuite.models.arenas import TableArena
from robosuite.models.objects import MujocoXMLObject
from robosuite.models.tasks import Task
from robosuite.utils.placement_samplers import UniformRandomSampler
for file in sys.argv[1:]:
    thing = MujocoXMLObject(file, name="thing", duplicate_collision_geoms=False)
    arena = TableArena()
    arena.set_origin([0, 0, 0])
    sampler = UniformRandomSampler(
        "places", [thing], [-.3, .3], [-.3, .3], None, reference_pos=(0, 0, 0.8), rng=np.random.default_rng(0)
    )
    model = Task(arena, [], [thing]).get_model()
    data = mujoco.MjData(model)
    at = model.joint("thing_joint0").qposadr[0]
    data.qpos[at : at + 7] = np.concatenate(sampler.sample()["thing"][:2])
    start = data.qpos.copy()
    for _ in range(1000):
        mujoco.mj_step(model, data)
    print(float(np.abs(data.qpos - start).max()))
"""


def test_robosuite_loads_and_places_its_objects(exported: Path) -> None:
    """In an environment of its own: ROBOSUITE_PYTHON names its Python."""
    python = os.environ.get("ROBOSUITE_PYTHON")
    if not python:
        pytest.skip("ROBOSUITE_PYTHON does not name a Python with robosuite")
    files = sorted((exported / "robosuite_objects").glob("*/model.xml"))
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    told = subprocess.run([python, "-c", LOAD, *files], env=environment, capture_output=True, text=True, check=True)
    assert len(files) == 3 and all(float(line) < 1e-3 for line in told.stdout.splitlines()[-3:])


def test_a_thumbnail_holds_all_of_the_object(package: Package) -> None:
    for o in package.scene:
        picture = thumbnail(o, package.scene.camera)
        assert picture.shape == (SIDE, SIDE, 3)
        drawn = (np.abs(picture.astype(int) - 235) > 12).any(2)
        assert not (drawn[0].any() or drawn[-1].any() or drawn[:, 0].any() or drawn[:, -1].any())
        rows, columns = np.flatnonzero(drawn.any(1)), np.flatnonzero(drawn.any(0))
        assert max(np.ptp(rows), np.ptp(columns)) > 0.6 * SIDE, "and is not small"


# --- the folder -------------------------------------------------------------------------------------------------


def test_equal_packages_give_equal_bytes(package: Package, exported: Path, tmp_path: Path) -> None:
    again = export_package(read_package(package.folder), tmp_path / "again", FORMATS)
    assert tree(again) == tree(exported)


def test_an_export_is_replaced_only_when_told(package: Package, tmp_path: Path) -> None:
    out = export_package(package, tmp_path / "out", ["urdf", "glb"])
    with pytest.raises(OutputError, match="only with --overwrite"):
        export_package(package, out, ["urdf"])
    assert (out / "glb").exists()
    export_package(package, out, ["urdf"], overwrite=True)
    assert sorted(p.name for p in out.iterdir()) == ["export.json", "urdf"]
    (out / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt, which f3sr did not write"):
        export_package(package, out, ["urdf"], overwrite=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other/x").write_text("mine")
    with pytest.raises(OutputError, match="no f3sr export"):
        export_package(package, tmp_path / "other", ["urdf"], overwrite=True)
    with pytest.raises(OutputError, match="inside the package"):
        export_package(package, package.folder / "export", ["urdf"])


@pytest.mark.parametrize("index", ["[]", "{", '{"kind": "f3sr export"}', '{"kind": "f3sr export", "formats": "urdf"}'])
def test_what_only_looks_like_an_export_stays(index: str, package: Package, tmp_path: Path) -> None:
    (tmp_path / "export.json").write_text(index)
    with pytest.raises(OutputError, match="no f3sr export"):
        export_package(package, tmp_path, ["urdf"], overwrite=True)


def test_unknown_formats_and_missing_libraries_are_told_first(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="formats: found fbx; accepted: glb, mjcf, robosuite, sdf, urdf, usd"):
        exporters_of(["urdf", "fbx"])
    with pytest.raises(InputError, match="found none"):
        exporters_of([])
    monkeypatch.setattr("f3sr.exporters.usd.find_spec", lambda name: None)
    with pytest.raises(F3srError, match=r"usd needs package usd-core.*pip install 'f3sr\[usd\]'"):
        exporters_of(["usd"])


def test_an_unknown_format_is_told_by_the_option_that_names_it(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command, option in (("export", "--format"), ("reconstruct", "--export")):
        assert main([command, str(package.folder), "-o", str(tmp_path / "out"), option, "glb,fbx"]) == 2
        told = capsys.readouterr().err
        assert told.startswith(f"f3sr: {option}: found fbx; accepted: glb, mjcf") and told.count("\n") == 1
    assert not list(tmp_path.iterdir())


FOREIGN = """
    class Bad:
        name = "bad"

        def files(self, exported):
            yield "fine.txt", b"1"
            yield {path!r}, b"2"
"""


@pytest.mark.parametrize("path", ["../x", "/etc/x", "a/../../x", "a\\x", "fine.txt", "", "./x", "x\0"])
def test_exporters_of_others_write_inside_their_folder(
    path: str, package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = {"f3sr.exporter": {"bad": "foreign_bad:Bad"}}
    install(tmp_path / "site", monkeypatch, module="foreign_bad", source=FOREIGN.format(path=path), points=points)
    monkeypatch.delitem(__import__("sys").modules, "foreign_bad", raising=False)
    with pytest.raises(F3srError, match="yields the path"):
        export_package(package, tmp_path / "out", ["bad"])
    assert not (tmp_path / "out").exists()


def test_the_date_is_the_file_s_or_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "x"
    file.write_text("")
    os.utime(file, (86_400 * 365, 86_400 * 365))
    assert date_of(file) == "1971-01-01"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert date_of(file) == "1970-01-01"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    assert date_of(file) == "1971-01-01"


def test_the_command_writes_beside_the_package(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = write_package(package.scene, tmp_path / "table")
    command = ["export", str(copy), "--format", "urdf", "--json"]
    assert main(command) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"folder": str(tmp_path / "table_export"), "formats": ["urdf"]}
    assert (tmp_path / "table_export/urdf/red_mug_00/red_mug_00.urdf").exists()
    assert main(command) == 1 and "--overwrite" in capsys.readouterr().err


# --- helpers ----------------------------------------------------------------------------------------------------

KINDS = ("visual", "collision")


def assert_inertial(link: ET.Element, record: Any) -> None:
    inertial = link.find("inertial")
    assert inertial is not None
    mass, inertia, origin = (inertial.find(tag) for tag in ("mass", "inertia", "origin"))
    assert mass is not None and inertia is not None and origin is not None
    assert float(mass.get("value", "")) == record.mass
    assert np.array_equal(inertia_matrix({k: float(v) for k, v in inertia.items()}), record.inertia)
    assert floats(origin.get("xyz", "")) == list(record.center_of_mass)


def assert_meshes(folder: Path, shapes: dict[str, list[str]], o: Any, *, hull_unit: float = 1.0) -> None:
    """Visual meshes together are the object's surface; every convex part is one of its own, and holds no other."""
    loaded: Any = [trimesh.load_mesh(folder / path, process=False) for path in shapes["visual"]]
    faces = np.concatenate([m.triangles for m in loaded])
    wanted = (o.scale * o.mesh.vertices)[o.mesh.faces]
    assert np.allclose(np.sort(faces.reshape(-1, 9), 0), np.sort(wanted.reshape(-1, 9), 0), atol=1e-9)
    textured = o.mesh.materials[0].texture is not None
    assert textured == all((folder / path).with_suffix(".png").exists() for path in shapes["visual"])
    scale = np.diag([o.scale, o.scale, o.scale, 1.0])
    for path, part in zip(shapes["collision"], o.solids, strict=True):
        hull: Any = trimesh.load_mesh(folder / path, process=False)
        wanted = grown(part.moved(scale), DEFAULT_MARGIN.body)
        volume = hull.volume * hull_unit**3
        assert hull.is_watertight and volume == pytest.approx(wanted.volume, rel=1e-5)
        assert volume > part.volume * o.scale**3


def inertia_matrix(named: dict[str, float]) -> Array:
    x, y, z = (np.array([named[f"i{''.join(sorted(a + b))}"] for b in "xyz"]) for a in "xyz")
    return np.stack([x, y, z])


def floats(text: str) -> list[float]:
    return [float(v) for v in text.split()]


def from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    z, y, x = (rotation_about(axis, angle) for axis, angle in zip(np.eye(3)[::-1], (yaw, pitch, roll), strict=True))
    return z @ y @ x


def matrix_of(quaternion: Array) -> Array:
    out = np.empty(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)
