"""Monocular geometry and depth maps: points per pixel and the camera's K, in OpenCV axes."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from f3sr.errors import InputError
from f3sr.folder import InputFolder
from f3sr.frames import Array
from f3sr.images import open_image
from f3sr.sam3d import OPENCV_FROM_PYTORCH3D
from f3sr.scene import Geometry, Photo

KEYS = ("points", "pointmap", "pcd", "mask", "normal", "intrinsics", "coordinate_system")
"""Arrays of geometry.npz that mean something here."""
MAX_BYTES = 2_000_000_000
"""Most bytes these may inflate to: points and normals of a photo of the largest size accepted, in half precision."""
MIN_FOCAL, MAX_FOCAL = 0.1, 30.0
"""Focal lengths accepted, in longer image sides: from wider than any rectilinear lens to a 1000 mm telephoto."""

Row = tuple[float, float, float]

CAMERA_FRAMES = {
    "opencv": np.eye(3),
    "opengl": np.diag([1.0, -1, -1]),
    "pytorch3d": OPENCV_FROM_PYTORCH3D,
    "pytorch3d_scene_y_up": OPENCV_FROM_PYTORCH3D,
}
"""Rotations (3, 3) from named camera frames to OpenCV axes."""


def read_geometry(folder: InputFolder, photo: Photo) -> tuple[Geometry, Array]:
    """Geometry and K (3, 3) in the photo's pixels, from geometry.npz or from depth.png|npy with intrinsics.json."""
    depths = [name for name in ("depth.png", "depth.npy") if folder.has(name)]
    if not (folder.has("geometry.npz") or depths):
        raise InputError(
            folder.root,
            found="no geometry",
            accepted="geometry.npz, or depth.png|npy with intrinsics.json (there is no monocular back end yet)",
        )
    if folder.has("geometry.npz") and depths:
        raise InputError(folder.root, found=f"geometry.npz and {depths[0]}", accepted="one of the two")
    if len(depths) > 1:
        raise InputError(folder.root, found="depth.png and depth.npy", accepted="one of the two")
    if depths:
        return _depth_map(folder, depths[0], photo)
    return _point_map(folder, photo)


def _point_map(folder: InputFolder, photo: Photo) -> tuple[Geometry, Array]:
    path = folder.file("geometry.npz")
    data = _open_npz(path)
    points = next((data[k] for k in ("points", "pointmap", "pcd") if k in data), None)
    if points is None or points.ndim != 3 or points.shape[2] != 3 or points.dtype.kind != "f":
        found = ", ".join(f"{k} {v.shape} {v.dtype}" for k, v in data.items())
        raise InputError(path, found=found or "nothing", accepted="points (h, w, 3) of floats")
    to_camera = camera_frame(path, str(data.get("coordinate_system", "opencv")))
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
        K = _checked_K(path, _fit_intrinsics(path, geometry, photo), photo)
        folder.decide(
            f"camera: focal length {K[0, 0]:.1f} px fitted to the points",
            "no intrinsics in geometry.npz",
            fallback=True,
        )
        return geometry, K
    return geometry, _checked_K(path, intrinsics.astype(float) * [[photo.width], [photo.height], [1]], photo)


def _depth_map(folder: InputFolder, name: str, photo: Photo) -> tuple[Geometry, Array]:
    meta = folder.document("intrinsics.json", _Intrinsics)
    path = folder.file(name)
    values = _load_npy(path) if path.suffix == ".npy" else _load_png(path)
    if values.ndim != 2 or values.dtype.kind not in "fiu" or not values.size:
        raise InputError(path, found=f"an array {values.shape} of {values.dtype}", accepted="(h, w) numbers")
    h, w = values.shape
    if meta.width and meta.height and (w / h) * (meta.height / meta.width) != 1:
        raise InputError(path, found=f"{w}x{h} pixels", accepted=f"the aspect of {meta.width}x{meta.height}")
    width, height = meta.width or w, meta.height or h
    K_depth = np.asarray(meta.K, float)
    K = _checked_K(
        folder.path("intrinsics.json"), K_depth * [[photo.width / width], [photo.height / height], [1]], photo
    )
    depth = values.astype(float) * meta.depth_scale
    valid = np.isfinite(depth) & (depth > 0)
    rays = _pixel_rays(K_depth * [[w / width], [h / height], [1]], w, h)
    points = np.where(valid[..., None], rays * np.where(valid, depth, 0)[..., None], 0)
    geometry = Geometry(points=points.astype(np.float32), valid=valid)
    _require_valid(path, geometry)
    return geometry, K


class _Intrinsics(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    K: tuple[Row, Row, Row]
    width: int | None = Field(default=None, gt=0, le=100_000)
    height: int | None = Field(default=None, gt=0, le=100_000)
    depth_scale: float = Field(default=0.001, gt=0)


def _open_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays this module reads; others are left alone. Sizes are checked before anything is inflated."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(i.file_size for i in archive.infolist() if Path(i.filename).stem in KEYS)
        if size > MAX_BYTES:
            raise InputError(path, found=f"{size:,} bytes of arrays", accepted=f"at most {MAX_BYTES:,}")
        with np.load(path, allow_pickle=False) as archive:
            return {k: archive[k] for k in archive.files if k in KEYS}
    except InputError:
        raise
    except Exception as error:  # numpy and zipfile raise many kinds for a broken archive
        raise InputError(path, found=f"no readable npz ({error})", accepted="an npz archive of arrays") from error


def _load_png(path: Path) -> NDArray[Any]:
    return np.asarray(open_image(path))


def _load_npy(path: Path) -> NDArray[Any]:
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(values, np.ndarray):
            raise ValueError("an archive of arrays")
        return values
    except (OSError, ValueError, EOFError, MemoryError, OverflowError) as error:
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


def camera_frame(where: Path, name: str) -> Array:
    """The rotation (3, 3) from a named camera frame to OpenCV axes."""
    if name not in CAMERA_FRAMES:
        raise InputError(where, found=f"camera frame {name!r}", accepted=", ".join(CAMERA_FRAMES))
    return CAMERA_FRAMES[name]


def _checked_K(path: Path, K: Array, photo: Photo) -> Array:
    """K in pixels of the photo, with focal lengths that some lens has."""
    longest = max(photo.width, photo.height)
    low, high = MIN_FOCAL * longest, MAX_FOCAL * longest
    ok = np.isfinite(K).all() and np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])
    if not ok or not (low <= K[0, 0] <= high and low <= K[1, 1] <= high):
        rows = ", ".join(str([float(f"{x:.4g}") for x in row]) for row in K)
        raise InputError(
            path,
            found=f"K = [{rows}] in pixels of the photo",
            accepted=f"[[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy from {low:.0f} to {high:.0f} px "
            "(in geometry.npz divided by the photo's width and height)",
        )
    return K


def _require_valid(path: Path, geometry: Geometry) -> None:
    if not geometry.valid.any():
        raise InputError(path, found="no valid depth", accepted="finite points in front of the camera")


def _pixel_rays(K: Array, width: int, height: int) -> Array:
    """(height, width, 3) directions with z = 1 through the pixel centres."""
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([columns, rows, np.ones_like(columns)], -1)
    return pixels @ np.linalg.inv(K).T


def _fit_intrinsics(path: Path, geometry: Geometry, photo: Photo) -> Array:
    """Focal length from X/Z and Y/Z of the points, principal point at the centre (robust least squares)."""
    h, w = geometry.valid.shape
    pixels = _pixel_rays(np.array([[1, 0, w / 2], [0, 1, h / 2], [0, 0, 1.0]]), w, h)[geometry.valid][:, :2]
    points = geometry.points[geometry.valid].astype(float)
    slopes = points[:, :2] / points[:, 2:]
    use = np.abs(slopes) > 0.05
    if not use.any():
        raise InputError(path, found="no intrinsics, and points on one line of sight", accepted="intrinsics (3, 3)")
    focal = float(np.median((pixels / np.where(use, slopes, np.nan))[use]))
    fx, fy = focal * photo.width / w, focal * photo.height / h
    return np.array([[fx, 0, photo.width / 2], [0, fy, photo.height / 2], [0, 0, 1]])
