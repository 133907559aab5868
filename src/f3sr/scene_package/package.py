"""The scene package on disk: written whole or not at all, and validated when read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue, ValidationError

import f3sr
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, MassProperties, Mesh
from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.core.transforms import boxes_of
from f3sr.errors import InputError, require_kind, require_path
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.glb import Glb
from f3sr.exporters.mjcf import Mjcf
from f3sr.exporters.protocol import Exporter
from f3sr.files import npz, strict_json
from f3sr.files.bounds import (
    MAX_OBJECT,
    MAX_PART_BYTES,
    MAX_SCENE_BYTES,
    MAX_SIZES_AWAY,
    MIN_OBJECT,
    MIN_VOLUME,
)
from f3sr.io.assets import require_solidity, require_total
from f3sr.io.gltf_writer import encode_pngs, mesh_to_glb
from f3sr.io.images import as_rgb, encode_png, open_image
from f3sr.io.masks import MAX_MASK_PIXELS
from f3sr.io.mesh_files import load_mesh, load_part
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, PhysicsConfig
from f3sr.physics.mujoco_scene import MujocoScene
from f3sr.report import Report
from f3sr.runtime.atomic_folder import claimed, recover
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import Excluded, Ground, Motion, Node, Photo, Relation, Scene, SceneGraph, SceneObject, Support
from f3sr.scene_package.package_folder import (
    BACKGROUND,
    EDITS,
    KEPT,
    MASKS,
    PAGE,
    PHOTO,
    REPORT,
    SCENE,
    SUPPORT,
    UNEDITED,
    is_package,
    placed,
    prepare_output,
    require_package,
    require_replaceable,
)
from f3sr.scene_package.scene_json import (
    SCHEMA_FILE,
    ObjectRecord,
    SceneDocument,
    dump_json,
    mesh_path,
    scene_schema,
    to_document,
    to_json,
)

if TYPE_CHECKING:
    from f3sr.background.inpainting import Inpainting

__all__ = [
    "Package",
    "SceneDocument",
    "is_package",
    "package_files",
    "prepare_output",
    "read_package",
    "scene_schema",
    "write_package",
]

WRITTEN: Sequence[Exporter] = (Glb(), Mjcf())
"""Formats of every package: ``scene.glb``; ``scene.xml``, ``visual/``, and ``collision/``, which scene.json names."""
NEAREST_KEPT = 0.001
"""Least depth [m] of pixels that may hide objects: a lens cannot be nearer."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Package:
    """A scene package in memory.

    ``scene`` has objects of scale 1; ``direct`` is the levelled input, None if the package has none. ``document`` is
    scene.json as typed records.
    """

    folder: Path
    document: SceneDocument
    scene: Scene
    direct: Scene | None

    def __repr__(self) -> str:
        return f"Package({str(self.folder)!r}, {self.scene.summary})"

    @property
    def camera_aligned(self) -> bool:
        """Whether f3sr aligned the camera. If not, ``evaluate`` also measures with a fitted camera."""
        return self.document.provenance.get("camera_aligned") is True

    @property
    def uncertainty(self) -> dict[int, PoseUncertainty]:
        """How well the pose of every object is known, by id; without objects of which scene.json does not tell it."""
        known = ((o.id, o.uncertainty) for o in self.document.objects)
        return {id: PoseUncertainty(**record.model_dump()) for id, record in known if record}

    def unedited(self) -> Package:
        """The package before all edits: this one, or what its folder keeps. Raises InputError as ``load`` does."""
        is_edited = (self.folder / EDITS).exists()
        return read_package(inside(self.folder, UNEDITED)) if is_edited else self

    def mujoco(self) -> MujocoScene:
        """MuJoCo's model and data, at rest: to step it, ``mujoco.mj_step(play.model, play.data)``."""
        return MujocoScene.of(self.scene, ground_friction=self.scene.ground.friction)

    def background(self) -> NDArray[np.uint8] | None:
        """background.png (H, W, 3) uint8 sRGB, the photo completed behind its objects; None if the file is absent."""
        return self._picture(BACKGROUND, "RGB")

    def support(self) -> NDArray[np.bool_] | None:
        """support.png (H, W): pixels of background.png that show the support surface; None if the file is absent."""
        picture = self._picture(SUPPORT, "L")
        return None if picture is None else picture > 127

    def kept_depth(self) -> NDArray[np.float32] | None:
        """kept_depth.npz (H, W): z-depth [m] of pixels of background.png that may hide objects, inf elsewhere.

        None if the file is absent. Raises InputError if it is damaged.
        """
        file, shape = self.folder / KEPT, (self.scene.camera.height, self.scene.camera.width)
        if not file.exists():
            return None
        wanted = {"depth": npz.Wanted(dtype=np.dtype(np.float32), shape=shape)}
        depth = npz.read(inside(self.folder, KEPT), wanted)["depth"]
        if not (depth >= NEAREST_KEPT).all():
            found = f"a depth of {depth[~(depth >= NEAREST_KEPT)][0]:.3g} m"
            raise InputError(file, found=found, accepted=f"{NEAREST_KEPT} m or more")
        return depth

    def _picture(self, name: str, mode: str) -> NDArray[np.uint8] | None:
        """A picture, read on demand: only films need these, so a damaged one stops nothing else."""
        if not (self.folder / name).exists():
            return None
        return _read_image(self.folder, name, (self.scene.camera.width, self.scene.camera.height), mode)


def write_package(
    scene: Scene,
    out: str | Path,
    *,
    direct: Scene | None = None,
    uncertainty: Mapping[int, PoseUncertainty] | None = None,
    metrics: Mapping[str, float | None] | None = None,
    provenance: Mapping[str, JsonValue] | None = None,
    reports: Sequence[Report] = (),
    rows: Mapping[str, Mapping[str, float]] | None = None,
    seconds: Mapping[str, float] | None = None,
    pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    inpainting: Inpainting | None = None,
    page: Callable[[], bytes] | None = None,
    physics: PhysicsConfig = DEFAULT_PHYSICS,
    overwrite: bool = False,
) -> Path:
    """Write the scene as a package to ``out`` and return the folder's full path (docs: conventions).

    ``direct``: the levelled input with the same ids. ``uncertainty`` of poses, by id. ``metrics``
    by name. ``provenance``: stages, hashes and the like, without paths or times. ``reports``,
    ``rows`` (measures by title) and ``seconds`` per stage go to report.json.
    ``pictures`` (h, w, 3) uint8 by name without suffix. ``inpainting``: the completed photo. ``page`` makes
    report.html. ``physics``: contact settings of scene.xml. ``out`` changes only after all files exist in a hidden
    folder. Raises OutputError if ``out`` is not an f3sr package, or is one with rollouts without ``overwrite``.
    """
    require_kind("scene", scene, Scene, accepted="f3sr.read_package(...).scene")
    place = placed(out)
    with claimed(place, lambda place: require_replaceable(place, overwrite=overwrite)) as claim:
        for name, data in package_files(
            scene,
            direct=direct,
            uncertainty=uncertainty or {},
            metrics=metrics or {},
            provenance=provenance or {},
            report=_report(reports, rows or {}, seconds or {}),
            pictures=pictures or {},
            inpainting=inpainting,
            page=page,
            physics=physics,
        ):
            claim.write(name, data)
        claim.replace()
    return place


def load(folder: str | Path) -> Package:
    """A package to play with: ``f3sr.load("out").mujoco()``. Raises InputError as ``read_package`` does."""
    return read_package(folder)


def read_package(folder: str | Path) -> Package:
    """Read and validate a package folder. A package is untrusted: every number and path is checked.

    Raises InputError naming the file that is missing, malformed or outside the folder.
    """
    folder = require_path("folder", folder)
    recover(folder)
    require_package(folder)
    document = _read_document(inside(folder, SCENE))
    size = document.camera.width, document.camera.height
    photo = Photo(rgb=_read_image(folder, PHOTO, size, "RGB"))
    ground = document.ground
    camera = Camera(
        width=size[0],
        height=size[1],
        K=np.array(document.camera.K),
        T_world_camera=np.array(document.camera.T_world_camera),
    )
    scene = Scene(
        photo=photo,
        camera=camera,
        ground=Ground(
            normal=np.array(ground.normal),
            offset=ground.offset,
            source=ground.source,
            confidence=ground.confidence,
            friction=ground.friction,
        ),
        objects=_read_objects(folder, document, camera),
        graph=SceneGraph(
            relations=tuple(Relation(**r.model_dump()) for r in document.scene_graph.relations),
            source=document.scene_graph.source,
            nodes=tuple(Node(**n.model_dump()) for n in document.scene_graph.nodes),
        ),
        excluded=tuple(Excluded(mask=e.mask, reason=e.reason) for e in document.excluded),
    )
    direct = _direct(document, scene)
    if direct is not None:
        for o in direct:
            _require_sound(folder, o, direct.camera, "direct object")
    return Package(folder=folder, document=document, scene=scene, direct=direct)


def _direct(document: SceneDocument, scene: Scene) -> Scene | None:
    """The levelled input, from the package's meshes. It has no footing: ``separate`` makes them. What the result holds
    on something unseen may move."""
    if document.direct is None:
        return None
    return replace(
        scene,
        camera=scene.camera.moved(np.array(document.direct.T_world_camera)),
        objects=tuple(
            replace(
                scene[r.id],
                T_world_object=np.array(r.T_world_object),
                scale=r.scale,
                footing=(),
                motion=(),
                mobility="dynamic" if scene[r.id].mobility_source == "found" else scene[r.id].mobility,
            )
            for r in document.direct.objects
        ),
    )


def package_files(
    scene: Scene,
    *,
    direct: Scene | None = None,
    uncertainty: Mapping[int, PoseUncertainty] | None = None,
    metrics: Mapping[str, float | None],
    provenance: Mapping[str, JsonValue],
    report: Mapping[str, Any] | None = None,
    pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    inpainting: Inpainting | None = None,
    page: Callable[[], bytes] | None = None,
    physics: PhysicsConfig = DEFAULT_PHYSICS,
) -> Iterator[tuple[str, bytes]]:
    """Every file of the package with its relative path. Pictures are compressed beside the others; of those one is made
    at a time: together they may be larger than the scene."""
    for name in pictures or {}:
        if not re.fullmatch(r"[\w-]+", name, flags=re.ASCII):
            raise ValueError(f"picture name {name!r}: only letters, digits, _ and - are accepted")
    encode_pngs(o.mesh for o in scene.objects)
    images = begun(list, _image_files(scene, inpainting, pictures or {}))
    for o in scene.objects:
        mesh = o.mesh.with_vertices(o.scale * o.mesh.vertices)
        yield mesh_path(o.id), mesh_to_glb(mesh, name=f"object_{o.id:02d}")
    exported = ExportedScene.of(scene, physics)
    for exporter in WRITTEN:
        yield from exporter.files(exported)
    yield from images.result()
    yield REPORT, dump_json(report or _report((), {}, {}))
    if page is not None:
        yield PAGE, page()
    yield SCHEMA_FILE, _schema_file()
    provenance = {"f3sr": f3sr.__version__, **provenance}
    document = to_document(scene, direct=direct, uncertainty=uncertainty or {}, metrics=metrics, provenance=provenance)
    yield "scene.json", to_json(document)


def _image_files(
    scene: Scene, inpainting: Inpainting | None, pictures: Mapping[str, NDArray[np.uint8]]
) -> Iterator[tuple[str, bytes]]:
    """Files of pixels, compressed: together much smaller than the pictures, which are there already."""
    yield PHOTO, encode_png(scene.photo.rgb)
    if inpainting is not None:
        yield BACKGROUND, encode_png(inpainting.rgb)
        yield SUPPORT, encode_png(255 * inpainting.support.astype(np.uint8))
        yield KEPT, npz.dump(depth=inpainting.kept)
    for o in scene.objects:
        yield f"{MASKS}/{o.mask_name}", encode_png(255 * o.mask.astype(np.uint8))
    for name, picture in pictures.items():
        yield f"pictures/{name}.png", encode_png(picture)


@cache
def _schema_file() -> bytes:
    """The same in all packages; it takes longer to make than the rest of a small one."""
    return dump_json(scene_schema())


def _report(
    reports: Sequence[Report], rows: Mapping[str, Mapping[str, float]], seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Stage reports and measures as plain values; numbers that are not finite become null."""
    return _plain({"seconds": seconds, "measures": rows, "stages": [asdict(report) for report in reports]})


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _read_document(file: Path) -> SceneDocument:
    accepted = "the scene.json of an f3sr package, schema_version 1"
    tree = strict_json.read(file, most=MAX_SCENE_BYTES, accepted=accepted)
    try:
        document = SceneDocument.model_validate(tree)
    except ValidationError as error:
        found, wanted = strict_json.problem(error, ", ".join(SceneDocument.model_fields))
        raise InputError(file, found=found, accepted=wanted) from None
    pixels = document.camera.width * document.camera.height * len(document.objects)
    if pixels > MAX_MASK_PIXELS:
        raise InputError(file, found=f"masks of {pixels:,} pixels", accepted=f"at most {MAX_MASK_PIXELS:,}")
    return document


def _read_objects(folder: Path, document: SceneDocument, camera: Camera) -> tuple[SceneObject, ...]:
    """All objects, within the limits that hold for all meshes together."""
    objects, parts = list[SceneObject](), dict[str, ConvexPart]()
    for record in document.objects:
        objects.append(o := _read_object(folder, record, (camera.width, camera.height), parts))
        require_total(folder / "meshes", [o.mesh for o in objects])
        _require_sound(folder, o, camera, "object")
    return tuple(objects)


def _require_sound(folder: Path, o: SceneObject, camera: Camera, name: str) -> None:
    if fault := next(faults(o, camera), None):
        found, _, accepted = fault.partition("; accepted: ")
        raise InputError(folder / "scene.json", found=f"{name} {o.id} {found}", accepted=accepted)


def faults(o: SceneObject, camera: Camera) -> Iterator[str]:
    """What no object is that a photo shows and physics can move: its mesh, its parts and its body must fit together."""
    size = o.scale * o.mesh.diagonal
    if not MIN_OBJECT <= size <= MAX_OBJECT:
        yield f"of {size:.3g} m; accepted: objects of {MIN_OBJECT} to {MAX_OBJECT:,.0f} m"
        return
    if (away := float(np.linalg.norm(o.T_world_object[:3, 3] - camera.center)) / size) > MAX_SIZES_AWAY:
        yield f"{away:.3g} times its own size away from the camera; accepted: at most {MAX_SIZES_AWAY:,.0f} times"
    low, high = o.mesh.bounds + np.array([[-1], [1]]) * o.mesh.diagonal
    if not all((low <= p.vertices).all() and (p.vertices <= high).all() for p in o.colliders):
        yield "with collision parts away from its mesh; accepted: parts that cover it"
        return
    if o.colliders and not _covers(o):
        yield "with collision parts that do not reach its mesh's bounds; accepted: parts that cover it"
    if (least := min((p.volume * o.scale**3 for p in o.colliders), default=np.inf)) < MIN_VOLUME:
        yield f"with a collision part of {least:.3g} m3; accepted: at least {MIN_VOLUME:g} m3"
    if o.solid is None:
        return
    if not ((low <= o.solid.center) & (o.solid.center <= high)).all():
        yield "with a center_of_mass away from its mesh; accepted: one within it"
    if o.solid.volume > o.mesh.diagonal**3:
        yield f"with a mass of {o.solid.volume:.3g} m3; accepted: at most {o.mesh.diagonal**3:.3g} m3 of its density"


def _covers(o: SceneObject) -> bool:
    """Whether the colliders together reach as far as the mesh, but for ``SHORT``."""
    boxes = boxes_of([p.vertices for p in o.colliders])
    short = np.array([boxes[:, 0].min(0) - o.mesh.bounds[0], o.mesh.bounds[1] - boxes[:, 1].max(0)])
    return bool((short <= SHORT * o.mesh.diagonal).all())


def _read_object(
    folder: Path, record: ObjectRecord, size: tuple[int, int], parts: dict[str, ConvexPart]
) -> SceneObject:
    """``parts``: those read so far, by their path."""
    parts |= {path: _read_part(folder, path) for path in dict.fromkeys(record.collision) if path not in parts}
    proxies = len(record.collision) - record.footing
    return SceneObject(
        id=record.id,
        label=record.label,
        mask_name=record.mask,
        mask=_read_image(folder, f"{MASKS}/{record.mask}", size, "L") > 127,
        mesh=_read_mesh(folder, record.mesh),
        T_world_object=np.array(record.T_world_object),
        parts=tuple(parts[path] for path in record.collision[:proxies]),
        footing=tuple(parts[path] for path in record.collision[proxies:]),
        mobility=record.mobility,
        mobility_source=record.mobility_source,
        density=record.density,
        solid=MassProperties(
            volume=record.mass / record.density,
            center=np.array(record.center_of_mass),
            inertia=np.array(record.inertia) / record.density,
        ),
        friction=record.friction,
        rolling_friction=record.rolling_friction,
        restitution=record.restitution,
        damping=record.damping,
        structure=record.structure,
        material=record.material,
        material_source=record.material_source,
        material_reason=record.material_reason,
        supports=tuple(Support(id=s.id, share=s.share) for s in record.supports),
        supported_by=record.supported_by,
        lifted=record.lifted,
        motion=tuple(Motion(**m.model_dump()) for m in record.motion),
    )


def _read_image(folder: Path, path: str, size: tuple[int, int], mode: str) -> NDArray[np.uint8]:
    """An image of the package, (height, width) or (height, width, 3), of the camera's size."""
    opened = open_image(inside(folder, path))
    image = np.asarray(opened) if mode == opened.mode else as_rgb(opened)
    if mode == "L" and image.ndim == 3:
        image = image.max(axis=2)
    if image.shape[1::-1] != size:
        raise InputError(
            folder / path,
            found=f"{image.shape[1]}x{image.shape[0]} pixels",
            accepted=f"the camera's {size[0]}x{size[1]}",
        )
    return image


def inside(folder: Path, path: str) -> Path:
    """A file of a package by its relative path. Raises InputError for one that a link, or ``..``, leads out of it."""
    file = folder / path
    try:
        inside = file.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # NUL bytes, loops of links
        raise InputError(folder, found=f"the path {path!r} that leads nowhere", accepted="files inside it") from None
    if not inside:
        raise InputError(file, found="a path that leaves the package", accepted="files inside the package")
    return file


def _read_mesh(folder: Path, path: str) -> Mesh:
    mesh = load_mesh(inside(folder, path))
    require_solidity(folder / path, mesh)
    return mesh


SHORT = 0.05
"""Of its mesh's diagonal, what an object's collision parts may lack of its bounds: ours lack nothing."""
THIN_PART = 1e-8
"""Least volume of a part, in cubes of its diagonal: thinner ones have no hull in single precision."""
DENT = 1e-4
"""Largest share of its hull's volume that a part may lack, by rounding, to count as convex."""


def _read_part(folder: Path, path: str) -> ConvexPart:
    """As it is written, so that physics is the same to the bit; the hull of what is not convex."""
    mesh = load_part(inside(folder, path), max_bytes=MAX_PART_BYTES)
    try:
        part, hull = ConvexPart(vertices=mesh.vertices, faces=mesh.faces), mesh.hull
        if hull.volume < THIN_PART * mesh.diagonal**3:
            raise ValueError("a part thinner than single precision can tell")
        return part if abs(part.volume - hull.volume) <= DENT * hull.volume else hull
    except ValueError as error:
        raise InputError(folder / path, found=str(error), accepted="a convex part with a volume") from None
