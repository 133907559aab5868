"""USD: OpenUSD reads what scene.json says, its validators find nothing, and NVIDIA's accepts the props."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr.core.mesh import Material
from f3sr.core.transforms import Array, rotation_from_quaternion, transform
from f3sr.exporters.export_names import export_name
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.grown_hulls import grown
from f3sr.exporters.usd import Usd
from f3sr.exporters.usd_variants import RUNTIMES
from f3sr.exporters.wikidata_classes import PHYSICAL_OBJECT, class_of
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import Scene
from f3sr.scene_export import export_package
from f3sr.scene_package.package import Package, read_package, write_package
from labelled_boxes import labelled_boxes
from scenes import box, box_mesh, scene_of

pytest.importorskip("pxr", reason="usd-core is not installed")
from pxr import Gf, UsdGeom, UsdPhysics, UsdSemantics, UsdShade
from pxr import Usd as UsdCore

VALIDATOR = shutil.which("simready-validate")


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return read_package(write_package(labelled_boxes(), tmp_path_factory.mktemp("usd") / "table"))


@pytest.fixture(scope="module")
def folder(package: Package, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_package(package, tmp_path_factory.mktemp("usd_export") / "out", ["usd"]) / "usd"


@pytest.fixture(scope="module")
def stage(folder: Path) -> Any:
    return UsdCore.Stage.Open(str(folder / "scene.usda"))


def prim_of(stage: Any, record: Any) -> Any:
    return stage.GetPrimAtPath(f"/scene/objects/{export_name(record.id, record.label)}")


def to_world(prim: Any) -> Array:
    """(4, 4), for columns; USD's matrices are for rows."""
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(UsdCore.TimeCode.Default())).T


def meshes(prim: Any, part: str) -> list[Any]:
    return [UsdGeom.Mesh(p) for p in prim.GetChild(part).GetChildren()]


# --- one truth --------------------------------------------------------------------------------------------------


def test_bodies_are_those_of_scene_json(package: Package, stage: Any) -> None:
    for record in package.document.objects:
        prim = prim_of(stage, record)
        assert np.allclose(to_world(prim), record.T_world_object, atol=1e-12)
        mass = UsdPhysics.MassAPI(prim)
        assert mass.GetMassAttr().Get() == pytest.approx(record.mass, rel=1e-6)
        assert np.allclose(mass.GetCenterOfMassAttr().Get(), record.center_of_mass, atol=1e-8)
        axes = mass.GetPrincipalAxesAttr().Get()
        R = rotation_from_quaternion(np.array([axes.GetReal(), *axes.GetImaginary()]))
        inertia = R @ np.diag(np.array(mass.GetDiagonalInertiaAttr().Get(), float)) @ R.T
        assert np.allclose(inertia, record.inertia, rtol=0, atol=1e-5 * np.abs(record.inertia).max())
        assert prim.HasAPI(UsdPhysics.RigidBodyAPI)
        enabled = UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get()
        assert enabled == (record.mobility == "dynamic")


def test_hulls_and_surfaces_are_those_of_the_package(package: Package, stage: Any) -> None:
    for record in package.document.objects:
        o, prim = package.scene[record.id], prim_of(stage, record)
        hulls = meshes(prim, "colliders")
        assert len(hulls) == len(record.collision)
        for hull, part in zip(hulls, o.solids, strict=True):
            wanted = grown(part, DEFAULT_MARGIN.body)
            assert np.allclose(hull.GetPointsAttr().Get()[::-1], wanted.vertices, atol=1e-7)
            assert hull.GetPurposeAttr().Get() == "guide"
            assert UsdPhysics.MeshCollisionAPI(hull.GetPrim()).GetApproximationAttr().Get() == "convexHull"
            binding = UsdShade.MaterialBindingAPI(hull.GetPrim())
            contact = UsdPhysics.MaterialAPI(binding.ComputeBoundMaterial("physics")[0].GetPrim())
            assert contact.GetDynamicFrictionAttr().Get() == pytest.approx(record.friction)
            assert contact.GetRestitutionAttr().Get() == pytest.approx(record.restitution)
        (visual,) = meshes(prim, "geometry")
        assert np.allclose(visual.GetPointsAttr().Get(), o.mesh.vertices, atol=1e-7)
        assert np.array_equal(np.reshape(visual.GetFaceVertexIndicesAttr().Get(), (-1, 3)), o.mesh.faces)


def test_normals_are_unit_and_outward(package: Package, stage: Any) -> None:
    for record in package.document.objects:
        for mesh in (*meshes(prim_of(stage, record), "geometry"), *meshes(prim_of(stage, record), "colliders")):
            normals = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals").ComputeFlattened())
            triangles = np.array(mesh.GetPointsAttr().Get())[np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3))]
            outward = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
            per_face = normals.reshape(len(triangles), -1, 3)
            assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
            assert (np.einsum("fij,fj->fi", per_face, outward) > 0).all()


def test_what_carries_an_object_is_a_relationship(package: Package, stage: Any) -> None:
    names = {-1: "/scene/ground"}
    names |= {r.id: f"/scene/objects/{export_name(r.id, r.label)}" for r in package.document.objects}
    for record in package.document.objects:
        prim = prim_of(stage, record)
        targets = prim.GetRelationship("f3sr:restsOn").GetTargets()
        assert [str(t) for t in targets] == [names[s.id] for s in record.supports]
        assert np.allclose(prim.GetAttribute("f3sr:restsOnShares").Get(), [s.share for s in record.supports])
        assert prim.GetAttribute("f3sr:id").Get() == record.id
        assert all(stage.GetPrimAtPath(t) for t in targets)


# --- the picture ------------------------------------------------------------------------------------------------


def test_the_camera_is_the_photo_s(package: Package, stage: Any) -> None:
    camera = package.scene.camera
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/scene/photo_camera")).GetCamera().frustum
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3)) + np.array([0, 0, 0.1])
    to_clip = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    clip = np.array([to_clip.Transform(Gf.Vec3d(*map(float, p))) for p in points])
    pixels = np.column_stack([camera.width * (1 + clip[:, 0]) / 2, camera.height * (1 - clip[:, 1]) / 2])
    assert np.allclose(pixels, camera.project(points)[0], atol=1e-3)


def test_the_backplate_fills_the_picture_behind_everything(package: Package, stage: Any) -> None:
    camera = package.scene.camera
    quad = UsdGeom.Mesh(stage.GetPrimAtPath("/scene/photo_camera/backplate"))
    corners = transform(to_world(quad.GetPrim()), np.array(quad.GetPointsAttr().Get(), float))
    pixels, depth = camera.project(corners)
    st = np.array(UsdGeom.PrimvarsAPI(quad).GetPrimvar("st").Get())
    assert np.allclose(pixels, st * [camera.width, -camera.height] + [0, camera.height], atol=1e-3)
    assert depth.min() > max(camera.to_camera(o.vertices_world)[:, 2].max() for o in package.scene)
    variants = quad.GetPrim().GetVariantSets().GetVariantSet("picture")
    assert sorted(variants.GetVariantNames()) == ["none", "photo"] and variants.GetVariantSelection() == "photo"


def test_a_completed_photo_is_the_backplate(package: Package) -> None:
    rgb = package.scene.photo.rgb
    files = dict(Usd().files(ExportedScene.of(package.scene, background=255 - rgb)))
    layer = files["scene.usda"].decode()
    assert 'string picture = "background"' in layer and "@./textures/background.png@" in layer
    assert files["textures/background.png"] != files["textures/photo.png"]


def test_colours_of_vertices_are_shown(tmp_path: Path) -> None:
    """A mesh without a texture gets one of the colours of its vertices, one without them its base colour."""
    colors = np.random.default_rng(0).integers(0, 256, (8, 3), np.uint8)
    painted = replace(box(0), mesh=replace(box_mesh(), vertex_colors=colors))
    plain = replace(box(1), mesh=replace(box_mesh(), materials=(Material(base_color=(1.0, 0.5, 0.0)),)))
    stage = opened(scene_of(painted, plain), tmp_path)
    inputs = []
    for name in ("box_00", "box_01"):
        (mesh,) = meshes(stage.GetPrimAtPath(f"/scene/objects/{name}"), "geometry")
        material = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()[0]
        inputs.append((material.ComputeSurfaceSource()[0].GetInput("diffuseColor"), mesh))
    source = UsdShade.Shader(inputs[0][0].GetConnectedSources()[0][0].source.GetPrim())
    with Image.open(source.GetInput("file").Get().resolvedPath) as file:
        texture = np.asarray(file.convert("RGB"))
    st = np.array(UsdGeom.PrimvarsAPI(inputs[0][1]).GetPrimvar("st").Get())
    height, width = texture.shape[:2]
    at = (st * [width, -height] + [0, height] - 0.5).round().astype(int)
    seen = texture[at[:, 1], at[:, 0]].astype(int)
    points = np.array(inputs[0][1].GetPointsAttr().Get())
    vertex = np.argmin(np.linalg.norm(points[:, None] - painted.mesh.vertices[None], axis=2), axis=1)
    assert np.abs(seen - colors[vertex]).max() <= 2
    assert np.allclose(inputs[1][0].Get(), [1, 0.2140, 0], atol=1e-4)


def test_faces_without_area_are_left_out(tmp_path: Path) -> None:
    mesh = box_mesh()
    mesh = replace(mesh, faces=np.concatenate([mesh.faces, [[0, 0, 1]]]), face_material=np.zeros(13, np.int32))
    stage = opened(scene_of(replace(box(0), mesh=mesh)), tmp_path)
    (visual,) = meshes(stage.GetPrimAtPath("/scene/objects/box_00"), "geometry")
    assert len(visual.GetFaceVertexCountsAttr().Get()) == 12


# --- engines ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_a_variant_adds_one_engine_s_schemas(runtime: str, package: Package, folder: Path) -> None:
    prefixes = {"PhysX": "Physx", "Newton": "Newton", "MuJoCo": "Mjc"}
    record = package.document.objects[1]
    name = export_name(record.id, record.label)
    stage = UsdCore.Stage.Open(str(folder / f"{name}/simready_usd/{name}.usda"))
    stage.SetEditTarget(stage.GetSessionLayer())  # OpenUSD shares layers among stages
    root = stage.GetDefaultPrim()
    paths = ("colliders/hull_000", "materials/contact")

    def foreign() -> set[str]:
        applied = [s for p in paths for s in schemas(root.GetPrimAtPath(p))]
        return {prefix for prefix in prefixes.values() if any(s.startswith(prefix) for s in applied)}

    assert sorted(root.GetVariantSets().GetNames()) == sorted(RUNTIMES) and not foreign()
    root.GetVariantSets().GetVariantSet(runtime).SetVariantSelection("Enabled")
    assert foreign() == {prefixes[runtime]}
    contact, hull = (root.GetPrimAtPath(p) for p in reversed(paths))
    told = {
        "PhysX": (contact, "physxMaterial:frictionCombineMode", "max"),
        "Newton": (contact, "newton:rollingFriction", record.rolling_friction),
        "MuJoCo": (contact, "mjc:rollingfriction", record.rolling_friction),
    }
    prim, attribute, value = told[runtime]
    found = prim.GetAttribute(attribute).Get()
    assert found == (value if isinstance(value, str) else pytest.approx(value))
    assert "PhysicsCollisionAPI" in schemas(hull), "beside what the prop has"


def schemas(prim: Any) -> list[str]:
    """All that are applied, known to OpenUSD or not."""
    return list(prim.GetMetadata("apiSchemas").GetAppliedItems())


# --- labels -----------------------------------------------------------------------------------------------------


def test_labels_are_kept_as_text(package: Package, stage: Any) -> None:
    for record in package.document.objects:
        prim = prim_of(stage, record)
        assert prim.GetAttribute("f3sr:label").Get() == record.label
        labels = UsdSemantics.LabelsAPI(prim, "class").GetLabelsAttr().Get()
        assert list(labels) == [record.label or "object"]


@pytest.mark.parametrize("label", ['"""', "a\n\0b", "\u202ex", "@x@", "</scene>", "'" * 300, "日本"])
def test_hostile_labels_leave_a_layer_that_opens(label: str, tmp_path: Path) -> None:
    stage = opened(scene_of(box(3, label=label, textured=True)), tmp_path)
    (prim,) = stage.GetPrimAtPath("/scene/objects").GetChildren()
    assert prim.GetName().endswith("_03") and prim.HasAPI(UsdPhysics.RigidBodyAPI)


def test_a_label_keeps_the_spaces_of_its_script(tmp_path: Path) -> None:
    stage = opened(scene_of(box(3, label="赤い\u3000マグ\xa0x", textured=True)), tmp_path)
    (prim,) = stage.GetPrimAtPath("/scene/objects").GetChildren()
    assert prim.GetAttribute("f3sr:label").Get() == "赤い\u3000マグ\xa0x"


def test_classes_are_codes_of_wikidata() -> None:
    assert class_of("red  Book") == "Q571" and class_of("") == class_of("gizmo") == PHYSICAL_OBJECT


# --- the judges -------------------------------------------------------------------------------------------------


def test_openusd_finds_no_fault(folder: Path, package: Package) -> None:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) >= 10
    for file in (folder / "scene.usda", *folder.glob("*/simready_usd/*.usda")):
        errors = UsdValidation.ValidationContext(validators).Validate(UsdCore.Stage.Open(str(file)))
        assert not [f"{file.name}: {e.GetMessage()}" for e in errors]


@pytest.mark.skipif(VALIDATOR is None, reason="NVIDIA's simready-validate is not on the path")
def test_nvidia_s_validator_passes_every_prop(folder: Path, tmp_path: Path) -> None:
    assets = sorted(folder.glob("*/simready_usd/*.usda"))
    (tmp_path / "assets.txt").write_text("\n".join(map(str, assets)))
    options = ["--profile", "Robotics-Prop", "--version", "4.0.0", "--asset_list", str(tmp_path / "assets.txt")]
    command = [str(VALIDATOR), *options, "--output", str(tmp_path / "out.json")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, env={"PATH": "/usr/bin"})
    assert done.stdout.count("[PASSED] Robotics-Prop v4.0.0") == len(assets) == 3, done.stdout


def test_equal_scenes_give_equal_bytes(package: Package) -> None:
    first, again = (dict(Usd().files(ExportedScene.of(package.scene, date="2026-01-01"))) for _ in range(2))
    assert first == again and len(first) == 1 + 1 + 3 * (1 + 1 + 3) + 2


def test_a_prop_tells_what_it_is(folder: Path, package: Package) -> None:
    for record in package.document.objects:
        name = export_name(record.id, record.label)
        stage = UsdCore.Stage.Open(str(folder / f"{name}/simready_usd/{name}.usda"))
        told = stage.GetRootLayer().customLayerData
        assert told["f3sr"]["id"] == str(record.id) and told["f3sr"]["density"] == record.density
        simready = told["SimReady_Metadata"]
        assert simready["asset_name"] == name and simready["source_file"] == record.mesh
        assert simready["mass"] == pytest.approx(record.mass)
        size = np.ptp(package.scene[record.id].mesh.bounds, axis=0)
        assert np.allclose(simready["asset_extents"], size)
        assert len(simready["usd_date_generated"]) == len("2026-01-01")
        assert json.loads(json.dumps(dict(told["f3sr"])))


def opened(scene: Scene, place: Path) -> Any:
    for name, data in files_of(scene):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(data)
    return UsdCore.Stage.Open(str(place / "scene.usda"))


def files_of(scene: Scene) -> Iterator[tuple[str, bytes]]:
    return Usd().files(ExportedScene.of(scene))
