"""Input folders that must be refused: what is wrong, how a valid folder gets so, which file is named and what is found.

``python tests/broken_inputs.py`` writes docs/broken_inputs.md from what f3sr says of each.
"""

# ruff: noqa: E501 - a case a line

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import socket
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from folders import HEIGHT, WIDTH, add_graph, camera, to_depth, to_posed, write_folder
from hostile_npz import HOSTILE, npy

Spoil = Callable[[Path], Any]
EMPTY = np.zeros((HEIGHT, WIDTH))
BIG, SMALL, TALL = "02_big_box.png", "05_small_box.png", "07_tall_box.png"


def in_order(*steps: Spoil) -> Spoil:
    return lambda folder: [step(folder) for step in steps]


# --- files ------------------------------------------------------------------------------------------------------------


def write(name: str, data: bytes) -> Spoil:
    return lambda f: (f / name).write_bytes(data)


def remove(*names: str) -> Spoil:
    return lambda f: [(f / n).unlink() for n in names]


def replaced(name: str, make: Callable[[Path], Any]) -> Spoil:
    """Another kind of thing under the name of a file."""

    def apply(folder: Path) -> None:
        (folder / name).unlink(missing_ok=True)
        make(folder / name)

    return apply


def moved(name: str, to: str) -> Spoil:
    return lambda f: (f / name).rename(f / to)


def copied(name: str, to: str) -> Spoil:
    return lambda f: (f / to).write_bytes((f / name).read_bytes())


def truncated(name: str, share: float = 0.5) -> Spoil:
    return lambda f: (f / name).write_bytes((f / name).read_bytes()[: int(share * (f / name).stat().st_size)])


def bind_socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # the name of a socket may not be long
    with socket.socket(socket.AF_UNIX) as s:
        s.bind(path.name)
    os.chdir(here)


def sparse(path: Path) -> None:
    """A file of 3 GB that takes no room."""
    with path.open("wb") as file:
        file.truncate(3_000_000_000)


def outside(name: str) -> Spoil:
    """A link to a file beside the folder."""

    def apply(folder: Path) -> None:
        secret = folder.parent / f"secret{Path(name).suffix}"
        secret.write_bytes((folder / name).read_bytes())
        (folder / name).unlink()
        (folder / name).symlink_to(secret)

    return apply


# --- pictures ---------------------------------------------------------------------------------------------------------


def picture(name: str, pixels: np.ndarray) -> Spoil:
    return lambda f: Image.fromarray(pixels.astype(np.uint8)).save(f / name)


def mask(name: str, pixels: np.ndarray) -> Spoil:
    return picture(f"masks/{name}", pixels)


def saved_as(name: str, kind: str, **options: Any) -> Spoil:
    """A picture in another file format under its old name."""

    def apply(folder: Path) -> None:
        with Image.open(folder / name) as image:
            copy = image.convert("RGB")
        copy.save(folder / name, kind, **options)

    return apply


def png_header(width: int, height: int) -> bytes:
    """A PNG that claims a size and holds nothing of it."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(b""))]
    parts = [struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(n + b)) for n, b in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def animation(name: str) -> Spoil:
    frames = [Image.new("RGB", (WIDTH, HEIGHT), (k, 0, 0)) for k in (0, 90, 200)]
    return lambda f: frames[0].save(f / name, "PNG", save_all=True, append_images=frames[1:])


def share_of(a: str, b: str) -> Spoil:
    """A tenth of the first mask also in the second."""

    def apply(folder: Path) -> None:
        small, large = (np.asarray(Image.open(folder / "masks" / n)).copy() for n in (a, b))
        rows, columns = np.nonzero(small)
        large[rows[: len(rows) // 10], columns[: len(rows) // 10]] = 255
        Image.fromarray(large).save(folder / "masks" / b)

    return apply


# --- JSON -------------------------------------------------------------------------------------------------------------


def document(name: str, change: Callable[[dict[str, Any]], Any]) -> Spoil:
    def apply(folder: Path) -> None:
        tree = json.loads((folder / name).read_text())
        change(tree)
        (folder / name).write_text(json.dumps(tree))

    return apply


def poses(change: Callable[[dict[str, Any]], Any]) -> Spoil:
    return document("assets/poses.json", change)


def entry(**values: Any) -> Spoil:
    return poses(lambda d: d["objects"][0].update(values))


def intrinsics(**values: Any) -> Spoil:
    return in_order(to_depth, document("intrinsics.json", lambda d: d.update(values)))


def graph(text: str) -> Spoil:
    return write("scene_graph.json", text.encode())


def materials(*objects: Mapping[str, Any]) -> Spoil:
    return write("materials.json", json.dumps({"objects": objects}).encode())


def relation(**values: Any) -> Spoil:
    given = {"subject": 2, "predicate": "next_to", "object": 7, "confidence": 0.5} | values
    return graph(json.dumps({"relations": [given]}))


# --- geometry ---------------------------------------------------------------------------------------------------------


def geometry(**values: Any) -> Spoil:
    """Arrays of geometry.npz replaced; None drops one, a function changes one."""

    def apply(folder: Path) -> None:
        with np.load(folder / "geometry.npz") as archive:
            data = dict(archive)
        for key, value in values.items():
            data[key] = value(data[key]) if callable(value) else value
        np.savez(folder / "geometry.npz", **{k: v for k, v in data.items() if v is not None})

    return apply


def only_first(count: int) -> Spoil:
    """Only so many valid points."""

    def change(valid: np.ndarray) -> np.ndarray:
        return (np.cumsum(valid.ravel()).reshape(valid.shape) <= count) & valid

    return geometry(mask=change)


def blind_spot(folder: Path) -> None:
    """No valid geometry where the tall box is."""
    tall = np.asarray(Image.open(folder / "masks" / TALL))[::2, ::2] > 0
    wide = np.asarray(Image.fromarray(tall).resize((WIDTH // 2, HEIGHT // 2)))
    grown = wide | np.roll(wide, 2, 0) | np.roll(wide, -2, 0) | np.roll(wide, 2, 1) | np.roll(wide, -2, 1)
    geometry(mask=lambda valid: valid & ~grown)(folder)


def depth_map(pixels: np.ndarray | Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def apply(folder: Path) -> None:
        to_depth(folder)
        given = np.asarray(Image.open(folder / "depth.png"))
        Image.fromarray(pixels(given) if callable(pixels) else pixels).save(folder / "depth.png")

    return apply


def depth_array(change: Callable[[np.ndarray], Any]) -> Spoil:
    def apply(folder: Path) -> None:
        to_depth(folder)
        given = np.asarray(Image.open(folder / "depth.png")).astype(float)
        (folder / "depth.png").unlink()
        np.save(folder / "depth.npy", change(given))

    return apply


def depth_bytes(data: bytes) -> Spoil:
    """A depth.npy of other bytes."""
    return in_order(depth_array(lambda d: d), write("depth.npy", data))


def on_one_ray(folder: Path) -> None:
    points = np.zeros((HEIGHT // 2, WIDTH // 2, 3), np.float32) + np.array([0, 0, 1], np.float32)
    geometry(points=points, intrinsics=None)(folder)


def bomb(folder: Path) -> None:
    """A header that claims 4 GB, deflated to nothing much."""
    path = folder / "geometry.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("points.npy", bytes(1_000_000))
    data = path.read_bytes()
    path.write_bytes(data.replace((1_000_000).to_bytes(4, "little"), (4_000_000_000).to_bytes(4, "little")))


def no_array(folder: Path) -> None:
    with zipfile.ZipFile(folder / "geometry.npz", "w") as archive:
        archive.writestr("points.npy", b"no array at all")


# --- meshes -----------------------------------------------------------------------------------------------------------


def glb(tree: Any, binary: bytes = b"") -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(binary))
    head += struct.pack("<II", len(text), 0x4E4F534A) + text
    return head + struct.pack("<II", len(binary), 0x004E4942) + binary


def read_glb(data: bytes) -> tuple[dict[str, Any], bytes]:
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def gltf(change: Callable[[dict[str, Any]], Any]) -> Spoil:
    """The JSON part of the big box's GLB changed, its lengths right."""

    def apply(folder: Path) -> None:
        tree, binary = read_glb((folder / "assets/02.glb").read_bytes())
        change(tree)
        (folder / "assets/02.glb").write_bytes(glb(tree, binary))

    return apply


def accessor(k: int, **values: Any) -> Spoil:
    return gltf(lambda t: t["accessors"][k].update(values))


def header(at: int, value: int) -> Spoil:
    """Another integer in the first bytes of the GLB."""

    def apply(folder: Path) -> None:
        data = bytearray((folder / "assets/02.glb").read_bytes())
        data[at : at + 4] = struct.pack("<I", value)
        (folder / "assets/02.glb").write_bytes(data)

    return apply


def vertices(change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    def apply(folder: Path) -> None:
        from f3sr.io.mesh_files import load_mesh, save_glb

        mesh = load_mesh(folder / "assets/02.glb")
        save_glb(mesh.with_vertices(change(np.array(mesh.vertices))), folder / "assets/02.glb")

    return apply


def numbers(key: str, kind: str, value: Any) -> Spoil:
    """The first numbers of the positions or indices, as they are in the file."""

    def apply(folder: Path) -> None:
        tree, binary = read_glb((folder / "assets/02.glb").read_bytes())
        primitive = tree["meshes"][0]["primitives"][0]
        index = primitive["indices"] if key == "indices" else primitive["attributes"][key]
        start = tree["bufferViews"][tree["accessors"][index]["bufferView"]]["byteOffset"]
        data = np.array(value, kind).tobytes()
        binary = binary[:start] + data + binary[start + len(data) :]
        (folder / "assets/02.glb").write_bytes(glb(tree, binary))

    return apply


def packed(**changes: Any) -> Spoil:
    """The first view of a GLB claims that meshoptimizer packed it."""

    def change(tree: Any) -> None:
        view = tree["bufferViews"][0]
        claim = {"buffer": 0, "byteOffset": view.get("byteOffset", 0), "byteLength": view["byteLength"]}
        view["extensions"] = {"EXT_meshopt_compression": {**claim, "mode": "ATTRIBUTES", **changes}}
        tree["extensionsRequired"] = ["EXT_meshopt_compression"]

    return gltf(change)


def textured(image: bytes | None, **info: Any) -> Spoil:
    """The big box with a picture on it."""

    def apply(folder: Path) -> None:
        from f3sr.io.mesh_files import save_glb
        from scenes import box_mesh

        save_glb(box_mesh((0.16, 0.08, 0.12), textured=True), folder / "assets/02.glb")
        tree, binary = read_glb((folder / "assets/02.glb").read_bytes())
        if image is not None:
            tree["images"][0]["bufferView"] = len(tree["bufferViews"])
            tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(image)})
            tree["buffers"][0]["byteLength"] = len(binary) + len(image)
            binary += image
        tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"].update(info)
        (folder / "assets/02.glb").write_bytes(glb(tree, binary))

    return apply


def encoded(kind: str) -> bytes:
    out = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)).save(out, kind)
    return out.getvalue()


def layers(count: int) -> Spoil:
    return gltf(lambda t: t.update(nodes=[{"mesh": 0}] * count, scenes=[{"nodes": list(range(count))}]))


def nodes(*given: dict[str, Any]) -> Spoil:
    return gltf(lambda t: t.update(nodes=list(given), scenes=[{"nodes": [0]}]))


def many_nodes(tree: dict[str, Any]) -> None:
    tree["nodes"] = [{"mesh": 0}] * 20_000
    tree["scenes"] = [{"nodes": list(range(20_000))}]


def many_primitives(tree: dict[str, Any]) -> None:
    tree["meshes"][0]["primitives"] *= 200
    tree["nodes"] = [{"mesh": 0}] * 200
    tree["scenes"] = [{"nodes": list(range(200))}]


def far_pose(z: float) -> Spoil:
    return poses(lambda d: d["objects"][0]["translation"].__setitem__(2, z))


# --- all of it --------------------------------------------------------------------------------------------------------

WRONG: dict[str, tuple[Spoil, str, str]] = {
    # the folder and its photo
    "no photo": (remove("image.png"), "input", "no image"),
    "two photos": (write("image.jpg", b""), "input", "image.jpg, image.png"),
    "an empty photo": (write("image.png", b""), "image.png", "no readable image"),
    "a photo cut off": (truncated("image.png"), "image.png", "damaged"),
    "a photo in another format": (saved_as("image.png", "BMP"), "image.png", "another format"),
    "a photo that claims 40,000 x 40,000 pixels": (write("image.png", png_header(40_000, 40_000)), "image.png", "pixels"),
    "a photo that claims 12,000 x 10,000 pixels": (write("image.png", png_header(12_000, 10_000)), "image.png", "12000x"),
    "a photo of one pixel": (picture("image.png", np.zeros((1, 1, 3))), "image.png", "1x1"),
    "an animated photo": (animation("image.png"), "image.png", "animation"),
    "a photo that is a pipe": (replaced("image.png", os.mkfifo), "image.png", "a pipe"),
    "a photo that is a socket": (replaced("image.png", bind_socket), "image.png", "a socket"),
    "a photo that is a folder": (replaced("image.png", Path.mkdir), "image.png", "a folder"),
    "a photo that links to /dev/zero": (replaced("image.png", lambda p: p.symlink_to("/dev/zero")), "input", "leaves"),
    "a photo that links to itself": (replaced("image.png", lambda p: p.symlink_to(p.name)), "input", "image.png"),
    "a photo of 3 GB": (replaced("image.png", sparse), "image.png", "3,000,000,000 bytes"),
    # masks
    "no masks": (in_order(*(remove(f"masks/{n}") for n in (BIG, SMALL, TALL))), "masks", "no masks"),
    "a file where masks/ is meant": (
        in_order(moved("masks", "other"), write("masks", b"")), "masks", "not a directory",
    ),
    "masks/ links out of the folder": (
        lambda f: ((f / "masks").rename(f.parent / "m"), (f / "masks").symlink_to(f.parent / "m")), "input", "leaves",
    ),
    "a mask of another size": (mask(BIG, np.ones((20, 20)) * 255), BIG, "20x20"),
    "a mask of nothing": (mask(BIG, EMPTY), BIG, "0 set pixels"),
    "a mask of three pixels": (mask(BIG, np.arange(EMPTY.size).reshape(EMPTY.shape) < 3), BIG, "3 set pixels"),
    "a mask of zero bytes": (write(f"masks/{BIG}", b""), BIG, "no readable image"),
    "a damaged mask": (truncated(f"masks/{BIG}", 0.8), BIG, "damaged"),
    "a mask that is no PNG": (write("masks/08_x.jpg", b""), "masks", "08_x.jpg"),
    "an id twice": (mask("2_again.png", EMPTY + 255), "masks", "id 2 twice"),
    "ids in some names only": (mask("cup.png", EMPTY + 255), "masks", "with and without an id"),
    "an id of 20 digits": (mask("99999999999999999999_x.png", EMPTY + 255), "masks", "the id of"),
    "masks that overlap": (share_of(SMALL, BIG), SMALL, "also in 02_big_box.png"),
    "a mask that covers all others": (mask("09_all.png", EMPTY + 255), "masks", "also in"),
    "names that differ by case": (copied(f"masks/{BIG}", "masks/02_BIG_box.png"), "masks", "02_BIG_box.png"),
    "a name with a line break": (copied(f"masks/{BIG}", "masks/08\nx.png"), "masks", "08\\nx.png"),
    "a name with terminal codes": (copied(f"masks/{BIG}", "masks/08\x1b[31m.png"), "masks", "08\\x1b[31m.png"),
    "a name that turns the text around": (copied(f"masks/{BIG}", "masks/08\u202egnp.png"), "masks", "08\\u202egnp"),
    "a name with a backslash": (copied(f"masks/{BIG}", "masks/08\\x.png"), "masks", "08\\\\x.png"),
    "a mask more than assets": (mask("08_" + "x" * 240 + ".png", EMPTY + (np.indices(EMPTY.shape)[0] < 9)), "poses", "08_x"),
    # ground
    "a ground mask of nothing": (picture("ground.png", EMPTY), "ground.png", "0 set pixels"),
    "a ground mask of another size": (picture("ground.png", np.ones((50, 50))), "ground.png", "50x50"),
    "a ground mask that links to nothing": (
        replaced("ground.png", lambda p: p.symlink_to("nowhere")), "ground.png", "no such file",
    ),
    "ground only where objects are": (copied(f"masks/{BIG}", "ground.png"), "ground.png", "outside the object masks"),
    # geometry.npz
    "two kinds of geometry": (write("depth.png", b""), "input", "geometry.npz and depth.png"),
    "an empty npz": (write("geometry.npz", b""), "geometry.npz", "no readable npz"),
    "a broken npz": (write("geometry.npz", b"PK\x03\x04junk"), "geometry.npz", "no readable npz"),
    "an npz cut off": (truncated("geometry.npz"), "geometry.npz", "no readable npz"),
    "an npz member that is no array": (no_array, "geometry.npz", "points that is no array"),
    "an npz bomb": (bomb, "geometry.npz", "points that is no array"),
    "pickled objects": (geometry(points=np.array([{}], object)), "geometry.npz", "Python objects"),
    **{
        f"points with {case}": (lambda f, case=case: HOSTILE[case][0](f / "geometry.npz", "points"), "geometry.npz", found)
        for case, found in (
            ("U0 of 10^12 elements", "points of type"),
            ("a shape of 10^400", "shape beyond"),
            ("9,000 brackets", "header of 9,000 bytes"),
            ("9,000 minus signs", "header of 9,001 bytes"),
            ("fewer bytes than it claims", "points (3,)"),
            ("complex numbers", "complex numbers"),
            ("an encrypted entry", "encrypted"),
            ("entries that overlap", "overlap"),
            ("600,000 entries", "directory of"),
        )
    },
    "points of the wrong shape": (geometry(points=np.zeros((4, 4))), "geometry.npz", "(4, 4)"),
    "points of whole numbers": (geometry(points=lambda p: p.astype(int)), "geometry.npz", "int64"),
    "points of text": (geometry(points=lambda p: p.astype("U4")), "geometry.npz", "<U4"),
    "a mask of another shape than the points": (geometry(mask=np.ones((3, 3))), "geometry.npz", "mask (3, 3)"),
    "no valid depth": (geometry(mask=np.zeros((HEIGHT // 2, WIDTH // 2), bool)), "geometry.npz", "no valid depth"),
    "points that are all NaN": (geometry(points=lambda p: p * np.nan), "geometry.npz", "no valid depth"),
    "one valid point": (only_first(1), "geometry.npz", "1 valid pixels"),
    "no valid point in a mask": (blind_spot, TALL, "no valid geometry"),
    "points 1e30 times too large": (geometry(points=lambda p: p * np.float32(1e30)), "geometry.npz", "median depth"),
    "points a million times too small": (geometry(points=lambda p: p * np.float32(1e-6)), "geometry.npz", "median depth"),
    "points behind the camera": (geometry(points=lambda p: -p), "geometry.npz", "no valid depth"),
    "points on one ray, no intrinsics": (on_one_ray, "geometry.npz", "one line of sight"),
    "an unknown camera frame": (geometry(coordinate_system="left"), "geometry.npz", "'left'"),
    "a focal length of zero": (geometry(intrinsics=np.zeros((3, 3))), "geometry.npz", "K ="),
    "a focal length below zero": (geometry(intrinsics=np.diag([-1.0, 1, 1])), "geometry.npz", "K ="),
    "a focal length in pixels": (geometry(intrinsics=camera().K), "geometry.npz", "44160"),
    "a principal point miles away": (
        geometry(intrinsics=lambda K: K + np.array([[0, 0, 1e6], [0, 0, 0], [0, 0, 0]])), "geometry.npz", "K =",
    ),
    "intrinsics with NaN": (geometry(intrinsics=lambda K: K * np.nan), "geometry.npz", "K ="),
    # depth maps
    "intrinsics alone, pixels not square": (
        in_order(intrinsics(K=[[200, 0, 96], [0, 150, 72], [0, 0, 1]]), remove("depth.png")),
        "intrinsics.json",
        "fx",
    ),
    "two depth maps": (in_order(to_depth, write("depth.npy", b"")), "input", "depth.png and depth.npy"),
    "a depth map of 8 bits": (depth_map(np.full((72, 96), 200, np.uint8)), "depth.png", "kind L"),
    "a depth map in colour": (depth_map(np.full((72, 96, 3), 200, np.uint8)), "depth.png", "kind RGB"),
    "a depth map of zeros": (depth_map(lambda d: d * 0), "depth.png", "no valid depth"),
    "a depth map of another aspect": (depth_map(lambda d: d[:40]), "depth.png", "96x40"),
    "a depth map in three dimensions": (depth_array(lambda d: d[..., None]), "depth.npy", "(72, 96, 1)"),
    "a depth map that is all infinite": (depth_array(lambda d: d + np.inf), "depth.npy", "no valid depth"),
    "a depth map of Python objects": (depth_array(lambda d: d.astype(object)), "depth.npy", "Python objects"),
    "a depth map of 10^12 empty texts": (
        depth_bytes(npy("'<U0'", f"({10**12}, 1)")), "depth.npy", "depth of type",
    ),
    "a depth map of 10^11 numbers": (depth_bytes(npy("'<f8'", f"({10**11}, 1)")), "depth.npy", "more than 100,000,000"),
    "a depth map with a header of brackets": (depth_bytes(npy("", "", header="(" * 9000)), "depth.npy", "header of 9,000"),
    "a depth map cut off": (depth_bytes(npy("'<f8'", "(72, 96)", bytes(80))), "depth.npy", "in a file of"),
    "a depth scale of 1e30": (intrinsics(depth_scale=1e30), "depth.png", "median depth"),
    "a depth scale of zero": (intrinsics(depth_scale=0), "intrinsics.json", "depth_scale"),
    "K of text": (intrinsics(K=[["200", "0", "50"], ["0", "200", "40"], ["0", "0", "1"]]), "intrinsics.json", "K.0.0"),
    "K of truth values": (intrinsics(K=[[True, 0, 50], [0, 200, 40], [0, 0, 1]]), "intrinsics.json", "K.0.0"),
    "K with NaN": (intrinsics(K=[[float("nan"), 0, 50], [0, 200, 40], [0, 0, 1]]), "intrinsics.json", "NaN"),
    "K of 1e308": (intrinsics(K=[[1e308, 0, 50], [0, 200, 40], [0, 0, 1]]), "intrinsics.json", "K ="),
    "K of two rows": (intrinsics(K=[[200, 0, 50], [0, 200, 40]]), "intrinsics.json", "K = [["),
    "K of a width of -1": (intrinsics(width=-1), "intrinsics.json", "width"),
    # poses.json
    "a file where assets/ is meant": (
        in_order(moved("assets", "other"), write("assets", b"")), "assets", "not a directory",
    ),
    "no poses for a mask": (poses(lambda d: d["objects"].pop()), "poses.json", "no asset for 07_tall_box.png"),
    "a pose for no mask": (
        poses(lambda d: d["objects"].append(d["objects"][0] | {"mask": "99.png"})), "poses.json", "unknown masks 99.png",
    ),
    "two poses for a mask": (poses(lambda d: d["objects"].append(d["objects"][0])), "poses.json", "two poses"),
    "a mesh for no mask": (copied("assets/02.glb", "assets/88.glb"), "88.glb", "a mesh of no mask"),
    "poses.json that is no JSON": (write("assets/poses.json", b"{"), "poses.json", "no valid JSON"),
    "poses.json of zero bytes": (write("assets/poses.json", b""), "poses.json", "no valid JSON"),
    "poses.json in UTF-16": (
        lambda f: (f / "assets/poses.json").write_text((f / "assets/poses.json").read_text(), "utf-16"),
        "poses.json", "not UTF-8",
    ),
    "poses.json nested 100,000 deep": (write("assets/poses.json", b"[" * 100_000), "poses.json", "nested too deeply"),
    "a key twice": (write("assets/poses.json", b'{"objects": [], "objects": []}'), "poses.json", "'objects' twice"),
    "a number of 6000 digits": (write("assets/poses.json", b'{"a": ' + b"9" * 6000 + b"}"), "poses.json", "6000 digits"),
    "poses.json of 11 MB": (write("assets/poses.json", b" " * 11_000_000), "poses.json", "11,000,000 bytes"),
    "a list where an object is meant": (write("assets/poses.json", b"[]"), "poses.json", "the document"),
    "an unknown convention": (poses(lambda d: d.update(convention="mine")), "poses.json", "mine"),
    "a quaternion too long": (entry(rotation=[1, 0, 0, 1]), "poses.json", "quaternion"),
    "a quaternion of 1e200": (entry(rotation=[1e200] * 4), "poses.json", "quaternion"),
    "a whole number of 400 digits": (entry(translation=[0, 0, 10**399]), "poses.json", "translation.2"),
    "a quaternion of three numbers": (entry(rotation=[1, 0, 0]), "poses.json", "rotation"),
    "a quaternion of text": (entry(rotation=["1", "0", "0", "0"]), "poses.json", "rotation.0"),
    "a scale of zero": (entry(scale=[0, 0, 0]), "poses.json", "scale"),
    "a scale below zero": (entry(scale=[-1, -1, -1]), "poses.json", "scale"),
    "a scale that is not uniform": (entry(scale=[1, 1, 2]), "poses.json", "scale"),
    "a scale of true": (entry(scale=True), "poses.json", "scale"),
    "a scale of 1e-12": (entry(scale=[1e-12] * 3), "poses.json", "an object of"),
    "a scale of 1e308": (entry(scale=[1e308] * 3), "poses.json", "an object of"),
    "a scale of 1e12": (entry(scale=[1e12] * 3), "poses.json", "an object of"),
    "a translation with NaN": (entry(translation=[0, 0, float("nan")]), "poses.json", "NaN"),
    "a translation of 1e999": (
        lambda f: (f / "assets/poses.json").write_text(
            (f / "assets/poses.json").read_text().replace('"translation": [', '"translation": [1e999, ', 1)
        ),
        "poses.json", "translation",
    ),
    "a translation of null": (entry(translation=[0, 0, None]), "poses.json", "translation.2"),
    "a pose behind the camera": (far_pose(-0.7), "poses.json", "behind the camera"),
    "a pose a billion metres to the side": (
        poses(lambda d: d["objects"][0]["translation"].__setitem__(0, 1e9)), "poses.json", "times its own size away",
    ),
    "a pose ten kilometres away": (far_pose(1e4), "poses.json", "at depth 1e+04 m"),
    "a mesh file that is missing": (entry(mesh="nope.glb"), "nope.glb", "no such file"),
    "a mesh path with ../": (entry(mesh="../../../etc/passwd"), "assets", "leaves the folder"),
    "an absolute mesh path": (entry(mesh="/etc/passwd"), "assets", "leaves the folder"),
    "a mesh that links out of the folder": (outside("assets/02.glb"), "assets", "leaves the folder"),
    "a mesh name with NUL": (entry(mesh="a\0b.glb"), "assets", "path"),
    "a mesh name with a lone surrogate": (entry(mesh="\ud800.glb"), "assets", "path"),
    "a mesh name of 5000 characters": (entry(mesh="x" * 5000), "assets", "5000 characters"),
    "a mesh of another type": (entry(mesh="poses.json"), "poses.json", "type '.json'"),
    "a mask name with a path": (entry(mask="/etc/02_big_box.png"), "poses.json", "mask"),
    # meshes
    "a mesh that is no GLB": (write("assets/02.glb", b"hello"), "02.glb", "broken glTF"),
    "a GLB of zero bytes": (write("assets/02.glb", b""), "02.glb", "broken glTF"),
    "a GLB cut off": (truncated("assets/02.glb", 0.9), "02.glb", "a claimed length of"),
    "a GLB of version 1": (header(4, 1), "02.glb", "version 1"),
    "a GLB whose length is wrong": (header(8, 2**31), "02.glb", "a claimed length"),
    "a GLB whose JSON is longer than the file": (header(12, 2**32 - 1), "02.glb", "a claimed length"),
    "an external buffer": (gltf(lambda t: t["buffers"][0].update(uri="http://x/y.bin")), "02.glb", "a reference to"),
    "an external picture": (gltf(lambda t: t.update(images=[{"uri": "../x.png"}])), "02.glb", "a reference to '../x.png'"),
    "a data URI that is no base64": (gltf(lambda t: t["buffers"][0].update(uri="data:,x%20y")), "02.glb", "not base64"),
    "a buffer longer than the file": (gltf(lambda t: t["buffers"][0].update(byteLength=10**9)), "02.glb", "buffer 0"),
    "a buffer view beyond its buffer": (
        gltf(lambda t: t["bufferViews"][0].update(byteOffset=10**9)), "02.glb", "bufferView 0 beyond",
    ),
    "an accessor beyond its view": (accessor(0, count=1000), "02.glb", "accessor 0 of 1000"),
    "an accessor of a billion vertices": (accessor(0, count=10**9), "02.glb", "1,000,000,000 vertices"),
    "an accessor below zero": (accessor(0, count=-1), "02.glb", "accessors.0.count"),
    "a sparse accessor": (accessor(0, sparse={"count": 1}), "02.glb", "sparse"),
    "positions of an unknown type": (accessor(0, componentType=5130), "02.glb", "component type 5130"),
    "vertices without colours": (accessor(0, count=3), "02.glb", "colours for 3 vertices"),
    "faces of vertices that do not exist": (numbers("indices", "<u4", 99), "02.glb", "vertices that do not exist"),
    "an index that does not exist": (gltf(lambda t: t["nodes"][0].update(mesh=7)), "02.glb", "mesh 7 of 1"),
    "draco compression": (gltf(lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"])), "02.glb", "KHR_draco"),
    "bytes that meshoptimizer did not pack": (packed(count=8, byteStride=12), "02.glb", "do not unpack"),
    "packed bytes that claim 2 GB": (packed(count=10**8, byteStride=24), "02.glb", "once unpacked"),
    "packed bytes in no known mode": (packed(count=8, byteStride=12, mode="ZIP"), "02.glb", "a compression that"),
    "packed bytes beyond the file": (packed(count=8, byteStride=12, byteLength=10**9), "02.glb", "beyond the"),
    "lines instead of triangles": (
        gltf(lambda t: t["meshes"][0]["primitives"][0].update(mode=1)), "02.glb", "mode 1",
    ),
    "half a triangle": (accessor(2, count=35), "02.glb", "35 corners"),
    "no faces": (gltf(lambda t: t.update(scenes=[{"nodes": []}])), "02.glb", "no faces"),
    "20,000 nodes": (gltf(many_nodes), "02.glb", "20,000 nodes"),
    "40,000 primitives": (gltf(many_primitives), "02.glb", "more than 10,000 primitives"),
    "nodes in a circle": (nodes({"mesh": 0, "children": [1]}, {"children": [0]}), "02.glb", "reached twice"),
    "a node shown twice": (nodes({"children": [1, 1]}, {"mesh": 0}), "02.glb", "reached twice"),
    "a matrix of 15 numbers": (nodes({"mesh": 0, "matrix": [1.0] * 15}), "02.glb", "matrix"),
    "nodes that scale by 1e200 twice": (
        nodes({"scale": [1e200] * 3, "children": [1]}, {"mesh": 0, "scale": [1e200] * 3}), "02.glb", "beyond",
    ),
    "a matrix of 1e300": (nodes({"mesh": 0, "matrix": [1e300, 0, 0, 0] * 4}), "02.glb", "beyond"),
    "a vertex that is NaN": (numbers("POSITION", "<f4", np.nan), "02.glb", "NaN, infinite"),
    "a vertex a million metres away": (numbers("POSITION", "<f4", 1e6), "02.glb", "thinner than"),
    "a mesh like a hair": (vertices(lambda v: v * [1, 1e-6, 1e-6]), "02.glb", "thinner than"),
    "triangles of no area": (numbers("indices", "<u4", [k // 3 % 8 for k in range(36)]), "02.glb", "no triangle that has an area"),
    "a mesh of 300 layers": (layers(300), "02.glb", "times its diagonal squared"),
    "a flat mesh": (vertices(lambda v: v * [1, 1, 0]), "02.glb", "flat"),
    "a mesh that is a point": (vertices(lambda v: v * 0), "02.glb", "flat"),
    "a texture that claims 20,000 x 20,000 pixels": (textured(png_header(20_000, 20_000)), "02.glb", "too many pixels"),
    "a texture that claims 10,000 x 10,000 pixels": (textured(png_header(10_000, 10_000)), "02.glb", "100,000,000 pixels"),
    "a damaged texture": (textured(encoded("PNG")[:-100]), "02.glb", "damaged"),
    "a texture in another format": (textured(encoded("TIFF")), "02.glb", "another format"),
    "a texture with a bad transform": (
        textured(None, extensions={"KHR_texture_transform": {"scale": [1]}}), "02.glb", "KHR_texture_transform",
    ),
    "a texture that does not exist": (textured(None, index=3), "02.glb", "texture 3 of 1"),
    # posed GLBs
    "posed GLBs, one missing": (in_order(to_posed, remove("assets/05.glb")), "assets", "no GLB for mask 05_small_box"),
    "posed GLBs, one too many": (
        in_order(to_posed, copied("assets/02.glb", "assets/88.glb")), "88.glb", "a mesh of no mask",
    ),
    "posed GLBs, two for a mask": (
        in_order(to_posed, copied("assets/02.glb", "assets/2.glb")), "assets", "02.glb, 2.glb for mask",
    ),
    # scene_graph.json
    "a graph of a stranger": (relation(object=44), "scene_graph.json", "2 next_to 44"),
    "a graph of an object with itself": (relation(object=2), "scene_graph.json", "2 next_to 2"),
    "a graph with a typing error": (graph('{"realtions": []}'), "scene_graph.json", "neither"),
    "a graph with an unknown predicate": (relation(predicate="loves"), "scene_graph.json", "predicate"),
    "a graph with ids of text": (relation(subject="2"), "scene_graph.json", "subject"),
    "a graph with ids of truth values": (relation(subject=True), "scene_graph.json", "subject"),
    "a graph with a confidence of 2": (relation(confidence=2), "scene_graph.json", "confidence"),
    "a graph that is a list": (graph("[]"), "scene_graph.json", "the document"),
    "a graph that links to nothing": (
        in_order(add_graph, replaced("scene_graph.json", lambda p: p.symlink_to("nowhere"))),
        "scene_graph.json", "no such file",
    ),
    "a graph of a hundred thousand relations": (
        graph(json.dumps({"relations": [{"subject": 2, "predicate": "next_to", "object": 5}] * 100_000})),
        "scene_graph.json", "relations",
    ),
    "a graph with a reason of a novel": (
        graph(json.dumps({"support_relations": [{"upper": 5, "lower": 2, "reason": "x" * 5000}]})),
        "scene_graph.json", "reason",
    ),
    # materials.json
    "materials of a stranger": (materials({"id": 44, "density": 700}), "materials.json", "object 44"),
    "materials given twice": (
        materials({"id": 2, "density": 700}, {"id": 2, "friction": 0.3}), "materials.json", "object 2 twice",
    ),
    "materials without a property": (materials({"id": 2, "reason": "heavy"}), "materials.json", "no property"),
    "materials with a typing error": (materials({"id": 2, "desnity": 700}), "materials.json", "desnity"),
    "a density in g/cm3": (materials({"id": 2, "density": 0.7}), "materials.json", "density"),
    "a friction of text": (materials({"id": 2, "friction": "high"}), "materials.json", "friction"),
    "materials that are a list": (write("materials.json", b"[]"), "materials.json", "the document"),
}  # fmt: skip
"""What is wrong: how it comes about, the file that the error names, and what the error says it found."""

TABLE = Path(__file__).parents[1] / "docs" / "broken_inputs.md"
HEAD = """# What f3sr says of broken inputs

Each of these folders is refused with one line, exit code 2, within 5 seconds, and nothing is written. The tests make this
table from the messages themselves: `python tests/broken_inputs.py` writes it anew.

| what is wrong | what f3sr says |
| --- | --- |
"""


def table(messages: dict[str, str]) -> str:
    """The page of docs from the messages by case."""
    return HEAD + "".join(row(name, text) for name, text in messages.items())


def row(name: str, text: str) -> str:
    """The line of a case."""
    text = re.sub("x{20,}", "x...x", text.removeprefix("f3sr: ").replace("|", "\\|"))
    return f"| {name} | `{text}` |\n"


def broken(name: str, place: Path) -> list[str]:
    """A broken folder below ``place``, and the arguments of the command that should refuse it."""
    write_folder(place / "input")
    WRONG[name][0](place / "input")
    return ["reconstruct", "input", "-o", "new/out"]


def said(name: str) -> str:
    """What the command says of a broken folder."""
    from f3sr.cli.main import main

    errors = io.StringIO()
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place), contextlib.redirect_stderr(errors):
        main(broken(name, Path(place)))
    return errors.getvalue().strip()


if __name__ == "__main__":
    TABLE.write_text(table({name: said(name) for name in WRONG}))
