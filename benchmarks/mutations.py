"""Seeded damage to input folders: bytes, files, and values inside JSON, GLB, PNG and npz that stay well formed."""

from __future__ import annotations

import copy
import io
import json
import os
import shutil
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

Rng = np.random.Generator
Mutation = Callable[[Path, Rng], str]
"""Changes a folder in place and says what it did in a few words."""

HOSTILE: list[Any] = [
    *(None, True, False, 0, 1, -1, 2, 3, 255, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**53 + 1, 2**63, 10**40, -(10**9)),
    *(0.0, -0.0, 0.5, 1e-300, 1e-30, 1e-12, 1e12, 1e30, 1e300, -1e300, float("nan"), float("inf"), float("-inf")),
    *(
        "",
        "x",
        "1.0",
        "NaN",
        "../../etc/passwd",
        "/etc/passwd",
        "a\0b",
        "\ud800",
        "\x1b[31mred\x07",
        "x" * 5000,
        "a\nb",
    ),
    *("\u202egnp.exe", "data:,", "data:application/octet-stream;base64,AAAA", "data:x;base64,%%%", "file:///dev/zero"),
    *([], {}, [[]], [1, 2, 3], [[1, 2, 3]], [None] * 3, {"a": 1}, [0.0] * 4, [1] * 1000),
]
NAMES = [
    *(
        "x",
        "99_new",
        "099",
        "2",
        "02",
        "00",
        "ä ö",
        "a\nb",
        "\x1b[31m",
        "\u202egnp",
        "-rf",
        "n" * 240,
        ".hidden",
        "con",
        "%s",
    ),
    *("02_BIG_BOX", "08\\x", "7_c:d", "image", "poses", "٣", "²", "1e5", "0x10"),
]
"""File stems."""
INTEGERS = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]


def pick(rng: Rng, values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def files_of(folder: Path, *suffixes: str) -> list[Path]:
    """Regular files below a folder, sorted; with suffixes only those."""
    found = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.is_symlink())
    return [p for p in found if not suffixes or p.suffix.lower() in suffixes]


# --- bytes ------------------------------------------------------------------------------------------------------------


def damage(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """Bytes after one low-level accident."""
    n = len(data)
    a, b = sorted(int(v) for v in rng.integers(0, n + 1, 2))
    kind = pick(rng, ["flip", "flip", "noise", "truncate", "zero", "repeat", "cut", "append", "integer", "swap"])
    changed = bytearray(data)
    if kind == "flip" and n:
        for at in rng.integers(0, n, int(rng.integers(1, 9))):
            changed[at] ^= 1 << int(rng.integers(8))
    elif kind == "noise" and n:
        for at in rng.integers(0, n, int(rng.integers(1, 65))):
            changed[at] = int(rng.integers(256))
    elif kind == "truncate":
        changed = changed[:a]
    elif kind == "zero":
        changed[a:b] = bytes(b - a)
    elif kind == "repeat":
        changed[b:b] = changed[a:b]
    elif kind == "cut":
        del changed[a:b]
    elif kind == "append":
        changed += rng.bytes(int(rng.integers(1, 200)))
    elif kind == "integer" and n >= 4:
        at = int(rng.integers(n - 3))
        changed[at : at + 4] = struct.pack("<I" if rng.random() < 0.5 else ">I", pick(rng, INTEGERS))
    elif kind == "swap":
        half = (b - a) // 2
        changed[a : a + half], changed[a + half : a + 2 * half] = data[a + half : a + 2 * half], data[a : a + half]
    return bytes(changed), kind


def raw_bytes(folder: Path, rng: Rng) -> str:
    path = pick(rng, files_of(folder))
    data, kind = damage(path.read_bytes(), rng)
    path.write_bytes(data)
    return f"{path.name}: {kind}"


# --- files ------------------------------------------------------------------------------------------------------------


def swap_files(folder: Path, rng: Rng) -> str:
    a, b = pick(rng, files_of(folder)), pick(rng, files_of(folder))
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    b.write_bytes(first)
    return f"{a.name} <-> {b.name}"


def same_kind_swap(folder: Path, rng: Rng) -> str:
    """Files of one kind change places, or one is written over another."""
    a = pick(rng, files_of(folder))
    b = pick(rng, files_of(folder, a.suffix.lower()))
    first, second = a.read_bytes(), b.read_bytes()
    a.write_bytes(second)
    if rng.random() < 0.5:
        b.write_bytes(first)
    return f"{b.name} -> {a.name}"


def rename(folder: Path, rng: Rng) -> str:
    path = pick(rng, files_of(folder))
    suffix = (
        path.suffix if rng.random() < 0.7 else pick(rng, [".png", ".PNG", ".glb", ".jpg", ".json", ".npz", "", ".txt"])
    )
    target = path.with_name(f"{pick(rng, NAMES)}{suffix}")
    if rng.random() < 0.3:
        target = target.parent.parent / target.name if target.parent != folder else folder / "masks" / target.name
    path.rename(target)
    return f"{path.name} -> {target.name}"


def copy_file(folder: Path, rng: Rng) -> str:
    path = pick(rng, files_of(folder))
    target = path.with_name(f"{pick(rng, NAMES)}{path.suffix}")
    shutil.copyfile(path, target)
    return f"{path.name} also as {target.name}"


def delete(folder: Path, rng: Rng) -> str:
    path = pick(rng, [p for p in sorted(folder.rglob("*")) if p.exists()])
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    return f"{path.name} gone"


def empty(folder: Path, rng: Rng) -> str:
    path = pick(rng, files_of(folder))
    path.write_bytes(b"")
    return f"{path.name} empty"


def special_file(folder: Path, rng: Rng) -> str:
    """Links, pipes, sockets and folders where files are meant."""
    path = pick(rng, files_of(folder))
    kind = pick(
        rng, ["self", "outside", "/dev/zero", "/dev/null", "folder", "fifo", "socket", "dangling", "inside", "dir"]
    )
    data = path.read_bytes()
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    elif kind == "socket":
        _socket(path)
    elif kind == "inside":
        path.with_name("kept").write_bytes(data)
        path.symlink_to("kept")
    elif kind == "outside":
        outside = folder.parent / f"outside{path.suffix}"
        outside.write_bytes(data)
        path.symlink_to(outside)
    elif kind == "dir":  # a folder of the input is a link
        path.write_bytes(data)
        place = pick(rng, ["masks", "assets"])
        if (folder / place).is_dir():
            (folder / place).rename(folder / "moved")
            (folder / place).symlink_to("moved")
    else:
        path.symlink_to({"self": path.name, "dangling": "nowhere"}.get(kind, kind))
    return f"{path.name}: {kind}"


def _socket(path: Path) -> None:
    """Bind a socket under a path of any length."""
    here = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as s:
            s.bind(path.name[:100])
    finally:
        os.chdir(here)


# --- JSON -------------------------------------------------------------------------------------------------------------


def places(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to every value of a JSON tree, the whole first."""
    found = [path]
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        found += places(value, (*path, key))
    return found


def change_tree(tree: Any, rng: Rng) -> tuple[Any, str]:
    """A JSON tree with one value replaced, scaled, dropped, doubled or moved."""
    tree = copy.deepcopy(tree)
    path = pick(rng, places(tree)[1:] or [()])
    if not path:
        return pick(rng, HOSTILE), "everything"
    parent = tree
    for key in path[:-1]:
        parent = parent[key]
    key, value = path[-1], parent[path[-1]]
    kind = pick(rng, ["value", "value", "value", "drop", "twice", "wrap", "text", "number", "number", "other"])
    if kind == "drop":
        del parent[key]
    elif kind == "twice" and isinstance(parent, list):
        parent.insert(key, copy.deepcopy(value))
    elif kind == "wrap":
        parent[key] = [value]
    elif kind == "text":
        parent[key] = str(value)
    elif kind == "number" and isinstance(value, int | float):
        parent[key] = value * pick(rng, [-1, 0, 2, 0.5, 10, 0.1, 1.01, 1e3, 1e-3, 1e9]) + pick(rng, [0, 0, 0, 1, -1])
        if isinstance(value, int) and rng.random() < 0.7:
            parent[key] = int(parent[key])
    elif kind == "other":
        other = tree
        for step in pick(rng, places(tree)):
            other = other[step]
        parent[key] = copy.deepcopy(other)
    else:
        parent[key] = copy.deepcopy(pick(rng, HOSTILE))
    return tree, f"{'.'.join(map(str, path))} {kind}"


def spell_json(tree: Any, rng: Rng) -> bytes:
    """JSON text, sometimes spelled strangely."""
    text = json.dumps(tree)
    kind = pick(rng, ["plain"] * 12 + ["bom", "utf-16", "latin", "double", "deep", "comment", "duplicate"])
    if kind == "bom":
        return b"\xef\xbb\xbf" + text.encode()
    if kind == "utf-16":
        return text.encode("utf-16")
    if kind == "latin":
        return text.replace("{", '{"\xe9": 1, ', 1).encode("latin-1")
    if kind == "double":
        return (text + text).encode()
    if kind == "deep":
        return text.replace("{", '{"deep": ' + "[" * 100_000 + "]" * 100_000 + ", ", 1).encode()
    if kind == "comment":
        return b"// notes\n" + text.encode()
    if kind == "duplicate" and isinstance(tree, dict) and tree:
        key = pick(rng, sorted(tree))
        return text.replace("{", "{" + json.dumps(key) + ": " + json.dumps(pick(rng, HOSTILE)) + ", ", 1).encode()
    return text.encode()


def json_value(folder: Path, rng: Rng) -> str:
    paths = files_of(folder, ".json")
    if not paths:
        return raw_bytes(folder, rng)
    path = pick(rng, paths)
    try:
        tree, said = change_tree(json.loads(path.read_text()), rng)
    except (ValueError, RecursionError):
        return raw_bytes(folder, rng)
    path.write_bytes(spell_json(tree, rng))
    return f"{path.name}: {said}"


# --- GLB --------------------------------------------------------------------------------------------------------------


def read_glb(data: bytes) -> tuple[dict[str, Any], bytes]:
    length = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + length])
    if not isinstance(tree, dict):
        raise ValueError("no object")
    return tree, data[28 + length :]


def write_glb(tree: Any, binary: bytes) -> bytes:
    """A GLB whose chunk lengths are right, whatever the tree says."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    head = struct.pack("<III", 0x46546C67, 2, 28 + len(text) + len(binary))
    head += struct.pack("<II", len(text), 0x4E4F534A) + text
    return head + struct.pack("<II", len(binary), 0x004E4942) + binary


def glb_tree(tree: dict[str, Any], binary: bytes, rng: Rng) -> tuple[Any, bytes, str]:
    changed, said = change_tree(tree, rng)
    return changed, binary, said


def glb_numbers(tree: dict[str, Any], binary: bytes, rng: Rng) -> tuple[Any, bytes, str]:
    """Some vertex coordinates, indices or colours become something else."""
    accessor = pick(rng, tree["accessors"])
    view = tree["bufferViews"][accessor["bufferView"]]
    start, size = view.get("byteOffset", 0), view["byteLength"]
    kind = {5126: "<f4", 5125: "<u4", 5121: "u1"}[accessor["componentType"]]
    values = np.frombuffer(binary, kind, size // np.dtype(kind).itemsize, start).copy()
    what = pick(rng, ["some", "some", "all", "scale", "equal", "shuffle", "jitter", "one far"])
    hostile: list[Any] = [0, 1, 255]
    if kind == "<u4":
        hostile = [0, 1, 2**31, 2**32 - 1, accessor["count"]]
    if kind == "<f4":
        hostile = [np.nan, np.inf, -np.inf, 0, 1e30, 1e-30, -1e9, 3.4e38, 1e-45]
    if what == "some":
        values[rng.integers(0, len(values), int(rng.integers(1, 5)))] = pick(rng, hostile)
    elif what == "all":
        values[:] = pick(rng, hostile)
    elif what == "equal":
        values[:] = values[0]
    elif what == "shuffle":
        rng.shuffle(values)
    elif kind == "<f4":
        if what == "scale":
            values *= np.float32(pick(rng, [-1, 1e-3, 1e3, 1e-9, 1e9, 0.1, 10]))
        elif what == "jitter":
            values += rng.normal(0, pick(rng, [1e-4, 0.01, 0.1]), len(values)).astype("<f4")
        else:
            values[3 * int(rng.integers(len(values) // 3))] = 1e4
    return tree, binary[:start] + values.tobytes() + binary[start + values.nbytes :], f"{kind} {what}"


def glb_faces(tree: dict[str, Any], binary: bytes, rng: Rng) -> tuple[Any, bytes, str]:
    """Triangles dropped, doubled, turned around or shrunk to lines; vertices nobody uses."""
    primitive = tree["meshes"][0]["primitives"][0]
    accessor = tree["accessors"][primitive["indices"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    start = view.get("byteOffset", 0)
    faces = np.frombuffer(binary, "<u4", accessor["count"], start).reshape(-1, 3)
    kind = pick(rng, ["open", "few", "one", "none", "doubled", "turned", "some turned", "lines", "unused", "instances"])
    keep = {"open": faces[1:], "few": faces[:3], "one": faces[:1], "none": faces[:0], "turned": faces[:, ::-1]}
    keep |= {"doubled": np.concatenate([faces, faces, faces[:, ::-1]]), "lines": np.repeat(faces[:, :1], 3, axis=1)}
    keep["some turned"] = np.where(rng.random(len(faces))[:, None] < 0.5, faces, faces[:, ::-1])
    if kind == "instances":
        tree["nodes"] = [{"mesh": 0, "translation": [0.1 * k, 0, 0]} for k in range(int(rng.integers(1, 6)))]
        tree["scenes"][0]["nodes"] = list(range(len(tree["nodes"])))
        return tree, binary, kind
    if kind == "unused":
        position = tree["accessors"][primitive["attributes"]["POSITION"]]
        old = tree["bufferViews"][position["bufferView"]]
        points = np.frombuffer(binary, "<f4", 3 * position["count"], old.get("byteOffset", 0)).reshape(-1, 3)
        extra = np.full((1, 3), pick(rng, [0.2, 30, 1e6, np.nan]), "<f4")
        primitive["attributes"] = {"POSITION": primitive["attributes"]["POSITION"]}
        position |= {"bufferView": len(tree["bufferViews"]), "count": position["count"] + 1}
        return tree, _appended(tree, binary, np.concatenate([points, extra]).tobytes()), kind
    new = np.ascontiguousarray(keep[kind], "<u4")
    accessor |= {"bufferView": len(tree["bufferViews"]), "count": new.size}
    return tree, _appended(tree, binary, new.tobytes()), kind


def glb_nodes(tree: dict[str, Any], binary: bytes, rng: Rng) -> tuple[Any, bytes, str]:
    """Chains, cycles and transforms of nodes."""
    kind = pick(rng, ["chain", "cycle", "many", "matrix", "shared"])
    nodes: list[dict[str, Any]] = [{"mesh": 0}]
    if kind == "chain":
        n = int(pick(rng, [5, 50, 3000]))
        nodes = [{"children": [k + 1]} for k in range(n)] + [{"mesh": 0}]
    elif kind == "cycle":
        nodes = [{"mesh": 0, "children": [1]}, {"mesh": 0, "children": [0]}]
    elif kind == "many":
        nodes = [{"mesh": 0} for _ in range(int(pick(rng, [10, 300, 20_000])))]
    elif kind == "matrix":
        values = pick(rng, [0.0, 1e30, float("nan"), 1.0, 1e-30])
        nodes = [{"mesh": 0, "matrix": [values] * int(pick(rng, [16, 16, 15, 9]))}]
    else:  # every level shows the one below twice
        n = int(pick(rng, [3, 12, 40]))
        nodes = [{"children": [k + 1, k + 1]} for k in range(n)] + [{"mesh": 0}]
    tree["nodes"] = nodes
    tree["scenes"] = [{"nodes": list(range(len(nodes))) if kind == "many" else [0]}]
    return tree, binary, kind


def glb_texture(tree: dict[str, Any], binary: bytes, rng: Rng) -> tuple[Any, bytes, str]:
    """Another picture as the base colour."""
    if not tree.get("images"):
        return glb_numbers(tree, binary, rng)
    view = tree["bufferViews"][tree["images"][0]["bufferView"]]
    start = view.get("byteOffset", 0)
    data, said = change_png(binary[start : start + view["byteLength"]], rng)
    tree["images"][0]["bufferView"] = len(tree["bufferViews"])
    return tree, _appended(tree, binary, data), f"texture {said}"


def _appended(tree: dict[str, Any], binary: bytes, data: bytes) -> bytes:
    """The binary chunk with one more buffer view behind it."""
    binary += b"\0" * (-len(binary) % 4)
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
    tree["buffers"] = [{"byteLength": len(binary) + len(data)}]
    return binary + data


def glb_inside(folder: Path, rng: Rng) -> str:
    paths = files_of(folder, ".glb")
    if not paths:
        return raw_bytes(folder, rng)
    path = pick(rng, paths)
    change = pick(rng, [glb_tree, glb_tree, glb_numbers, glb_numbers, glb_faces, glb_nodes, glb_texture])
    try:
        tree, binary, said = change(*read_glb(path.read_bytes()), rng)
        path.write_bytes(write_glb(tree, binary))
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, struct.error):  # damaged before
        return raw_bytes(folder, rng)
    return f"{path.name}: {change.__name__} {said}"


# --- PNG --------------------------------------------------------------------------------------------------------------


def chunks_of(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at + 8 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        found.append((name, data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def png_of(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG whose checksums are right."""
    parts = [struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(n + b)) for n, b in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def change_chunks(data: bytes, rng: Rng) -> tuple[bytes, str]:
    chunks = chunks_of(data)
    kind = pick(rng, ["header", "header", "drop", "twice", "order", "add", "pixels"])
    k = int(rng.integers(len(chunks)))
    if kind == "header":
        header = bytearray(chunks[0][1])
        if rng.random() < 0.5:
            header[4 * int(rng.integers(2)) :][:4] = b""
            at = 4 * int(rng.integers(2))
            header = bytearray(chunks[0][1])
            header[at : at + 4] = struct.pack(">I", pick(rng, [*INTEGERS, 100, 191, 193, 20_000, 50_000]))
        else:
            header[8 + int(rng.integers(5))] = int(rng.integers(18))
        chunks[0] = (b"IHDR", bytes(header))
    elif kind == "drop":
        del chunks[k]
    elif kind == "twice":
        chunks.insert(k, chunks[k])
    elif kind == "order":
        rng.shuffle(chunks)
        chunks = [(bytes(n), bytes(b)) for n, b in chunks]
    elif kind == "add":
        bomb = zlib.compress(bytes(30_000_000))
        more = [(b"tEXt", b"a\0b"), (b"zTXt", b"a\0\0" + bomb), (b"iCCP", b"a\0\0" + bomb), (b"tRNS", b"\0\0")]
        more += [
            (b"acTL", struct.pack(">II", 5, 0)),
            (b"PLTE", bytes(5)),
            (b"eXIf", b"MM\0*\0\0\0\x08\0\x01" + bytes(20)),
        ]
        more += [(b"iTXt", b"a\0\1\0\0\0" + bomb), (b"gAMA", bytes(4)), (b"pHYs", bytes(9)), (b"ABCD", b"x")]
        chunks.insert(1, pick(rng, more))
    else:
        k = next((i for i, c in enumerate(chunks) if c[0] == b"IDAT"), 0)
        try:
            body, _ = damage(zlib.decompress(chunks[k][1]), rng)
        except zlib.error:
            body = chunks[k][1]
        chunks[k] = (b"IDAT", zlib.compress(body))
    return png_of(chunks), f"chunks {kind}"


def change_pixels(data: bytes, rng: Rng) -> tuple[bytes, str]:
    image = Image.open(io.BytesIO(data))
    values = np.asarray(image).copy()
    kind = pick(
        rng, ["invert", "zero", "full", "noise", "shift", "crop", "size", "mode", "mode", "format", "turn", "thin"]
    )
    if values.dtype == bool:
        values = values.astype(np.uint8) * 255
    top = 65535 if values.dtype.itemsize > 1 else 255
    if kind == "invert":
        values = top - values
    elif kind in ("zero", "full"):
        values[:] = 0 if kind == "zero" else top
    elif kind == "noise":
        where = rng.random(values.shape) < pick(rng, [0.001, 0.05, 0.5])
        values[where] = rng.integers(0, top + 1, int(where.sum()))
    elif kind == "shift":
        values = np.roll(values, (int(rng.integers(-99, 99)), int(rng.integers(-99, 99))), (0, 1))
    elif kind == "crop":
        values = values[: int(rng.integers(1, len(values))), : int(rng.integers(1, values.shape[1]))]
    elif kind == "turn":
        values = np.rot90(values)
    elif kind == "thin":
        values[int(rng.integers(1, len(values))) :] = 0
    image = Image.fromarray(np.ascontiguousarray(values))
    if kind == "size":
        image = image.resize([(1, 1), (2000, 10), (384, 288), (96, 72), (191, 144)][int(rng.integers(5))])
    options: dict[str, Any] = {}
    if kind == "mode":
        mode = pick(rng, ["1", "L", "LA", "RGB", "RGBA", "P", "I;16", "I", "EXIF", "APNG"])
        if mode == "EXIF":
            exif = Image.Exif()
            exif[0x0112] = int(rng.integers(0, 12))
            options = {"exif": exif}
        elif mode == "APNG":
            options = {"save_all": True, "append_images": [image.copy(), image.copy()]}
        elif mode == "I;16":
            image = Image.fromarray(np.asarray(image.convert("L")).astype(np.uint16) * 257)
        else:
            image = image.convert("RGB").convert(mode) if mode != "I" else image.convert("L").convert("I")
        kind = f"mode {mode}"
    out = io.BytesIO()
    if kind == "format":
        name = pick(rng, ["JPEG", "GIF", "BMP", "TIFF", "WEBP", "PPM", "CMYK"])
        image.convert("CMYK" if name == "CMYK" else "RGB").save(out, "JPEG" if name == "CMYK" else name)
        return out.getvalue(), f"is {name}"
    image.save(out, "PNG", **options)
    return out.getvalue(), f"pixels {kind}"


def change_png(data: bytes, rng: Rng) -> tuple[bytes, str]:
    return (change_chunks if rng.random() < 0.45 else change_pixels)(data, rng)


def png_inside(folder: Path, rng: Rng) -> str:
    path = pick(rng, files_of(folder, ".png") or files_of(folder))
    try:
        data, said = change_png(path.read_bytes(), rng)
    except Exception:  # damaged before, in any way PIL can stumble over
        return raw_bytes(folder, rng)
    path.write_bytes(data)
    return f"{path.name}: {said}"


# --- npz --------------------------------------------------------------------------------------------------------------


def npz_inside(folder: Path, rng: Rng) -> str:
    paths = files_of(folder, ".npz", ".npy")
    if not paths:
        return png_inside(folder, rng)
    path = pick(rng, paths)
    if path.suffix == ".npy" or rng.random() < 0.25:
        return _npz_members(path, rng)
    try:
        with np.load(path, allow_pickle=False) as archive:
            data = {k: archive[k] for k in archive.files}
    except Exception:  # damaged before
        return raw_bytes(folder, rng)
    key = pick(rng, sorted(data))
    said = _change_array(data, key, rng)
    (np.savez_compressed if rng.random() < 0.3 else np.savez)(path, **data)
    return f"{path.name}: {key} {said}"


def _change_array(data: dict[str, Any], key: str, rng: Rng) -> str:
    kind = pick(
        rng, ["values", "values", "values", "scale", "type", "shape", "drop", "object", "order", "block", "add"]
    )
    values = data[key]
    if kind == "values" and values.dtype.kind == "f":
        where = rng.random(values.shape) < pick(rng, [0.001, 0.1, 0.99, 1.0])
        data[key] = np.where(where, pick(rng, [np.nan, np.inf, -np.inf, 0, 1e30, -1, 1e-30, 1]), values).astype(
            values.dtype
        )
    elif kind == "values":
        data[key] = (
            np.zeros_like(values)
            if rng.random() < 0.5
            else np.full_like(values, 1 if values.dtype.kind != "U" else "left")
        )
    elif kind == "scale" and values.dtype.kind == "f":
        with np.errstate(over="ignore"):
            data[key] = values * values.dtype.type(pick(rng, [-1, 1e-3, 1e3, 1e-12, 1e12, 1e30, 0.5, 2]))
    elif kind == "type":
        types = ["f2", "f8", ">f4", "i4", "u1", "c8", "U8", "S4", "?", "M8[s]"]
        name = pick(rng, types)
        with np.errstate(all="ignore"):
            try:
                data[key] = values.astype(name)
            except (ValueError, TypeError):
                data[key] = np.zeros(values.shape, name)
        return f"type {name}"
    elif kind == "shape":
        values = np.atleast_1d(values)
        data[key] = pick(
            rng,
            [
                values.T,
                values[None],
                values[:1],
                values[:0],
                values.ravel(),
                values[..., :2] if values.ndim else values,
            ],
        )
    elif kind == "drop":
        del data[key]
    elif kind == "object":
        data[key] = np.array([{"a": 1}], object)
    elif kind == "order":
        data[key] = np.asfortranarray(values)
    elif kind == "block" and values.ndim >= 2:
        values = values.copy()
        values[: int(rng.integers(1, len(values) + 1))] = 0
        data[key] = values
    else:
        data[pick(rng, ["pcd", "normal", "coordinate_system", "../x", "a" * 200])] = np.float32(1)
    return kind


def _npz_members(path: Path, rng: Rng) -> str:
    """The bytes inside an archive change, its checksums stay right."""
    if path.suffix == ".npy":
        data, said = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return f"{path.name}: {said}"
    try:
        with zipfile.ZipFile(path) as archive:
            members = {i.filename: archive.read(i) for i in archive.infolist()}
        name = pick(rng, sorted(members))
    except Exception:  # damaged before
        data, said = damage(path.read_bytes(), rng)
        path.write_bytes(data)
        return f"{path.name}: {said}"
    head, body = members[name][:128], members[name][128:]
    if rng.random() < 0.7:
        head, said = damage(head, rng)
        members[name] = head + body
    else:
        members[name], said = damage(members[name], rng)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, data in members.items():
            archive.writestr(key, data)
    return f"{path.name}: {name} {said}"


MUTATIONS: dict[str, tuple[float, Mutation]] = {
    "bytes": (3, raw_bytes),
    "json": (4, json_value),
    "glb": (5, glb_inside),
    "png": (4, png_inside),
    "npz": (3, npz_inside),
    "swap": (1, swap_files),
    "same kind": (1, same_kind_swap),
    "rename": (1, rename),
    "copy": (1, copy_file),
    "delete": (0.7, delete),
    "empty": (0.3, empty),
    "special": (1, special_file),
}
"""By name: how often, relative to each other, and the change."""


def mutate(folder: Path, rng: Rng) -> list[tuple[str, str]]:
    """One to three changes of a folder, by kind and what was done."""
    weights = np.array([w for w, _ in MUTATIONS.values()])
    count = 1 + int(rng.random() < 0.25) + int(rng.random() < 0.1)
    done = []
    for _ in range(count):
        if not files_of(folder):
            break
        kind = list(MUTATIONS)[int(rng.choice(len(weights), p=weights / weights.sum()))]
        try:
            done.append((kind, MUTATIONS[kind][1](folder, rng)))
        except OSError as error:  # a name that is too long, a folder where a file goes
            done.append((kind, f"not possible: {error.strerror}"))
    return done
