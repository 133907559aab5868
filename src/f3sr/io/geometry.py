"""Monocular geometry and depth maps: points per pixel and the camera's K, in OpenCV axes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from f3sr.backends.protocols import KnownFocal
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.files import npz
from f3sr.io.images import MAX_PIXELS, open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.sam3d import OPENCV_FROM_PYTORCH3D
from f3sr.scene import Geometry, Photo

MIN_VALID = 100
"""Fewest valid pixels of geometry: fewer show no ground and no objects."""
MIN_DEPTH, MAX_DEPTH = 0.01, 10_000.0
"""The median depth accepted, in metres of the geometry: from a macro lens to a landscape."""
MIN_NEAR, MAX_FAR = 0.001, 100_000.0
"""Depth and coordinates of single points [m]; what lies nearer or farther, often a sky, is left out."""
MAX_CENTER = 30.0
"""How far the principal point may lie from the image's corner, in longer image sides: far crops of a photo."""
OFF_RAYS = 0.01
"""Tangent of the angle between points and the rays of their pixels from which on intrinsics contradict them: a focal
length that is 4 % off. Of made scenes and of the example they are less than .0001 off."""
SAMPLED = 20_000
"""About how many points are compared with their rays: a map may have as many as the photo has pixels."""
MAX_STRETCH = 1.1
"""Aspect of the geometry over the photo's, either way, that passes without a decision: networks round to tiles."""
MIN_FOCAL, MAX_FOCAL = 0.1, 30.0
"""Focal lengths accepted, in longer image sides: from wider than any rectilinear lens to a 1000 mm telephoto."""

DEPTH_FILES = ("depth.png", "depth.npy")
GEOMETRY_FILES = ("geometry.npz", *DEPTH_FILES)
"""Each by itself claims to be the geometry."""
INTRINSICS = "intrinsics.json"
"""K of depth.png|npy; without depths, of the photo."""
SKEWED = 0.02
"""Largest difference of fx and fy, as a share, that a camera found from the photo may leave out."""
GEOMETRY_ACCEPTED = "geometry.npz, or depth.png|npy, best with intrinsics.json, or a back end's name after --geometry"

WANTED = {
    "points": npz.Wanted(kinds="f", shape=("h", "w", 3), most=3 * MAX_PIXELS, also=("pointmap", "pcd")),
    "mask": npz.Wanted(shape=("h", "w"), optional=True),
    "normal": npz.Wanted(shape=("h", "w", 3), optional=True),
    "intrinsics": npz.Wanted(shape=(3, 3), optional=True),
    "coordinate_system": npz.Wanted(kinds="U", optional=True),
}
"""Arrays of geometry.npz that mean something here."""
DEPTH = npz.Wanted(kinds="fiu", shape=("h", "w"), most=MAX_PIXELS)
"""The array of depth.npy: z-depths in units of ``depth_scale``."""

Row = Annotated[list[float], Field(min_length=3, max_length=3)]

CAMERA_FRAMES = {
    "opencv": np.eye(3),
    "opengl": np.diag([1.0, -1, -1]),
    "pytorch3d": OPENCV_FROM_PYTORCH3D,
    "pytorch3d_scene_y_up": OPENCV_FROM_PYTORCH3D,
}
"""Rotations (3, 3) from named camera frames to OpenCV axes."""


def read_geometry(folder: InputFolder, photo: Photo, found: Array | None = None) -> tuple[Geometry, Array]:
    """Geometry and K (3, 3) in the photo's pixels, from geometry.npz or from depth.png|npy with intrinsics.json,
    one of which is there. ``found`` (3, 3) is K for depths without intrinsics.json. Raises InputError, which names the
    file, for what is invalid."""
    depths = [name for name in DEPTH_FILES if folder.has(name)]
    if folder.has("geometry.npz") and depths:
        raise InputError(folder.root, found=f"geometry.npz and {depths[0]}", accepted="one of the two")
    if len(depths) > 1:
        raise InputError(folder.root, found="depth.png and depth.npy", accepted="one of the two")
    geometry, K = _depth_map(folder, depths[0], photo, found) if depths else _point_map(folder, photo)
    tell_stretch(folder, geometry, photo)
    return geometry, K


def tell_stretch(folder: InputFolder, geometry: Geometry, photo: Photo) -> None:
    """A decision where geometry and photo have another aspect."""
    h, w = geometry.valid.shape
    if not 1 / MAX_STRETCH <= (w * photo.height) / (h * photo.width) <= MAX_STRETCH:
        folder.decide(
            f"geometry of {w}x{h} pixels is stretched over the photo",
            f"the photo has {photo.width}x{photo.height}",
            fallback=True,
        )


def _point_map(folder: InputFolder, photo: Photo) -> tuple[Geometry, Array]:
    path = folder.file("geometry.npz")
    data = npz.read(path, WANTED)
    points = data["points"]
    to_camera = camera_frame(path, str(data.get("coordinate_system", "opencv")))
    valid = data.get("mask", np.ones(points.shape[:2], bool)) > 0
    geometry = estimated(folder, path, points, valid, data.get("normal"), to_camera)
    if "intrinsics" in data:
        shares = data["intrinsics"].astype(float)
        K = checked_K(path, _scaled(shares, photo.width, photo.height), photo)
        _tell_disagreement(folder, geometry, _scaled(shares, *geometry.valid.shape[::-1]))
        return geometry, K
    fitted = checked_K(path, _fit_intrinsics(path, geometry, photo), photo)
    folder.decide(
        f"camera: focal length {fitted[0, 0]:.1f} px fitted to the points",
        "no intrinsics in geometry.npz",
        fallback=True,
    )
    return geometry, fitted


def _tell_disagreement(folder: InputFolder, geometry: Geometry, K: Array) -> None:
    """A decision where points lie elsewhere than on the rays of their pixels, which K (3, 3) of the map tells."""
    at = np.flatnonzero(geometry.valid)
    at = at[:: max(1, len(at) // SAMPLED)]
    rows, columns = np.divmod(at, geometry.valid.shape[1])
    rays = _rays(K, columns, rows)[:, :2]
    points = geometry.points.reshape(-1, 3)[at]
    off = float(np.median(np.linalg.norm(points[:, :2] / points[:, 2:] - rays, axis=1)))
    if off > OFF_RAYS:
        found = f"points lie {np.degrees(np.arctan(off)):.1f} degrees off the rays of their pixels in the median"
        choice = "geometry: points and intrinsics are used as given, although they contradict each other"
        folder.decide(choice, found, fallback=True)


def estimated(
    folder: InputFolder,
    where: Path | str,
    points: NDArray[Any],
    valid: NDArray[np.bool_],
    normals: NDArray[Any] | None,
    to_camera: Array,
) -> Geometry:
    """Points (h, w, 3) and normals of somebody's estimate, turned into the camera frame, without what is no place in a
    photo. Raises InputError, which names ``where`` they came from, where too little is left."""
    points, finite = _turned(points, to_camera)
    valid = _usable(folder, where, points[..., 2], points, valid & finite)
    if normals is not None:
        normals, _ = _turned(np.where(np.abs(normals) <= 1.5, normals, 0), to_camera)
    return Geometry(points=np.where(valid[..., None], points, 0), valid=valid, normals=normals)


def read_intrinsics(folder: InputFolder, photo: Photo) -> KnownFocal:
    """What intrinsics.json alone tells of the photo's camera. Raises InputError, also where pixels are not square."""
    meta = folder.document(INTRINSICS, _Intrinsics)
    width, height = meta.width or photo.width, meta.height or photo.height
    path = folder.path(INTRINSICS)
    K = checked_K(path, _scaled(np.asarray(meta.K, float), photo.width / width, photo.height / height), photo)
    if abs(K[0, 0] / K[1, 1] - 1) > SKEWED:
        raise InputError(
            path, found=f"fx {K[0, 0]:.4g} and fy {K[1, 1]:.4g} px", accepted="equal ones where there is no depth"
        )
    return KnownFocal(
        pixels=float(np.sqrt(K[0, 0] * K[1, 1])), sigma=0, source=INTRINSICS, centre=(float(K[0, 2]), float(K[1, 2]))
    )


def _depth_map(folder: InputFolder, name: str, photo: Photo, found: Array | None) -> tuple[Geometry, Array]:
    meta = None if found is not None else folder.document(INTRINSICS, _Intrinsics)
    path = folder.file(name)
    values = npz.read_npy(path, "depth", DEPTH) if path.suffix == ".npy" else _load_png(path)
    if meta is None:
        metres = values.dtype.kind == "f"
        folder.decide(
            f"{name}: depths in {'metres' if metres else 'millimetres'}", "no intrinsics.json with depth_scale"
        )
        rows = np.asarray(found).tolist()
        meta = _Intrinsics(K=rows, width=photo.width, height=photo.height, depth_scale=1.0 if metres else 0.001)
    h, w = values.shape
    if meta.width and meta.height and abs(w * meta.height - h * meta.width) > max(meta.width, meta.height):
        raise InputError(path, found=f"{w}x{h} pixels", accepted=f"the aspect of {meta.width}x{meta.height}")
    width, height = meta.width or w, meta.height or h
    K_depth = np.asarray(meta.K, float)
    K_photo = _scaled(K_depth, photo.width / width, photo.height / height)
    K = checked_K(folder.path(INTRINSICS), K_photo, photo)
    with np.errstate(over="ignore"):  # what overflows is infinite, so invalid
        depth = values.astype(float) * meta.depth_scale
    depth = np.where(np.isfinite(depth), depth, 0)
    # K belongs to the pixels named in the file; the depth map may have others.
    rays = _pixel_rays(K_depth * [[w / width], [h / height], [1]], w, h)
    valid = _usable(folder, path, depth, depth[..., None], depth > 0)
    points = rays * np.where(valid, depth, 0)[..., None]
    return Geometry(points=points.astype(np.float32), valid=valid, source="sensor"), K


class _Intrinsics(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False, strict=True)
    K: Annotated[list[Row], Field(min_length=3, max_length=3)]
    width: int | None = Field(default=None, gt=0, le=100_000)
    height: int | None = Field(default=None, gt=0, le=100_000)
    depth_scale: float = Field(default=0.001, gt=0)


def _load_png(path: Path) -> NDArray[Any]:
    image = open_image(path)
    if not image.mode.startswith("I"):
        raise InputError(
            path, found=f"pixels of kind {image.mode}, at most 8 bits a channel", accepted="16-bit grey depth"
        )
    return np.asarray(image)


def camera_frame(where: Path, name: str) -> Array:
    """The rotation (3, 3) from a named camera frame to OpenCV axes. InputError for another name."""
    if name not in CAMERA_FRAMES:
        raise InputError(where, found=f"camera frame {name!r}", accepted=", ".join(CAMERA_FRAMES))
    return CAMERA_FRAMES[name]


def _scaled(K: Array, x: float, y: float) -> Array:
    """K for an image x times as wide and y times as high; what overflows is refused as infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return K * [[x], [y], [1]]


def checked_K(path: Path | str, K: Array, photo: Photo) -> Array:
    """K (3, 3) in pixels of the photo, with focal lengths that some lens has. InputError names ``path``."""
    longest = max(photo.width, photo.height)
    low, high = MIN_FOCAL * longest, MAX_FOCAL * longest
    # The fixed entries: 0 below the diagonal, 1 in the corner.
    ok = np.isfinite(K).all() and np.allclose(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1])
    # Skew and principal point: of K[:2, 1:] all but fy.
    far = np.abs(K[:2, 1:]).max(initial=0, where=[[True, True], [False, True]]) > MAX_CENTER * longest
    if not ok or far or not (low <= K[0, 0] <= high and low <= K[1, 1] <= high):
        rows = ", ".join(str([float(f"{x:.4g}") for x in row]) for row in K)
        raise InputError(
            path,
            found=f"K = [{rows}] in pixels of the photo",
            accepted=f"[[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy from {low:.0f} to {high:.0f} px, the rest "
            f"within {MAX_CENTER * longest:.0f} px (in geometry.npz divided by the photo's width and height)",
        )
    return K


def _turned(vectors: NDArray[Any], R: Array) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Vectors (h, w, 3) turned by R, zero where they are not finite, and where they are finite (h, w)."""
    with np.errstate(over="ignore"):
        vectors = vectors.astype(np.float32)
    finite = np.asarray(np.isfinite(vectors).all(2))
    return np.where(finite[..., None], vectors, 0) @ R.T.astype(np.float32), finite


def _usable(
    folder: InputFolder, path: Path | str, depth: NDArray[Any], points: NDArray[Any], valid: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """The valid pixels (h, w) within reach: enough of them, and of a unit that a photo can have."""
    valid = valid & (depth > 0)
    if not valid.any():
        raise InputError(path, found="no valid depth", accepted="finite points in front of the camera")
    median = float(np.median(depth[valid]))
    if not MIN_DEPTH <= median <= MAX_DEPTH:
        raise InputError(
            path,
            found=f"a median depth of {median:.3g} m",
            accepted=f"{MIN_DEPTH} to {MAX_DEPTH:,.0f} m (check the unit)",
        )
    near = valid & (depth >= MIN_NEAR) & (np.abs(points).max(2) <= MAX_FAR)
    if (lost := int(valid.sum() - near.sum())) > 0:
        reason = f"nearer than {MIN_NEAR} m or farther than {MAX_FAR:,.0f} m"
        folder.decide(f"{Path(path).name}: {lost} points left out", reason)
    if near.sum() < MIN_VALID:
        raise InputError(path, found=f"{int(near.sum())} valid pixels", accepted=f"at least {MIN_VALID}")
    return near


def _pixel_rays(K: Array, width: int, height: int) -> Array:
    """(height, width, 3) directions with z = 1 through the pixel centres."""
    return _rays(K, *np.meshgrid(np.arange(width), np.arange(height)))


def _rays(K: Array, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> Array:
    """(..., 3) directions with z = 1 through the centres of some pixels."""
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(columns.shape)], -1)
    return pixels @ np.linalg.inv(K).T


def _fit_intrinsics(path: Path, geometry: Geometry, photo: Photo) -> Array:
    """K (3, 3): one focal length from X / Z and Y / Z of the points, principal point at the centre.

    It is the median of pixel offsets over slopes; rays near the axis, whose ratio is noise, have no say."""
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
