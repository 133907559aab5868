"""Generated meshes and where they stand in the camera: SAM 3D Objects poses, or meshes posed already."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from f3sr import sam3d
from f3sr.errors import InputError
from f3sr.folder import InputFolder
from f3sr.frames import Array, pose
from f3sr.mesh import ConvexPart, Mesh
from f3sr.mesh_io import load_mesh
from f3sr.point_maps import camera_frame

MIN_SIZE, MAX_SIZE = 1e-3, 1e3
"""Sizes of objects accepted, in metres of the geometry: single-precision files and contact margins end there."""
ASSET_FRAMES = ("auto", "opencv", "opengl", "pytorch3d")


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedAsset:
    """A generated mesh in its own axes and its similarity into the OpenCV camera frame: x -> T (scale x), T rigid."""

    mesh: Mesh
    T_camera_object: Array
    scale: float


def read_assets(folder: InputFolder, masks: Mapping[int, str], frame: str) -> dict[int, PosedAsset]:
    """One asset per object; ``masks`` gives each id's mask file name, ``frame`` the axes of GLBs without poses.json."""
    if not folder.path("assets").is_dir():
        raise InputError(
            folder.root / "assets", found="no assets", accepted="assets/poses.json with GLBs, or one posed GLB per mask"
        )
    given = folder.has("assets/poses.json")
    assets = _sam3d_assets(folder, masks) if given else _posed_assets(folder, masks, frame)
    _require_size(folder.path("assets/poses.json" if given else "assets"), assets)
    return assets


def _solid_enough(path: Path, mesh: Mesh) -> Mesh:
    """The mesh, if it can have a place and a volume in a scene."""
    try:
        ConvexPart.hull_of(mesh.vertices)
    except ValueError as error:
        raise InputError(
            path, found="a flat mesh without any thickness", accepted="a mesh that spans a volume"
        ) from error
    return mesh


def _require_size(path: Path, assets: Mapping[int, PosedAsset]) -> None:
    """Every object between MIN_SIZE and MAX_SIZE: beyond them is another unit, or a mistake."""
    for id, asset in assets.items():
        size = asset.scale * asset.mesh.diagonal
        if not MIN_SIZE <= size <= MAX_SIZE:
            raise InputError(
                path, found=f"an object {id} of {size:.3g} m", accepted=f"objects of {MIN_SIZE} to {MAX_SIZE:.0f} m"
            )


def _sam3d_assets(folder: InputFolder, masks: Mapping[int, str]) -> dict[int, PosedAsset]:
    path = folder.path("assets/poses.json")
    document = folder.document("assets/poses.json", sam3d.Poses)
    by_mask = {p.mask: p for p in document.objects}
    if len(by_mask) != len(document.objects):
        raise InputError(path, found="two poses for one mask", accepted="one pose per mask")
    names = set(masks.values())
    if missing := sorted(names - by_mask.keys()):
        raise InputError(path, found=f"no asset for {', '.join(missing)}", accepted="one asset per mask")
    if extra := sorted(by_mask.keys() - names):
        raise InputError(path, found=f"assets for unknown masks {', '.join(extra)}", accepted="one asset per mask")
    assets: dict[int, PosedAsset] = {}
    for id, name in masks.items():
        entry = by_mask[name]
        file = folder.file(entry.mesh, base="assets")
        mesh = _solid_enough(file, load_mesh(file))
        R, t = entry.camera_pose()
        assets[id] = PosedAsset(
            mesh=mesh.with_vertices(mesh.vertices @ sam3d.LOCAL_FROM_GLB.T),
            T_camera_object=pose(R, t),
            scale=entry.uniform_scale,
        )
    return assets


def _posed_assets(folder: InputFolder, masks: Mapping[int, str], frame: str) -> dict[int, PosedAsset]:
    """GLBs whose vertices already are in a camera frame, one per mask, found by the mask's stem or id."""
    files = {p.stem: p for p in sorted((folder.root / "assets").glob("*.glb"))}
    by_id = {int(d.group()): p for stem, p in files.items() if (d := re.match(r"\d+", stem))}
    assets: dict[int, PosedAsset] = {}
    for id, name in masks.items():
        path = files.get(Path(name).stem) or by_id.get(id)
        if path is None:
            names = ", ".join(p.name for p in files.values()) or "none"
            raise InputError(
                folder.root / "assets",
                found=f"no GLB for mask {name} among {names}",
                accepted="one posed GLB per mask, named by the mask's stem or id",
            )
        mesh = _solid_enough(path, load_mesh(folder.file(f"assets/{path.name}")))
        vertices = mesh.vertices @ _posed_frame(path, mesh, frame).T
        center = (vertices.min(0) + vertices.max(0)) / 2
        assets[id] = PosedAsset(
            mesh=mesh.with_vertices(vertices - center), T_camera_object=pose(np.eye(3), center), scale=1.0
        )
    return assets


def _posed_frame(path: Path, mesh: Mesh, frame: str) -> Array:
    """The rotation from a posed GLB's axes to OpenCV, told from its bounds where that is certain."""
    if frame != "auto":
        return camera_frame(path, frame)
    low, high = mesh.bounds
    if high[2] < 0:
        return camera_frame(path, "opengl")
    if np.all(low > -0.55) and np.all(high < 0.55):
        found, accepted = "a mesh in its own frame and no poses.json", "poses.json, or a mesh posed in the camera"
    else:
        found, accepted = "a posed mesh whose axes cannot be told", "--asset-frame opencv, opengl or pytorch3d"
    raise InputError(path, found=found, accepted=accepted)
