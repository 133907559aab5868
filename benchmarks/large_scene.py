"""Builds the input folders of the size benchmark from a seed: detailed meshes, photo-like textures, any photo size.

usage: large_scene.py FOLDER '{"objects": 20, "faces": 200000, "texture": 2048, "width": 4000, "height": 3000}'
       large_scene.py FOLDER '{"enlarged": 11}'
"""

from __future__ import annotations

import json
import shutil
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import manifold3d as mf
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from f3sr import example
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, transform

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
import make_tabletop
from tabletop import atlas, degrade, looks, render
from tabletop.degrade import Damage
from tabletop.settle import Rest, settle
from tabletop.things import Thing, arrange, room

PITCH = np.array([0.55, 0.45])
"""Distance [m] between copies of the example's arrangement of ten things; the table holds three by two."""
GEOMETRY_WIDTH = 1000
"""Of the point map [px], as depth networks give it."""
STRIP = 600_000
"""Pixels rendered at once."""
GRAIN = 3.0
"""Standard deviation [8-bit levels] of the texture's finest detail: what a photographed surface has, and what makes
its PNG as large as a photo's."""
HOLED = 7
"""Every so many objects have a hole: no solid, as some generated meshes are none."""


@dataclass(frozen=True, kw_only=True)
class Size:
    """How large an input is."""

    objects: int
    faces: int
    texture: int
    """Side [px]."""
    width: int
    height: int
    seed: int = 5

    @property
    def name(self) -> str:
        return f"{self.objects}x{self.faces}_{self.texture}_{self.width}x{self.height}_{self.seed}"


def write(folder: Path, size: Size, *, workers: int = 2) -> None:
    """Write the input folder, unless it is there already."""
    stamp = folder / "meta.json"
    if stamp.exists():
        return
    for name in ("masks", "assets"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    things, camera = copies(size.objects), viewpoint(size)
    rest = settle(things)
    scenery = room()
    world = render.World([*scenery, *things], [*(t.T_start for t in scenery), *rest.T_world_object])
    photo, seen = shoot(world, camera, np.random.default_rng([size.seed, 0]))
    Image.fromarray(photo).save(folder / "image.jpg", quality=92, subsampling=0)
    make_tabletop.write_masks(folder, things, seen - len(scenery))
    small = camera.resized(GEOMETRY_WIDTH, round(GEOMETRY_WIDTH * size.height / size.width))
    _, points, normals = render.first_hits(world, small)
    arrays = degrade.geometry(points, normals, small, Damage(), np.random.default_rng([size.seed, 1]))
    np.savez_compressed(folder / "geometry.npz", **arrays)
    write_assets(folder, size, rest, camera, workers)
    stamp.write_text(json.dumps({"source": "benchmarks/large_scene.py", **asdict(size)}, indent=1) + "\n")


@cache
def copies(count: int) -> tuple[Thing, ...]:
    """The first ``count`` things of some copies of the example's arrangement, side by side on the table."""
    ten = arrange()
    groups = -(-count // len(ten))
    rows = 1 if groups <= 3 else 2
    columns = -(-groups // rows)
    things: list[Thing] = []
    for k in range(count):
        group, thing = k // len(ten), ten[k % len(ten)]
        place = np.array([group % columns - (columns - 1) / 2, group // columns - (rows - 1) / 2]) * PITCH
        at = (thing.at[0] + place[0], thing.at[1] + place[1], thing.at[2])
        label = thing.label if group == 0 else f"{thing.label}_{group + 1}"
        things.append(replace(thing, label=label, at=at))
    return tuple(things)


def viewpoint(size: Size) -> Camera:
    """The example's view, from so far away that all groups are in the picture, at this size of the photo."""
    near = make_tabletop.hand_held()
    groups = -(-size.objects // 10)
    distance = {1: 1.0, 2: 1.55}.get(groups, 2.5)
    T = near.T_world_camera.copy()
    T[:3, 3] = distance * (T[:3, 3] + [0, 0, 0.05])
    return near.moved(T).resized(size.width, size.height)


def shoot(world: render.World, camera: Camera, rng: np.random.Generator) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """The photo (h, w, 3) by window light with soft shadows, with sensor noise, and the thing in every pixel (h, w)."""
    photo, seen = (
        np.empty((camera.height, camera.width, 3), np.uint8),
        np.empty((camera.height, camera.width), np.int64),
    )
    step = max(1, STRIP // camera.width)
    for top in range(0, camera.height, step):
        strip = camera.cropped(0, top, camera.width, min(step, camera.height - top))
        origin, direction = render.rays(strip)
        triangle, distance, flat, normal = world.cast(origin, direction)
        point = origin + distance[:, None] * direction
        color, _, _ = world.look_up(np.maximum(triangle, 0), point)
        light = 0.4 * render.sky(normal) + render.from_window(world, point + render.NUDGE * flat, normal, rng)
        srgb = looks.to_srgb(render.tone(color * light)) + rng.normal(0, 1.2 / 255, color.shape)
        rows = slice(top, top + strip.height)
        photo[rows] = np.round(255 * np.clip(srgb, 0, 1)).reshape(photo[rows].shape)
        seen[rows] = np.where(triangle >= 0, world.owner[triangle], 0).reshape(seen[rows].shape)
    return photo, seen


def write_assets(folder: Path, size: Size, rest: Rest, camera: Camera, workers: int) -> None:
    jobs = [(folder, size, k, T, camera) for k, T in enumerate(rest.T_world_object)]
    with ProcessPoolExecutor(workers) as pool:
        poses = list(pool.map(write_asset, *zip(*jobs, strict=True)))
    entries = [
        {"mask": f"{k:02d}_{thing.label}.png", "mesh": f"{k:02d}.glb", **placed}
        for k, (thing, placed) in enumerate(zip(copies(size.objects), poses, strict=True))
    ]
    make_tabletop.write_json(
        folder / "assets" / "poses.json", {"convention": make_tabletop.CONVENTION, "objects": entries}
    )


def write_asset(folder: Path, size: Size, k: int, T_world_object: Array, camera: Camera) -> dict[str, Any]:
    """One GLB as an image-to-3D model might return it, finer than the example's; its pose for poses.json."""
    thing, rng, damage = copies(size.objects)[k], np.random.default_rng([size.seed, 2, k]), Damage()
    fine = refined(thing.shape.solid, size.faces)
    cut = atlas.unwrap(trimesh.Trimesh(*fine, process=False))
    image = photographic(atlas.bake(cut, painter(thing), size=size.texture), rng)
    T_camera_object = camera.T_camera_world @ T_world_object
    faces = cut.faces if k % HOLED != HOLED - 1 else holed(cut.vertices, cut.faces)

    low, high = cut.vertices.min(0), cut.vertices.max(0)
    middle, diagonal = (low + high) / 2, float(np.linalg.norm(high - low))
    away = T_camera_object[:3, :3].T @ transform(T_camera_object, middle)
    waves = degrade.Waves.draw(rng)
    bent = degrade.bend(cut.vertices, center=middle, size=diagonal, away=away, waves=waves, damage=damage)
    bent += diagonal * grooves((cut.vertices - middle) / diagonal, rng)
    low, high = bent.min(0), bent.max(0)
    extent, middle = float((high - low).max()) / 0.98, (low + high) / 2
    placed = degrade.place(T_camera_object, middle, extent, diagonal, camera, damage, rng)
    local = (bent - middle) / extent
    (folder / "assets" / f"{k:02d}.glb").write_bytes(
        degrade.to_glb(local[:, [0, 2, 1]] * [1, 1, -1], faces, cut.uv, image)
    )
    return placed


def refined(solid: mf.Manifold, faces: int) -> tuple[Array, NDArray[np.int64]]:
    """The surface with ``faces`` triangles or a few more."""
    fine, coarse = 1e-4, 1e-1
    for _ in range(40):
        length = float(np.sqrt(fine * coarse))
        count = solid.refine_to_length(length).num_tri()
        fine, coarse = (length, coarse) if count >= faces else (fine, length)
        if faces <= count < 1.02 * faces:
            break
    mesh = solid.refine_to_length(fine).to_mesh()
    return np.asarray(mesh.vert_properties[:, :3], float), np.asarray(mesh.tri_verts, np.int64)


def painter(thing: Thing) -> degrade.Warp:
    """Unlit sRGB colours about as bright as the photo."""

    def paint(points: Array) -> Array:
        blocks = np.array_split(points, max(1, len(points) // STRIP))
        return np.concatenate(
            [looks.to_srgb(render.tone(degrade.EXPOSURE * thing.look(block)[:, :3])) for block in blocks]
        )

    return paint


def photographic(image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The texture with detail at every scale, down to grain of one texel."""
    shape = image.shape[:2]
    detail = GRAIN * rng.normal(size=shape)
    for sigma in (2, 8, 32):
        wave = gaussian_filter(rng.normal(size=shape), sigma, mode="wrap")
        detail += 1.5 * GRAIN * wave / wave.std()
    return np.clip(np.round(image + detail[..., None]), 0, 255).astype(np.uint8)


def grooves(x: Array, rng: np.random.Generator) -> Array:
    """Fine relief (n, 3) in object sizes, at points in object sizes: what scans and generators show up close."""
    relief = np.zeros_like(x)
    for frequency, amplitude in ((40.0, 6e-4), (120.0, 2e-4)):
        relief += amplitude * degrade.Waves(
            k=rng.normal(size=(6, 3)) * frequency,
            phase=rng.uniform(0, 2 * np.pi, 6),
            amplitude=rng.normal(size=(6, 3)) / np.sqrt(6),
        )(x)
    return relief


def holed(vertices: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The faces without a disc of them about the lowest vertex."""
    lowest = vertices[vertices[:, 2].argmin()]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return faces[np.linalg.norm(vertices[faces].mean(1) - lowest, axis=1) > 0.04 * size]


def enlarge(folder: Path, factor: int) -> None:
    """Write the bundled example with a photo and masks of ``factor`` times its width and height, unless it is there."""
    source = example.folder()
    if (folder / "meta.json").exists():
        return
    shutil.copytree(source, folder, ignore=shutil.ignore_patterns("*.png", "image.jpg", "meta.json"))
    for path in (source / "image.jpg", source / "ground.png", *sorted((source / "masks").iterdir())):
        target = folder / path.relative_to(source)
        target.parent.mkdir(exist_ok=True)
        with Image.open(path) as image:
            size = (factor * image.width, factor * image.height)
            image.resize(size, Image.Resampling.NEAREST if path.suffix == ".png" else Image.Resampling.BICUBIC).save(
                target
            )
    shutil.copy(source / "meta.json", folder)


def main() -> None:
    folder, case = Path(sys.argv[1]), json.loads(sys.argv[2])
    if "enlarged" in case:
        enlarge(folder, case["enlarged"])
    else:
        write(folder, Size(**case))


if __name__ == "__main__":
    main()
