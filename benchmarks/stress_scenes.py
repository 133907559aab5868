"""Builds the input folders of the stress benchmark from a seed: analytic objects at rest, seen by our own raster, and
their assets where a generator would put them.

usage: stress_scenes.py DATA '{"case": "tower", "seed": 0, "view": "low"}'
writes DATA/scenes/NAME, with truth.json, and the true meshes to DATA/objects.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

import container_things
import room_things
import scan_things
import stress_things
from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import UP, Array, invert_pose, pose, rotation_about, transform
from f3sr.io.mesh_files import save_glb
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from scene_views import USUAL, VIEWS, View, scene_name
from stress_judged import crossing_pairs
from stress_things import Item, Stage
from tabletop import degrade, shapes
from tabletop.degrade import Damage
from tabletop.settle import Rest, settle

WIDTH, HEIGHT = 960, 720
RAGGED, CORRELATED = 2.5, 6.0
"""Standard deviation of a ragged edge's place, and of the filter that correlates it along the edge [px]."""
AIMED = 6
"""Times that the camera is turned to what it saw in the middle."""
OFF_CENTER = (4.0, -3.0)
"""Of the principal point [px]: estimated geometry has it in the middle, and takes what it misses for a turn."""
FINE, FINER = 28, 60
"""Edges along an object's size: some 5,000 and 20,000 triangles; the finer ones for the growth table."""
WALL = 1.5
"""Distance of the wall behind the objects [m]."""
FLOOR_COLOR, WALL_COLOR = (0.55, 0.5, 0.44), (0.8, 0.8, 0.78)
CASES = {**stress_things.CASES, **container_things.CASES, **room_things.CASES, **scan_things.CASES}
CONVENTION = "sam-3d-objects: p_opencv = s F R(q)^T A v_glb + F t"


@dataclass(frozen=True, kw_only=True)
class Case:
    case: str
    seed: int = 0
    view: str = USUAL

    @property
    def name(self) -> str:
        return scene_name(self.case, self.seed, self.view)


def write(data: Path, case: Case) -> Path:
    """Write a case, unless it is there already; returns its input folder."""
    folder = data / "scenes" / case.name
    if (folder / "truth.json").exists():
        return folder
    for place in (folder / "masks", folder / "assets", data / "objects"):
        place.mkdir(parents=True, exist_ok=True)
    rng, view = np.random.default_rng([case.seed, *case.case.encode()]), VIEWS[case.view]
    stage, rest, everything = set_down(case.case, rng)
    camera = viewpoint(stage, everything, view)
    seen = rasterizer.visible_ids(everything, camera)
    shown = [k for k in range(len(everything)) if np.count_nonzero(seen == k) >= stage.seen]
    missed = most_carrying(shown, rest.supports) if view.misses_carrier else None
    kept = [k for k in shown if k != missed]
    labels = {k: stage.items[k].label for k in kept}
    write_picture(folder, [everything[k] for k in shown], labels, camera)
    if view.is_ragged:
        roughen(folder / "masks", np.random.default_rng(case.seed))
    if view.has_geometry:
        write_geometry(folder, everything, camera, stage.damage, rng)
    write_assets(folder, kept, stage, everything, camera, stage.damage, case.seed)
    for new, k in enumerate(kept):
        save_glb(everything[k].mesh, data / "objects" / f"{case.name}_{new:02d}.glb")
    truth = truth_of(case, kept, stage.items, rest.T_world_object, camera)
    supports = [(a, b) for a, b in rest.supports if a in kept and (b in kept or b == -1)]
    index = {k: new for new, k in enumerate(kept)} | {-1: -1}
    truth |= {
        "supports": [[index[a], index[b]] for a, b in supports],
        "kinetic_after_release": rest.kinetic,
        "hidden": len(everything) - len(kept),
        "skip": stage.skip,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")
    return folder


def set_down(case: str, rng: np.random.Generator) -> tuple[Stage, Rest, list[SceneObject]]:
    """A stage and its objects at rest, drawn anew while two that start in each other stay so: no scene is like that."""
    while True:
        stage = numbered(CASES[case](rng))
        meshes = [mesh_of(item, FINER if case.startswith("mixed") else FINE) for item in stage.items]
        rest = settle(stage.items, seconds=stage.seconds)
        start, end = (
            [object_of(k, m, T) for k, (m, T) in enumerate(zip(meshes, poses, strict=True))]
            for poses in ([item.T_start for item in stage.items], rest.T_world_object)
        )
        if not {*crossing_pairs(start)} & {*crossing_pairs(end)}:
            return stage, rest, end


def numbered(stage: Stage) -> Stage:
    """Every label once: they are names of bodies."""
    count = Counter(item.label for item in stage.items)
    items = (replace(i, label=f"{i.label}_{k}" if count[i.label] > 1 else i.label) for k, i in enumerate(stage.items))
    return replace(stage, items=list(items))


def mesh_of(item: Item, edges: int) -> Mesh:
    """The item's own surface, cut up finely, in its colours; a scan as it is."""
    if item.mesh is not None:
        return item.mesh
    corners = shapes.vertices(item.shape.solid)
    length = float(np.linalg.norm(np.ptp(corners, axis=0))) / edges
    out = item.shape.solid.refine_to_length(length).to_mesh()
    vertices = np.asarray(out.vert_properties[:, :3], float)
    colors = np.round(255 * item.look(vertices)).astype(np.uint8)
    return Mesh(vertices=vertices, faces=np.asarray(out.tri_verts, np.int32), vertex_colors=colors)


def object_of(id: int, mesh: Mesh, T_world_object: Array) -> SceneObject:
    return SceneObject(
        id=id, label="", mask_name="", mask=np.zeros((1, 1), bool), mesh=mesh, T_world_object=T_world_object
    )


def viewpoint(stage: Stage, objects: Sequence[SceneObject], view: View) -> Camera:
    """A camera before the objects, a little to the side, whose focal length fills the picture with them."""
    points = np.concatenate([o.vertices_world for o in objects])
    target = (points.min(0) + points.max(0)) / 2
    eye = np.array([target[0] + 0.18 * stage.distance, points[:, 1].min() - 0.8 * stage.distance, stage.height])
    if view.elevation is not None or view.across is not None:
        eye = target + moved_eye(eye - target, view, float(np.linalg.norm(np.ptp(points, axis=0))))
    roll = pose(rotation_about([0, 0, 1], np.radians(view.roll)))
    for _ in range(AIMED):
        T = looking(eye, target) @ roll
        local = transform(invert_pose(T), points)
        x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
        target = transform(T, np.array([[(x.min() + x.max()) / 2, (y.min() + y.max()) / 2, 1.0]]))[0]
    width, height = (HEIGHT, WIDTH) if view.is_tall else (WIDTH, HEIGHT)
    focal = view.fills * min(width / np.ptp(x), height / np.ptp(y))
    K = np.array([[focal, 0, width / 2 + OFF_CENTER[0]], [0, focal, height / 2 + OFF_CENTER[1]], [0, 0, 1]])
    return Camera(width=width, height=height, K=K, T_world_camera=T)


def moved_eye(away: Array, view: View, size: float) -> Array:
    """The way from objects of a ``size`` [m] to the camera, at the view's elevation and as far as it says."""
    distance, over = float(np.linalg.norm(away)), float(np.hypot(*away[:2]))
    elevation = np.arctan2(away[2], over) if view.elevation is None else np.radians(view.elevation)
    if view.across is not None:
        distance = size / 2 / np.sin(np.radians(view.across) / 2)
    flat = np.cos(elevation) * away[:2] / over
    return distance * np.array([*flat, np.sin(elevation)])


def looking(eye: Array, target: Array) -> Array:
    """The pose of a level camera that looks from one point at another."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, UP) / np.linalg.norm(np.cross(forward, UP))
    return pose(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def ragged(mask: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """A mask (H, W) whose edge wanders."""
    inside = ndimage.distance_transform_edt(mask) - ndimage.distance_transform_edt(~mask)
    noise = ndimage.gaussian_filter(rng.normal(size=mask.shape), CORRELATED)
    return inside + RAGGED * noise / noise.std() > 0


def roughen(folder: Path, rng: np.random.Generator) -> None:
    """Give all masks of a folder ragged edges; no two share a pixel."""
    taken: NDArray[np.bool_] | None = None
    for path in sorted(folder.glob("*.png")):
        mask = ragged(np.asarray(Image.open(path)) > 127, rng)
        mask = mask if taken is None else mask & ~taken
        taken = mask if taken is None else taken | mask
        save_mask(path, mask)


def background(camera: Camera, wall: float) -> tuple[Array, NDArray[np.bool_]]:
    """Camera z (h, w) of floor and wall, the wall being at y = ``wall``, and where the floor shows."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T @ camera.T_world_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        down = np.where(rays[..., 2] < 0, -camera.center[2] / rays[..., 2], np.inf)
        back = np.where(rays[..., 1] > 0, (wall - camera.center[1]) / rays[..., 1], np.inf)
    return np.minimum(down, back), down < back


def wall_behind(objects: Sequence[SceneObject]) -> float:
    return WALL + max(float(o.bounds_world[1, 1]) for o in objects)


def most_carrying(among: Sequence[int], supports: Iterable[tuple[int, int]]) -> int | None:
    """Of these objects the one that carries most others, None when none carries any."""
    carried = Counter(b for _, b in supports if b in among)
    return max(carried, key=lambda b: (carried[b], -b), default=None)


def write_picture(folder: Path, objects: Sequence[SceneObject], labels: Mapping[int, str], camera: Camera) -> None:
    """The photo, unlit as our own renders are, the masks of what has a label and where the floor shows."""
    fragments = rasterizer.render(objects, camera)
    _, on_floor = background(camera, wall_behind(objects))
    empty = fragments.ids == rasterizer.EMPTY
    photo = rasterizer.shade(fragments, objects)
    photo[empty] = np.where(on_floor[..., None], FLOOR_COLOR, WALL_COLOR)[empty]
    Image.fromarray(np.round(255 * photo).astype(np.uint8)).save(folder / "image.png")
    save_mask(folder / "ground.png", empty & on_floor)
    for new, (id, label) in enumerate(labels.items()):
        save_mask(folder / "masks" / f"{new:02d}_{label}.png", fragments.ids == id)


def save_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    Image.fromarray(mask.astype(np.uint8) * 255).save(path)


def write_geometry(
    folder: Path, objects: Sequence[SceneObject], camera: Camera, damage: Damage, rng: np.random.Generator
) -> None:
    """A point map with normals at half size, as wrong as a network's."""
    small = camera.resized(camera.width // 2, camera.height // 2)
    points, normals, _ = surfaces(objects, small, wall_behind(objects))
    np.savez_compressed(folder / "geometry.npz", **degrade.geometry(points, normals, small, damage, rng))


def surfaces(objects: Sequence[SceneObject], camera: Camera, wall: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points and normals (h, w, 3) in camera axes of objects, floor and wall, and what is not the wall."""
    fragments = rasterizer.render(objects, camera)
    depth, on_floor = background(camera, wall)
    normals = np.where(on_floor[..., None], UP, [0.0, -1, 0])
    hit = fragments.face >= 0
    depth[hit] = fragments.depth[hit]
    normals[hit] = face_normals(objects)[fragments.face[hit]]
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.K).T
    return rays * depth[..., None], normals @ camera.T_camera_world[:3, :3].T, hit | on_floor


def face_normals(objects: Sequence[SceneObject]) -> Array:
    corners = np.concatenate([o.vertices_world[o.mesh.faces] for o in objects])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)


def write_assets(
    folder: Path,
    kept: Sequence[int],
    stage: Stage,
    objects: Sequence[SceneObject],
    camera: Camera,
    damage: Damage,
    seed: int,
) -> None:
    entries: list[dict[str, Any]] = []
    for new, k in enumerate(kept):
        rng, o, item = np.random.default_rng([seed, 2, k]), objects[k], stage.items[k]
        T_camera_object = camera.T_camera_world @ pose(t=item.push) @ o.T_world_object
        low, high = o.mesh.bounds
        size = float(np.linalg.norm(high - low))
        bent = o.mesh.vertices + size * damage.bump * degrade.Waves.draw(rng)((o.mesh.vertices - low) / size)
        low, high = bent.min(0), bent.max(0)
        extent, middle = float((high - low).max()) / 0.98, (low + high) / 2
        placed = degrade.place(T_camera_object, middle, extent, size, camera, stage.damage, rng)
        local = (bent - middle) / extent
        save_glb(o.mesh.with_vertices(local[:, [0, 2, 1]] * [1, 1, -1]), folder / "assets" / f"{new:02d}.glb")
        entries.append({"mask": f"{new:02d}_{item.label}.png", "mesh": f"{new:02d}.glb", **placed})
    poses = {"convention": CONVENTION, "objects": entries}
    (folder / "assets" / "poses.json").write_text(json.dumps(poses, indent=1) + "\n")


def truth_of(
    case: Case, kept: Sequence[int], items: Sequence[Item], poses: Sequence[Array], camera: Camera
) -> dict[str, Any]:
    """In the layout of the project's test scenes."""
    return {
        "family": case.case,
        "image_size": [camera.width, camera.height],
        "K": camera.K.tolist(),
        "T_world_camera": camera.T_world_camera.tolist(),
        "objects": [
            {
                "index": new,
                "name": items[k].label,
                "model": f"{case.name}_{new:02d}",
                "T_world_object": poses[k].tolist(),
                "round": items[k].round,
            }
            for new, k in enumerate(kept)
        ],
    }


def main() -> None:
    data, case = Path(sys.argv[1]), Case(**json.loads(sys.argv[2]))
    print(json.dumps(str(write(data, case))))


if __name__ == "__main__":
    main()
