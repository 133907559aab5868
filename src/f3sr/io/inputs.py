"""The prompted-image folder (equation 1): all inputs are read and validated here, before any work starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from f3sr.backends.protocols import (
    AssetGenerator,
    CameraByPoses,
    GeometryEstimator,
    KnownFocal,
    Labeler,
    NormalEstimator,
    PromptedImage,
    SceneGrapher,
)
from f3sr.backends.registry import Backend
from f3sr.core.transforms import Array, transform
from f3sr.errors import InputError, NoAnswerError, require_known, require_names, require_path
from f3sr.io.answers import (
    MAX_REASON,
    MAX_RELATIONS,
    assets_of,
    camera_of,
    geometry_of,
    graph_of,
    labels_of,
    normals_of,
    require_relation,
    with_normals,
)
from f3sr.io.assets import ASSETS_ACCEPTED, PosedAsset, has_unplaced_meshes, placed_assets, read_meshes, require_size
from f3sr.io.exif import ExifError, focal_by_exif
from f3sr.io.geometry import (
    DEPTH_FILES,
    GEOMETRY_ACCEPTED,
    GEOMETRY_FILES,
    INTRINSICS,
    read_geometry,
    read_intrinsics,
)
from f3sr.io.given_meshes import GivenMeshes, MeshPlacer
from f3sr.io.given_properties import MATERIALS, GivenProperties, read_properties
from f3sr.io.images import as_rgb, exif_orientation, open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import read_instances, read_mask
from f3sr.io.photo_hints import PhotoHints
from f3sr.io.pose_conventions import require_asset_frame
from f3sr.options import PARTS
from f3sr.report import Decision
from f3sr.runtime.result_store import digest
from f3sr.scene import Geometry, Instance, Photo, Predicate, Relation, SceneGraph

P = TypeVar("P")

NOISES = (1e-4, 0.5)
"""Least and most noise of a geometry [share of the distance]."""
PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg")
STRICT = ConfigDict(strict=True, allow_inf_nan=False)
"""No conversions between types, no NaN: what a document says is what it means."""
TAKEN = 1e-3
"""Largest difference, as a share, of a focal length from the one that was asked for."""
MAX_DISTANCE = 100_000.0
"""Largest distance of an object from the camera, in its own sizes: rounding leaves it no shape from far beyond, and no
pixel shows it."""
MAX_DISAGREEMENT = 10_000.0
"""Largest factor between an asset's depth and the geometry's inside its mask: millimetres for metres are repaired,
anything beyond is no unit."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Inputs:
    """A validated prompted-image folder (docs: conventions). ``K`` (3, 3) in pixels of the photo.

    ``geometry`` is in camera axes [m]. ``assets`` are meshes by object id with their poses in the camera.
    ``ground_mask`` (H, W) is the visible support surface; ``graph`` holds the given relations.
    """

    photo: Photo
    instances: tuple[Instance, ...]
    K: Array
    geometry: Geometry
    assets: dict[int, PosedAsset]
    ground_mask: NDArray[np.bool_] | None = None
    graph: SceneGraph | None = None
    background: NDArray[np.uint8] | None = None
    """background.png of the folder (H, W, 3): the photo without its objects. None: ``inpaint`` completes it."""
    decisions: tuple[Decision, ...] = ()
    digests: dict[str, str] = field(default_factory=dict[str, str])
    """sha256 of every file read, by its path relative to the folder."""
    properties: Mapping[int, GivenProperties] = field(default_factory=dict[int, GivenProperties])
    """Physical properties that materials.json gives, by object id."""
    asset_frame: str = "auto"
    fillers: Mapping[str, str] = field(default_factory=dict[str, str])
    """Back ends that made what the folder lacks, by kind: name, version and model."""

    def __repr__(self) -> str:
        count = len(self.instances)
        return f"Inputs({count} mask{'s' * (count != 1)}, {self.photo.width}x{self.photo.height})"

    @property
    def key(self) -> str:
        """A hash of all files and options: equal keys mean equal inputs."""
        return digest(self.digests, self.asset_frame, self.geometry.noise)


@dataclass(frozen=True, eq=False, kw_only=True)
class Fillers:
    """Back ends that make what a folder lacks; what it has is not asked for."""

    geometry: Backend[GeometryEstimator] | None = None
    assets: Backend[AssetGenerator] | None = None
    scene_graph: Backend[SceneGrapher] | None = None
    labels: Backend[Labeler] | None = None
    normals: Backend[NormalEstimator] | None = None
    """Asked where nothing measures the ground: no geometry, or one without normals."""
    places: Callable[[Path], Backend[AssetGenerator]] | None = None
    """For the folder's own meshes that tell no agreed pose: of their folder, the back end that places them."""

    def telling(self, tell: Callable[[str], None]) -> Fillers:
        """The same, which tell what they are at while a user waits."""
        return Fillers(
            geometry=self.geometry and self.geometry.telling(tell),
            assets=self.assets and self.assets.telling(tell),
            scene_graph=self.scene_graph and self.scene_graph.telling(tell),
            labels=self.labels and self.labels.telling(tell),
            normals=self.normals and self.normals.telling(tell),
        )


def read(
    folder: str | Path,
    *,
    ignore: Collection[str] = (),
    asset_frame: str = "auto",
    geometry_noise: float | None = None,
    mask_overlap: float | None = None,
    fillers: Fillers | None = None,
    stand_ins: Fillers | None = None,
    hints: PhotoHints | None = None,
    placer: MeshPlacer | None = None,
) -> Inputs:
    """Read and validate a prompted-image folder (docs: conventions).

    ``ignore`` treats parts of PARTS as absent. ``asset_frame`` says how the assets are read, as ``--asset-frame``
    takes it; ``placer`` tells what nobody says. ``geometry_noise``: standard deviation of the depths [share of the
    distance], else measured.
    ``mask_overlap``: share of the smaller of two masks that may lie in both, .05 without it.
    ``fillers`` make parts that are absent, ``stand_ins`` those for which nobody named a filler: a fallback. Answers
    are validated as files are. ``hints`` are what a user knows of the camera, where geometry is made from the photo.
    Raises InputError for the first invalid file or value, BackendError where a filler raises.
    """
    require_names("ignore", ignore)
    require_known("--ignore", ignore, PARTS)
    require_asset_frame("--asset-frame", asset_frame)
    source = InputFolder(require_path("folder", folder))
    photo, told = _photo(source)
    instances = read_instances(source, photo, overlap=mask_overlap)
    parts = _Parts(
        folder=source,
        ignore=ignore,
        fillers=fillers or Fillers(),
        stand_ins=stand_ins or Fillers(),
        hints=hints or PhotoHints(),
        placer=placer,
        masks={i.id: i.name for i in instances},
        asset_frame=asset_frame,
    )
    instances = parts.labelled(photo, instances)
    ground_mask = parts.ground_mask(photo, instances)
    image = PromptedImage(photo=photo, instances=instances, ground_mask=ground_mask)
    seen = parts.shown(parts.hinted(image, told))
    geometry, K = parts.geometry(seen)
    geometry = parts.facing(seen, geometry, K)
    parts.require_taken(photo, geometry, K)
    if geometry_noise is not None:
        geometry = _with_noise(source, geometry, geometry_noise)
    _require_inside(source, geometry, instances)
    assets = parts.assets(image, geometry, K)
    _require_agreement(source, geometry, instances, assets)
    return Inputs(
        photo=photo,
        instances=instances,
        K=K,
        geometry=geometry,
        assets=assets,
        ground_mask=ground_mask,
        graph=parts.graph(image, geometry),
        background=_background(source, photo) if parts.has("background", "background.png") else None,
        properties=parts.properties(instances),
        decisions=tuple(source.decisions),
        digests=dict(sorted(source.digests.items())),
        asset_frame=asset_frame,
        fillers={kind: backend.told for kind, backend in parts.used.items()},
    )


def _with_noise(folder: InputFolder, geometry: Geometry, noise: float) -> Geometry:
    """The geometry, of which a user knows the noise. Raises InputError for a noise that no geometry has."""
    low, high = NOISES
    if not low <= noise <= high:
        raise InputError("--geometry-noise", found=str(noise), accepted=f"a share of the distance from {low} to {high}")
    known = replace(geometry, noise=noise)
    folder.decide(f"geometry: its depths have a noise of {100 * noise:.3g} % of the distance", "--geometry-noise")
    return known


@dataclass(frozen=True, eq=False, kw_only=True)
class _Parts:
    """The parts of a folder that may be absent: read, or made by a back end."""

    folder: InputFolder
    ignore: Collection[str]
    fillers: Fillers
    stand_ins: Fillers
    hints: PhotoHints = field(default_factory=PhotoHints)
    placer: MeshPlacer | None = None
    masks: Mapping[int, str]
    """Names of their files, by object id."""
    asset_frame: str
    used: dict[str, Backend[Any]] = field(default_factory=dict[str, Backend[Any]])

    def has(self, part: str, *names: str) -> bool:
        return part not in self.ignore and any(map(self.folder.has, names))

    def labelled(self, photo: Photo, instances: tuple[Instance, ...]) -> tuple[Instance, ...]:
        """With labels for masks whose file names tell none, where a back end gives them."""
        unnamed = [i for i in instances if not i.label]
        if (backend := self.fillers.labels) is None or not unnamed:
            return instances
        try:
            image = PromptedImage(photo=photo, instances=instances)
            labels = labels_of(self.folder, backend, image, unnamed)
        except NoAnswerError as error:
            self.folder.decide(f"labels: {len(unnamed)} objects have none", str(error), fallback=True)
            return instances
        self.used[backend.kind] = backend
        return tuple(replace(i, label=labels.get(i.id, i.label)) for i in instances)

    def ground_mask(self, photo: Photo, instances: Sequence[Instance]) -> NDArray[np.bool_] | None:
        if self.has("ground", "ground.png"):
            return _ground_mask(self.folder, photo, instances)
        self.folder.decide("ground: the lower image region outside all masks", "no ground.png", fallback=True)
        return None

    @property
    def lacks_intrinsics(self) -> bool:
        """Whether depths are there, and nothing that tells their camera."""
        return self.has("geometry", *DEPTH_FILES) and not any(map(self.folder.has, ("geometry.npz", INTRINSICS)))

    def hinted(self, image: PromptedImage, by_exif: KnownFocal | str | None) -> PromptedImage:
        """With what is known of the camera, where it has to be found: by the user, intrinsics.json, or EXIF; and by the
        poses of meshes.

        Raises InputError for hints that nothing asks for."""
        given = self.has("geometry", *GEOMETRY_FILES)
        self._require_use(given)
        if given and not self.lacks_intrinsics:
            return image
        focal = self.hints.known_focal(image.photo)
        if not given and self.has("geometry", INTRINSICS):
            if focal:
                raise InputError(focal.source, found=INTRINSICS, accepted="one of the two")
            focal = read_intrinsics(self.folder, image.photo)
        if not focal and isinstance(by_exif, str):
            self.folder.decide("EXIF ignored", by_exif, fallback=True)
        elif not focal:
            focal = by_exif
        posed = self._camera_by_poses(image)
        return replace(image, focal=focal, camera_height=self.hints.camera_height, posed=posed)

    def _camera_by_poses(self, image: PromptedImage) -> CameraByPoses | None:
        if self.has("assets", "assets") and not has_unplaced_meshes(self.folder):
            posed = self.placer.camera(image, self.meshes) if self.placer else None
            if self.placer and posed is None and self.meshes.poses is not None:
                reason = "no focal length and no reading of them shows the meshes near their masks"
                self.folder.decide("camera: the poses of the meshes tell none", reason, fallback=True)
            return posed
        maker = self._placing if self.has("assets", "assets") else self.fillers.assets
        tells = getattr(maker and maker.made, "tells_camera", False) is True
        return maker.asked(lambda made: made.camera(image)) if maker and tells else None

    @property
    def _placing(self) -> Backend[Any] | None:
        """What places the folder's meshes that come with a file each."""
        return self.stand_ins.places(self.folder.path("assets")) if self.stand_ins.places else None

    def require_taken(self, photo: Photo, geometry: Geometry, K: Array) -> None:
        """Raises InputError for a hint that the back end does without."""
        focal = self.hints.known_focal(photo)
        if focal and abs(K[0, 0] / focal.pixels - 1) > TAKEN:
            found = f"{K[0, 0]:.0f} px by the geometry's back end, which takes no hint"
            raise InputError(focal.source, found=found, accepted="only with the built-in geometry")
        if self.hints.camera_height is not None and not geometry.guessed_unit:
            found = "a back end for geometry that takes no hint"
            accepted = "only with the built-in geometry, or with relative depths, which it gives a unit"
            raise InputError("--camera-height", found=found, accepted=accepted)

    def _require_use(self, given: bool) -> None:
        """Hints are for what is made from the photo; depths alone lack a focal length, and know their unit."""
        usable = ["--focal", "--focal-35mm"] if self.lacks_intrinsics else [] if given else self.hints.options
        if unused := [option for option in self.hints.options if option not in usable]:
            accepted = "only where geometry is made from the photo: without geometry files, or with --ignore geometry"
            raise InputError(unused[0], found=f"geometry in {self.folder.root.name or 'the folder'}", accepted=accepted)

    def geometry(self, image: PromptedImage) -> tuple[Geometry, Array]:
        given = self.has("geometry", *GEOMETRY_FILES)
        maker = self.fillers.geometry or self.stand_ins.geometry
        if self.lacks_intrinsics and maker:
            return read_geometry(self.folder, image.photo, camera_of(self.folder, self._standing_in(maker), image))
        if backend := self._filler(self.fillers.geometry, given):
            return geometry_of(self.folder, backend, image)
        if not given and self.stand_ins.geometry:
            return geometry_of(self.folder, self._standing_in(self.stand_ins.geometry), image, fallback=True)
        if not given:
            raise InputError(self.folder.root, found="no geometry", accepted=GEOMETRY_ACCEPTED)
        return read_geometry(self.folder, image.photo)

    def shown(self, image: PromptedImage) -> PromptedImage:
        """With a network's normals, where a camera is to be found by an estimator that takes them."""
        found = not self.has("geometry", *GEOMETRY_FILES) or self.lacks_intrinsics
        maker = self.fillers.geometry or self.stand_ins.geometry
        if self.fillers.normals is None or not found or not getattr(maker and maker.made, "takes_normals", False):
            return image
        return replace(image, normals=normals_of(self.folder, self._standing_in(self.fillers.normals), image))

    def facing(self, image: PromptedImage, geometry: Geometry, K: Array) -> Geometry:
        """With a network's normals, where the geometry has none, and was not made by them."""
        backend = self.fillers.normals
        if backend is None or (image.normals is not None and geometry.guessed_unit):
            return geometry
        if geometry.normals is not None:
            self.folder.decide(f"normals: as the geometry has them; {backend} is not asked", "it has normals")
            return geometry
        return with_normals(geometry, normals_of(self.folder, self._standing_in(backend), image, geometry, K))

    @cached_property
    def meshes(self) -> GivenMeshes:
        """Those of the folder."""
        return read_meshes(self.folder, self.masks, self.asset_frame)

    def assets(self, image: PromptedImage, geometry: Geometry, K: Array) -> dict[int, PosedAsset]:
        given = self.has("assets", "assets")
        if backend := self._filler(self.fillers.assets, given):
            return assets_of(self.folder, backend, image, geometry, K)
        if not given and self.stand_ins.assets:
            standing_in = self._standing_in(self.stand_ins.assets)
            return assets_of(self.folder, standing_in, image, geometry, K, fallback=True)
        if not given:
            raise InputError(self.folder.path("assets"), found="no assets", accepted=ASSETS_ACCEPTED)
        if has_unplaced_meshes(self.folder) and (placing := self._placing):
            if self.asset_frame != "auto":
                accepted = "nothing where a file NN.json beside each mesh tells its pose"
                raise InputError("--asset-frame", found=self.asset_frame, accepted=accepted)
            places = self._standing_in(placing)
            return assets_of(self.folder, places, image, geometry, K, saved=True)
        place = None if self.placer is None else partial(self.placer.place, image, geometry, K)
        return placed_assets(self.folder, self.meshes, self.masks, place)

    def graph(self, image: PromptedImage, geometry: Geometry) -> SceneGraph | None:
        given = self.has("scene_graph", "scene_graph.json")
        if backend := self._filler(self.fillers.scene_graph, given):
            try:
                return graph_of(self.folder, backend, image, geometry)
            except NoAnswerError as error:
                self.folder.decide("scene graph: by the rules alone", str(error), fallback=True)
                return None
        return _scene_graph(self.folder, image.instances) if given else None

    def properties(self, instances: Sequence[Instance]) -> Mapping[int, GivenProperties]:
        return read_properties(self.folder, {i.id for i in instances}) if self.has("materials", MATERIALS) else {}

    def _filler(self, backend: Backend[P] | None, given: bool) -> Backend[P] | None:
        """The back end that is to make a part; one that is not needed is told of."""
        if backend is not None and given:
            self.folder.decide(f"{backend.kind}: as given; {backend} is not asked", "the folder has it")
            return None
        return None if backend is None else self._standing_in(backend)

    def _standing_in(self, backend: Backend[P]) -> Backend[P]:
        """The back end, named among those that were used."""
        self.used[backend.kind] = backend
        return backend


def _photo(folder: InputFolder) -> tuple[Photo, KnownFocal | str | None]:
    """The photo, and the focal length in its EXIF, or why that cannot be used."""
    names = sorted(p.name for p in folder.root.iterdir() if p.stem == "image" and p.suffix.lower() in PHOTO_SUFFIXES)
    if len(names) != 1:
        found = ", ".join(names) or "no image"
        raise InputError(folder.root, found=found, accepted="one image.png, image.jpg or image.jpeg")
    file = folder.file(names[0])
    image = open_image(file)
    if (turned := exif_orientation(file)) in range(2, 9):
        choice = "photo: turned as its EXIF says; masks and geometry are those of the turned photo"
        folder.decide(choice, f"{names[0]} has the orientation {turned}")
    try:
        told = focal_by_exif(image)
    except ExifError as error:
        told = str(error)
    return Photo(rgb=as_rgb(image)), told


def _background(folder: InputFolder, photo: Photo) -> NDArray[np.uint8]:
    file = folder.file("background.png")
    rgb = as_rgb(open_image(file))
    if rgb.shape != photo.rgb.shape:
        found = f"{rgb.shape[1]}x{rgb.shape[0]} pixels"
        raise InputError(file, found=found, accepted=f"the photo's {photo.width}x{photo.height}")
    return rgb


def _require_inside(folder: InputFolder, geometry: Geometry, instances: Sequence[Instance]) -> None:
    """Every object at a known distance, where the geometry knows more than the ground."""
    if geometry.source == "ground":
        return
    for instance in instances:
        if not geometry.inside(instance.mask).any():
            raise InputError(
                folder.path(f"masks/{instance.name}"),
                found="no valid geometry inside the mask",
                accepted="at least one valid point",
            )


def _require_agreement(
    folder: InputFolder, geometry: Geometry, instances: Sequence[Instance], assets: Mapping[int, PosedAsset]
) -> None:
    """Every asset in front of the camera, in a unit that can be the geometry's, of a size that can be simulated."""
    for i in instances:
        asset = assets[i.id]
        x, y, depth = map(float, transform(asset.T_camera_object, asset.scale * asset.mesh.bounds.mean(0)))
        if depth <= 0:
            raise InputError(
                asset.source,
                found=f"the mesh for {i.name} behind the camera (depth {depth:.3g} m)",
                accepted="meshes in front of it, and the pose convention or --asset-frame they are in",
            )
        sizes = math.hypot(x, y, depth) / (asset.scale * asset.mesh.diagonal)
        if sizes > MAX_DISTANCE:
            raise InputError(
                asset.source,
                found=f"the mesh for {i.name} {sizes:.3g} times its own size away from the camera",
                accepted=f"at most {MAX_DISTANCE:,.0f} times",
            )
        if geometry.source == "ground":
            require_size(asset.source, i.name, asset)
            continue
        measured = float(np.median(geometry.points[geometry.inside(i.mask)][:, 2]))
        if not 1 / MAX_DISAGREEMENT <= depth / measured <= MAX_DISAGREEMENT:
            raise InputError(
                asset.source,
                found=f"the mesh for {i.name} at depth {depth:.3g} m, the geometry in its mask at {measured:.3g} m",
                accepted="the same unit in both",
            )
        require_size(asset.source, i.name, asset, factor=min(1.0, measured / depth))
        require_size(asset.source, i.name, asset, factor=max(1.0, measured / depth))


def _ground_mask(folder: InputFolder, photo: Photo, instances: Sequence[Instance]) -> NDArray[np.bool_]:
    """The visible support surface (H, W), without the objects' pixels."""
    ground = read_mask(folder, "ground.png", photo)
    covered = ground & np.any([i.mask for i in instances], axis=0)
    if covered.any():
        folder.decide("ground: pixels of objects removed", f"{int(covered.sum())} pixels of ground.png lie in masks")
    if not (ground & ~covered).any():
        raise InputError(
            folder.path("ground.png"), found="no pixel outside the object masks", accepted="the visible support surface"
        )
    return ground & ~covered


def _scene_graph(folder: InputFolder, instances: Sequence[Instance]) -> SceneGraph:
    """Given relations, between objects that exist."""
    path = folder.path("scene_graph.json")
    document = folder.document("scene_graph.json", _GivenGraph)
    ids = {i.id for i in instances}
    relations = document.as_relations()
    for r in relations:
        require_relation(path, r.subject, r.predicate, r.object, ids)
    return SceneGraph(relations=tuple(relations), source=path.name)


class _GivenRelation(BaseModel):
    model_config = STRICT
    subject: int
    predicate: Predicate
    object: int
    confidence: float = Field(default=1.0, ge=0, le=1)


class _GivenSupport(BaseModel):
    model_config = STRICT
    upper: int
    lower: int
    confidence: float = Field(default=1.0, ge=0, le=1)
    reason: Annotated[str, Field(max_length=MAX_REASON)] = ""


class _GivenGraph(BaseModel):
    model_config = STRICT
    relations: Annotated[list[_GivenRelation], Field(max_length=MAX_RELATIONS)] = []
    support_relations: Annotated[list[_GivenSupport], Field(max_length=MAX_RELATIONS)] = []

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("neither relations nor support_relations; accepted: at least one of them")
        return self

    def as_relations(self) -> list[Relation]:
        given = [
            Relation(
                subject=r.subject,
                predicate=r.predicate,
                object=r.object,
                confidence=r.confidence,
                evidence="given",
                source="given",
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
                    source="given",
                )
            )
        return given
