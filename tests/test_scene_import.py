"""Laws of imports: what every program left comes back where it was, and what is broken is one clear error."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import f3sr
import producer_outputs as outputs
from f3sr.cli.main import main
from f3sr.core.camera import Camera
from f3sr.core.transforms import transform
from f3sr.errors import InputError
from f3sr.importing.import_source import ImportSource, masks_of_folder
from f3sr.importing.imported_folder import NOTE
from f3sr.importing.scene_import import Imported, import_output
from f3sr.io import inputs
from f3sr.io.inputs import Inputs
from f3sr.io.mesh_files import load_mesh, save_glb
from f3sr.io.photo_hints import PhotoHints
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import iou
from folders import FLAT, boxes, camera
from producer_outputs import Laid

SHARED = Path(__file__).parents[2] / "shared" / "data"


def centred(view: Camera) -> Camera:
    """The same camera with its axis through the picture's middle, as glTF and most producers have it."""
    K = view.K.copy()
    K[:2, 2] = view.width / 2, view.height / 2
    return replace(view, K=K)


@pytest.fixture(scope="module")
def laid() -> Laid:
    """Three boxes with textures: ids 0, 1, 2."""
    objects = [replace(o, id=k) for k, o in enumerate(boxes(textured=True))]
    return Laid.of(objects, centred(camera()))


@pytest.fixture(scope="module")
def real() -> Laid:
    """Scans of real things in a stack, where they truly stood: four of seven, in half of the photo's size."""
    place = SHARED / "scenes" / "dev_00_stack" / "truth.json"
    if not place.is_file():
        pytest.skip("needs ../shared/data/scenes")
    truth = json.loads(place.read_text())
    width, height = truth["image_size"]
    view = Camera(width=width, height=height, K=np.array(truth["K"]), T_world_camera=np.array(truth["T_world_camera"]))
    objects = [
        SceneObject(
            id=k, label=o["name"].replace("_", " "), mask_name="", mask=np.ones((1, 1), bool),
            mesh=load_mesh(SHARED / "objects" / f"{o['model']}.glb"), T_world_object=np.array(o["T_world_object"]),
        )
        for k, o in enumerate(truth["objects"][:4])
    ]  # fmt: skip
    return Laid.of(objects, centred(view.resized(width // 2, height // 2)))


def imported(path: Path, out: Path, *, masks: Path | None = None, photo: Path | None = None, focal: float | None = None,
             producer: str | None = None, in_order: bool = False, asset_frame: str = "auto") -> Imported:  # fmt: skip
    source = ImportSource(
        path=path,
        photo_file=photo,
        mask_reader=masks_of_folder(masks) if masks else None,
        in_order=in_order,
        hints=PhotoHints(focal=focal),
        asset_frame=asset_frame,
    )
    return import_output(source, out, producer)


def vertices(given: Inputs, id: int) -> np.ndarray:
    """An object's vertices in the camera, as the folder has them."""
    asset = given.assets[id]
    return transform(asset.T_camera_object, asset.scale * asset.mesh.vertices)


def require_equal(given: Inputs, laid: Laid, *, up_to_scale: bool = False) -> None:
    """All vertices where they truly are, within 1e-4 of an object's size."""
    assert [i.id for i in given.instances] == [o.id for o in laid.objects]
    for o in laid.objects:
        here, there = vertices(given, o.id), laid.in_camera(o.id)
        here = here * (np.linalg.norm(there.mean(0)) / np.linalg.norm(here.mean(0)) if up_to_scale else 1)
        assert here.shape == there.shape
        assert np.abs(here - there).max() <= 1e-4 * o.size, o.label


def require_masks(given: Inputs, laid: Laid, least: float = 0.99) -> None:
    for i in given.instances:
        assert iou(i.mask, laid.masks[i.id]) >= least, i.label


POSED: dict[str, Callable[[Laid, Path], Path]] = {
    "sam3d, N.json": lambda laid, p: outputs.write_sam3d(laid, p, poses="json"),
    "sam3d, N.npz": lambda laid, p: outputs.write_sam3d(laid, p, poses="npz"),
    "sam3d, poses.json": lambda laid, p: outputs.write_sam3d(laid, p, poses="list"),
    "sam3d, posed vertices": lambda laid, p: outputs.write_sam3d(laid, p, poses="posed"),
    "comfyui, aligned": lambda laid, p: outputs.write_comfyui(laid, p, poses="aligned"),
    "comfyui, pose.json": lambda laid, p: outputs.write_comfyui(laid, p, poses="json"),
    "fal, wxyz": outputs.write_fal,
    "fal, xyzw": lambda laid, p: outputs.write_fal(laid, p, order="xyzw"),
}


@pytest.mark.parametrize("name", POSED)
def test_given_poses_are_read_as_the_masks_show(name: str, laid: Laid, tmp_path: Path):
    place = POSED[name](laid, tmp_path / "made")
    masks = outputs.write_masks(laid, tmp_path / "masks", labels=False) if name.startswith("fal") else None
    written = imported(place, tmp_path / "in", masks=masks)
    assert (written.masks, written.poses) == ("given", "given, read as the masks show")
    if masks:  # fal keeps no point map
        np.savez(written.folder / "geometry.npz", points=outputs.point_map(laid), coordinate_system="pytorch3d")
    given = f3sr.read_inputs(written.folder)
    require_equal(given, laid)
    require_masks(given, laid, 1.0)
    assert any("placed by assets back end saved" in d.choice for d in given.decisions)


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_masks_and_poses_tell_the_camera(laid: Laid, tmp_path: Path, order: str):
    masks = outputs.write_masks(laid, tmp_path / "masks", labels=False)
    place = outputs.write_fal(laid, tmp_path / "made", order=order)
    written = imported(place, tmp_path / "in", masks=masks)
    given = f3sr.read_inputs(written.folder)
    assert given.K[0, 0] == pytest.approx(laid.camera.K[0, 0], rel=0.02)
    (told,) = (d.choice for d in given.decisions if "told by the poses of the meshes" in d.choice)
    is_certain = order == "wxyz"  # the documented one; of the other, boxes fit their masks on another side too
    assert (f"the stable facets of {len(laid.objects)} posed meshes" in told) == is_certain
    imported(place, tmp_path / "in", masks=masks, focal=200.0)
    assert json.loads((tmp_path / "in" / "intrinsics.json").read_text())["K"][0][0] == 200.0


def test_without_masks_sam3d_poses_are_the_picture(laid: Laid, tmp_path: Path):
    """fal's reply alone, with the lens as the user knows it."""
    written = imported(outputs.write_fal(laid, tmp_path / "made"), tmp_path / "in", focal=float(laid.camera.K[0, 0]))
    assert (written.masks, written.poses) == ("drawn from the poses", "given")
    np.savez(written.folder / "geometry.npz", points=outputs.point_map(laid), coordinate_system="pytorch3d")
    (written.folder / "intrinsics.json").unlink()
    given = inputs.read(written.folder)
    require_equal(given, laid)
    require_masks(given, laid)


def test_without_a_lens_one_that_sees_all_is_assumed_and_told(laid: Laid, tmp_path: Path):
    written = imported(outputs.write_fal(laid, tmp_path / "made"), tmp_path / "in")
    assert any("focal length assumed" in remark for remark in written.remarks)
    meta = json.loads((written.folder / "intrinsics.json").read_text())
    K = np.array(meta["K"])
    for o in laid.objects:
        p = laid.in_camera(o.id)
        pixels = p[:, :2] / p[:, 2:] * K[0, 0] + K[:2, 2]
        assert (pixels >= 0).all() and (pixels <= [meta["width"], meta["height"]]).all()


UNPOSED: dict[str, Callable[[Laid, Path], Path]] = {
    "trellis": outputs.write_trellis,
    "embodiedgen": lambda laid, p: outputs.write_embodiedgen(laid, p, layout=False),
    "comfyui": outputs.write_comfyui_files,
}


@pytest.mark.parametrize("name", UNPOSED)
def test_meshes_without_poses_are_kept_for_the_pose_search(name: str, laid: Laid, tmp_path: Path):
    place = UNPOSED[name](laid, tmp_path / "made")
    outputs.write_photo(laid, tmp_path / "photo.png")
    masks = outputs.write_masks(laid, tmp_path / "masks")
    written = imported(place, tmp_path / "in", masks=masks, photo=tmp_path / "photo.png", in_order=name == "comfyui")
    assert written.poses == "none, found by the masks"
    assert (written.folder / "image.png").read_bytes() == (tmp_path / "photo.png").read_bytes()
    for o in laid.objects:
        mesh, _, scale = outputs.generated(o)
        kept = load_mesh(written.folder / "assets" / f"{o.id:02d}.glb")
        size = scale if name == "embodiedgen" else 1.0
        R = np.eye(3) if name != "embodiedgen" else np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        assert np.abs(kept.vertices - size * mesh.vertices @ R.T).max() <= 1e-4 * size
        told = json.loads((written.folder / "assets" / f"{o.id:02d}.json").read_text())
        assert told["pose"]["convention"] == "none"
        assert told["up"] == {"trellis": "+y", "embodiedgen": "+z", "comfyui": None}[name]


def test_the_pose_search_places_what_was_imported(laid: Laid, tmp_path: Path):
    outputs.write_photo(laid, tmp_path / "photo.png")
    masks = outputs.write_masks(laid, tmp_path / "masks")
    written = imported(outputs.write_trellis(laid, tmp_path / "made"), tmp_path / "in", masks=masks,
                       photo=tmp_path / "photo.png")  # fmt: skip
    np.savez(written.folder / "geometry.npz", points=outputs.point_map(laid), coordinate_system="pytorch3d")
    given = f3sr.read_inputs(written.folder)
    for o in laid.objects:
        middle = lambda v: (v.min(0) + v.max(0)) / 2  # noqa: E731
        assert np.linalg.norm(middle(vertices(given, o.id)) - middle(laid.in_camera(o.id))) < 0.1 * o.size
    with pytest.raises(InputError, match=r"no GLB|poses\.json|own frame"):
        inputs.read(written.folder)  # io alone finds no poses


COMPOSED: dict[str, Callable[[Laid, Path], Path]] = {
    "with a camera and a ground": lambda laid, p: outputs.write_composed(laid, p / "scene.glb"),
    "with a camera": lambda laid, p: outputs.write_composed(laid, p / "scene.glb", ground=False),
}


@pytest.mark.parametrize("name", COMPOSED)
def test_a_composed_glb_comes_back_as_its_camera_sees_it(name: str, real: Laid, tmp_path: Path):
    file = COMPOSED[name](real, tmp_path / "made")
    outputs.write_photo(real, tmp_path / "made" / "image.png")
    written = imported(file.parent, tmp_path / "in")
    given = inputs.read(written.folder)
    require_equal(given, real)
    require_masks(given, real)
    assert [i.label for i in given.instances] == [o.label for o in real.objects]
    world = transform(real.camera.T_world_camera, given.geometry.points[given.geometry.inside(given.ground_mask)])
    lowest = min(float(o.bounds_world[0, 2]) for o in real.objects)
    assert np.abs(world[:, 2] - (0.0 if "ground" in name else lowest)).max() < 1e-3
    assert [item.label for item in written.left_out] == (["ground"] if "ground" in name else [])


def test_a_composed_glb_in_camera_axes(laid: Laid, tmp_path: Path):
    file = outputs.write_composed(laid, tmp_path / "scene.glb", camera=False, ground=False, frame="camera")
    outputs.write_photo(laid, tmp_path / "photo.png")
    written = imported(file, tmp_path / "in", photo=tmp_path / "photo.png", asset_frame="opengl",
                       focal=float(laid.camera.K[0, 0]))  # fmt: skip
    given = f3sr.read_inputs(written.folder)
    require_equal(given, laid, up_to_scale=True)
    require_masks(given, laid)


def test_the_camera_of_a_composed_glb_is_fitted_to_masks(real: Laid, tmp_path: Path):
    file = outputs.write_composed(real, tmp_path / "scene.glb", camera=False)
    outputs.write_photo(real, tmp_path / "photo.png")
    masks = outputs.write_masks(real, tmp_path / "masks")
    written = imported(file, tmp_path / "in", photo=tmp_path / "photo.png", masks=masks)
    assert any("fitted to the masks" in remark for remark in written.remarks)
    given = inputs.read(written.folder)
    found = Camera(width=real.camera.width, height=real.camera.height, K=given.K, T_world_camera=np.eye(4))
    shown = [
        replace(o, mesh=given.assets[o.id].mesh, T_world_object=given.assets[o.id].T_camera_object)
        for o in real.objects
    ]
    ids = rasterizer.visible_ids(shown, found)
    assert np.mean([iou(ids == o.id, real.masks[o.id]) for o in real.objects]) > 0.9


@pytest.mark.parametrize("name", ["embodiedgen", "glb"])
def test_a_scene_without_a_photo_is_drawn_from_where_all_is_seen(name: str, laid: Laid, tmp_path: Path):
    if name == "glb":
        place = outputs.write_composed(laid, tmp_path / "scene.glb", camera=False)
    else:
        place = outputs.write_embodiedgen(laid, tmp_path / "made", layout=True)
    written = imported(place, tmp_path / "in")
    given = inputs.read(written.folder)
    assert (written.objects, written.masks) == (3, "drawn from the poses")
    assert "photo: drawn from the meshes" in written.remarks
    here = np.concatenate([vertices(given, o.id) for o in laid.objects])
    there = np.concatenate([o.vertices_world for o in laid.objects])
    # One rigid motion takes all objects from the world into the camera (Kabsch).
    a, b = here - here.mean(0), there - there.mean(0)
    U, _, V = np.linalg.svd(b.T @ a)
    assert np.linalg.det(U @ V) > 0
    assert np.abs(a - b @ U @ V).max() < 1e-4 * 0.1
    photo = np.asarray(Image.open(written.folder / "image.png"))
    assert photo.shape == (768, 1024, 3) and photo.std() > 10
    if name == "embodiedgen":
        assert {(r.subject, r.object) for r in given.graph.relations} == {(1, 0), (2, 0)}


def test_the_command_imports_and_says_what_it_did(laid: Laid, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    place = outputs.write_sam3d(laid, tmp_path / "made")
    assert main(["import", str(place), "-o", str(tmp_path / "in"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["objects"], told["masks"], told["poses"]) == (3, "given", "given, read as the masks show")
    assert any(".ply" in remark for remark in told["remarks"])
    assert main(["import", str(place), "-o", str(tmp_path / "in")]) == 0, "its own folder is replaced"
    assert json.loads((tmp_path / "in" / NOTE).read_text())["remarks"]
    outputs.write_photo(laid, tmp_path / "photo.png")
    numbers = sum((k + 1) * mask for k, mask in laid.masks.items()).astype(np.uint8)
    Image.fromarray(numbers).save(tmp_path / "map.png")
    trellis = outputs.write_trellis(laid, tmp_path / "trellis")
    command = ["import", str(trellis), "-o", str(tmp_path / "in2"), "--photo", str(tmp_path / "photo.png")]
    assert main([*command, "--label-map", str(tmp_path / "map.png"), "--in-order"]) == 0
    assert sorted(p.name for p in (tmp_path / "in2" / "assets").glob("*.glb")) == ["01.glb", "02.glb", "03.glb"]


def test_the_program_is_told_by_what_is_there(laid: Laid, tmp_path: Path):
    outputs.write_trellis(laid, tmp_path / "a")
    outputs.write_embodiedgen(laid, tmp_path / "a", layout=False)
    with pytest.raises(InputError, match="what trellis and embodiedgen leave; accepted: one of them by --from NAME"):
        imported(tmp_path / "a", tmp_path / "in")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no output of a known program; accepted: fysiverse: "):
        imported(tmp_path / "empty", tmp_path / "in")
    with pytest.raises(InputError, match="nothing there"):
        imported(tmp_path / "none", tmp_path / "in")
    with pytest.raises(InputError, match="--from: found blender"):
        imported(tmp_path / "empty", tmp_path / "in", producer="blender")
    written = imported(outputs.write_sam3d(laid, tmp_path / "b"), tmp_path / "in")
    with pytest.raises(InputError, match="a prompted-image folder; accepted: it as it is"):
        imported(written.folder, tmp_path / "in2")


def spoilt_json(name: str, change: Callable[[dict], object]) -> Callable[[Path], object]:
    def spoil(place: Path) -> None:
        document = json.loads((place / name).read_text())
        change(document)
        (place / name).write_text(json.dumps(document))

    return spoil


def pickled(place: Path) -> None:
    np.savez(place / "0.npz", rotation=np.array([{"a": 1}], dtype=object), translation=[0], scale=[1])
    (place / "0.json").unlink()


BROKEN: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "sam3d: no mesh": ("sam3d", lambda p: [f.unlink() for f in p.glob("*.glb")], "no N.glb"),
    "sam3d: a mesh short": ("sam3d", lambda p: (p / "1.glb").unlink(), "2 meshes .* for 3 masks"),
    "sam3d: a pose short": ("sam3d", lambda p: (p / "1.json").unlink(), "no pose of mesh 1"),
    "sam3d: a pose with NaN": ("sam3d", lambda p: (p / "1.json").write_text('{"rotation": NaN}'), "no valid JSON"),
    "sam3d: a pose of zeros": ("sam3d", spoilt_json("1.json", lambda d: d.update(rotation=[[0] * 4])), "length 0"),
    "sam3d: a pickle for a pose": ("sam3d", pickled, "Python objects"),
    "sam3d: two files with a pose": ("sam3d", lambda p: (p / "1.npz").write_bytes(b"x"), "1.json and 1.npz"),
    "sam3d: a mask of another size": ("sam3d", lambda p: Image.new("L", (20, 20), 255).save(p / "1.png"), "20x20"),
    "sam3d: a link out of it": ("sam3d", lambda p: ((p / "1.glb").unlink(), (p / "1.glb").symlink_to("/etc/passwd")),
                                "leaves the folder"),
    "sam3d: points of another shape": ("sam3d", lambda p: np.save(p / "pointmap.npy", np.zeros((4, 4))), "pointmap"),
    "sam3d: a flat mesh": ("sam3d", lambda p: save_glb(FLAT, p / "1.glb"), "1.glb: found a flat mesh"),
    "layout: a flat mesh": ("layout", lambda p: save_glb(FLAT, next(p.rglob("small_box.glb"))), "a flat mesh"),
    "comfyui: an object without a mesh": ("comfyui", lambda p: [f.unlink() for f in (p / "object_1").glob("*.glb")],
                                          "no mesh"),
    "comfyui: no mask": ("comfyui", lambda p: (p / "object_1" / "mask.npy").unlink(), "no such file"),
    "comfyui: a mask of objects": ("comfyui", lambda p: np.save(p / "object_1" / "mask.npy", np.array([{}])),
                                   "objects"),
    "comfyui: a mask of NaN": ("comfyui", lambda p: np.save(p / "object_1" / "mask.npy", np.full((144, 192), np.nan)),
                               "0 set pixels"),
    "comfyui: no photo": ("comfyui", lambda p: (p / "image.png").unlink(), "no image.png"),
    "fal: a mesh of null": ("fal", spoilt_json("result.json", lambda d: d["data"]["individual_glbs"].append(None)),
                            "no mesh of object 3"),
    "fal: a pose short": ("fal", spoilt_json("result.json", lambda d: d["data"]["metadata"].pop()), "metadata of"),
    "fal: one object twice": ("fal", spoilt_json("result.json", lambda d: d["data"]["metadata"].append(
        d["data"]["metadata"][0])), "metadata of"),
    "fal: a file that is not there": ("fal", lambda p: (p / "fal_0001_xY.glb").unlink(), "no fal_0001_xY.glb"),
    "fal: a name out of it": ("fal", spoilt_json("result.json", lambda d: d["data"]["individual_glbs"][1].update(
        file_name="../../../etc/passwd", url="https://x/../../etc/shadow")), "no passwd or shadow"),
    "fal: one file twice": ("fal", spoilt_json("result.json", lambda d: d["data"]["individual_glbs"].__setitem__(
        1, d["data"]["individual_glbs"][0])), "one GLB for two objects"),
    "fal: two replies": ("fal", lambda p: (p / "b.json").write_bytes((p / "result.json").read_bytes()),
                         "b.json and result.json"),
    "layout: an asset out of it": ("layout", spoilt_json("layout.json", lambda d: d["assets"].update(
        {"small box": "../../etc"})), "leaves the folder"),
    "layout: no position": ("layout", spoilt_json("layout.json", lambda d: d["position"].pop("small box")),
                            "no position of small box"),
    "layout: a quaternion of zeros": ("layout", spoilt_json("layout.json", lambda d: d["position"].update(
        {"small box": [0] * 7})), "length 0"),
    "layout: a position of six": ("layout", spoilt_json("layout.json", lambda d: d["position"].update(
        {"small box": [0] * 6})), "small box"),
    "layout: no assets": ("layout", spoilt_json("layout.json", lambda d: d.update(assets={})), "assets"),
    "urdf: an entity": ("layout", lambda p: next(p.rglob("small_box.urdf")).write_text(
        '<!DOCTYPE r [<!ENTITY a "b">]><robot/>'), "an entity"),
    "urdf: no XML": ("layout", lambda p: next(p.rglob("small_box.urdf")).write_text("<robot"), "no valid XML"),
    "urdf: a mesh out of it": ("layout", lambda p: (f := next(p.rglob("small_box.urdf"))).write_text(
        f.read_text().replace("mesh/small_box", "../../../../../etc/x")), "leaves the folder"),
    "urdf: numbers of text": ("layout", lambda p: (f := next(p.rglob("small_box.urdf"))).write_text(
        f.read_text().replace("1.5708 0.0 0.0", "1 nan 0")), "three finite numbers"),
    "glb: cut off": ("glb", lambda p: (p / "scene.glb").write_bytes((p / "scene.glb").read_bytes()[:2000]), "GLB"),
    "trellis: a sample that is none": ("trellis", lambda p: next(p.rglob("sample.glb")).write_bytes(b"x"),
                                       "broken glTF"),
    "trellis: two in a folder": ("trellis", lambda p: (p / "small_box" / "a.glb").write_bytes(b"x"), "more than one"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_one_clear_error_and_nothing_is_written(name: str, laid: Laid, tmp_path: Path):
    kind, spoil, told = BROKEN[name]
    place = tmp_path / "made"
    made = {
        "sam3d": outputs.write_sam3d,
        "comfyui": lambda laid, p: outputs.write_comfyui(laid, p, poses="json"),
        "fal": outputs.write_fal,
        "layout": lambda laid, p: outputs.write_embodiedgen(laid, p, layout=True),
        "glb": lambda laid, p: outputs.write_composed(laid, p / "scene.glb"),
        "trellis": outputs.write_trellis,
    }[kind]
    made(laid, place)
    spoil(place)
    outputs.write_photo(laid, tmp_path / "photo.png")
    photo = tmp_path / "photo.png" if kind == "trellis" else None
    masks = outputs.write_masks(laid, tmp_path / "masks") if kind in ("trellis", "fal") else None
    path = place / "scene.glb" if kind == "glb" else place
    with pytest.raises(InputError, match=told):
        imported(path, tmp_path / "in", masks=masks, photo=photo)
    assert not (tmp_path / "in").exists()


def test_what_is_missing_is_asked_for(laid: Laid, tmp_path: Path):
    trellis = outputs.write_trellis(laid, tmp_path / "trellis")
    outputs.write_photo(laid, tmp_path / "photo.png")
    with pytest.raises(InputError, match="neither masks nor a pose of big_box; accepted: --masks"):
        imported(trellis, tmp_path / "in", photo=tmp_path / "photo.png")
    masks = outputs.write_masks(laid, tmp_path / "masks")
    with pytest.raises(InputError, match=r"no image.png or image.jpg or image.jpeg; accepted: --photo FILE"):
        imported(trellis, tmp_path / "in", masks=masks)
    glb = outputs.write_composed(laid, tmp_path / "scene.glb", camera=False)
    with pytest.raises(InputError, match="a photo, and no camera in the file; accepted: --masks"):
        imported(glb, tmp_path / "in", photo=tmp_path / "photo.png")
    other = outputs.write_masks(replace(laid, objects=laid.objects[:2]), tmp_path / "two")
    with pytest.raises(InputError, match=r"3 meshes .* for 2 masks"):
        imported(trellis, tmp_path / "in", masks=other, photo=tmp_path / "photo.png")
    save_glb(laid.objects[0].mesh, tmp_path / "trellis" / "big_box" / "sample.glb")
    numbered = outputs.write_masks(laid, tmp_path / "numbers", labels=False)
    with pytest.raises(InputError, match="or --in-order"):
        imported(trellis, tmp_path / "in", masks=numbered, photo=tmp_path / "photo.png")
    assert not (tmp_path / "in").exists()
