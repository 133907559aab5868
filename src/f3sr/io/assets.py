"""Generated meshes and where they stand in the camera: SAM 3D Objects poses, or meshes posed already."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from f3sr.backends.protocols import GeneratedAsset
from f3sr.core.mesh import Mesh, area_vectors, surface_flaws
from f3sr.core.transforms import Array, pose
from f3sr.errors import InputError
from f3sr.io import sam3d
from f3sr.io.geometry import camera_frame
from f3sr.io.given_meshes import GivenMeshes, PlacedMeshes
from f3sr.io.input_folder import InputFolder
from f3sr.io.mesh_files import load_mesh

MIN_SIZE, MAX_SIZE = 1e-3, 1e3
"""Sizes of objects accepted, in metres of the geometry: single-precision files and contact margins end there."""
MIN_FILL = 1e-7
"""Smallest volume of a mesh's hull, in cubes of its diagonal: a thread of 1 m that is .3 mm thick."""
THIN = 1e-3
"""Spread of vertices, in diagonals, from which on a mesh surely has a hull of ``MIN_FILL``."""
MAX_FOLDS = 200.0
"""Largest area of a mesh in squares of its diagonal. A box has up to 2, the generated meshes we have up to 3. Hundreds
of layers are no object, and the memory for its penetration grows with its area."""
MAX_SCENE_FACES = 20_000_000
"""Of all meshes together: a hundred objects of 200,000 triangles."""
MAX_SCENE_TEXTURE_PIXELS = 400_000_000
"""Of all textures together: 1.2 GB decoded."""
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".fbx")
"""Files in assets/ that look like an object's mesh: each must belong to a mask."""
ONE_PER_MASK = "one mesh per mask"
ASSETS_ACCEPTED = "assets/poses.json with GLBs, or one posed GLB per mask, or a back end's name after --assets"
POSES = "assets/poses.json"
UNPLACED = re.compile(r"[0-9]+\.json")
"""Files that tell of one mesh each, as workers' answers do, where there is no poses.json."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedAsset:
    """A generated mesh in its own axes and its similarity into the OpenCV camera frame: x -> T (scale x), T rigid."""

    mesh: Mesh
    T_camera_object: Array
    """(4, 4) rigid, OpenCV camera axes [m]."""
    scale: float
    """Metres per unit of the mesh."""
    source: Path | str
    """The file, or the back end, that says where the mesh stands."""
    fixed: str = ""
    """Why physics must not move it, by the back end; empty where it may."""
    lifted: bool = False
    """Whether a back end made it from its own mask, upright."""


Place = Callable[[GivenMeshes], PlacedMeshes]
"""Where meshes stand, told by somebody who sees the masks."""


def read_meshes(folder: InputFolder, masks: Mapping[int, str], frame: str) -> GivenMeshes:
    """One mesh per object, and its pose if there is one; ``masks`` gives each id's mask file name, ``frame`` is what
    ``--asset-frame`` says. Raises InputError, which names the file, for a mesh that is missing, left over or broken."""
    given = _with_poses(folder, masks, frame) if folder.has(POSES) else _without_poses(folder, masks, frame)
    used = {file.name for file in given.files.values()}
    if extra := [n for n in folder.names("assets") if Path(n).suffix.lower() in MESH_SUFFIXES and n not in used]:
        raise InputError(folder.path(f"assets/{extra[0]}"), found="a mesh of no mask", accepted=ONE_PER_MASK)
    return given


def placed_assets(
    folder: InputFolder, given: GivenMeshes, masks: Mapping[int, str], place: Place | None = None
) -> dict[int, PosedAsset]:
    """Meshes in the camera, by object id. ``place`` tells what nobody declares; without it only what is certain is
    read. Raises InputError for a frame that nothing tells, and for an object of an odd size."""
    placed = place(given) if place else _as_certain(given)
    for d in placed.decisions:
        folder.decide(d.choice, d.reason, d.about, fallback=d.fallback)
    assets = {
        id: PosedAsset(
            mesh=asset.mesh,
            T_camera_object=asset.T_camera_object,
            scale=asset.scale,
            source=given.files[id] if given.poses is None else given.place,
        )
        for id, asset in placed.assets.items()
    }
    require_assets(folder, folder.path("assets"), assets, masks)
    return assets


def has_unplaced_meshes(folder: InputFolder) -> bool:
    """Whether the folder's meshes come with a file each, NN.json, that may tell no pose or one to be read."""
    return not folder.has(POSES) and any(map(UNPLACED.fullmatch, folder.names("assets")))


def require_assets(
    folder: InputFolder, place: Path | str, assets: Mapping[int, PosedAsset], masks: Mapping[int, str]
) -> None:
    """Assets that can be a scene together, by size and number; what is odd about one is decided and told."""
    require_total(place, [a.mesh for a in assets.values()])
    for id, asset in assets.items():
        require_size(asset.source, masks[id], asset)
        _describe(folder, id, asset.mesh)


def require_size(path: Path | str, mask: str, asset: PosedAsset, *, factor: float = 1.0) -> None:
    """Raises InputError for an object outside MIN_SIZE..MAX_SIZE [m], also after scaling by a factor.

    Beyond is another unit, or a mistake."""
    size = factor * asset.scale * asset.mesh.diagonal
    if not MIN_SIZE <= size <= MAX_SIZE:
        raise InputError(
            path, found=f"an object of {size:.3g} m for {mask}", accepted=f"objects of {MIN_SIZE} to {MAX_SIZE:.0f} m"
        )


def require_total(place: Path | str, meshes: Sequence[Mesh]) -> None:
    """Raises InputError where all meshes together have too many faces or texture pixels."""
    faces = sum(len(m.faces) for m in meshes)
    textures = [t for m in meshes for material in m.materials if (t := material.texture) is not None]
    pixels = sum(t.shape[0] * t.shape[1] for t in textures)
    for what, count, most in (("faces", faces, MAX_SCENE_FACES), ("texture pixels", pixels, MAX_SCENE_TEXTURE_PIXELS)):
        if count > most:
            raise InputError(place, found=f"{count:,} {what} in all meshes", accepted=f"at most {most:,}")


def _mesh(folder: InputFolder, id: int, relative: str) -> Mesh:
    """The mesh of a GLB below assets/, if it can have a place and a volume in a scene."""
    file = folder.file(relative, base="assets")
    if file.suffix.lower() != ".glb":
        raise InputError(file, found=f"a file of type {file.suffix!r}", accepted="a GLB file")
    return usable_mesh(folder, file, id, load_mesh(file))


def load_asset_mesh(path: Path) -> Mesh:
    """The mesh of a file (``load_mesh``). Raises InputError, naming it, also for one that spans no volume."""
    mesh = load_mesh(path)
    require_solidity(path, mesh.without_unused())
    return mesh


def usable_mesh(folder: InputFolder, where: Path | str, id: int, mesh: Mesh) -> Mesh:
    """The mesh without vertices that no triangle uses, if it can have a place and a volume in a scene."""
    used = mesh.without_unused()
    if count := len(mesh.vertices) - len(used.vertices):
        folder.decide(f"{Path(where).name}: {count} vertices left out", "no triangle uses them", id)
    require_solidity(where, used)
    return used


def require_solidity(path: Path | str, mesh: Mesh) -> None:
    """Raises InputError for a mesh that spans no or hardly any volume, or whose triangles have no or an absurd area."""
    accepted = "a mesh that spans a volume"
    try:
        filled = mesh.hull.volume / mesh.diagonal**3 if _is_thin(mesh) else 1.0
    except ValueError as error:
        raise InputError(path, found="a flat mesh without any thickness", accepted=accepted) from error
    if filled < MIN_FILL:
        raise InputError(path, found="a mesh thinner than single precision can tell", accepted=accepted)
    areas = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1)
    folds = float(areas.sum() / 2) / mesh.diagonal**2
    if not folds:
        raise InputError(path, found="no triangle that has an area", accepted=accepted)
    if folds > MAX_FOLDS:
        found, accepted = f"a surface of {folds:,.0f} times its diagonal squared", f"at most {MAX_FOLDS:.0f} times"
        raise InputError(path, found=found, accepted=accepted)


def _is_thin(mesh: Mesh) -> bool:
    """Whether its vertices spread so little along some direction that its hull, which takes longer, must tell."""
    away = mesh.vertices - mesh.vertices.mean(0)
    # Variances along the principal axes, least first: the square root is a standard deviation.
    spread = np.linalg.eigvalsh(away.T @ away / len(away))
    return bool(spread[0] <= (THIN * mesh.diagonal) ** 2)


def _describe(folder: InputFolder, id: int, mesh: Mesh) -> None:
    """Say why a mesh is no solid: then its mass comes from its collision parts."""
    flaws = surface_flaws(mesh)
    if not mesh.is_solid:
        folder.decide("its volume is that of its collision parts", f"the mesh is no closed solid ({flaws})", id)
    elif flaws.degenerate or flaws.doubled:
        folder.decide("kept as it is", f"the mesh has {flaws}", id)


def _with_poses(folder: InputFolder, masks: Mapping[int, str], frame: str) -> GivenMeshes:
    """The meshes of poses.json."""
    path = folder.path(POSES)
    document = folder.document(POSES, sam3d.Poses)
    by_mask = {p.mask: p for p in document.objects}
    if len(by_mask) != len(document.objects):
        raise InputError(path, found="two poses for one mask", accepted="one pose per mask")
    names = set(masks.values())
    if missing := sorted(names - by_mask.keys()):
        raise InputError(path, found=f"no asset for {', '.join(missing)}", accepted="one asset per mask")
    if extra := sorted(by_mask.keys() - names):
        raise InputError(path, found=f"assets for unknown masks {', '.join(extra)}", accepted="one asset per mask")
    poses = {id: by_mask[name] for id, name in masks.items()}
    return GivenMeshes(
        place=path,
        meshes={id: _mesh(folder, id, p.mesh) for id, p in poses.items()},
        files={id: folder.path(f"assets/{p.mesh}") for id, p in poses.items()},
        poses=poses,
        declared=document.declared,
        frame=frame,
    )


def _without_poses(folder: InputFolder, masks: Mapping[int, str], frame: str) -> GivenMeshes:
    """One GLB per mask, found by the mask's stem or id."""
    files = [n for n in folder.names("assets") if n.lower().endswith(".glb")]
    chosen = dict[int, str]()
    for id, mask in masks.items():
        own = [n for n in files if Path(n).stem == Path(mask).stem] or [n for n in files if _leading_id(n) == id]
        if len(own) != 1:
            found = f"{', '.join(own)} for mask {mask}" if own else f"no GLB for mask {mask} among {', '.join(files)}"
            raise InputError(
                folder.path("assets"),
                found=found,
                accepted="one posed GLB per mask, named by the mask's stem or id (or poses.json)",
            )
        chosen[id] = own[0]
    return GivenMeshes(
        place=folder.path("assets"),
        meshes={id: _mesh(folder, id, name) for id, name in chosen.items()},
        files={id: folder.path(f"assets/{name}") for id, name in chosen.items()},
        poses=None,
        declared=False,
        frame=frame,
    )


def _as_certain(given: GivenMeshes) -> PlacedMeshes:
    """Assets where nobody sees the masks: poses by the documented convention, meshes in axes that are told or certain.

    Raises InputError for all else."""
    assets = dict[int, GeneratedAsset]()
    for id, mesh in given.meshes.items():
        if given.poses is not None:
            entry = given.poses[id]
            R, t = entry.camera_pose()
            local = mesh.with_vertices(mesh.vertices @ sam3d.LOCAL_FROM_GLB.T)
            assets[id] = GeneratedAsset(mesh=local, T_camera_object=pose(R, t), scale=entry.uniform_scale)
            continue
        vertices = mesh.vertices @ _posed_frame(given.files[id], mesh, given.frame).T
        center = (vertices.min(0) + vertices.max(0)) / 2
        assets[id] = GeneratedAsset(
            mesh=mesh.with_vertices(vertices - center), T_camera_object=pose(np.eye(3), center), scale=1.0
        )
    return PlacedMeshes(assets=assets)


def _leading_id(name: str) -> int | None:
    digits = re.match(r"[0-9]+", name)
    return int(digits.group()) if digits else None


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
        found, accepted = "a posed mesh of unknown axes", "--asset-frame opencv, opengl or pytorch3d"
    raise InputError(path, found=found, accepted=accepted)
