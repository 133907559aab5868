"""What back ends answer, checked as files from outside are: types, shapes, finite numbers, sizes that a scene can have.

Every error is an InputError that names the back end, what it answered and what is accepted.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import (
    AssetGenerator,
    Detection,
    EstimatedGeometry,
    EstimatedNormals,
    GeneratedAsset,
    GeometryEstimator,
    Labeler,
    NormalEstimator,
    PromptedImage,
    SceneGrapher,
)
from f3sr.backends.registry import Backend
from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array
from f3sr.errors import InputError, printable
from f3sr.io.assets import PosedAsset, require_assets, usable_mesh
from f3sr.io.geometry import checked_K, estimated, tell_stretch
from f3sr.io.images import MAX_PIXELS
from f3sr.io.input_folder import InputFolder
from f3sr.io.mesh_files import MAX_COORDINATE, MAX_FACES, MAX_TEXTURE_PIXELS
from f3sr.scene import GROUND, Geometry, Instance, Photo, Predicate, Relation, SceneGraph

T = TypeVar("T")

MAX_RELATIONS = 10_000
"""Most relations of a kind that are given: every pair of a hundred objects, both ways."""
MAX_REASON = 1000
"""Most characters of a relation's reason, which goes into the package and its report."""
UNIT = 1e-3
"""Largest difference of a normal's length from 1."""
RIGID = 1e-4
"""Largest entry of R'R - 1 that a rotation may have: single precision and rounding in files leave less."""
LABEL = re.compile(r"[a-z][a-z0-9' -]{0,38}[a-z0-9]")
"""What a label of a back end may be."""
ABSENT = "the folder has none"
Shape = tuple[int | str, ...]
"""Lengths of an array's axes; a letter stands for any."""


def geometry_of(
    folder: InputFolder, backend: Backend[GeometryEstimator], image: PromptedImage, *, fallback: bool = False
) -> tuple[Geometry, Array]:
    """The geometry that a back end estimates, and K (3, 3) in the photo's pixels. It may be a ``fallback``."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.estimate(image)), EstimatedGeometry)
    valid = _array(where, "valid", answer.valid, "b", ("h", "w"))
    points = _array(where, "points", answer.points, "f", (*valid.shape, 3))
    normals = None if answer.normals is None else _array(where, "normals", answer.normals, "f", (*valid.shape, 3))
    K = checked_K(where, _array(where, "K", answer.K, "fiu", (3, 3)).astype(float), image.photo)
    geometry = estimated(folder, where, points, valid, normals, np.eye(3))
    folder.digests[f"geometry by {backend.key}"] = _digest(
        points, valid, normals, K, answer.up_error, answer.focal_error
    )
    if _typed(where, answer.ground_only, bool):
        geometry = replace(geometry, source="ground", guessed_unit=True)
    elif _typed(where, answer.guessed_unit, bool):
        geometry = replace(geometry, guessed_unit=True)
    if answer.up_error is not None:
        geometry = replace(geometry, up_error=_error(where, answer.up_error, " rad"))
    if answer.focal_error is not None:
        geometry = replace(geometry, focal_error=_error(where, answer.focal_error))
    told = _told(where, answer.told)
    folder.decide(f"geometry: estimated by {where}{told and ': '}{told}", ABSENT, fallback=fallback)
    tell_stretch(folder, geometry, image.photo)
    return geometry, K


def normals_of(
    folder: InputFolder,
    backend: Backend[NormalEstimator],
    image: PromptedImage,
    geometry: Geometry | None = None,
    K: Array | None = None,
) -> EstimatedNormals:
    """The normals (h, w, 3) float32 that a back end estimates; ``geometry`` and K (3, 3) where points are known."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.normals(image, geometry, K)), EstimatedNormals)
    values = _array(where, "values", answer.values, "f", ("h", "w", 3)).astype(np.float32)
    lengths = np.linalg.norm(values, axis=2)
    if not (np.isclose(lengths, 1, atol=UNIT) | (lengths == 0)).all():  # NaN is neither
        worst = float(lengths[~np.isclose(lengths, 1, atol=UNIT)][0])
        _refuse(where, f"a normal of length {worst:.3g}", "unit vectors, or zero where unknown")
    error = _error(where, answer.error, " rad")
    folder.digests[f"normals by {backend.key}"] = _digest(values, error)
    told, warning = _told(where, answer.told), _told(where, answer.warning)
    folder.decide(f"normals: estimated by {where}{told and ': '}{told}", "named by the user")
    if warning:
        folder.decide("normals: their axes are doubtful", warning, fallback=True)
    return replace(answer, values=values, error=error)


def _error(where: str, value: object, unit: str = "") -> float:
    """A standard error that a back end tells."""
    error = _number(where, value)
    if not 0 <= error <= math.pi:
        _refuse(where, f"an error of {error:g}{unit}", "0 to pi")
    return error


def with_normals(geometry: Geometry, normals: EstimatedNormals) -> Geometry:
    """The geometry with normals of the whole photo, read at its own pixels."""
    (h, w), (rows, columns) = geometry.valid.shape, normals.values.shape[:2]
    at = ((np.arange(h) + 0.5) * rows / h).astype(int)[:, None], ((np.arange(w) + 0.5) * columns / w).astype(int)
    return replace(geometry, normals=normals.values[at], normals_error=normals.error)


def camera_of(folder: InputFolder, backend: Backend[GeometryEstimator], image: PromptedImage) -> Array:
    """K (3, 3) in the photo's pixels, by a back end: for depths whose camera nobody tells."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.estimate(image)), EstimatedGeometry)
    K = checked_K(where, _array(where, "K", answer.K, "fiu", (3, 3)).astype(float), image.photo)
    folder.digests[f"intrinsics by {backend.key}"] = _digest(K)
    told = _told(where, answer.told)
    choice = f"camera: focal length {K[0, 0]:.0f} px by {where}{told and ': '}{told}"
    folder.decide(choice, "depths without intrinsics.json", fallback=True)
    return K


def assets_of(
    folder: InputFolder,
    backend: Backend[AssetGenerator],
    image: PromptedImage,
    geometry: Geometry,
    K: Array,
    *,
    fallback: bool = False,
    saved: bool = False,
) -> dict[int, PosedAsset]:
    """The meshes that a back end makes, one for every mask. They may be a ``fallback``. ``saved`` ones are the
    folder's own, and the back end only finds their poses."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.generate(image, geometry, K)), Mapping)
    ids = [i.id for i in image.instances]
    if set(answer) != set(ids):
        _refuse(where, f"assets for {list(answer)[:12]}", f"one for each of {ids}")
    assets = {id: _asset(folder, where, id, answer[id]) for id in ids}
    require_assets(folder, where, assets, {i.id: i.name for i in image.instances})
    arrays = [a for asset in assets.values() for a in (asset.T_camera_object, asset.scale, *_arrays(asset.mesh))]
    folder.digests[f"assets by {backend.key}"] = _digest(*arrays)
    if saved:
        folder.decide(f"assets: placed by {where}", "the folder has meshes and no poses.json")
    else:
        folder.decide(f"assets: generated by {where}", ABSENT, fallback=fallback)
    for id in ids:
        if told := _told(where, answer[id].told):
            folder.decide(f"mesh: {told}", f"by {where}", id, fallback=bool(answer[id].doubted))
    return assets


def graph_of(
    folder: InputFolder, backend: Backend[SceneGrapher], image: PromptedImage, geometry: Geometry
) -> SceneGraph:
    """The relations that a back end sees, as given ones."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.relations(image, geometry)), Sequence)
    if len(answer) > MAX_RELATIONS:
        _refuse(where, f"{len(answer):,} relations", f"at most {MAX_RELATIONS:,}")
    ids = {i.id for i in image.instances}
    relations = tuple(_relation(where, _typed(where, r, Relation), ids) for r in answer)
    folder.digests[f"scene_graph by {backend.key}"] = _digest(repr(relations))
    folder.decide(f"scene graph: {len(relations)} relations by {where}", ABSENT)
    return SceneGraph(relations=relations, source=where)


def labels_of(
    folder: InputFolder, backend: Backend[Labeler], image: PromptedImage, unnamed: Sequence[Instance]
) -> Mapping[int, str]:
    """The labels that a back end gives to masks without one."""
    where = str(backend)
    answer = _typed(where, backend.asked(lambda b: b.labels(image, unnamed)), Mapping)
    ids = [i.id for i in unnamed]
    if set(answer) != set(ids):
        _refuse(where, f"labels for {list(answer)[:12]}", f"one for each of {ids}")
    labels = {id: _typed(where, answer[id], str) for id in ids}
    if bad := [label for label in labels.values() if not LABEL.fullmatch(label)]:
        _refuse(where, f"the label {bad[0][:60]!r}", "one to four plain words in small letters")
    folder.digests[f"labels by {backend.key}"] = _digest(repr(sorted(labels.items())))
    folder.decide(f"labels: {', '.join(f'{id} {label}' for id, label in labels.items())}", f"given by {where}")
    return labels


def require_relation(where: Path | str, subject: int, predicate: str, object: int, ids: set[int]) -> None:
    """Raises InputError unless a relation is between two different ids of objects that exist.

    Its second may be the ground."""
    if subject not in ids or object not in ids | {GROUND} or subject == object:
        accepted = f"two different ids of {sorted(ids)} ({GROUND} as the second is the ground)"
        _refuse(where, f"{subject} {predicate} {object}", accepted)


def checked_masks(where: str, answer: object, photo: Photo, count: int) -> tuple[NDArray[np.bool_], ...]:
    """A Segmenter's answer: ``count`` masks (H, W) of the photo's size, none of them empty."""
    masks = _typed(where, answer, Sequence)
    if len(masks) != count:
        _refuse(where, f"{len(masks)} masks", f"{count}, one per prompt")
    shape = (photo.height, photo.width)
    checked = tuple(_array(where, f"mask {k}", mask, "b", shape) for k, mask in enumerate(masks))
    if empty := [k for k, mask in enumerate(checked) if not mask.any()]:
        _refuse(where, f"mask {empty[0]} without a pixel", "masks with at least one")
    return checked


def checked_detections(where: str, answer: object, photo: Photo, phrases: Sequence[str]) -> tuple[Detection, ...]:
    """A Detector's answer: labels that were asked for, scores from 0 to 1, boxes with an area within the photo, masks
    (H, W) with at least one pixel."""
    found = tuple(_typed(where, d, Detection) for d in _typed(where, answer, Sequence))
    for d in found:
        if d.label not in phrases:
            _refuse(where, f"the label {d.label!r:.60}", f"one of {', '.join(phrases)}")
        if not 0 <= _number(where, d.score) <= 1:  # NaN is not
            _refuse(where, f"score {d.score:g} of {d.label}", "a number from 0 to 1")
        box = _typed(where, d.box, tuple)
        left, top, right, bottom = map(float, box) if len(box) == 4 else (math.nan,) * 4
        if not (0 <= left < right <= photo.width and 0 <= top < bottom <= photo.height):
            told = ", ".join(f"{_number(where, x):g}" for x in box[:4])
            accepted = f"left, top, right, bottom within the photo's {photo.width}x{photo.height} pixels"
            _refuse(where, f"the box {told} of {d.label}", accepted)
    masked = [d for d in found if d.mask is not None]
    checked_masks(where, [d.mask for d in masked], photo, len(masked))
    return found


def checked_ground(where: str, answer: object, photo: Photo) -> NDArray[np.bool_]:
    """A GroundSegmenter's answer: (H, W) bool of the photo's size."""
    return _array(where, "ground", answer, "b", (photo.height, photo.width))


def checked_photo(where: str, answer: object, photo: Photo) -> NDArray[np.uint8]:
    """A BackgroundCompleter's answer: (H, W, 3) uint8 of the photo's size."""
    return _bytes(where, "the completed photo", answer, (photo.height, photo.width, 3))


def _asset(folder: InputFolder, where: str, id: int, answer: object) -> PosedAsset:
    asset = _typed(where, answer, GeneratedAsset)
    mesh = _typed(where, asset.mesh, Mesh)
    T = _array(where, f"T_camera_object of {id}", asset.T_camera_object, "fiu", (4, 4)).astype(float)
    if not _is_rigid(T):
        _refuse(where, f"T_camera_object of {id} that is not rigid", "a rotation and a shift [m], the scale beside it")
    scale = _number(where, asset.scale)
    if not 0 < scale <= MAX_COORDINATE:
        _refuse(where, f"scale {scale:g} of {id}", "a positive number")
    _require_mesh(f"{where}, mesh of {id}", mesh)
    source = where if asset.file is None else _typed(where, asset.file, Path)
    used = usable_mesh(folder, source, id, mesh)
    return PosedAsset(
        mesh=used,
        T_camera_object=T,
        scale=scale,
        source=source,
        fixed=_told(where, asset.fixed),
        lifted=_typed(where, asset.lifted, bool),
    )


def _is_rigid(T: Array) -> bool:
    R = T[:3, :3]
    if not (np.abs(T) <= MAX_COORDINATE).all() or (T[3] != [0, 0, 0, 1]).any():  # NaN is not
        return False
    return bool(np.abs(R.T @ R - np.eye(3)).max() <= RIGID and np.linalg.det(R) > 0)


def _require_mesh(where: str, mesh: Mesh) -> None:
    """Arrays that fit together, finite, and no larger than a mesh file's may be."""
    vertices = _array(where, "vertices", mesh.vertices, "f", ("n", 3))
    faces = _array(where, "faces", mesh.faces, "i", ("m", 3))
    n, m = len(vertices), len(faces)
    if not 0 < m <= MAX_FACES or n > 3 * MAX_FACES:
        _refuse(where, f"{m:,} faces and {n:,} vertices", f"1 to {MAX_FACES:,} faces, {3 * MAX_FACES:,} vertices")
    uv = np.zeros((n, 2)) if mesh.uv is None else _array(where, "uv", mesh.uv, "f", (n, 2))
    if not all((np.abs(v) <= MAX_COORDINATE).all() for v in (vertices, uv)):  # NaN is not
        _refuse(where, "coordinates that are NaN, infinite or too large", f"at most {MAX_COORDINATE:.0e}")
    if faces.min() < 0 or faces.max() >= n:
        _refuse(where, "faces of vertices that do not exist", "a consistent mesh")
    if mesh.vertex_colors is not None:
        _bytes(where, "vertex_colors", mesh.vertex_colors, (n, 3))
    index = _array(where, "face_material", mesh.face_material, "i", (m,))
    materials = _typed(where, mesh.materials, tuple)
    if not materials or index.min() < 0 or index.max() >= len(materials):
        _refuse(where, "faces of materials that do not exist", "a consistent mesh")
    pixels = sum(_texture_pixels(where, _typed(where, material, Material)) for material in materials)
    if pixels > MAX_TEXTURE_PIXELS:
        _refuse(where, f"{pixels:,} texture pixels", f"at most {MAX_TEXTURE_PIXELS:,}")


def _texture_pixels(where: str, material: Material) -> int:
    """Of a material that can be drawn."""
    colour = _typed(where, material.base_color, tuple)
    if len(colour) != 3 or not all(0 <= _number(where, c) <= 1 for c in colour):
        _refuse(where, f"base_color {colour!r}", "three factors from 0 to 1")
    if material.texture is None:
        return 0
    texture = _bytes(where, "texture", material.texture, ("h", "w", 3))
    if not texture.size:
        _refuse(where, "a texture without pixels", "(h, w, 3) uint8")
    return texture.shape[0] * texture.shape[1]


def _relation(where: str, r: Relation, ids: set[int]) -> Relation:
    """As one that is given, its evidence a line of text."""
    if r.predicate not in get_args(Predicate):
        _refuse(where, f"the predicate {r.predicate!r}", ", ".join(get_args(Predicate)))
    subject, other = _typed(where, r.subject, int), _typed(where, r.object, int)
    require_relation(where, subject, r.predicate, other, ids)
    confidence, said = _number(where, r.confidence), _typed(where, r.evidence, str)
    if not 0 <= confidence <= 1:
        _refuse(where, f"confidence {confidence:g}", "a number from 0 to 1")
    if len(said) > MAX_REASON:
        _refuse(where, f"evidence of {len(said)} characters", f"at most {MAX_REASON}")
    return replace(
        r,
        subject=int(subject),
        object=int(other),
        confidence=confidence,
        evidence=f"given by {where}: {printable(said)}",
        source="given",
    )


def _told(where: str, text: object) -> str:
    """What a back end says for the report."""
    said = _typed(where, text, str)
    if len(said) > MAX_REASON:
        _refuse(where, f"a text of {len(said)} characters", f"at most {MAX_REASON}")
    return printable(said)


def _typed(where: str, value: object, kind: type[T]) -> T:
    if not isinstance(value, kind):
        _refuse(where, f"an answer with {type(value).__name__}", f"{kind.__name__} there")
    return value


def _number(where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
        _refuse(where, f"an answer with {type(value).__name__}", "a number there")
    return float(value)


def _bytes(where: str, name: str, value: object, shape: Shape) -> NDArray[np.uint8]:
    array = _array(where, name, value, "u", shape)
    if array.dtype != np.uint8:
        _refuse(where, f"{name} of type {array.dtype}", "uint8")
    return array


def _array(where: str, name: str, value: object, kinds: str, shape: Shape) -> NDArray[Any]:
    """An array of one of some kinds of numbers (numpy's letters) and of a shape, no larger than what a photo has."""
    array = _typed(where, value, np.ndarray)
    fits = array.ndim == len(shape) and all(
        isinstance(n, str) or n == found for n, found in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds:
        accepted = f"({', '.join(map(str, shape))}) of kind {' or '.join(kinds)}"
        _refuse(where, f"{name} of shape {array.shape} and type {array.dtype}", accepted)
    if array.size > 3 * MAX_PIXELS:
        _refuse(where, f"{name} of {array.size:,} numbers", f"at most {3 * MAX_PIXELS:,}")
    return array


def _arrays(mesh: Mesh) -> list[NDArray[Any] | str | None]:
    """Everything a mesh is made of."""
    looks = [value for m in mesh.materials for value in (repr([float(c) for c in m.base_color]), m.texture)]
    return [mesh.vertices, mesh.faces, mesh.uv, mesh.vertex_colors, mesh.face_material, *looks]


def _digest(*values: NDArray[Any] | str | float | None) -> str:
    """sha256 of an answer, whatever it is made of."""
    hashed = hashlib.sha256()
    for value in values:
        if isinstance(value, np.ndarray):
            hashed.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
        else:
            hashed.update(repr(value).encode(errors="backslashreplace") + b";")
    return hashed.hexdigest()


def _refuse(where: Path | str, found: str, accepted: str) -> NoReturn:
    raise InputError(where, found=found, accepted=accepted)
