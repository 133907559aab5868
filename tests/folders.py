"""Tiny prompted-image folders on disk, with known truth: boxes on a table, seen by a known camera."""

from __future__ import annotations

import json
import shutil
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from f3sr import example
from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_about
from f3sr.io import sam3d
from f3sr.io.mesh_files import save_glb
from f3sr.scene import Geometry, Photo, Scene, SceneObject
from f3sr.vision import rasterizer
from scenes import box

WIDTH, HEIGHT = 192, 144
FLAT = Mesh(vertices=np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), faces=np.array([[0, 1, 2], [0, 2, 3]]))
"""A square without any thickness."""


def camera() -> Camera:
    """70 cm away, 40 degrees down, principal point off the centre."""
    forward = np.array([0.0, np.cos(np.radians(40)), -np.sin(np.radians(40))])
    right = np.array([1.0, 0, 0])
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.array([[230.0, 0, 99], [0, 230, 70], [0, 0, 1]])
    return Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose(R, -0.75 * forward + [0, 0, 0.04]))


def photographed(*objects: SceneObject, on_ground: bool = False) -> Scene:
    """Objects with the masks and the geometry of a camera that looks down by 40 degrees, perhaps ``on_ground`` that
    the geometry shows too."""
    eye = camera().resized(4 * camera().width, 4 * camera().height)
    seen = rasterizer.render(objects, eye)
    rows, columns = np.mgrid[: eye.height, : eye.width] + 0.5
    rays = np.linalg.solve(eye.K, np.stack([columns, rows, np.ones_like(rows)]).reshape(3, -1)).T
    depth = seen.depth
    if on_ground:
        down = rays @ -eye.T_world_camera[2, :3]
        depth = np.minimum(depth, np.where(down > 0, eye.center[2] / down.clip(1e-9), np.inf).reshape(depth.shape))
    points = (rays * np.nan_to_num(depth, posinf=0.0).reshape(-1, 1)).reshape(eye.height, eye.width, 3)
    return Scene(
        photo=Photo(rgb=np.zeros((eye.height, eye.width, 3), np.uint8)),
        camera=eye,
        objects=tuple(replace(o, mask=seen.ids == o.id) for o in objects),
        geometry=Geometry(points=points.astype(np.float32), valid=np.isfinite(depth)),
    )


def boxes(*, textured: bool = False) -> list[SceneObject]:
    """A stack of two and a box beside it, all at rest; the first with a texture on demand."""
    return [
        box(
            2,
            size=(0.16, 0.12, 0.08),
            at=(-0.1, 0.0, 0.04),
            R=rotation_about([0, 0, 1], 0.3),
            label="big box",
            textured=textured,
        ),
        box(
            5,
            size=(0.06, 0.06, 0.05),
            at=(-0.1, 0.0, 0.105),
            R=rotation_about([0, 0, 1], 0.5),
            label="small box",
        ),
        box(
            7,
            size=(0.09, 0.07, 0.1),
            at=(0.13, 0.02, 0.05),
            R=rotation_about([0, 0, 1], -0.4),
            label="tall box",
        ),
    ]


@dataclass(frozen=True, eq=False)
class Truth:
    camera: Camera
    objects: list[SceneObject]


def write_folder(
    folder: Path,
    *,
    perturb: float = 0.0,
    seed: int = 0,
    objects: list[SceneObject] | None = None,
    eye: Camera | None = None,
) -> Truth:
    """Write a folder of boxes; assets are off by about ``perturb`` (share of size, and radians of yaw).

    The usual boxes, which hundreds of tests ask for, are drawn once."""
    if objects is not None or eye is not None:
        return _written(folder, perturb, seed, objects or boxes(), eye or camera())
    for name, data in _usual(perturb, seed).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return Truth(camera(), boxes())


@cache
def _usual(perturb: float, seed: int) -> dict[str, bytes]:
    """Files of the folder of ``boxes()`` by their paths in it."""
    with TemporaryDirectory() as place:
        _written(Path(place), perturb, seed, boxes(), camera())
        return {str(f.relative_to(place)): f.read_bytes() for f in sorted(Path(place).rglob("*")) if f.is_file()}


def _written(folder: Path, perturb: float, seed: int, truth: list[SceneObject], eye: Camera) -> Truth:
    fragments = rasterizer.render(truth, eye)
    (folder / "masks").mkdir(parents=True)
    (folder / "assets").mkdir()
    photo = np.full((eye.height, eye.width, 3), (150, 120, 90), np.uint8)
    rng = np.random.default_rng(seed)
    entries = []
    for o in truth:
        mask = fragments.ids == o.id
        photo[mask] = rng.integers(40, 220, 3)
        name = f"{o.id:02d}_{o.label.replace(' ', '_')}"
        Image.fromarray((255 * mask).astype(np.uint8)).save(folder / "masks" / f"{name}.png")
        wrong = _perturbed(o, eye, perturb, rng)
        save_glb(
            o.mesh.with_vertices(o.mesh.vertices @ sam3d.LOCAL_FROM_GLB),
            folder / "assets" / f"{o.id:02d}.glb",
        )
        entries.append(_sam3d_entry(wrong, eye, f"{name}.png"))
    Image.fromarray(photo).save(folder / "image.png")
    Image.fromarray((255 * (fragments.ids == rasterizer.EMPTY)).astype(np.uint8)).save(folder / "ground.png")
    (folder / "assets" / "poses.json").write_text(json.dumps({"convention": "sam-3d-objects", "objects": entries}))
    np.savez(folder / "geometry.npz", **_geometry(fragments.depth, eye))
    return Truth(eye, truth)


def _perturbed(o: SceneObject, eye: Camera, amount: float, rng: np.random.Generator) -> SceneObject:
    if not amount:
        return o
    center = o.bounds_world.mean(0)
    yaw = rotation_about([0, 0, 1], amount * rng.choice([-1, 1]))
    shift = amount * o.size * rng.uniform(-1, 1, 3)
    s = 1 + amount * rng.uniform(-0.5, 0.5)
    return o.moved(pose(yaw, center + shift - yaw @ (s * center)), scale=s, stage="test", reason="perturbed")


def _sam3d_entry(o: SceneObject, eye: Camera, mask: str) -> dict[str, object]:
    """The pose of an object in the model's row-vector PyTorch3D convention."""
    T_camera_object = eye.T_camera_world @ o.T_world_object
    F = sam3d.OPENCV_FROM_PYTORCH3D
    R = (F @ T_camera_object[:3, :3]).T
    return {
        "mask": mask,
        "mesh": f"{o.id:02d}.glb",
        "rotation": quaternion_from_rotation(R).tolist(),
        "translation": (F @ T_camera_object[:3, 3]).tolist(),
        "scale": [o.scale] * 3,
    }


def _geometry(depth: Array, eye: Camera) -> dict[str, Array]:
    """Half-resolution points of objects and table, in camera axes."""
    columns, rows = np.meshgrid(np.arange(0, eye.width, 2), np.arange(0, eye.height, 2))
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones_like(rows)], -1) @ np.linalg.inv(eye.K).T
    R, t = eye.T_world_camera[:3, :3], eye.center
    table = -t[2] / (rays @ R.T)[..., 2]
    z = np.where(np.isfinite(depth[::2, ::2]), depth[::2, ::2], table)
    valid = (z > 0) & (z < 5)
    normalised = eye.K / [[eye.width], [eye.height], [1]]
    return {
        "points": (rays * np.where(valid, z, 0)[..., None]).astype(np.float32),
        "mask": valid,
        "intrinsics": normalised,
    }


def to_depth(folder: Path) -> None:
    """A 16-bit depth.png with intrinsics.json instead of geometry.npz."""
    with np.load(folder / "geometry.npz") as archive:
        depth, valid = archive["points"][..., 2], archive["mask"]
    (folder / "geometry.npz").unlink()
    Image.fromarray(np.where(valid, depth / 0.001, 0).astype(np.uint16)).save(folder / "depth.png")
    K = camera().K * [[0.5], [0.5], [1]]
    meta = {"width": WIDTH // 2, "height": HEIGHT // 2, "K": K.tolist(), "depth_scale": 0.001}
    (folder / "intrinsics.json").write_text(json.dumps(meta))


def to_posed(folder: Path) -> None:
    """GLBs posed in OpenGL camera axes instead of poses.json."""
    (folder / "assets" / "poses.json").unlink()
    for o in boxes():
        opengl = camera().to_camera(o.vertices_world) * [1, -1, -1]
        save_glb(o.mesh.with_vertices(opengl), folder / "assets" / f"{o.id:02d}.glb")


def add_graph(folder: Path) -> None:
    """Relations that hold between the boxes."""
    graph = {
        "relations": [{"subject": 7, "predicate": "next_to", "object": 2, "confidence": 0.9}],
        "support_relations": [
            {"upper": 5, "lower": 2, "confidence": 0.9, "reason": "on it"},
            {"upper": 2, "lower": -1},
        ],
    }
    (folder / "scene_graph.json").write_text(json.dumps(graph))


PART = ("01_tomato_tin", "06_dotted_mug", "09_lemon")
"""Three objects of the example: a third of the time. ``make demo`` and ``benchmarks/film.py`` run all ten."""


def part_of_example(folder: Path, part: Collection[str] = PART) -> Path:
    """The bundled folder with the masks and assets of some objects alone, and pictures of half its size."""
    part_of(example.folder(), folder, part)
    for file in (folder / "image.jpg", folder / "ground.png", *(folder / "masks").iterdir()):
        picture = Image.open(file)
        sampling = Image.Resampling.BOX if file.suffix == ".jpg" else Image.Resampling.NEAREST
        picture.resize((picture.width // 2, picture.height // 2), sampling).save(file, quality=95)
    return folder


def part_of(given: Path, folder: Path, part: Collection[str]) -> Path:
    """A copy of a folder with posed meshes that has some of its objects, named by their masks."""
    poses = json.loads((given / "assets/poses.json").read_text())
    poses["objects"] = [o for o in poses["objects"] if Path(o["mask"]).stem in part]
    kept = {"poses.json", *(o[key] for o in poses["objects"] for key in ("mask", "mesh"))}
    for file in given.rglob("*"):
        if file.is_file() and (file.parent == given or file.name in kept):
            copy = folder / file.relative_to(given)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, copy)
    (folder / "assets/poses.json").write_text(json.dumps(poses))
    return folder
