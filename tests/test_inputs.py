"""Reading input folders: what is accepted, and that every wrong one gives one clear error."""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

import broken_inputs
import forked
from broken_inputs import BIG, WRONG, Spoil, broken, in_order
from f3sr.cli.main import main
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import transform
from f3sr.errors import InputError
from f3sr.io import inputs
from folders import HEIGHT, WIDTH, boxes, camera, to_depth, to_posed, write_folder


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
    to_depth(folder)
    again = inputs.read(folder)
    assert np.allclose(again.K, camera().K)
    # The point map samples pixel (0, 0) of every 2x2 block, the depth map's pixels are the blocks themselves.
    offset = np.abs(again.geometry.points - points.points)[points.valid].max()
    assert offset < 0.5 / camera().K[0, 0] * 1.5 + 0.0005  # and a millimetre a level


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
    to_posed(folder)
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


# --- inputs that look wrong and are not -------------------------------------------------------------------------------


def picture(name: str, change: Callable[[np.ndarray], np.ndarray], **options: Any) -> Spoil:
    def apply(folder: Path) -> None:
        with Image.open(folder / name) as image:
            changed = change(np.asarray(image).copy())
        Image.fromarray(changed).save(folder / name, **options)

    return apply


def gray16(pixels: np.ndarray) -> np.ndarray:
    return pixels.mean(2).astype(np.uint16) * 257 if pixels.ndim == 3 else pixels.astype(np.uint16) * 257


def transparent(pixels: np.ndarray) -> np.ndarray:
    return np.dstack([pixels, np.full(pixels.shape[:2], 7, np.uint8)])


def soft(pixels: np.ndarray) -> np.ndarray:
    """Bright levels where the mask is, dark ones elsewhere."""
    noise = np.random.default_rng(0).integers(0, 9, pixels.shape)
    return np.where(pixels > 0, 255 - noise, noise).astype(np.uint8)


def cut_out(pixels: np.ndarray) -> np.ndarray:
    """The mask in the alpha channel of a white picture."""
    return np.dstack([np.full((*pixels.shape, 3), 255, np.uint8), pixels])


def turned_photo(folder: Path) -> None:
    """The photo lies on its side in the file, and says so."""
    exif = Image.Exif()
    exif[0x0112] = 6
    with Image.open(folder / "image.png") as image:
        image.transpose(Image.Transpose.ROTATE_90).save(folder / "image.png", exif=exif)


def palette(name: str) -> Spoil:
    def apply(folder: Path) -> None:
        with Image.open(folder / name) as image:
            image.convert("RGB").convert("P").save(folder / name)

    return apply


def mesh(change: Callable[[Mesh], Mesh]) -> Spoil:
    def apply(folder: Path) -> None:
        from f3sr.io.mesh_files import load_mesh, save_glb

        save_glb(change(load_mesh(folder / "assets/02.glb")), folder / "assets/02.glb")

    return apply


def faces(change: Callable[[np.ndarray], Any]) -> Spoil:
    return mesh(lambda m: replace(m, faces=np.asarray(change(m.faces), np.int32), face_material=None))


def layered(m: Mesh) -> Mesh:
    """A second shell inside, facing outward too."""
    inner = m.vertices.mean(0) + 0.5 * (m.vertices - m.vertices.mean(0))
    return Mesh(
        vertices=np.concatenate([m.vertices, inner]), faces=np.concatenate([m.faces, m.faces + len(m.vertices)])
    )


def fin(m: Mesh) -> Mesh:
    """A triangle that stands on an edge of the box."""
    a, b = m.faces[0, :2]
    tip = m.vertices[a] + 0.2 * (m.vertices[a] - m.vertices.mean(0))
    return Mesh(
        vertices=np.concatenate([m.vertices, [tip]]), faces=np.concatenate([m.faces, [[a, b, len(m.vertices)]]])
    )


def stray(m: Mesh) -> Mesh:
    """A vertex 50 m away that no triangle uses."""
    return Mesh(vertices=np.concatenate([[[50, 50, 50]], m.vertices]), faces=m.faces + 1)


def ranks(count: int) -> Callable[[dict[str, Any]], None]:
    """Nodes that hang from one another."""

    def change(tree: dict[str, Any]) -> None:
        tree["nodes"] = [{"children": [k + 1]} for k in range(count)] + [{"mesh": 0}]
        tree["scenes"] = [{"nodes": [0]}]

    return change


def embedded(folder: Path) -> None:
    """The mesh's data in a data URI."""
    import base64

    tree, binary = broken_inputs.read_glb((folder / "assets/02.glb").read_bytes())
    tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
    (folder / "assets/02.glb").write_bytes(broken_inputs.glb(tree))


ODD: dict[str, tuple[Spoil, str | None]] = {
    "a 16-bit photo": (picture("image.png", gray16), None),
    "a photo with alpha": (picture("image.png", transparent), None),
    "a photo turned by EXIF": (turned_photo, "has the orientation 6"),
    "a palette photo": (palette("image.png"), None),
    "a JPEG called image.png": (broken_inputs.saved_as("image.png", "JPEG"), None),
    "a CMYK photo": (lambda f: Image.new("CMYK", (WIDTH, HEIGHT)).save(f / "image.png", "JPEG"), None),
    "a photo called image.PNG": (broken_inputs.moved("image.png", "image.PNG"), None),
    "a mask of 16 bits": (picture(f"masks/{BIG}", gray16), None),
    "a mask of zeros and ones": (picture(f"masks/{BIG}", lambda p: (p > 0).astype(np.uint8)), None),
    "a mask in the alpha channel": (picture(f"masks/{BIG}", cut_out), "alpha channel is the mask"),
    "a palette mask": (palette(f"masks/{BIG}"), None),
    "a mask of two levels above 0": (
        picture(f"masks/{BIG}", lambda p: np.where(p > 0, 255, 1).astype(np.uint8)), "neither of them 0",
    ),
    "a soft mask": (picture(f"masks/{BIG}", soft), "grey levels"),
    "files of others": (
        in_order(*(broken_inputs.write(n, b"x") for n in ("notes.txt", "masks/.DS_Store", "assets/a.md"))), None,
    ),
    "JSON with a byte order mark": (
        lambda f: (f / "assets/poses.json").write_text((f / "assets/poses.json").read_text(), "utf-8-sig"), None,
    ),
    "a link inside the folder": (
        lambda f: ((f / "masks").rename(f / "m"), (f / "masks").symlink_to("m")), None,
    ),
    "a sky 1000 km away": (
        broken_inputs.geometry(points=lambda p: np.where(np.indices(p.shape)[0] < 3, np.float32(1e6), p)), "left out",
    ),
    "geometry of another aspect": (
        broken_inputs.geometry(points=lambda p: p[::2], mask=lambda m: m[::2]), "stretched over the photo",
    ),
    "points in double precision": (broken_inputs.geometry(points=lambda p: p.astype(float)), None),
    "an npz with other arrays": (broken_inputs.geometry(extra=np.array([{}], object)), None),
    "an open mesh": (faces(lambda f: f[1:]), "3 open edges"),
    "a mesh turned inside out": (faces(lambda f: f[:, ::-1]), "facing inward"),
    "a mesh with a triangle turned": (faces(lambda f: np.concatenate([f[:1, ::-1], f[1:]])), "face opposite sides"),
    "a mesh with triangles twice": (faces(lambda f: np.concatenate([f, f])), "12 doubled triangles"),
    "a mesh with triangles of no area": (faces(lambda f: np.concatenate([f, f[:, [0, 0, 1]]])), "12 triangles of no"),
    "an edge of three triangles": (mesh(fin), "edges of more than two triangles"),
    "an inner layer": (mesh(layered), "1 layer or fold within itself"),
    "a vertex of no triangle": (mesh(stray), "1 vertices left out"),
    "5000 nodes in a chain": (broken_inputs.gltf(ranks(5000)), None),
    "a mesh in a data URI": (embedded, None),
    "unknown extensions, not required": (broken_inputs.gltf(lambda t: t.update(extensionsUsed=["X_y"])), None),
}  # fmt: skip
"""What is odd: how it comes about, and what a decision says of it."""


@pytest.mark.parametrize("case", ODD)
def test_odd_inputs_are_accepted_and_what_matters_is_said(folder: Path, case: str):
    plain = inputs.read(folder)
    spoil, decision = ODD[case]
    spoil(folder)
    given = inputs.read(folder)
    assert given.photo.rgb.shape == (HEIGHT, WIDTH, 3)
    said = {f"{d.choice} {d.reason}" for d in given.decisions} - {f"{d.choice} {d.reason}" for d in plain.decisions}
    assert (decision is None and not said) or any(decision and decision in text for text in said), said
    for a, b in zip(given.instances, plain.instances, strict=True):
        assert np.array_equal(a.mask, b.mask)
        assert given.assets[a.id].mesh.diagonal == pytest.approx(plain.assets[a.id].mesh.diagonal, rel=0.2)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        ({"intrinsics": lambda K: K * [[1.02], [1.02], [1]]}, False),
        ({"intrinsics": lambda K: K * [[1.15], [1.15], [1]]}, True),
        ({"points": lambda p: np.ones_like(p)}, True),
    ],
)
def test_points_off_the_rays_of_their_pixels_are_a_fallback(folder: Path, spoil: dict[str, Any], told: bool):
    broken_inputs.geometry(**spoil)(folder)
    fallbacks = [d for d in inputs.read(folder).decisions if d.fallback]
    assert any("contradict" in d.choice and "degrees off the rays" in d.reason for d in fallbacks) is told


def test_a_shaded_cut_out_as_a_mask_is_a_fallback_and_soft_borders_are_none(folder: Path):
    mask = np.asarray(Image.open(folder / "masks" / BIG)) > 0
    shades = np.linspace(40, 250, WIDTH)[None].repeat(HEIGHT, 0)
    Image.fromarray(np.where(mask, shades, 0).astype(np.uint8)).save(folder / "masks" / BIG)
    (told,) = (d for d in inputs.read(folder).decisions if d.fallback)
    assert BIG in told.choice and "as in a cut-out of the photo" in told.reason
    Image.fromarray(gaussian_filter(255.0 * mask, 1.0).astype(np.uint8)).save(folder / "masks" / BIG)
    assert not [d for d in inputs.read(folder).decisions if d.fallback]


def test_masks_of_a_photo_that_exif_turns_are_told_so(folder: Path):
    turned_photo(folder)
    mask = np.asarray(Image.open(folder / "masks" / BIG)).T
    Image.fromarray(mask).save(folder / "masks" / BIG)
    with pytest.raises(InputError, match=f"{WIDTH}x{HEIGHT}: a photo is turned as its EXIF says"):
        inputs.read(folder)


# --- wrong inputs -----------------------------------------------------------------------------------------------------


def everything(place: Path) -> dict[str, tuple[int, int, int]]:
    """Kind, size and time of change of all below a folder."""
    found = {p.relative_to(place).as_posix(): p.lstat() for p in sorted(place.rglob("*"))}
    return {name: (s.st_mode, s.st_size, s.st_mtime_ns) for name, s in found.items()}


@pytest.mark.parametrize("case", WRONG)
def test_a_broken_input_gives_one_line_and_nothing_else(
    case: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    arguments, (_, where, found) = broken(case, tmp_path), WRONG[case]
    before = everything(tmp_path)
    start = time.perf_counter()
    code = main(arguments)
    seconds = time.perf_counter() - start
    out, err = capfd.readouterr()
    assert (code, out) == (2, "") and seconds < 5
    assert everything(tmp_path) == before
    assert err.startswith("f3sr: input") and err.count("\n") == 1 and err.strip().isprintable() and len(err) < 700
    place, _, rest = err.partition(": found ")
    what, _, accepted = rest.partition("; accepted: ")
    assert where in place and found in what and accepted.strip()
    assert broken_inputs.row(case, err.strip()) in table_lines(), "run: python tests/broken_inputs.py"


def table_lines() -> list[str]:
    return broken_inputs.TABLE.read_text().removeprefix(broken_inputs.HEAD).splitlines(keepends=True)


def test_the_table_in_the_docs_has_a_line_for_every_case():
    """The test above compares what the line says."""
    assert broken_inputs.TABLE.read_text().startswith(broken_inputs.HEAD)
    assert [line.split(" | ")[0] for line in table_lines()] == [f"| {name}" for name in WRONG]


def without_privileges() -> None:
    """Let file permissions count for root too: drop the two capabilities that pass them over."""
    libc = ctypes.CDLL(None)
    for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
        libc.prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


CLOSED = {"input": "input", "masks": "input/masks", "assets": "input/assets", "image.png": "input/image.png"}


SEVERAL = """
import os, sys
from f3sr.cli.main import main
for place in sys.argv[1:]:
    os.chdir(place)
    print(main(["reconstruct", "input", "-o", "new/out"]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="drops Linux capabilities")
def test_what_may_not_be_read_is_named(tmp_path: Path):
    """All in one process, which has fewer privileges than the tests."""
    places = {name: tmp_path / Path(path).name for name, path in CLOSED.items()}
    for name, place in places.items():
        write_folder(place / "input")
        (place / CLOSED[name]).chmod(0)
    command = [sys.executable, "-c", SEVERAL, *map(str, places.values())]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, preexec_fn=without_privileges)
    finally:
        for name, place in places.items():
            (place / CLOSED[name]).chmod(0o755)
    assert done.returncode == 0 and done.stdout.split() == ["2"] * len(CLOSED), done.stderr
    for said, name in zip(done.stderr.splitlines(), CLOSED, strict=True):
        assert said.startswith(f"f3sr: {CLOSED[name]}: found permission denied; ")
        assert not (places[name] / "new").exists()


@pytest.mark.parametrize("case", ["an npz bomb", "nodes in a circle", "poses.json nested 100,000 deep"])
def test_a_process_of_its_own_says_the_same(case: str, tmp_path: Path):
    broken(case, tmp_path)
    done = command(tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and WRONG[case][2] in done.stderr
    assert not (tmp_path / "new").exists()


def command(place: Path) -> subprocess.CompletedProcess[str]:
    arguments = [sys.executable, "-m", "f3sr", "reconstruct", "input", "-o", "new/out"]
    return forked.run(arguments, cwd=place)


def test_a_file_or_nothing_where_a_folder_is_meant(tmp_path: Path):
    (tmp_path / "file").write_text("x")
    for name, found in (("file", "a file"), ("absent", "nothing there"), ("x" * 5000, "file name too long")):
        with pytest.raises(InputError, match=found):
            inputs.read(tmp_path / name)


def test_messages_are_one_line_of_what_a_terminal_can_show():
    error = InputError("a\nb\x1b[31m", found="\u202egnp" + "x" * 1000, accepted="\ud800")
    assert str(error).isprintable() and "a\\nb\\x1b[31m" in str(error) and len(str(error)) < 400


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
