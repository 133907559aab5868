"""The prompted-image folder: everything that enters is read and validated here, before any work starts."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr import sam3d
from f3sr.errors import InputError
from f3sr.frames import Array, pose
from f3sr.images import as_rgb, open_image
from f3sr.mesh import Mesh
from f3sr.mesh_io import load_mesh
from f3sr.report import Decision
from f3sr.scene import GROUND, Geometry, Photo, Predicate, Relation, SceneGraph

M = TypeVar("M", bound=BaseModel)

Part = Literal["assets", "geometry", "ground", "scene_graph"]
PARTS: tuple[Part, ...] = ("assets", "geometry", "ground", "scene_graph")
AssetFrame = Literal["auto", "local", "opencv", "opengl", "pytorch3d"]

MAX_MASK_OVERLAP = 0.05
"""Share of the smaller mask that two masks may overlap by; the pixels then go to the smaller one."""
MIN_MASK_PIXELS = 16
"""A smaller mask holds no usable silhouette."""
MIN_GEOMETRY_PIXELS = 16
"""Fewer valid points inside a mask say nothing about where the object is."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Instance:
    """One masked object of the photo."""

    id: int
    label: str
    name: str
    """File name of the mask."""
    mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedAsset:
    """A generated mesh in its own axes and its similarity into the OpenCV camera frame: x -> T (scale x), T rigid."""

    mesh: Mesh
    T_camera_object: Array
    scale: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Inputs:
    """A validated prompted-image folder. ``K`` (3, 3) in pixels of the photo."""

    photo: Photo
    instances: tuple[Instance, ...]
    K: Array
    geometry: Geometry
    assets: dict[int, PosedAsset]
    ground_mask: NDArray[np.bool_] | None = None
    graph: SceneGraph | None = None
    decisions: tuple[Decision, ...] = ()
    digests: dict[str, str] = field(default_factory=dict[str, str])
    """sha256 of every file read, by its path relative to the folder."""


def read(folder: str | Path, *, ignore: Iterable[Part] = (), asset_frame: AssetFrame = "auto") -> Inputs:
    """Read and validate a prompted-image folder (design: section 3 of the conventions page).

    ``ignore`` treats parts as absent. ``asset_frame`` names the axes of GLBs that come without ``poses.json``.
    Raises InputError for the first thing that is wrong.
    """
    reader = _Reader(Path(folder), frozenset(ignore))
    photo = reader.photo()
    instances = reader.instances(photo)
    geometry, K = reader.geometry(photo)
    for instance in instances:
        _require_geometry(geometry, instance)
    return Inputs(
        photo=photo,
        instances=instances,
        K=K,
        geometry=geometry,
        assets=reader.assets(instances, asset_frame),
        ground_mask=reader.ground_mask(photo, instances),
        graph=reader.scene_graph(instances),
        decisions=tuple(reader.decisions),
        digests=dict(sorted(reader.digests.items())),
    )


read_inputs = read


class _Reader:
    """Reads files of one folder, remembering their digests and the decisions taken."""

    def __init__(self, folder: Path, ignore: frozenset[Part]) -> None:
        if not folder.is_dir():
            found = "a file" if folder.exists() else "nothing there"
            raise InputError(folder, found=found, accepted="a folder with image.png|jpg and masks/*.png")
        if unknown := ignore - set(PARTS):
            raise InputError("--ignore", found=", ".join(sorted(unknown)), accepted=", ".join(PARTS))
        self.folder, self.ignore = folder, ignore
        self.decisions: list[Decision] = []
        self.digests: dict[str, str] = {}

    # --- files -----------------------------------------------------------------------------------------------

    def path(self, relative: str, *, base: str = "") -> Path:
        """A file of the folder; a path that leaves it is refused."""
        path = self.folder / base / relative
        root = self.folder.resolve()
        if Path(relative).is_absolute() or not path.resolve().is_relative_to(root):
            raise InputError(
                self.folder / base,
                found=f"the path {relative!r} that leaves the folder",
                accepted="paths inside it",
            )
        return path

    def note(self, path: Path) -> Path:
        """Remember the digest of a file that is read."""
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(path, found=error.strerror or "unreadable", accepted="a readable file") from error
        self.digests[path.relative_to(self.folder).as_posix()] = hashlib.sha256(data).hexdigest()
        return path

    def decide(self, choice: str, reason: str, about: int | None = None, *, fallback: bool = False) -> None:
        self.decisions.append(Decision(choice=choice, reason=reason, about=about, fallback=fallback))

    # --- the photo and its masks -----------------------------------------------------------------------------

    def photo(self) -> Photo:
        found = [p for p in sorted(self.folder.glob("image.*")) if p.suffix.lower() in (".png", ".jpg", ".jpeg")]
        if len(found) != 1:
            names = ", ".join(p.name for p in found) or "no image"
            raise InputError(self.folder, found=names, accepted="one image.png, image.jpg or image.jpeg")
        return Photo(rgb=as_rgb(open_image(self.note(self.path(found[0].name)))))

    def instances(self, photo: Photo) -> tuple[Instance, ...]:
        folder = self.folder / "masks"
        paths = sorted(folder.glob("*.png")) if folder.is_dir() else []
        if not paths:
            raise InputError(folder, found="no masks", accepted="masks/*.png, one binary mask per object")
        ids = _mask_ids(folder, [p.stem for p in paths])
        instances = [
            Instance(id=id, label=label, name=path.name, mask=self._mask(self.path(f"masks/{path.name}"), photo))
            for path, (id, label) in zip(paths, ids, strict=True)
        ]
        return self._disjoint(sorted(instances, key=lambda i: i.id))

    def ground_mask(self, photo: Photo, instances: Sequence[Instance]) -> NDArray[np.bool_] | None:
        path = self.folder / "ground.png"
        if "ground" in self.ignore or not path.exists():
            self.decide("ground: the lower image region outside all masks", "no ground.png", fallback=True)
            return None
        ground = self._mask(self.path("ground.png"), photo)
        covered = ground & np.any([i.mask for i in instances], axis=0)
        if covered.any():
            self.decide("ground: pixels of objects removed", f"{int(covered.sum())} pixels of ground.png lie in masks")
        if not (ground & ~covered).any():
            raise InputError(path, found="no pixel outside the object masks", accepted="the visible support surface")
        return ground & ~covered

    def _mask(self, path: Path, photo: Photo) -> NDArray[np.bool_]:
        gray = np.asarray(open_image(self.note(path)).convert("L"))
        if gray.shape != (photo.height, photo.width):
            size = f"{gray.shape[1]}x{gray.shape[0]} pixels"
            raise InputError(path, found=size, accepted=f"the photo's size {photo.width}x{photo.height}")
        levels = np.unique(gray)
        threshold = 0
        if len(levels) > 2:
            threshold = int(levels.max()) // 2
            self.decide(
                f"{path.name}: pixels above {threshold} belong to the mask",
                f"{len(levels)} grey levels, not two",
            )
        mask = gray > threshold
        if mask.sum() < MIN_MASK_PIXELS:
            raise InputError(
                path,
                found=f"{int(mask.sum())} set pixels",
                accepted=f"a mask of at least {MIN_MASK_PIXELS} pixels",
            )
        return mask

    def _disjoint(self, instances: list[Instance]) -> tuple[Instance, ...]:
        """Overlapping pixels go to the smaller mask where the overlap is small; a larger one is an error."""
        area = {i.id: int(i.mask.sum()) for i in instances}
        masks = {i.id: i.mask.copy() for i in instances}
        for k, a in enumerate(instances):
            for b in instances[k + 1 :]:
                shared = a.mask & b.mask
                if not shared.any():
                    continue
                small, large = sorted((a, b), key=lambda i: (area[i.id], i.id))
                share = shared.sum() / area[small.id]
                if share >= MAX_MASK_OVERLAP:
                    raise InputError(
                        self.folder / "masks" / small.name,
                        found=f"{100 * share:.0f}% of it also in {large.name}",
                        accepted=f"masks that overlap by less than {100 * MAX_MASK_OVERLAP:.0f}% of the smaller",
                    )
                masks[large.id] &= ~shared
                self.decide(
                    f"masks: {int(shared.sum())} shared pixels go to {small.name}",
                    f"also in {large.name}",
                    small.id,
                )
        return tuple(Instance(id=i.id, label=i.label, name=i.name, mask=masks[i.id]) for i in instances)

    # --- geometry --------------------------------------------------------------------------------------------

    def geometry(self, photo: Photo) -> tuple[Geometry, Array]:
        npz = self.folder / "geometry.npz"
        depths = [p for p in (self.folder / "depth.png", self.folder / "depth.npy") if p.exists()]
        if "geometry" in self.ignore or not (npz.exists() or depths):
            raise InputError(
                self.folder,
                found="no geometry",
                accepted="geometry.npz, or depth.png|npy with intrinsics.json (there is no monocular back end yet)",
            )
        if npz.exists() and depths:
            raise InputError(self.folder, found=f"geometry.npz and {depths[0].name}", accepted="one of the two")
        if len(depths) > 1:
            raise InputError(self.folder, found="depth.png and depth.npy", accepted="one of the two")
        return self._point_map(self.note(npz), photo) if npz.exists() else self._depth_map(depths[0], photo)

    def _point_map(self, path: Path, photo: Photo) -> tuple[Geometry, Array]:
        data = _open_npz(path)
        points = next((data[k] for k in ("points", "pointmap", "pcd") if k in data), None)
        if points is None or points.ndim != 3 or points.shape[2] != 3 or points.dtype.kind != "f":
            found = ", ".join(f"{k} {v.shape} {v.dtype}" for k, v in data.items())
            raise InputError(path, found=found or "nothing", accepted="points (h, w, 3) of floats")
        to_camera = _frame_matrix(path, str(data.get("coordinate_system", "opencv")))
        valid = _array(path, data, "mask", points.shape[:2], default=np.ones(points.shape[:2], bool)) > 0
        points = points.astype(np.float32) @ to_camera.T.astype(np.float32)
        valid = valid & np.isfinite(points).all(2) & (points[..., 2] > 0)
        normals = _array(path, data, "normal", points.shape)
        if normals is not None:
            normals = normals.astype(np.float32) @ to_camera.T.astype(np.float32)
        geometry = Geometry(points=np.where(valid[..., None], points, 0), valid=valid, normals=normals)
        _require_valid(path, geometry)
        intrinsics = _array(path, data, "intrinsics", (3, 3))
        if intrinsics is None:
            K = _fit_intrinsics(geometry, photo)
            self.decide(
                f"camera: focal length {K[0, 0]:.1f} px fitted to the points",
                "no intrinsics in geometry.npz",
                fallback=True,
            )
            return geometry, K
        return geometry, _checked_K(path, intrinsics.astype(float) * [[photo.width], [photo.height], [1]])

    def _depth_map(self, path: Path, photo: Photo) -> tuple[Geometry, Array]:
        intrinsics_path = self.path("intrinsics.json")
        meta = _parse(intrinsics_path, self._json(intrinsics_path), _Intrinsics)
        values = _load_npy(self.note(path)) if path.suffix == ".npy" else _load_png(self.note(path))
        if values.ndim != 2:
            raise InputError(path, found=f"an array of shape {values.shape}", accepted="one depth value per pixel")
        h, w = values.shape
        if meta.width and meta.height and (w / h) * (meta.height / meta.width) != 1:
            raise InputError(path, found=f"{w}x{h} pixels", accepted=f"the aspect of {meta.width}x{meta.height}")
        width, height = meta.width or w, meta.height or h
        K = _checked_K(intrinsics_path, np.asarray(meta.K, float))
        depth = values.astype(float) * meta.depth_scale
        valid = np.isfinite(depth) & (depth > 0)
        rays = _pixel_rays(K * [[w / width], [h / height], [1]], w, h)
        points = np.where(valid[..., None], rays * np.where(valid, depth, 0)[..., None], 0)
        geometry = Geometry(points=points.astype(np.float32), valid=valid)
        _require_valid(path, geometry)
        return geometry, K * [[photo.width / width], [photo.height / height], [1]]

    # --- assets ----------------------------------------------------------------------------------------------

    def assets(self, instances: Sequence[Instance], frame: AssetFrame) -> dict[int, PosedAsset]:
        folder = self.folder / "assets"
        if "assets" in self.ignore or not folder.is_dir():
            raise InputError(
                folder, found="no assets", accepted="assets/poses.json with GLBs, or one posed GLB per mask"
            )
        if (folder / "poses.json").exists():
            return self._sam3d_assets(instances)
        return self._posed_assets(instances, frame)

    def _sam3d_assets(self, instances: Sequence[Instance]) -> dict[int, PosedAsset]:
        path = self.path("assets/poses.json")
        document = _parse(path, self._json(path), sam3d.Poses)
        by_mask = {Path(p.mask).name: p for p in document.objects}
        if len(by_mask) != len(document.objects):
            raise InputError(path, found="two poses for one mask", accepted="one pose per mask")
        names = {i.name for i in instances}
        if missing := sorted(names - by_mask.keys()):
            raise InputError(path, found=f"no asset for {', '.join(missing)}", accepted="one asset per mask")
        if extra := sorted(by_mask.keys() - names):
            raise InputError(path, found=f"assets for unknown masks {', '.join(extra)}", accepted="one asset per mask")
        assets: dict[int, PosedAsset] = {}
        for instance in instances:
            entry = by_mask[instance.name]
            mesh = load_mesh(self.note(self.path(entry.mesh, base="assets")))
            R, t = entry.camera_pose()
            assets[instance.id] = PosedAsset(
                mesh=mesh.with_vertices(mesh.vertices @ sam3d.LOCAL_FROM_GLB.T),
                T_camera_object=pose(R, t),
                scale=entry.uniform_scale,
            )
        return assets

    def _posed_assets(self, instances: Sequence[Instance], frame: AssetFrame) -> dict[int, PosedAsset]:
        """GLBs whose vertices already are in a camera frame, one per mask, found by the mask's stem or id."""
        files = {p.stem: p for p in sorted((self.folder / "assets").glob("*.glb"))}
        by_id = {int(d.group()): p for stem, p in files.items() if (d := re.match(r"\d+", stem))}
        assets: dict[int, PosedAsset] = {}
        for instance in instances:
            path = files.get(Path(instance.name).stem) or by_id.get(instance.id)
            if path is None:
                names = ", ".join(p.name for p in files.values()) or "none"
                raise InputError(
                    self.folder / "assets",
                    found=f"no GLB for mask {instance.name} among {names}",
                    accepted="one posed GLB per mask, named by the mask's stem or id",
                )
            mesh = load_mesh(self.note(self.path(f"assets/{path.name}")))
            vertices = mesh.vertices @ _posed_frame(path, mesh, frame).T
            center = (vertices.min(0) + vertices.max(0)) / 2
            assets[instance.id] = PosedAsset(
                mesh=mesh.with_vertices(vertices - center), T_camera_object=pose(np.eye(3), center), scale=1.0
            )
        return assets

    # --- relations -------------------------------------------------------------------------------------------

    def scene_graph(self, instances: Sequence[Instance]) -> SceneGraph | None:
        path = self.folder / "scene_graph.json"
        if "scene_graph" in self.ignore or not path.exists():
            return None
        document = _parse(path, self._json(path), _GivenGraph)
        ids = {i.id for i in instances}
        relations = document.as_relations()
        for r in relations:
            if r.subject not in ids or r.object not in ids | {GROUND} or r.subject == r.object:
                raise InputError(
                    path,
                    found=f"{r.subject} {r.predicate} {r.object}",
                    accepted=f"two different ids of {sorted(ids)} ({GROUND} as the second is the ground)",
                )
        return SceneGraph(relations=tuple(relations), source=path.name)

    def _json(self, path: Path) -> object:
        try:
            return json.loads(self.note(path).read_text("utf-8"))
        except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
            raise InputError(path, found=f"no valid JSON ({error})", accepted="a JSON document") from error


# --- documents ---------------------------------------------------------------------------------------------------


class _Intrinsics(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    K: list[list[float]] = Field(min_length=3, max_length=3)
    width: int | None = Field(default=None, gt=0)
    height: int | None = Field(default=None, gt=0)
    depth_scale: float = Field(default=0.001, gt=0)


class _GivenRelation(BaseModel):
    subject: int
    predicate: Predicate
    object: int
    confidence: float = Field(default=1.0, ge=0, le=1)


class _GivenSupport(BaseModel):
    upper: int
    lower: int
    confidence: float = Field(default=1.0, ge=0, le=1)
    reason: str = ""


class _GivenGraph(BaseModel):
    relations: list[_GivenRelation] = []
    support_relations: list[_GivenSupport] = []

    def as_relations(self) -> list[Relation]:
        given = [
            Relation(
                subject=r.subject, predicate=r.predicate, object=r.object, confidence=r.confidence, evidence="given"
            )
            for r in self.relations
        ]
        for r in self.support_relations:
            evidence = f"given: {r.reason}" if r.reason else "given"
            given.append(
                Relation(
                    subject=r.upper,
                    predicate="supported_by",
                    object=r.lower,
                    confidence=r.confidence,
                    evidence=evidence,
                )
            )
        return given


def _parse(path: Path, value: object, model: type[M]) -> M:
    try:
        return model.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(p) for p in first["loc"]) or "the document"
        raise InputError(path, found=f"{where}: {first['msg']}", accepted=_describe(model)) from error


def _describe(model: type[BaseModel]) -> str:
    return f"an object with {', '.join(model.model_fields)}"


# --- values -------------------------------------------------------------------------------------------------------


def _mask_ids(folder: Path, stems: Sequence[str]) -> list[tuple[int, str]]:
    """Ids and labels from file stems: leading digits are the id, the rest the label."""
    matches = [re.match(r"(\d+)(.*)", s, re.DOTALL) for s in stems]
    if not any(matches):
        return [(k, _label(s)) for k, s in enumerate(stems)]
    if not all(matches):
        without = [s for s, m in zip(stems, matches, strict=True) if not m]
        raise InputError(
            folder,
            found=f"names with and without an id ({without[0]}.png)",
            accepted="ids in all names, or in none",
        )
    ids = [(int(m.group(1)), _label(m.group(2))) for m in matches if m]
    seen: dict[int, str] = {}
    for stem, (id, _) in zip(stems, ids, strict=True):
        if id in seen:
            raise InputError(folder, found=f"id {id} twice ({seen[id]}.png, {stem}.png)", accepted="unique ids")
        seen[id] = stem
    return ids


def _label(text: str) -> str:
    return re.sub(r"[_\s]+", " ", text).strip()


def _open_npz(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {k: archive[k] for k in archive.files}
    except Exception as error:  # numpy and zipfile raise many kinds for a broken archive
        raise InputError(path, found=f"no readable npz ({error})", accepted="an npz archive of arrays") from error


def _load_png(path: Path) -> NDArray[Any]:
    return np.asarray(open_image(path))


def _load_npy(path: Path) -> NDArray[Any]:
    try:
        return cast("NDArray[Any]", np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise InputError(path, found=f"no readable npy ({error})", accepted="a 2-D array of numbers") from error


def _array(
    path: Path,
    data: dict[str, NDArray[Any]],
    key: str,
    shape: tuple[int, ...],
    default: NDArray[Any] | None = None,
) -> Any:
    value = data.get(key, default)
    if value is not None and (value.shape != shape or value.dtype.kind not in "fiub"):
        raise InputError(path, found=f"{key} {value.shape} {value.dtype}", accepted=f"{key} {shape} of numbers")
    return value


def _frame_matrix(path: Path, name: str) -> Array:
    """The rotation (3, 3) from a named camera frame to OpenCV axes."""
    known = {
        "opencv": np.eye(3),
        "opengl": np.diag([1.0, -1, -1]),
        "pytorch3d": np.diag([-1.0, -1, 1]),
        "pytorch3d_scene_y_up": np.diag([-1.0, -1, 1]),
    }
    if name not in known:
        raise InputError(path, found=f"coordinate_system {name!r}", accepted=", ".join(known))
    return known[name]


def _posed_frame(path: Path, mesh: Mesh, frame: AssetFrame) -> Array:
    """The rotation from a posed GLB's axes to OpenCV, told from its bounds where that is certain."""
    low, high = mesh.bounds
    if frame == "auto":
        if high[2] < 0:
            frame = "opengl"
        elif np.all(low > -0.55) and np.all(high < 0.55):
            frame = "local"
    if frame == "local":
        raise InputError(
            path,
            found="a mesh in its own frame and no poses.json",
            accepted="poses.json, or a mesh posed in the camera",
        )
    if frame == "auto":
        raise InputError(
            path,
            found="a posed mesh whose axes cannot be told",
            accepted="--asset-frame opencv|opengl|pytorch3d",
        )
    return _frame_matrix(path, frame)


def _checked_K(path: Path, K: Array) -> Array:
    ok = K.shape == (3, 3) and np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0
    if not ok or not np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
        raise InputError(path, found=f"K = {K.tolist()}", accepted="[[fx, s, cx], [0, fy, cy], [0, 0, 1]], fx, fy > 0")
    return K


def _require_valid(path: Path, geometry: Geometry) -> None:
    if not geometry.valid.any():
        raise InputError(path, found="no valid depth", accepted="finite points in front of the camera")


def _require_geometry(geometry: Geometry, instance: Instance) -> None:
    count = int(geometry.inside(instance.mask).sum())
    if count == 0:
        raise InputError(
            f"masks/{instance.name}",
            found="no valid geometry inside the mask",
            accepted="at least one valid point",
        )


def _pixel_rays(K: Array, width: int, height: int) -> Array:
    """(height, width, 3) directions with z = 1 through the pixel centres."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([columns, rows, np.ones_like(columns)], -1)
    return pixels @ np.linalg.inv(K).T


def _fit_intrinsics(geometry: Geometry, photo: Photo) -> Array:
    """Focal length from X/Z and Y/Z of the points, principal point at the centre (robust least squares)."""
    h, w = geometry.valid.shape
    pixels = _pixel_rays(np.array([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1.0]]), w, h)[geometry.valid][:, :2]
    points = geometry.points[geometry.valid].astype(float)
    slopes = points[:, :2] / points[:, 2:]
    use = np.abs(slopes) > 0.05
    focal = float(np.median((pixels / np.where(use, slopes, np.nan))[use]))
    fx, fy = focal * photo.width / w, focal * photo.height / h
    return np.array([[fx, 0, photo.width / 2], [0, fy, photo.height / 2], [0, 0, 1]])
