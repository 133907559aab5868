"""The rendered scenes with the true geometry in place of the estimated one: what is left is the assets' own error.

usage: python benchmarks/exact_geometry.py [--data PATH] [--out FOLDER] [--noise SHARE]
``--noise`` is given to f3sr as ``--geometry-noise``; without it f3sr takes the geometry for an estimate.
``sunk_pct``: how deep the true objects that stand on the ground are under it [% of their size], which no scene that
crosses nowhere can have; ``shape_pct``: distance of the centres when assets are fitted to the visible sides alone.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

import caches
import process
import tables
from f3sr.core.camera import Camera
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array
from f3sr.io.mesh_files import load_mesh
from f3sr.scene import SceneObject
from poses import similarity
from run import REPO
from stress_scenes import object_of, surfaces

FLIP = np.diag([-1.0, -1.0, 1.0])
"""PyTorch3D camera axes from OpenCV's, and back."""
FAR = 1e6
"""Distance [m] of the wall behind the table: there is none."""
COLUMNS = ("mIoU_visible", "tilt_deg", "centre_pct", "chamfer_pct", "sunk_pct", "shape_pct")


def main() -> int:
    args = _arguments()
    folders = sorted((args.data / "scenes").glob("dev_*"))
    if not folders:
        print(f"skipped: no data in {args.data} (--data PATH names another folder)")
        return 0
    kept = caches.kept(args.out / "warm_up.log")
    options = [] if args.noise is None else ["--geometry-noise", str(args.noise)]
    rows: dict[str, dict[str, float]] = {}
    for folder in folders:
        made, package = args.out / "inputs" / folder.name, args.out / folder.name
        floor = write(folder, made, args.data / "objects")
        with caches.fresh(*kept) as cache:
            done = process.reconstruct(made, package, environment={"F3SR_CACHE_DIR": str(cache)}, options=options)
        true = process.run(["truth.py", made, package, args.data / "objects"], args.out / f"{folder.name}.truth.log")
        rows[folder.name] = {**done.answer["f3sr"], **true.answer["f3sr"], **floor}
        print(folder.name, {c: round(rows[folder.name][c], 3) for c in COLUMNS}, flush=True)
    rows["mean"] = {c: float(np.mean([r[c] for r in rows.values()])) for c in COLUMNS}
    tables.show([["", *COLUMNS], *([name, *(f"{r[c]:.3g}" for c in COLUMNS)] for name, r in rows.items())])
    return 0


def write(folder: Path, made: Path, objects: Path) -> dict[str, float]:
    """The input folder with exact geometry [m] and poses brought from the estimated one; returns what no alignment can
    take away."""
    shutil.rmtree(made, ignore_errors=True)
    shutil.copytree(folder, made)
    true = json.loads((folder / "truth.json").read_text())
    width, height = true["image_size"]
    camera = Camera(width=width, height=height, K=np.array(true["K"]), T_world_camera=np.array(true["T_world_camera"]))
    everything = [
        object_of(k, load_mesh(objects / f"{g['model']}.glb"), np.array(g["T_world_object"]))
        for k, g in enumerate(true["objects"])
    ]
    pixels = np.array([[width], [height], [1.0]])
    estimated = np.load(folder / "geometry.npz")["intrinsics"] * pixels
    np.savez_compressed(made / "geometry.npz", **geometry(everything, camera), intrinsics=camera.K / pixels)
    poses = json.loads((folder / "assets" / "poses.json").read_text())
    for entry in poses["objects"]:
        _bring_over(entry, estimated, camera.K, true["geometry_scale"])
    (made / "assets" / "poses.json").write_text(json.dumps(poses))
    standing = {a for a, b in true["supports"] if b == -1}
    sunk = [max(0.0, -float(o.bounds_world[0, 2])) / o.size for o in everything if o.id in standing]
    shape = [_fitted_to_the_visible(o, load_mesh(folder / "assets" / f"{o.id:02d}.glb"), camera) for o in everything]
    return {"sunk_pct": 100 * float(np.mean(sunk)), "shape_pct": 100 * float(np.mean(shape))}


def geometry(objects: list[SceneObject], camera: Camera) -> dict[str, Any]:
    """Points, normals and validity (h, w) of objects and ground at the photo's size."""
    points, normals, valid = surfaces(objects, camera, FAR)
    return {"points": points.astype(np.float32), "normal": normals.astype(np.float32), "mask": valid}


def _bring_over(entry: dict[str, Any], estimated: Array, K: Array, unit: float) -> None:
    """A generated pose from the estimated camera and unit to the true ones: the same pixel, the same depth."""
    place = FLIP @ np.array(entry["translation"])
    ray = np.linalg.inv(K) @ estimated @ (place / place[2])
    entry["translation"] = (FLIP @ ray * place[2] / unit).tolist()
    entry["scale"] = [s / unit for s in entry["scale"]]


def _fitted_to_the_visible(o: SceneObject, asset: Any, camera: Camera) -> float:
    """Distance of the mean surface points of an object and of its asset, as a share of the object's size, when the
    asset's vertices are fitted to the object's that face the camera."""
    P, Q = o.vertices_world, np.asarray(asset.vertices, float)
    corners = P[o.mesh.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(P)
    for k in range(3):
        np.add.at(normals, o.mesh.faces[:, k], outward)
    seen = ((P - camera.center) * normals).sum(1) < 0
    R, scale = similarity(Q[seen], P[seen])
    fitted = scale * (Q - Q[seen].mean(0)) @ R.T + P[seen].mean(0)
    off = sample_surface(fitted, asset.faces, 1500).mean(0) - sample_surface(P, o.mesh.faces, 1500).mean(0)
    return float(np.linalg.norm(off)) / o.size


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/, objects/")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench" / "exact_geometry")
    parser.add_argument("--noise", type=float, help="of the depths, as a share of the distance")
    args = parser.parse_args()
    args.out = args.out.resolve()
    args.out.mkdir(parents=True, exist_ok=True)
    return args


if __name__ == "__main__":
    sys.exit(main())
