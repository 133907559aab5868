"""Makes the example that ships in the package: a table-top photo with masks, geometry, assets and truth.

    pip install -e . embreex
    python examples/make_tabletop.py OUT

Everything is our own: shapes and textures are written down in ``tabletop/``, MuJoCo puts the things at rest,
a small path tracer takes the photo, and the inputs are damaged as depth networks and image-to-3D models do.
``--exact`` skips that damage, which checks the conventions. Seeded: the same versions make the same folder.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose, rotation_about
from tabletop import degrade, render
from tabletop.degrade import NONE, Damage
from tabletop.settle import Rest, settle
from tabletop.things import Thing, arrange, room

SEED = 11
ROOM = len(room())
FACES, TEXTURE = 4000, 512
CONVENTION = (
    "sam-3d-objects: quaternion wxyz, p_camera = (scale * p_local) @ R(q) + translation in PyTorch3D camera "
    "axes (+X left, +Y up, +Z forward); glb vertices are (x, z, -y) of the local frame"
)


def main() -> None:
    options = parse()
    out, damage = options.out, NONE if options.exact else Damage()
    for folder in ("masks", "assets"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    things, camera = arrange(), hand_held()
    rest = settle(things)
    world = render.furnished(rest.T_world_object)

    instances = render.first_hits(world, camera)[0] - ROOM
    write_masks(out, things, instances)
    light = {"samples": options.samples, "workers": options.workers, "seed": SEED}
    image = render.photo(rest.T_world_object, camera, **light)
    Image.fromarray(image).save(out / "image.jpg", quality=92, subsampling=0)
    write_geometry(out, world, camera, damage)
    write_assets(out, things, rest, camera, damage)
    write_json(out / "truth.json", truth(things, rest, camera, damage, instances))
    write_json(out / "meta.json", {"source": "made by examples/make_tabletop.py", "license": "Apache-2.0"})


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Make the bundled table-top example.")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--samples", type=int, default=64, help="light paths per pixel")
    parser.add_argument("--workers", type=int, default=2, help="processes that trace light")
    parser.add_argument("--exact", action="store_true", help="undamaged geometry and assets")
    return parser.parse_args()


def hand_held() -> Camera:
    """A phone's view from above the near edge, slightly rolled, its principal point off the centre."""
    eye, target = np.array([0.055, -0.60, 0.515]), np.array([0.008, 0.018, 0.052])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    K = np.array([[1128.0, 0, 506.0], [0, 1128.0, 389.0], [0, 0, 1]])
    rolled = level @ rotation_about([0, 0, 1], np.radians(1.4))
    return Camera(width=1024, height=768, K=K, T_world_camera=pose(rolled, eye))


def write_masks(out: Path, things: tuple[Thing, ...], instances: NDArray[np.int64]) -> None:
    for k, thing in enumerate(things):
        save_mask(out / "masks" / f"{k:02d}_{thing.label}.png", instances == k)
    save_mask(out / "ground.png", instances == render.TABLE - ROOM)


def save_mask(path: Path, mask: NDArray[np.bool_]) -> None:
    Image.fromarray(mask.astype(np.uint8) * 255).save(path, optimize=True)


def write_geometry(out: Path, world: render.World, camera: Camera, damage: Damage) -> None:
    half = camera.resized(camera.width // 2, camera.height // 2)
    _, points, normals = render.first_hits(world, half)
    arrays = degrade.geometry(points, normals, half, damage, np.random.default_rng([SEED, 1]))
    np.savez_compressed(out / "geometry.npz", **arrays)


def write_assets(out: Path, things: tuple[Thing, ...], rest: Rest, camera: Camera, damage: Damage) -> None:
    entries: list[dict[str, Any]] = []
    for k, (thing, T) in enumerate(zip(things, rest.T_world_object, strict=True)):
        rng = np.random.default_rng([SEED, 2, k])
        T_camera_object = camera.T_camera_world @ T
        asset = degrade.generate(thing, T_camera_object, camera, damage, rng, faces=FACES, texture=TEXTURE)
        (out / "assets" / f"{k:02d}.glb").write_bytes(asset.glb)
        entry = {"rotation": asset.rotation, "translation": asset.translation, "scale": asset.scale}
        entries.append({"mask": f"{k:02d}_{thing.label}.png", "mesh": f"{k:02d}.glb", **entry})
    write_json(out / "assets" / "poses.json", {"convention": CONVENTION, "objects": entries})


def truth(
    things: tuple[Thing, ...], rest: Rest, camera: Camera, damage: Damage, instances: NDArray[np.int64]
) -> dict[str, Any]:
    """Camera, poses at rest, masses and who rests on whom, in the layout of the project's test scenes."""
    objects: list[dict[str, Any]] = []
    for k, (thing, T) in enumerate(zip(things, rest.T_world_object, strict=True)):
        pixels = int((instances == k).sum())
        entry = {
            "index": k,
            "name": thing.label,
            "model": f"tabletop_{thing.label}",
            "T_world_object": T.tolist(),
            "mass": thing.mass,
            "visible_fraction": pixels / silhouette(thing, T, camera),
            "pixels": pixels,
        }
        objects.append(entry)
    return {
        "family": "tabletop",
        "image_size": [camera.width, camera.height],
        "K": camera.K.tolist(),
        "T_world_camera": camera.T_world_camera.tolist(),
        "geometry_scale": damage.unit,
        "focal_ratio": damage.focal,
        "objects": objects,
        "contacts": rest.contacts,
        "supports": rest.supports,
        "kinetic_after_release": rest.kinetic,
    }


def silhouette(thing: Thing, T_world_object: Array, camera: Camera) -> int:
    """Pixels of the thing alone."""
    return int((render.first_hits(render.World([thing], [T_world_object]), camera)[0] == 0).sum())


def write_json(path: Path, value: dict[str, Any]) -> None:
    path.write_text(json.dumps(value, indent=1) + "\n")


if __name__ == "__main__":
    main()
