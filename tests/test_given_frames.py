"""Complaints about frames and poses of generated meshes, each as a folder that f3sr must read (docs: importing)."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.core.handedness import MIRROR
from f3sr.core.transforms import pose, quaternion_from_rotation, rotation_about, transform
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.io.inputs import Inputs
from f3sr.io.mesh_files import save_glb
from f3sr.io.photo_hints import PhotoHints
from f3sr.io.pose_conventions import (
    ALL_AXES,
    CAMERAS,
    FILE_AXES,
    SAM3D,
    PoseConvention,
    SignedAxes,
    all_conventions,
    parsed,
)
from f3sr.mesh_poses import given_frames
from f3sr.mesh_poses.camera_by_poses import camera_by_poses
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.given_frames import MaskPlacer
from f3sr.mesh_poses.reading_votes import VoteConfig
from f3sr.metrics.measures import full_silhouette
from f3sr.photo_inputs import read_inputs
from f3sr.scene import Scene, SceneObject
from f3sr.stages.assemble import as_given
from folders import HEIGHT, WIDTH, boxes, camera, write_folder
from scenes import box, box_mesh, chair

DOCS = Path(__file__).parents[1] / "docs"
THREE_JS = PoseConvention("xyzw", "column", FILE_AXES, CAMERAS["opengl"])
UNITY = PoseConvention("xyzw", "column", SignedAxes("-x+y+z"), CAMERAS["unity"])


def chairs() -> list[SceneObject]:
    """Two chairs of .2 m, turned differently, on the table."""
    mesh, found = chair(), list[SceneObject]()
    for id, (x, yaw) in enumerate([(-0.12, 0.7), (0.13, -1.1)]):
        T = pose(rotation_about([0, 0, 1], yaw), [x, 0.0, -0.2 * float(mesh.bounds[0, 2])])
        like = box(id, size=(1, 1, 1), at=(0, 0, 0), label="chair")
        found.append(replace(like, mesh=mesh, T_world_object=T, scale=0.2))
    return found


def written(folder: Path, by: PoseConvention, *, unit: float = 1.0, places: float = 1.0) -> None:
    """A folder whose poses.json follows a convention that it does not name; a file's unit is 1/``unit``."""
    things = chairs()
    write_folder(folder, objects=things)
    F, A, entries = by.camera.matrix, by.mesh.matrix, list[dict[str, object]]()
    for o, mask in zip(things, sorted(p.name for p in (folder / "masks").iterdir()), strict=True):
        T = camera().T_camera_world @ o.T_world_object
        M = MIRROR if by.camera.mirrors else np.eye(3)
        turned = F.T @ T[:3, :3] @ M
        vertices = unit * o.mesh.vertices @ M @ A
        save_glb(o.mesh.with_vertices(vertices), folder / f"assets/{o.id:02d}.glb")
        wxyz = quaternion_from_rotation(turned.T if by.vectors == "row" else turned)
        entries.append(
            {
                "mask": mask,
                "mesh": f"{o.id:02d}.glb",
                "rotation": (wxyz if by.order == "wxyz" else np.roll(wxyz, -1)).tolist(),
                "translation": (places * F.T @ T[:3, 3]).tolist(),
                "scale": [places * o.scale] * 3,
            }
        )
    (folder / "assets/poses.json").write_text(json.dumps({"objects": entries}))


def require_true(given: Inputs, *, within: float = 1e-3) -> None:
    """Every vertex where it is in truth [m]; an order of vertices survives all readings."""
    for o in chairs():
        asset = given.assets[o.id]
        found = transform(asset.T_camera_object, asset.scale * asset.mesh.vertices)
        assert np.abs(found - camera().to_camera(o.vertices_world)).max() < within


def test_a_y_up_glb_meets_a_pose_that_turns_z_up_axes(tmp_path: Path):
    written(tmp_path / "in", SAM3D)
    given = read_inputs(tmp_path / "in")
    require_true(given)
    assert any(SAM3D.name in d.choice for d in given.decisions)


def test_a_mesh_saved_without_the_swap_of_axes_is_read(tmp_path: Path):
    written(tmp_path / "in", replace(SAM3D, mesh=SignedAxes("+x+y+z")))
    require_true(read_inputs(tmp_path / "in"))


def test_rotations_of_rows_and_of_columns_are_told_apart(tmp_path: Path):
    written(tmp_path / "in", replace(SAM3D, vectors="column"))
    require_true(read_inputs(tmp_path / "in"))


def test_poses_turned_for_three_js_are_read(tmp_path: Path):
    written(tmp_path / "in", THREE_JS)
    require_true(read_inputs(tmp_path / "in"))


def test_poses_of_a_left_handed_program_are_read(tmp_path: Path):
    written(tmp_path / "in", UNITY)
    require_true(read_inputs(tmp_path / "in"))


def test_a_mirrored_file_is_turned_back(tmp_path: Path):
    written(tmp_path / "in", replace(SAM3D, mesh=SignedAxes("-x-z+y")))
    given = read_inputs(tmp_path / "in")
    require_true(given)
    assert all(asset.mesh.is_solid for asset in given.assets.values()), "triangles face outward"


@pytest.mark.parametrize("by", [replace(SAM3D, order="xyzw"), THREE_JS, UNITY], ids=["fal", "three.js", "unity"])
def test_whoever_writes_a_pose_down_gives_the_same_scene_to_the_digit(tmp_path: Path, by: PoseConvention):
    """A pile magnifies a difference in the last digit to a millimetre, so there must be none."""
    scenes = list[Scene]()
    for name, convention in (("ours", SAM3D), ("theirs", by)):
        by_program(tmp_path / name, convention)
        given = read_inputs(tmp_path / name)
        require_true(given)
        scenes.append(as_given(given))
    for ours, theirs in zip(*scenes, strict=True):
        assert ours.T_world_object.tobytes() == theirs.T_world_object.tobytes()
        assert ours.scale == theirs.scale
        assert ours.mesh.vertices.tobytes() == theirs.mesh.vertices.tobytes()
        assert np.array_equal(ours.mesh.faces, theirs.mesh.faces)


def by_program(folder: Path, by: PoseConvention) -> None:
    """The Y-up files of SAM 3D Objects, and poses as a program writes them that holds files and camera its own way."""
    written(folder, SAM3D)
    document = json.loads((folder / "assets/poses.json").read_text())
    for o, entry in zip(chairs(), document["objects"], strict=True):
        T = camera().T_camera_world @ o.T_world_object
        Q = by.camera.matrix.T @ T[:3, :3] @ SAM3D.mesh.matrix @ by.mesh.matrix.T
        wxyz = quaternion_from_rotation(Q.T if by.vectors == "row" else Q)
        entry["rotation"] = (wxyz if by.order == "wxyz" else np.roll(wxyz, -1)).tolist()
        entry["translation"] = (by.camera.matrix.T @ T[:3, 3]).tolist()
    (folder / "assets/poses.json").write_text(json.dumps(document))


@pytest.mark.parametrize("unit", [100.0, 1000.0])
def test_a_mesh_in_another_unit_than_its_place_is_scaled(tmp_path: Path, unit: float):
    written(tmp_path / "in", SAM3D, unit=unit)
    given = read_inputs(tmp_path / "in")
    require_true(given)
    assert any(f"meshes times {1 / unit:g}" in d.choice for d in given.decisions)


def test_places_in_another_unit_than_the_depth_are_scaled(tmp_path: Path):
    written(tmp_path / "in", SAM3D, places=1000.0)
    given = read_inputs(tmp_path / "in")
    require_true(given)
    assert any("millimetres" in d.reason for d in given.decisions)


@pytest.mark.parametrize("name", [*CAMERAS, "-y-x+z"])
def test_meshes_posed_in_any_camera_axes_are_read(tmp_path: Path, name: str):
    posed(tmp_path / "in", name)
    given = read_inputs(tmp_path / "in")
    require_true(given)
    assert any(name in d.choice for d in given.decisions)


def posed(folder: Path, name: str) -> None:
    write_folder(folder, objects=chairs())
    (folder / "assets/poses.json").unlink()
    F = next(a.matrix for a in ALL_AXES if a == CAMERAS.get(name, SignedAxes(name)))
    for o in chairs():
        vertices = camera().to_camera(o.vertices_world) @ F
        save_glb(o.mesh.with_vertices(vertices), folder / f"assets/{o.id:02d}.glb")


def test_a_wrong_frame_of_the_user_is_kept_and_warned_of(tmp_path: Path):
    posed(tmp_path / "in", "opencv")
    with pytest.raises(InputError, match="--asset-frame"):
        read_inputs(tmp_path / "in", asset_frame="opengl")  # behind the camera: no scene at all
    told = read_inputs(tmp_path / "in", asset_frame="-x+y+z").decisions
    assert any("looks wrong" in d.choice and "--asset-frame opencv" in d.reason for d in told)


def test_a_wrong_convention_that_poses_json_declares_is_kept_and_warned_of(tmp_path: Path):
    written(tmp_path / "in", replace(SAM3D, vectors="column"))
    file = tmp_path / "in/assets/poses.json"
    file.write_text(json.dumps({"convention": "sam-3d-objects", **json.loads(file.read_text())}))
    told = read_inputs(tmp_path / "in").decisions
    warnings = [d for d in told if "looks wrong" in d.choice]
    assert len(warnings) == 1 and "wxyz/column" in warnings[0].reason


# --- no geometry: the poses tell the camera ---------------------------------------------------------------------------


@pytest.mark.parametrize("by", [SAM3D, THREE_JS, UNITY], ids=["sam3d", "three.js", "unity"])
@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_poses_tell_the_focal_length_where_no_geometry_does(tmp_path: Path, by: PoseConvention, unit: float):
    """A blank photo: without the poses its focal length is the usual one, 173 px."""
    written(tmp_path / "in", by, unit=unit)
    given = read_inputs(tmp_path / "in", ignore=["geometry"])
    assert given.K[0, 0] == pytest.approx(camera().K[0, 0], rel=0.04)
    assert any("told by the poses of the meshes" in d.choice for d in given.decisions)


def test_stable_facets_tell_what_is_up_where_no_geometry_does(tmp_path: Path):
    true = write_folder(tmp_path / "in")
    given = read_inputs(tmp_path / "in", ignore=["geometry"])
    points = given.geometry.points[given.geometry.valid].astype(float)
    normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    assert abs(normal @ true.camera.T_world_camera[2, :3]) > np.cos(np.radians(3))
    assert any("the stable facets of 3 posed meshes" in d.choice for d in given.decisions)


def test_posed_meshes_tell_the_focal_length_too(tmp_path: Path):
    posed(tmp_path / "in", "opencv")
    given = read_inputs(tmp_path / "in", ignore=["geometry"])
    assert given.K[0, 0] == pytest.approx(camera().K[0, 0], rel=0.04)


def test_a_told_focal_length_overrules_the_poses(tmp_path: Path):
    write_folder(tmp_path / "in")
    given = read_inputs(tmp_path / "in", ignore=["geometry"], hints=PhotoHints(focal=260.0))
    assert given.K[0, 0] == 260
    (tmp_path / "in/geometry.npz").unlink()
    (tmp_path / "in/intrinsics.json").write_text(json.dumps({"K": [[250, 0, 99], [0, 250, 70], [0, 0, 1]]}))
    assert read_inputs(tmp_path / "in").K[0, 0] == 250


def test_poses_that_show_nothing_near_the_masks_tell_no_camera(tmp_path: Path):
    write_folder(tmp_path / "in")
    place = tmp_path / "in/assets/poses.json"
    document = json.loads(place.read_text())
    for entry in document["objects"]:
        entry["translation"] = [8.0, -5.0, 1.0]
    place.write_text(json.dumps(document))
    given = read_inputs(tmp_path / "in", ignore=["geometry"])
    assert not any("told by the poses" in d.choice for d in given.decisions)
    (none,) = (d for d in given.decisions if d.choice == "camera: the poses of the meshes tell none")
    assert none.fallback


def test_a_declared_reading_that_looks_wrong_tells_nothing_of_gravity(tmp_path: Path):
    """Chairs, as boxes look alike on another side: quaternions of another order than the folder declares."""
    by_program(tmp_path / "in", replace(SAM3D, order="xyzw"))
    place = tmp_path / "in/assets/poses.json"
    document = json.loads(place.read_text())
    place.write_text(json.dumps({**document, "convention": "sam-3d-objects"}))
    given = read_inputs(tmp_path / "in", ignore=["geometry"])
    assert any("which looks wrong" in d.choice for d in given.decisions)
    assert not any("stable facets" in d.choice for d in given.decisions)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_objects_tell_the_focal_length_badly(count: int):
    """Their jackknife may be zero: poses that are exact here are off by some percent elsewhere."""
    things = boxes()[:count]
    masks = {o.id: full_silhouette(o, camera()) for o in things}
    places = CandidatePlaces.of_frames([o.id for o in things], [CAMERAS["opencv"]])
    meshes = {o.id: o.mesh.with_vertices(camera().to_camera(o.vertices_world)) for o in things}
    found = camera_by_poses(masks, meshes, places, units=False)
    assert found is not None and found.focal.sigma > 0.1 / (count + 1)


def test_objects_that_others_hide_on_all_sides_tell_the_focal_length_too():
    """A wall fills the photo around a box: no edge is an object's own, and boxes say 34 px."""
    inner = full_silhouette(boxes()[0], camera())
    frame = ~inner
    things = {0: boxes()[0], 1: box(1, size=(2.0, 0.01, 2.0), at=(0, 0.3, 0))}
    places = CandidatePlaces.of_frames([0, 1], [CAMERAS["opencv"]])
    meshes = {id: o.mesh.with_vertices(camera().to_camera(o.vertices_world)) for id, o in things.items()}
    found = camera_by_poses({0: inner, 1: frame}, meshes, places, units=False)
    assert found is not None and found.focal.pixels == pytest.approx(camera().K[0, 0], rel=0.3)


@pytest.mark.parametrize("zoom", [0.5, 1.0, 4.0])
def test_a_photo_zoomed_by_a_factor_has_its_focal_length_times_that(zoom: float):
    """The same places, drawn by another lens: depths, and so perspectives, stay."""
    things, eye = [o for o in boxes() if o.id != 5], camera()
    eye = replace(eye, K=np.array([[eye.K[0, 0] * zoom, 0, WIDTH / 2], [0, eye.K[1, 1] * zoom, HEIGHT / 2], [0, 0, 1]]))
    eye = eye.resized(4 * WIDTH, 4 * HEIGHT) if zoom < 1 else eye
    masks = {o.id: full_silhouette(o, eye) for o in things}
    places = CandidatePlaces.of_frames([o.id for o in things], [CAMERAS["opencv"]])
    meshes = {o.id: o.mesh.with_vertices(eye.to_camera(o.vertices_world)) for o in things}
    found = camera_by_poses(masks, meshes, places, units=False)
    assert found is not None
    assert abs(np.log(found.focal.pixels / eye.K[0, 0])) < max(0.015, 3 * found.focal.sigma)
    for o, up in zip(things, found.upward, strict=True):
        assert (up @ eye.T_camera_world[:3, 2]).max() == pytest.approx(1, abs=1e-9), f"box {o.id} stands"


def test_meshes_in_their_own_frame_stand_where_the_masks_put_them(tmp_path: Path):
    """One of two: each is searched for alone, and the test below reads both."""
    written(tmp_path / "in", SAM3D)
    (tmp_path / "in/assets/poses.json").unlink()
    (tmp_path / "in/masks/01_chair.png").unlink()
    (tmp_path / "in/assets/01.glb").unlink()
    given = read_inputs(tmp_path / "in")
    (asset,), o = given.assets.values(), chairs()[0]
    found = transform(asset.T_camera_object, asset.scale * asset.mesh.vertices)
    assert np.linalg.norm(found - camera().to_camera(o.vertices_world), axis=1).max() < 0.03
    assert any("meshes without a pose" in d.choice and d.fallback for d in given.decisions)


def test_what_the_masks_do_not_decide_is_asked_for(tmp_path: Path):
    written(tmp_path / "in", SAM3D)
    doubtful = MaskPlacer(votes=VoteConfig(noise=1.0))  # no difference in cost is evidence
    with pytest.raises(InputError, match=f"the masks show alike as {re.escape(SAM3D.name)}.*accepted: --asset-frame "):
        inputs.read(tmp_path / "in", placer=doubtful)
    require_true(read_inputs(tmp_path / "in", asset_frame=SAM3D.name))


@pytest.mark.slow
def test_a_pose_that_the_masks_do_not_decide_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # The second reading takes the search of the first: it takes seconds, and gives the same.
    monkeypatch.setattr(given_frames, "poses_by_masks", cache_first(given_frames.poses_by_masks))
    written(tmp_path / "in", SAM3D)
    (tmp_path / "in/assets/poses.json").unlink()
    save_glb(box_mesh((1.0, 0.02, 0.02)), tmp_path / "in/assets/01.glb")  # a stick, where the mask shows a chair
    with pytest.raises(InputError, match=r"object 1 \(chair\): .*--asset-frame unposed"):
        read_inputs(tmp_path / "in")
    told = read_inputs(tmp_path / "in", asset_frame="unposed").decisions
    assert [d.about for d in told if d.fallback and d.about is not None] == [1]


def cache_first(search: Callable[..., Any]) -> Callable[..., Any]:
    """A function that gives what its first call gave, whatever it is asked."""
    found = list[Any]()
    return lambda *asked: found[0] if found else (found.append(search(*asked)) or found[0])


def test_names_of_conventions_are_read_back():
    found = all_conventions()
    assert len(found) == len({c.name for c in found}) == 864
    assert all(parsed(c.name) == c for c in found)
    assert found[0] == SAM3D


def test_every_test_that_a_complaint_names_exists():
    named = re.findall(r"`(test_\w+)`", (DOCS / "importing.md").read_text())
    sources = "".join(p.read_text() for p in Path(__file__).parent.glob("test_*.py"))
    assert len(named) >= 10
    assert not [name for name in named if f"def {name}(" not in sources]
