"""Whether the 90 % intervals of packages hold the truth: middle along and across the viewing ray, yaw, tilt and size.

usage: interval_coverage.py PACKAGES INPUTS [OBJECTS] [-- PACKAGES INPUTS [OBJECTS] ...]
PACKAGES holds packages named as the folders of INPUTS, or as their beginning. With truth.json, OBJECTS holds the meshes
that it names. With truth_points.npz yaw and tilt are not known.
Exit codes: 0 COVERED of every quantity, over all families, 1 not so.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

import tables
from f3sr.core.transforms import Array, transform, vector_from_rotation
from f3sr.io.mesh_files import load_mesh
from f3sr.scene import SceneObject
from f3sr.scene_package.package import Package, read_package
from poses import similarity
from truth import global_scale

COVERED = (0.85, 0.95)
"""Least and most share of objects whose truth lies in its 90 % interval."""
DEGREE = 100 * np.radians(1)
"""So that a share of it, in %, is an angle in degrees."""
QUANTITIES = ("along_ray", "across_ray", "yaw", "tilt", "size")


@dataclass(frozen=True, kw_only=True)
class Error:
    """Of one object: by how much it is off, the half width of the interval, and a length that both are shares of."""

    scene: str
    label: str
    quantity: str
    off: float
    half: float
    unit: float

    @property
    def is_covered(self) -> bool:
        return self.off <= self.half


def main() -> None:
    families = [list(g) for is_end, g in itertools.groupby(sys.argv[1:], lambda a: a == "--") if not is_end]
    every: list[Error] = []
    for family in families:
        packages, inputs = Path(family[0]), Path(family[1])
        errors = [
            error
            for package in sorted(p for p in packages.iterdir() if (p / "scene.json").exists())
            for folder in sorted(f for f in inputs.iterdir() if f.name.startswith(package.name))[:1]
            for error in _errors(read_package(package), folder, Path(family[2]) if len(family) > 2 else None)
        ]
        tables.show(_table(str(inputs), errors))
        every += errors
    tables.show(_table("all", every))
    for e in sorted(every, key=lambda e: e.half / max(e.off, 1e-12))[:12]:
        print(f"{e.off / e.half:.1f} half widths: {e.quantity} of {e.label} in {e.scene}")
    shares = [np.mean([e.is_covered for e in every if e.quantity == q]) for q in QUANTITIES]
    sys.exit(0 if all(COVERED[0] <= s <= COVERED[1] for s in shares) else 1)


def _table(title: str, errors: list[Error]) -> tables.Table:
    table = [[title, "objects", "covered [%]", "median half width [% of size, deg]"]]
    for q in QUANTITIES:
        some = [e for e in errors if e.quantity == q]
        if some:
            widths = [100 * e.half / e.unit for e in some]
            covered = 100 * np.mean([e.is_covered for e in some])
            table.append([q, str(len(some)), f"{covered:.1f}", f"{median(widths):.2f}"])
    return table


def _errors(package: Package, folder: Path, objects: Path | None) -> Iterator[Error]:
    index = {file.name: k for k, file in enumerate(sorted((folder / "masks").glob("*.png")))}
    known = package.uncertainty
    found = _against_meshes(package, folder, index, objects) if objects else _against_points(package, folder, index)
    for o, off in found:
        u = known[o.id]
        ray = o.middle - package.scene.camera.center
        ray /= np.linalg.norm(ray)
        along = float(off["middle"] @ ray)
        yield from (
            Error(scene=folder.name, label=o.label, quantity=q, off=float(value), half=half, unit=unit)
            for q, value, half, unit in (
                ("along_ray", abs(along), u.along_ray, o.size),
                ("across_ray", float(np.linalg.norm(off["middle"] - along * ray)), u.across_ray, o.size),
                *([("yaw", abs(off["turn"][2]), u.yaw, DEGREE)] if "turn" in off else []),
                *([("tilt", np.linalg.norm(off["turn"][:2]), u.tilt, DEGREE)] if "turn" in off else []),
                ("size", abs(off["size"]), u.size, 1.0),
            )
        )


def _against_meshes(
    package: Package, folder: Path, index: dict[str, int], objects: Path
) -> Iterator[tuple[SceneObject, dict[str, Array]]]:
    """Errors [m, rad] of similarities between equal vertices, in our world, after one global scale."""
    truth, camera = json.loads((folder / "truth.json").read_text()), package.scene.camera
    T_camera_true = np.linalg.inv(np.array(truth["T_world_camera"]))
    pairs: list[tuple[SceneObject, Array, Array]] = []
    for o in package.scene:
        record = truth["objects"][index[o.mask_name]]
        vertices = load_mesh(objects / f"{record['model']}.glb").vertices
        if len(vertices) == len(o.mesh.vertices):
            points = transform(T_camera_true @ np.array(record["T_world_object"]), vertices)
            pairs.append((o, points, camera.to_camera(o.vertices_world)))
    scale = global_scale([p for _, p, _ in pairs], [q for _, _, q in pairs])
    for o, points, _ in pairs:
        true, ours = transform(camera.T_world_camera, points / scale), o.vertices_world
        R, growth = similarity(true, ours)
        off = {"middle": ours.mean(0) - true.mean(0), "turn": vector_from_rotation(R), "size": np.log(growth)}
        yield o, off


def _against_points(
    package: Package, folder: Path, index: dict[str, int]
) -> Iterator[tuple[SceneObject, dict[str, Array]]]:
    """Errors [m] of middles and sizes of boxes around scanned surfaces, in the true world's axes."""
    with np.load(folder / "truth_points.npz") as truth:
        T_camera_true, camera = truth["T_camera_world"], package.scene.camera
        T_true_ours = np.linalg.inv(T_camera_true) @ camera.T_camera_world
        for o in package.scene:
            points = truth[f"object_{index[o.mask_name]:02d}"].astype(float)
            true = np.array([points.min(0), points.max(0)])
            ours = transform(T_true_ours, o.vertices_world)
            box = np.array([ours.min(0), ours.max(0)])
            middle = T_true_ours[:3, :3].T @ (box - true).mean(0)
            growth = np.log(np.linalg.norm(np.ptp(box, axis=0)) / np.linalg.norm(np.ptp(true, axis=0)))
            yield o, {"middle": middle, "size": growth}


if __name__ == "__main__":
    main()
