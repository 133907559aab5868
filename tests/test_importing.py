"""Scenes of other programs: a session of Fysiverse-3D, whole and broken in many ways."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr.cli.main import main
from f3sr.core.camera import Camera
from f3sr.core.transforms import quaternion_from_rotation, transform
from f3sr.errors import InputError, OutputError
from f3sr.importing import fysiverse
from f3sr.importing.composition import drawn
from f3sr.importing.import_source import ImportSource
from f3sr.importing.imported_folder import NOTE, write_imported
from f3sr.io import inputs
from f3sr.io.mesh_files import save_glb
from f3sr.io.pose_conventions import CAMERAS
from f3sr.io.sam3d import LOCAL_FROM_GLB
from f3sr.scene import SceneObject
from f3sr.stages.assemble import as_given
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import iou
from folders import boxes, camera

NAME = "20260101_000000_abcdef01"


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return write_session(tmp_path / "sessions" / NAME, boxes(), camera())


def write_session(place: Path, objects: list[SceneObject], seen: Camera) -> Path:
    """A session as the program leaves it: Y-up GLBs in the settled world, a camera that looks along its -Z."""
    for folder in ("input", "results/3dgs_bg", "results/web_assets/web_objects"):
        (place / folder).mkdir(parents=True)
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 255, (seen.height, seen.width, 3), np.uint8)
    Image.fromarray(pixels).save(place / "input" / "image.png")
    listed = list[dict[str, Any]]()
    for o in objects:
        file = place / "results/web_assets/web_objects" / f"{o.id:04d}.glb"
        world = transform(o.T_world_object, o.scale * o.mesh.vertices)
        save_glb(o.mesh.with_vertices(world @ LOCAL_FROM_GLB), file)
        path = f"sessions/{place.name}/results/web_assets/web_objects/{file.name}"
        listed.append({"mask_id": o.id, "semantic_label": o.label.replace(" ", "_"), "web_asset_glb": path})
    relation = {"upper_mask_id": 5, "lower_mask_id": 2, "confidence": 0.9, "reason": "seen"}
    manifest = {"objects": listed, "support": {"scene_graph_support_relations": [relation]}}
    (place / fysiverse.MANIFEST).write_text(json.dumps(manifest))
    w, x, y, z = quaternion_from_rotation(seen.T_world_camera[:3, :3] @ CAMERAS["opengl"].matrix)
    told = {
        "position": seen.center.tolist(),
        "quaternion_xyzw": [x, y, z, w],
        "intrinsics_pixels": seen.K.tolist(),
        "image_size": [seen.width, seen.height],
    }
    (place / fysiverse.CAMERA).write_text(json.dumps({"camera": told}))
    return place


def test_what_is_imported_is_the_scene_that_was_there(session: Path, tmp_path: Path):
    composition = fysiverse.read(ImportSource(path=session))
    folder = write_imported(tmp_path / "in", composition, drawn(composition))
    given = inputs.read(folder)
    scene = as_given(given)
    truth = camera()
    assert np.allclose(given.K, truth.K)
    assert [(i.id, i.label) for i in given.instances] == [(2, "big box"), (5, "small box"), (7, "tall box")]
    visible = rasterizer.visible_ids(boxes(), truth)
    for o, true in zip(scene, boxes(), strict=True):
        assert iou(o.mask, visible == o.id) == 1.0
        here, there = o.vertices_world, transform(true.T_world_object, true.mesh.vertices)
        in_camera = np.sort(scene.camera.to_camera(here), axis=0), np.sort(truth.to_camera(there), axis=0)
        assert np.allclose(*in_camera, atol=1e-5)
    ground = given.geometry.points[given.geometry.inside(given.ground_mask)]
    assert np.abs(transform(truth.T_world_camera, ground.astype(float))[:, 2]).max() < 1e-4
    assert [(r.subject, r.object) for r in given.graph.relations] == [(5, 2)]


def test_the_command_leaves_out_what_the_camera_does_not_see(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    manifest = json.loads((session / fysiverse.MANIFEST).read_text())
    far = boxes()[1].mesh.vertices + np.array([0, 500, 0])
    save_glb(boxes()[1].mesh.with_vertices(far), session / "results/web_assets/web_objects/0009.glb")
    manifest["objects"].append({"mask_id": 9, "semantic_label": "moon", "web_asset_glb":
                                f"sessions/{NAME}/results/web_assets/web_objects/0009.glb"})  # fmt: skip
    (session / fysiverse.MANIFEST).write_text(json.dumps(manifest))
    assert main(["import", str(session), "-o", str(tmp_path / "in"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["left_out"] == ["moon"]
    assert json.loads((tmp_path / "in" / NOTE).read_text())["left_out"][0]["id"] == 9
    assert main(["import", str(session), "-o", str(tmp_path / "in")]) == 0, "its own folder is replaced"
    assert len(inputs.read(tmp_path / "in").instances) == 3


def changed(name: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    def apply(session: Path) -> None:
        document = json.loads((session / name).read_text())
        change(document)
        (session / name).write_text(json.dumps(document))

    return apply


def first(**values: Any) -> Callable[[Path], None]:
    return changed(fysiverse.MANIFEST, lambda d: d["objects"][0].update(values))


def seen_by(**values: Any) -> Callable[[Path], None]:
    return changed(fysiverse.CAMERA, lambda d: d["camera"].update(values))


BROKEN: dict[str, tuple[Callable[[Path], None], str]] = {
    "no objects": (changed(fysiverse.MANIFEST, lambda d: d.update(objects=[])), "objects"),
    "two of one id": (first(mask_id=5), "two objects with one mask_id"),
    "a path out of the folder": (first(web_asset_glb="../../../etc/passwd.glb"), "leaves the folder"),
    "an absolute path": (first(web_asset_glb="/etc/passwd.glb"), "leaves the folder"),
    "a mesh that is not there": (first(web_asset_glb=f"sessions/{NAME}/results/none.glb"), "no such file"),
    "a mesh that is none": (lambda s: (s / "results/web_assets/web_objects/0002.glb").write_bytes(b"x"), "broken glTF"),
    "no camera": (lambda s: (s / fysiverse.CAMERA).unlink(), "no such file"),
    "a camera of another size": (seen_by(image_size=[10, 10]), "a camera of 10x10 pixels"),
    "no intrinsics": (seen_by(intrinsics_pixels=None), "intrinsics that are no camera's"),
    "intrinsics of two rows": (seen_by(intrinsics_pixels=[[1, 0, 0]] * 2), "intrinsics_pixels"),
    "rows of another length": (seen_by(intrinsics_pixels=[[1, 0], [0, 1], [0, 0]]), "intrinsics_pixels"),
    "ragged rows": (seen_by(intrinsics_pixels=[[1, 0, 0], [0, 1], [0, 0, 1]]), "intrinsics_pixels"),
    "intrinsics that divide by zero": (seen_by(intrinsics_pixels=[[9, 0, 0], [0, 9, 0], [0, 0, 0]]), "no camera's"),
    "no turn": (seen_by(quaternion_xyzw=[0, 0, 0, 0]), "no rotation"),
    "a camera that looks away": (seen_by(quaternion_xyzw=[0, 0, 0, 1], position=[0, 0, -5]), "no object"),
    "no photo": (lambda s: (s / "input/image.png").unlink(), "no such file"),
    "NaN": (lambda s: (s / fysiverse.CAMERA).write_text('{"camera": NaN}'), "no valid JSON"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_session_is_one_clear_error_and_nothing_is_written(name: str, session: Path, tmp_path: Path):
    spoil, told = BROKEN[name]
    spoil(session)
    with pytest.raises(InputError, match=told):
        composition = fysiverse.read(ImportSource(path=session))
        write_imported(tmp_path / "in", composition, drawn(composition))
    assert not (tmp_path / "in").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda folder: (folder / "materials.json").write_text("{}"),
            "holds materials.json, which f3sr import did not",
        ),
        (lambda folder: (folder / "masks" / "link.png").symlink_to("/dev/zero"), "holds masks/link.png"),
        (lambda folder: (folder / "image.png").write_bytes(b"mine"), "image.png was changed or removed since"),
        (lambda folder: (folder / "assets" / "poses.json").unlink(), "assets/poses.json was changed or removed since"),
    ],
)
def test_a_folder_that_was_worked_on_is_not_replaced(
    session: Path, tmp_path: Path, change: Callable[[Path], object], told: str
):
    composition = fysiverse.read(ImportSource(path=session))
    folder = write_imported(tmp_path / "in", composition, drawn(composition))
    change(folder)
    before = sorted((p, p.is_file() and not p.is_symlink() and p.read_bytes()) for p in folder.rglob("*"))
    with pytest.raises(OutputError, match=told):
        write_imported(folder, composition, drawn(composition))
    assert before == sorted((p, p.is_file() and not p.is_symlink() and p.read_bytes()) for p in folder.rglob("*"))


def test_other_folders_are_named_and_never_replaced(session: Path, tmp_path: Path):
    assert main(["import", str(tmp_path), "-o", str(tmp_path / "in")]) == 2
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    composition = fysiverse.read(ImportSource(path=session))
    with pytest.raises(OutputError, match=r"found a folder with thesis\.tex"):
        write_imported(tmp_path / "mine", composition, drawn(composition))
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "x"
