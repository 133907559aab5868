"""The prompted-image folder (equation 1): all inputs are read and validated here, before any work starts."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from f3sr.core.transforms import Array, transform
from f3sr.errors import InputError
from f3sr.io.assets import PosedAsset, read_assets, require_size
from f3sr.io.geometry import read_geometry
from f3sr.io.images import as_rgb, open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import Instance, read_instances, read_mask
from f3sr.options import ASSET_FRAMES, PARTS
from f3sr.report import Decision
from f3sr.runtime.result_store import digest
from f3sr.scene import GROUND, Geometry, Photo, Predicate, Relation, SceneGraph

PHOTO_SUFFIXES = (".png", ".jpg", ".jpeg")
STRICT = ConfigDict(strict=True, allow_inf_nan=False)
MAX_RELATIONS = 10_000
"""Most relations of a kind in scene_graph.json: every pair of a hundred objects, both ways."""
MAX_REASON = 1000
"""Most characters of a relation's reason, which goes into the package and its report."""
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
    asset_frame: str = "auto"

    @property
    def key(self) -> str:
        """A hash of all files and options: equal keys mean equal inputs."""
        return digest(self.digests, self.asset_frame)


def read(folder: str | Path, *, ignore: Collection[str] = (), asset_frame: str = "auto") -> Inputs:
    """Read and validate a prompted-image folder (docs: conventions).

    ``ignore`` treats parts of PARTS as absent. ``asset_frame`` names the axes of GLBs without ``poses.json``: one of
    ASSET_FRAMES. Raises InputError for the first invalid file or value.
    """
    _require_known("--ignore", ignore, PARTS)
    _require_known("--asset-frame", [asset_frame], ASSET_FRAMES)
    source = InputFolder(Path(folder))
    photo = _photo(source)
    instances = read_instances(source, photo)
    if "geometry" in ignore:
        raise InputError(source.root, found="no geometry", accepted="geometry (there is no monocular back end yet)")
    geometry, K = read_geometry(source, photo)
    _require_inside(source, geometry, instances)
    if "assets" in ignore:
        raise InputError(source.root, found="no assets", accepted="assets (nothing makes meshes here yet)")
    assets = read_assets(source, {i.id: i.name for i in instances}, asset_frame)
    _require_agreement(source, geometry, instances, assets)
    ground_mask = graph = None
    if "ground" not in ignore and source.has("ground.png"):
        ground_mask = _ground_mask(source, photo, instances)
    else:
        source.decide("ground: the lower image region outside all masks", "no ground.png", fallback=True)
    if "scene_graph" not in ignore and source.has("scene_graph.json"):
        graph = _scene_graph(source, instances)
    background = None
    if "background" not in ignore and source.has("background.png"):
        background = _background(source, photo)
    return Inputs(
        photo=photo,
        instances=instances,
        K=K,
        geometry=geometry,
        assets=assets,
        ground_mask=ground_mask,
        graph=graph,
        background=background,
        decisions=tuple(source.decisions),
        digests=dict(sorted(source.digests.items())),
        asset_frame=asset_frame,
    )


read_inputs = read


def _require_known(what: str, names: Collection[str], known: Sequence[str]) -> None:
    if unknown := sorted(set(names) - set(known)):
        raise InputError(what, found=", ".join(unknown), accepted=", ".join(known))


def _photo(folder: InputFolder) -> Photo:
    names = sorted(p.name for p in folder.root.iterdir() if p.stem == "image" and p.suffix.lower() in PHOTO_SUFFIXES)
    if len(names) != 1:
        found = ", ".join(names) or "no image"
        raise InputError(folder.root, found=found, accepted="one image.png, image.jpg or image.jpeg")
    return Photo(rgb=as_rgb(open_image(folder.file(names[0]))))


def _background(folder: InputFolder, photo: Photo) -> NDArray[np.uint8]:
    file = folder.file("background.png")
    rgb = as_rgb(open_image(file))
    if rgb.shape != photo.rgb.shape:
        found = f"{rgb.shape[1]}x{rgb.shape[0]} pixels"
        raise InputError(file, found=found, accepted=f"the photo's {photo.width}x{photo.height}")
    return rgb


def _require_inside(folder: InputFolder, geometry: Geometry, instances: Sequence[Instance]) -> None:
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
        if r.subject not in ids or r.object not in ids | {GROUND} or r.subject == r.object:
            raise InputError(
                path,
                found=f"{r.subject} {r.predicate} {r.object}",
                accepted=f"two different ids of {sorted(ids)} ({GROUND} as the second is the ground)",
            )
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
