"""Imports whose conventions nobody tells: scenes of twenty real meshes, written as producers of any convention would.

usage: python benchmarks/scrambled.py [--count N] [--first K] [--route NAME] [--data PATH] [--out FILE]
Masks, photo and depth are drawn from the true places. The files then have random mesh axes (48, half of them mirrored),
order and direction of the quaternion, camera axes, units, nested nodes and packing; most poses are off as a generator's
are. The product reads the folder. An import is *right* where every surface lies within BOUND of where the written pose
means it (without a pose: of the truth), *asked* where the product stops and names ``--asset-frame``, else *wrong*.
Exit codes: 0 the bounds hold, 1 they do not.
"""

from __future__ import annotations

import argparse
import json
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial import KDTree

from f3sr.core.camera import Camera
from f3sr.core.handedness import outward
from f3sr.core.mesh import Mesh
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_about, rotation_from_vector, transform
from f3sr.errors import InputError
from f3sr.io.mesh_files import load_mesh
from f3sr.io.pose_conventions import ALL_AXES, CAMERAS
from f3sr.photo_inputs import read_inputs
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from run import REPO

MESHES = (
    *("gso_frypan", "hope_ketchup", "hope_macaroni_and_cheese", "ycb_a_toy_airplane", "ycb_adjustable_wrench"),
    *("ycb_b_lego_duplo", "ycb_bleach_cleanser", "ycb_bowl", "ycb_cracker_box", "ycb_hammer", "ycb_mug"),
    *("ycb_mustard_bottle", "ycb_padlock", "ycb_phillips_screwdriver", "ycb_plate", "ycb_rubiks_cube", "ycb_spatula"),
    *("ycb_strawberry", "ycb_tomato_soup_can", "ycb_windex_bottle"),
)
"""Twenty scans of ``data/objects``: symmetric ones, thin ones and bottles among them."""
FACES = 1_500
WIDTH, HEIGHT = 320, 240
BOUND = 0.05
"""Mean distance of surfaces [share of the object's diagonal] up to which a pose is right."""
MOST_ASKED = 0.10
COUNTS, COUNT_SHARES = (1, 2, 3, 4, 5), (0.2, 0.2, 0.25, 0.2, 0.15)
ROUTES, ROUTE_SHARES = ("poses", "posed", "unposed"), (0.65, 0.25, 0.10)
UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0, "cube": 0.0}
"""Of a mesh file, per metre; "cube": its own, 1 long."""


def scanned(path: Path) -> Mesh:
    """A scan with FACES triangles, its texture as vertex colours: what generators leave."""
    import fast_simplification

    mesh = load_mesh(path)
    vertices, faces = mesh.welded
    light, triangles = fast_simplification.simplify(vertices, faces, target_count=FACES)
    texture = mesh.materials[0].texture
    colors = None
    if texture is not None and mesh.uv is not None:
        near = mesh.uv[KDTree(mesh.vertices).query(light)[1]] % 1.0
        h, w = texture.shape[:2]
        rows, columns = ((1 - near[:, 1]) * (h - 1)).round().astype(int), (near[:, 0] * (w - 1)).round().astype(int)
        colors = texture[rows, columns]
    return outward(Mesh(vertices=np.asarray(light, float), faces=np.asarray(triangles, np.int32), vertex_colors=colors))


@dataclass(frozen=True, eq=False, kw_only=True)
class TrueScene:
    """Objects on a table, seen by a camera."""

    camera: Camera
    objects: tuple[SceneObject, ...]
    ids: Array
    depth: Array
    rgb: Array


def true_scene(meshes: Mapping[str, Mesh], rng: np.random.Generator) -> TrueScene:
    """Some objects upright or lying on a table; one may hide a part of another, none hides it all."""
    names = list(meshes)
    while True:
        down = np.radians(rng.uniform(20, 60))
        forward, right = np.array([0.0, np.cos(down), -np.sin(down)]), np.array([1.0, 0, 0])
        R = np.stack([right, np.cross(forward, right), forward], axis=1)
        K = np.array([[rng.uniform(300, 420), 0, WIDTH / 2], [0, 0, HEIGHT / 2], [0, 0, 1]])
        K[1, 1] = K[0, 0]
        eye = Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose(R, -rng.uniform(0.8, 1.1) * forward))
        objects = list[SceneObject]()
        for id, name in enumerate(rng.choice(names, rng.choice(COUNTS, p=COUNT_SHARES), replace=False)):
            turn = rotation_about([0, 0, 1], rng.uniform(0, 2 * np.pi))
            if rng.random() < 0.3:
                turn = turn @ rotation_about([1, 0, 0], np.pi / 2)
            low = float((meshes[name].vertices @ turn.T)[:, 2].min())
            place = [rng.uniform(-0.22, 0.22), rng.uniform(-0.2, 0.2), -low]
            objects.append(
                SceneObject(
                    id=id,
                    label=str(name),
                    mask_name=f"{id:02d}.png",
                    mask=np.zeros((1, 1), bool),
                    mesh=meshes[name],
                    T_world_object=pose(turn, place),
                )
            )
        fragments = rasterizer.render(objects, eye)
        alone = [np.count_nonzero(rasterizer.visible_ids([o], eye) == o.id) for o in objects]
        seen = [np.count_nonzero(fragments.ids == o.id) for o in objects]
        if all(s >= 250 and s >= 0.5 * a for s, a in zip(seen, alone, strict=True)):
            break
    rgb = rasterizer.shade(fragments, objects)
    rgb[fragments.ids == rasterizer.EMPTY] = 0.55
    return TrueScene(camera=eye, objects=tuple(objects), ids=fragments.ids, depth=fragments.depth, rgb=rgb)


@dataclass(frozen=True, kw_only=True)
class Producer:
    """What one import's files are like."""

    route: str
    order: str
    vectors: str
    mesh: str
    camera: str
    unit: str
    nodes: str
    packing: str
    rewound: bool
    """Whether a mirrored file turned its triangles round, too."""
    jitter: float
    """Of poses: radians, and shares of size and place."""


def producer(rng: np.random.Generator, only: str | None = None) -> Producer:
    """Of any route, or of one only."""
    drawn = str(rng.choice(ROUTES, p=ROUTE_SHARES))
    route = only or drawn
    axes = str(rng.choice([a.name for a in ALL_AXES]))
    camera = str(rng.choice(list(CAMERAS)))
    if route == "poses" and camera == "unity":
        axes = str(rng.choice([a.name for a in ALL_AXES if a.mirrors]))
    if route == "unposed":
        axes = str(rng.choice(["+x-z+y", "+x+y+z"]))  # Y-up or Z-up
    return Producer(
        route=route,
        order=str(rng.choice(["wxyz", "xyzw"])),
        vectors=str(rng.choice(["row", "column"])),
        mesh=axes,
        camera=camera,
        unit=str(rng.choice(list(UNITS))),
        nodes=str(rng.choice(["none", "nested", "baked"])),
        packing=str(rng.choice(["plain", "quantised", "meshopt"])),
        rewound=bool(rng.random() < 0.5),
        jitter=float(rng.choice([0.0, 0.04, 0.08])) if route == "poses" else 0.0,
    )


def write(folder: Path, scene: TrueScene, made: Producer, rng: np.random.Generator) -> dict[int, Array]:
    """The input folder; returns where samples (n, 3) of every surface should be read in the camera, by id."""
    for part in ("masks", "assets"):
        (folder / part).mkdir(parents=True)
    Image.fromarray((255 * scene.rgb).round().astype(np.uint8)).save(folder / "image.png")
    Image.fromarray((255 * (scene.ids == rasterizer.EMPTY)).astype(np.uint8)).save(folder / "ground.png")
    np.savez(folder / "geometry.npz", **_geometry(scene))
    F, A = CAMERAS[made.camera].matrix, next(a for a in ALL_AXES if a.name == made.mesh).matrix
    wanted, entries = dict[int, Array](), list[dict[str, Any]]()
    for o in scene.objects:
        Image.fromarray((255 * (scene.ids == o.id)).astype(np.uint8)).save(folder / "masks" / o.mask_name)
        T = scene.camera.T_camera_world @ o.T_world_object
        size = o.mesh.diagonal
        R = T[:3, :3] @ rotation_from_vector(rng.normal(size=3) / np.sqrt(3) * made.jitter)
        t = T[:3, 3] + rng.normal(size=3) / np.sqrt(3) * made.jitter * size / 2
        s = 1 + made.jitter / 2 * rng.uniform(-1, 1)
        points = sample_surface(o.mesh.vertices, o.mesh.faces, 1_000)
        wanted[o.id] = s * points @ R.T + t
        if made.route == "posed":
            factor, flips = UNITS[made.unit] or 1.0, np.linalg.det(F) < 0
            vertices = factor * (o.mesh.vertices @ T[:3, :3].T + T[:3, 3]) @ F
        else:
            # A takes the file to what the pose turns: the file holds A^T v.
            factor, flips = UNITS[made.unit] or 1 / size, np.linalg.det(A) < 0
            vertices = factor * o.mesh.vertices @ A
            G = F.T @ R  # x = F (G v); of a left-handed camera it mirrors
            if np.linalg.det(F) < 0:
                # The file is right-handed, as glTF is; the program that reads it mirrors it, and turns that.
                M = np.diag([-1.0, 1, 1])
                G, vertices, flips = G @ M, factor * o.mesh.vertices @ M @ A, False
            wxyz = quaternion_from_rotation(G.T if made.vectors == "row" else G)
            # A file in centimetres or millimetres comes with poses that know nothing of it; a cube's pose has its size.
            entries.append(
                {
                    "mask": o.mask_name,
                    "mesh": f"{o.id:02d}.glb",
                    "rotation": (wxyz if made.order == "wxyz" else np.roll(wxyz, -1)).tolist(),
                    "translation": (F.T @ t).tolist(),
                    "scale": [float(s * size if made.unit == "cube" else s)] * 3,
                }
            )
        faces = o.mesh.faces[:, ::-1] if flips and made.rewound else o.mesh.faces
        mesh = Mesh(vertices=vertices, faces=faces, vertex_colors=o.mesh.vertex_colors)
        (folder / "assets" / f"{o.id:02d}.glb").write_bytes(packed_glb(mesh, made, rng))
    if made.route == "poses":
        (folder / "assets" / "poses.json").write_text(json.dumps({"objects": entries}))
    return wanted


def _geometry(scene: TrueScene) -> dict[str, Array]:
    eye = scene.camera
    rows, columns = np.indices(scene.ids.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(eye.K).T
    down = (rays @ eye.T_world_camera[:3, :3].T)[..., 2]
    table = -eye.center[2] / np.minimum(down, -1e-6)
    z = np.where(np.isfinite(scene.depth), scene.depth, table)
    valid = (z > 0) & (z < 5)
    points = (rays * np.where(valid, z, 0)[..., None]).astype(np.float32)
    return {"points": points, "mask": valid, "intrinsics": eye.K / [[eye.width], [eye.height], [1]]}


def packed_glb(mesh: Mesh, made: Producer, rng: np.random.Generator) -> bytes:
    """A GLB with nodes and packing of a producer, that shows the mesh as it is."""
    vertices = mesh.vertices
    T = np.eye(4)
    if made.nodes != "none":  # the file's vertices are elsewhere, and two nodes bring them back
        R, k = rotation_from_vector(rng.normal(size=3)), float(rng.uniform(0.3, 3))
        shift = rng.normal(size=3) * mesh.diagonal
        T[:3, :3], T[:3, 3] = k * R, shift
        vertices = (vertices - shift) @ R / k
    quantised = made.packing == "quantised"
    if quantised:
        low, span = vertices.min(0), float(np.ptp(vertices, axis=0).max())
        stored = np.zeros((len(vertices), 4), "<u2")  # rows of eight bytes: attributes are aligned to four
        stored[:, :3] = ((vertices - low) / span * 65535).round()
        T = T @ np.block([[span * np.eye(3), low[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])
        position, component = stored, {"componentType": 5123, "normalized": True}
    else:
        position, component = vertices.astype("<f4"), {"componentType": 5126}
    color = np.full((len(vertices), 4), 255, "u1")
    if mesh.vertex_colors is not None:
        color[:, :3] = mesh.vertex_colors
    indices = mesh.faces.ravel().astype("<u4")
    blocks = [(position, "ATTRIBUTES"), (color, "ATTRIBUTES"), (indices, "TRIANGLES")]
    binary, views, required = b"", list[dict[str, Any]](), list[str]()
    for values, mode in blocks:
        stride = values.strides[0]
        if made.packing == "meshopt":
            import meshopt

            data = meshopt.encode_gltf_buffer(values, mode)
            claim = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "byteStride": stride,
                     "mode": mode, "count": len(values)}  # fmt: skip
            views.append({"buffer": 1, "byteLength": values.nbytes, "extensions": {"EXT_meshopt_compression": claim}})
        else:
            data = values.tobytes()
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            if mode == "ATTRIBUTES":
                views[-1]["byteStride"] = stride
        binary += data + b"\0" * (-len(data) % 4)
    buffers: list[dict[str, Any]] = [{"byteLength": len(binary)}]
    if made.packing == "meshopt":
        required.append("EXT_meshopt_compression")
        total = sum(values.nbytes for values, _ in blocks)
        buffers.append({"byteLength": total, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    if quantised:
        required.append("KHR_mesh_quantization")
    nodes: list[dict[str, Any]] = [{"mesh": 0, "matrix": T.T.ravel().tolist()}]
    if made.nodes == "nested":
        half = pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
        nodes = [
            {"children": [1], "matrix": half.T.ravel().tolist()},
            {"mesh": 0, "matrix": (np.linalg.inv(half) @ T).T.ravel().tolist()},
        ]
    n = len(vertices)
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2}]}],
        "extensionsRequired": required, "buffers": buffers, "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "count": n, "type": "VEC3", **component},
            {"bufferView": 1, "componentType": 5121, "normalized": True, "count": n, "type": "VEC4"},
            {"bufferView": 2, "componentType": 5125, "count": len(indices), "type": "SCALAR"},
        ],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 28 + len(text) + len(binary), len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def apart(wanted: Array, vertices: Array, faces: Any, size: float) -> float:
    """Mean distance of two surfaces [share of size]."""
    found = sample_surface(vertices, faces, len(wanted))
    return float(KDTree(wanted).query(found)[0].mean() + KDTree(found).query(wanted)[0].mean()) / 2 / size


def judged(meshes: Mapping[str, Mesh], seed: int, place: Path, route: str | None = None) -> dict[str, Any]:
    """One import: what it was, and what became of it."""
    rng = np.random.default_rng([7, seed])
    scene, made = true_scene(meshes, rng), producer(rng, route)
    wanted = write(place, scene, made, rng)
    began = time.process_time()
    told, off = "", 0.0
    try:
        given = read_inputs(place)
        for o in scene.objects:
            asset = given.assets[o.id]
            vertices = transform(asset.T_camera_object, asset.scale * asset.mesh.vertices)
            off = max(off, apart(wanted[o.id], vertices, asset.mesh.faces, o.mesh.diagonal))
        outcome = "right" if off <= BOUND else "wrong"
        told = "; ".join(d.choice for d in given.decisions if d.choice.startswith("assets"))
    except InputError as error:
        told = str(error)[-400:]
        outcome = "asked" if "--asset-frame" in told else "wrong"
    return {"seed": seed, "outcome": outcome, "off": round(off, 4), "objects": [o.label for o in scene.objects],
            "seconds": round(time.process_time() - began, 2), **made.__dict__, "told": told}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--route", choices=ROUTES, help="all imports by this one")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=Path("out/scrambled.jsonl"))
    args = parser.parse_args()
    if not (args.data / "objects").is_dir():
        print(f"skipped: no objects in {args.data}")
        return 0
    meshes = {name: scanned(args.data / "objects" / f"{name}.glb") for name in MESHES}
    args.out.parent.mkdir(parents=True, exist_ok=True)
    found = list[dict[str, Any]]()
    with args.out.open("w") as lines:
        for seed in range(args.first, args.first + args.count):
            with tempfile.TemporaryDirectory() as place:
                found.append(judged(meshes, seed, Path(place) / "input", args.route))
            lines.write(json.dumps(found[-1]) + "\n")
            lines.flush()
    for route in (*ROUTES, "all"):
        rows = [f for f in found if route in (f["route"], "all")]
        print(route, len(rows), dict(Counter(f["outcome"] for f in rows)))
    seconds = sum(f["seconds"] for f in found)
    print(json.dumps({"imports": len(found), "cpu_seconds_each": round(seconds / len(found), 2)}))
    wrong, asked = (sum(f["outcome"] == kind for f in found) for kind in ("wrong", "asked"))
    return int(wrong > 0 or asked > MOST_ASKED * len(found))


if __name__ == "__main__":
    sys.exit(main())
