"""Reading input folders: what is accepted, and that every wrong one gives one clear error."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from f3sr import inputs
from f3sr.errors import InputError
from f3sr.frames import transform
from folders import HEIGHT, WIDTH, boxes, camera


def test_a_valid_folder_gives_ids_labels_and_exact_poses(folder: Path):
    given = inputs.read(folder)
    assert [(i.id, i.label) for i in given.instances] == [(2, "big box"), (5, "small box"), (7, "tall box")]
    assert np.allclose(given.K, camera().K)
    assert not [d for d in given.decisions if d.fallback]
    for o in boxes():
        asset = given.assets[o.id]
        points = transform(asset.T_camera_object, asset.scale * asset.mesh.vertices)
        expected = camera().to_camera(o.vertices_world)
        order = [np.lexsort(np.round(p, 5).T) for p in (points, expected)]
        assert np.allclose(points[order[0]], expected[order[1]], atol=1e-5)


def test_geometry_is_read_at_its_own_resolution(folder: Path):
    geometry = inputs.read(folder).geometry
    assert geometry.valid.shape == (HEIGHT // 2, WIDTH // 2)
    mask = inputs.read(folder).instances[0].mask
    depths = geometry.points[geometry.inside(mask)][:, 2]
    assert 0.5 < depths.min() < depths.max() < 1.0


def test_depth_with_intrinsics_replaces_the_point_map(folder: Path):
    points = inputs.read(folder).geometry
    depth = np.where(points.valid, points.points[..., 2], 0)
    (folder / "geometry.npz").unlink()
    np.save(folder / "depth.npy", depth / 0.001)
    K = camera().K * [[0.5], [0.5], [1]]
    meta = {"width": WIDTH // 2, "height": HEIGHT // 2, "K": K.tolist(), "depth_scale": 0.001}
    (folder / "intrinsics.json").write_text(json.dumps(meta))
    again = inputs.read(folder)
    assert np.allclose(again.K, camera().K)
    # The point map samples pixel (0, 0) of every 2x2 block, the depth map's pixels are the blocks themselves.
    offset = np.abs(again.geometry.points - points.points)[points.valid].max()
    assert offset < 0.5 / camera().K[0, 0] * 1.5


def test_point_maps_in_other_frames_are_turned(folder: Path):
    data = dict(np.load(folder / "geometry.npz"))
    before = inputs.read(folder).geometry.points
    data["points"] = data["points"] * np.array([-1, -1, 1], np.float32)
    np.savez(folder / "geometry.npz", **data, coordinate_system="pytorch3d_scene_y_up")
    assert np.allclose(inputs.read(folder).geometry.points, before)


def test_missing_intrinsics_are_fitted_and_said(folder: Path):
    data = dict(np.load(folder / "geometry.npz"))
    del data["intrinsics"]
    data["points"] = _centred(data["points"])
    np.savez(folder / "geometry.npz", **data)
    given = inputs.read(folder)
    assert given.K[0, 0] == pytest.approx(200, rel=0.02)
    assert any("fitted" in d.choice and d.fallback for d in given.decisions)


def _centred(points: np.ndarray) -> np.ndarray:
    """Points of a camera with f = 200 px and the principal point at the image's centre."""
    h, w = points.shape[:2]
    columns, rows = np.meshgrid((np.arange(w) + 0.5) / w - 0.5, (np.arange(h) + 0.5) / h - 0.5)
    z = np.full((h, w), 1.5)
    return np.stack([columns * WIDTH / 200 * z, rows * HEIGHT / 200 * z, z], -1).astype(np.float32)


def test_posed_glbs_need_no_poses_file(folder: Path):
    from f3sr.mesh_io import save_glb

    poses = folder / "assets" / "poses.json"
    poses.unlink()
    for o in boxes():
        opengl = camera().to_camera(o.vertices_world) * [1, -1, -1]
        save_glb(o.mesh.with_vertices(opengl), folder / "assets" / f"{o.id:02d}.glb")
    given = inputs.read(folder)
    for o in boxes():
        asset = given.assets[o.id]
        middle = transform(asset.T_camera_object, asset.scale * asset.mesh.vertices).mean(0)
        assert np.allclose(middle, camera().to_camera(o.vertices_world).mean(0), atol=1e-5)


def test_small_overlaps_go_to_the_smaller_mask(folder: Path):
    small, large = (folder / "masks" / n for n in ("05_small_box.png", "02_big_box.png"))
    overlap = np.asarray(Image.open(large)).copy()
    rows, columns = np.nonzero(np.asarray(Image.open(small)))
    overlap[rows[:3], columns[:3]] = 255
    Image.fromarray(overlap).save(large)
    given = inputs.read(folder)
    assert any("shared pixels go to 05_small_box.png" in d.choice for d in given.decisions)
    assert not (given.instances[0].mask & given.instances[1].mask).any()


def test_ids_without_digits_follow_the_sorted_names(folder: Path):
    for k, p in enumerate(sorted((folder / "masks").iterdir())):
        p.rename(p.with_name("cab"[k] + ".png"))
    entries = json.loads((folder / "assets/poses.json").read_text())
    for entry, name in zip(entries["objects"], "cab", strict=True):
        entry["mask"] = f"{name}.png"
    (folder / "assets/poses.json").write_text(json.dumps(entries))
    assert [(i.id, i.name) for i in inputs.read(folder).instances] == [
        (0, "a.png"),
        (1, "b.png"),
        (2, "c.png"),
    ]


def test_zero_is_a_valid_id_and_order_is_by_id(folder: Path):
    (folder / "masks/07_tall_box.png").rename(folder / "masks/00000.png")
    entries = json.loads((folder / "assets/poses.json").read_text())
    entries["objects"][2]["mask"] = "00000.png"
    (folder / "assets/poses.json").write_text(json.dumps(entries))
    first = inputs.read(folder).instances[0]
    assert (first.id, first.label) == (0, "")


# --- wrong inputs -----------------------------------------------------------------------------------------------


def poses(change: Callable[[dict], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / "assets/poses.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    return apply


def entry(**values: object) -> Callable[[Path], None]:
    return poses(lambda d: d["objects"][0].update(values))


def mask(name: str, pixels: np.ndarray) -> Callable[[Path], None]:
    return lambda f: Image.fromarray(pixels.astype(np.uint8)).save(f / "masks" / name)


def geometry(**values: object) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        data = dict(np.load(folder / "geometry.npz")) | values
        np.savez(folder / "geometry.npz", **{k: v for k, v in data.items() if v is not None})

    return apply


def write(name: str, data: bytes) -> Callable[[Path], None]:
    return lambda f: (f / name).write_bytes(data)


def remove(*names: str) -> Callable[[Path], None]:
    return lambda f: [(f / n).unlink() for n in names] and None


def replaced(name: str, make: Callable[[Path], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return apply


def flat_mesh(folder: Path) -> None:
    from f3sr.mesh_io import load_mesh, save_glb

    mesh = load_mesh(folder / "assets/02.glb")
    save_glb(mesh.with_vertices(mesh.vertices * [1, 1, 0]), folder / "assets/02.glb")


def on_one_ray(folder: Path) -> None:
    points = np.zeros((HEIGHT // 2, WIDTH // 2, 3), np.float32) + np.array([0, 0, 1], np.float32)
    geometry(points=points, intrinsics=None)(folder)


def bomb(folder: Path) -> None:
    """A header that claims 4 GB, deflated to nothing much."""
    import zipfile

    path = folder / "geometry.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("points.npy", bytes(1_000_000))
    data = path.read_bytes()
    path.write_bytes(data.replace((1_000_000).to_bytes(4, "little"), (4_000_000_000).to_bytes(4, "little")))


EMPTY = np.zeros((HEIGHT, WIDTH))

WRONG: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "no photo": (remove("image.png"), "input", "no image"),
    "truncated photo": (write("image.png", b"\x89PNG\r\n\x1a\n"), "image.png", "no readable image"),
    "two photos": (write("image.jpg", b""), "input", "image.jpg, image.png"),
    "mask of another size": (mask("02_big_box.png", np.ones((5, 5)) * 255), "02_big_box.png", "5x5"),
    "empty mask": (mask("02_big_box.png", EMPTY), "02_big_box.png", "0 set pixels"),
    "ids clash": (mask("2_again.png", EMPTY + 255), "masks", "id 2 twice"),
    "ids in some names only": (mask("cup.png", EMPTY + 255), "masks", "with and without an id"),
    "masks overlap": (mask("09_all.png", EMPTY + 255), "masks", "also in"),
    "no geometry": (remove("geometry.npz"), "input", "no geometry"),
    "broken npz": (write("geometry.npz", b"PK\x03\x04junk"), "geometry.npz", "no readable npz"),
    "points of the wrong shape": (geometry(points=np.zeros((4, 4))), "geometry.npz", "(4, 4)"),
    "no valid depth": (geometry(mask=np.zeros((HEIGHT // 2, WIDTH // 2), bool)), "geometry.npz", "no valid depth"),
    "unknown frame": (geometry(coordinate_system="left"), "geometry.npz", "'left'"),
    "focal length zero": (geometry(intrinsics=np.zeros((3, 3))), "geometry.npz", "K ="),
    "no poses for a mask": (poses(lambda d: d["objects"].pop()), "poses.json", "no asset for 07_tall_box.png"),
    "asset without mask": (
        poses(lambda d: d["objects"].append(d["objects"][0] | {"mask": "99.png"})),
        "poses.json", "unknown masks 99.png",
    ),
    "two poses for a mask": (poses(lambda d: d["objects"].append(d["objects"][0])), "poses.json", "two poses"),
    "focal length in pixels": (geometry(intrinsics=camera().K), "geometry.npz", "44160"),
    "focal length negative": (geometry(intrinsics=np.diag([-1.0, 1, 1])), "geometry.npz", "K ="),
    "a bomb of points": (bomb, "geometry.npz", "bytes of arrays"),
    "points on one ray": (on_one_ray, "geometry.npz", "one line of sight"),
    "id too long": (mask("99999999999999999999_x.png", EMPTY + 255), "masks", "the id of"),
    "mask of another kind": (write("masks/08_x.jpg", b""), "masks", "08_x.jpg"),
    "photo is a pipe": (replaced("image.png", os.mkfifo), "image.png", "no regular file"),
    "photo links to itself": (replaced("image.png", lambda p: p.symlink_to(p.name)), "input", "image.png"),
    "mesh name with NUL": (entry(mesh="a\0b.glb"), "assets", "path"),
    "mesh name with a lone surrogate": (entry(mesh="\ud800.glb"), "assets", "path"),
    "mask name with a path": (entry(mask="/etc/02_big_box.png"), "poses.json", "mask"),
    "scale tiny": (entry(scale=[1e-30] * 3), "poses.json", "an object 2 of"),
    "scale huge": (entry(scale=[1e30] * 3), "poses.json", "an object 2 of"),
    "a number of 6000 digits": (
        write("assets/poses.json", b'{"a": ' + b"9" * 6000 + b"}"), "poses.json", "no valid JSON",
    ),
    "flat mesh": (flat_mesh, "02.glb", "flat"),
    "mesh file missing": (entry(mesh="nope.glb"), "nope.glb", "No such file"),
    "mesh path escapes": (entry(mesh="../../../etc/passwd"), "assets", "leaves the folder"),
    "absolute mesh path": (entry(mesh="/etc/passwd"), "assets", "leaves the folder"),
    "quaternion too long": (entry(rotation=[1, 0, 0, 1]), "poses.json", "quaternion"),
    "quaternion of three": (entry(rotation=[1, 0, 0]), "poses.json", "rotation"),
    "scale zero": (entry(scale=[0, 0, 0]), "poses.json", "scale"),
    "scale negative": (entry(scale=[-1, -1, -1]), "poses.json", "scale"),
    "scale not uniform": (entry(scale=[1, 1, 2]), "poses.json", "scale"),
    "translation not finite": (entry(translation=[0, 0, float("nan")]), "poses.json", "finite"),
    "unknown convention": (poses(lambda d: d.update(convention="mine")), "poses.json", "mine"),
    "poses no JSON": (write("assets/poses.json", b"{"), "poses.json", "no valid JSON"),
    "mesh is no GLB": (write("assets/02.glb", b"hello"), "02.glb", "broken glTF"),
    "ground covers nothing": (
        lambda f: Image.fromarray(EMPTY.astype(np.uint8)).save(f / "ground.png"), "ground.png", "0 set pixels",
    ),
    "graph names a stranger": (
        write("scene_graph.json", b'{"support_relations": [{"upper": 2, "lower": 44}]}'), "scene_graph.json", "44",
    ),
    "graph with a typing error": (write("scene_graph.json", b'{"realtions": []}'), "scene_graph.json", "neither"),
    "graph of itself": (
        write("scene_graph.json", b'{"relations": [{"subject": 2, "predicate": "inside", "object": 2}]}'),
        "scene_graph.json", "2 inside 2",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_gives_one_clear_error(folder: Path, case: str):
    spoil, where, found = WRONG[case]
    spoil(folder)
    with pytest.raises(InputError) as error:
        inputs.read(folder)
    assert where in error.value.where
    assert found in error.value.found
    assert error.value.accepted and "\n" not in str(error.value)


def test_symlink_out_of_the_folder_is_refused(folder: Path, tmp_path: Path):
    secret = tmp_path / "secret.glb"
    secret.write_bytes((folder / "assets/02.glb").read_bytes())
    (folder / "assets/02.glb").unlink()
    (folder / "assets/02.glb").symlink_to(secret)
    with pytest.raises(InputError, match="leaves the folder"):
        inputs.read(folder)


def test_a_file_or_nothing_where_a_folder_is_meant(tmp_path: Path):
    (tmp_path / "file").write_text("x")
    for name, found in (("file", "a file"), ("absent", "nothing there")):
        with pytest.raises(InputError, match=found):
            inputs.read(tmp_path / name)


def test_ignored_parts_count_as_absent(folder: Path):
    (folder / "scene_graph.json").write_text("{")
    with pytest.raises(InputError):
        inputs.read(folder)
    given = inputs.read(folder, ignore=["scene_graph", "ground"])
    assert given.graph is None and given.ground_mask is None
    with pytest.raises(InputError, match="no assets"):
        inputs.read(folder, ignore=["assets", "scene_graph"])


@pytest.mark.parametrize("scene", ["scenes/dev_00_stack", "scenes/dev_04_pile", "real/ycb_table_0", "real/ycb_table_1"])
def test_real_folders_are_accepted(shared_data: Path, scene: str):
    given = inputs.read(shared_data / scene)
    assert len(given.assets) == len(given.instances) >= 5
    assert given.geometry.valid.mean() > 0.5
