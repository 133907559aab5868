"""scene.json, the source of truth of a package: its typed document, and how a scene becomes one."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    ValidationError,
    model_validator,
)

from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.core.support_forest import circle_of
from f3sr.core.transforms import Array
from f3sr.errors import OutputError
from f3sr.exporters.collision_parts import collision_path
from f3sr.files import strict_json
from f3sr.files.bounds import (
    FARTHEST,
    MAX_OBJECT_PARTS,
    MAX_OBJECTS,
    MAX_SCENE_PARTS,
    MAX_VOLUME,
    MIN_VOLUME,
    Damping,
    Density,
    Friction,
    Id,
    IdOrGround,
    Inertia,
    Intrinsics,
    Label,
    Mass,
    Number,
    Place,
    RigidMatrix4,
    RollingFriction,
    Scale,
    Share,
    Side,
    UnitVector3,
    Vector3,
    inertia_fault,
    intrinsics_fault,
)
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import (
    GROUND,
    Ground,
    MaterialSource,
    Mobility,
    MobilitySource,
    Predicate,
    RelationSource,
    Scene,
    SceneObject,
    Structure,
)

SCHEMA_VERSION = 1
SCHEMA_FILE = "scene.schema.json"


def _safe_path(path: str) -> str:
    """A relative POSIX path that stays in its folder."""
    pure = PurePosixPath(path)
    if pure.is_absolute() or ".." in pure.parts or "\\" in path or ":" in path or "\0" in path or path in ("", "."):
        raise ValueError(f"{path[:60]!r}; accepted: a relative path inside the package, with forward slashes")
    return path


def _file_name(name: str) -> str:
    if "/" in name or "\\" in name or name in ("", ".", ".."):
        raise ValueError(f"{name[:60]!r}; accepted: the bare name of a file")
    return name


def _whole(version: object) -> object:
    """Not true nor 1.0, which equal 1."""
    if type(version) is not int:
        raise ValueError(f"{version!r:.60}; accepted: a whole number")
    return version


WHOLE = BeforeValidator(_whole)
Version = Annotated[Literal[1], WHOLE]
Path = Annotated[str, AfterValidator(_safe_path)]
FileName = Annotated[str, AfterValidator(_file_name)]


class _SceneRecord(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class CameraRecord(_SceneRecord):
    """Pinhole camera: OpenCV axes, pixel centres at +0.5."""

    width: Side
    height: Side
    K: Intrinsics
    T_world_camera: RigidMatrix4

    @model_validator(mode="after")
    def _has_rays(self) -> Self:
        if fault := intrinsics_fault(np.array(self.K), self.width, self.height):
            raise ValueError(fault)
        return self


class GroundRecord(_SceneRecord):
    """The support plane normal . x = offset in the world."""

    normal: UnitVector3
    offset: Place
    source: str
    confidence: Share
    friction: Friction = Ground.friction
    """Coefficient of sliding friction; a contact takes the larger of two."""


class SupportRecord(_SceneRecord):
    """What carries an object (-1: the ground) and its share of the load."""

    id: IdOrGround
    share: Share


class MotionRecord(_SceneRecord):
    """How a stage moved an object: centre [m], turn [rad], scale factor."""

    stage: str
    translation: tuple[Number, Number, Number]
    rotation: Number
    scale: Scale
    reason: str


Length = Annotated[float, Field(ge=0, le=FARTHEST, allow_inf_nan=False)]
Row7 = Annotated[tuple[Place, ...], Field(min_length=7, max_length=7)]
Covariance = Annotated[tuple[Row7, ...], Field(min_length=7, max_length=7)]
"""(7, 7), symmetric and positive semidefinite."""


class UncertaintyRecord(_SceneRecord):
    """How well a pose is known: half widths of 90 % intervals, and covariances of seven parameters.

    These are a shift along the world's axes [m], a rotation vector [rad] and the logarithm of the scale. Turn and scale
    are about the middle of the object's world box."""

    along_ray: Length
    """Of the middle, along the viewing ray [m]."""
    across_ray: Length
    """Of the middle, across the viewing ray [m]."""
    yaw: Annotated[Number, Field(ge=0, le=math.pi)]
    tilt: Annotated[Number, Field(ge=0, le=math.pi)]
    size: Annotated[Number, Field(ge=0, le=10)]
    """Share of the size."""
    covariance: Covariance
    """All else is as uncertain as it is: camera, ground and other objects."""
    conditional: Covariance
    """All else is as the scene has it."""

    @model_validator(mode="after")
    def _are_covariances(self) -> Self:
        for rows in (self.covariance, self.conditional):
            matrix = np.array(rows)
            values = np.linalg.eigvalsh((matrix + matrix.T) / 2)
            if np.abs(matrix - matrix.T).max() > 1e-6 * max(values[-1], 0) or values[0] < -1e-6 * max(values[-1], 0):
                raise ValueError("a matrix that is no covariance; accepted: symmetric, without negative eigenvalues")
        return self


class ObjectRecord(_SceneRecord):
    """One object. Lengths in its own frame, metres; world points are T_world_object @ v."""

    id: Id
    label: Label
    mask: FileName
    mesh: Path
    collision: Annotated[tuple[Path, ...], Field(min_length=1, max_length=MAX_OBJECT_PARTS)]
    """Convex parts: first the proxies of the mesh, then the wedges of its footing."""
    footing: Annotated[int, Field(ge=0, lt=MAX_OBJECT_PARTS, strict=True)] = 0
    """How many parts at the end of ``collision`` are its footing."""
    T_world_object: RigidMatrix4
    mobility: Mobility
    mobility_source: MobilitySource = "default"
    """``found``: fixed because nothing that is seen can carry it where the photo shows it."""
    mass: Mass
    inertia: Inertia
    """kg m2 about the centre of mass, object axes."""
    center_of_mass: Vector3
    density: Density
    volume_source: Literal["mesh", "proxies"]
    friction: Friction
    rolling_friction: RollingFriction
    restitution: Share
    """Of speed, in rollouts; contacts at rest do not bounce."""
    damping: Damping = 0.0
    """Rate of velocity loss [1/s], in rollouts."""
    structure: Structure = "solid"
    material: Label
    material_source: MaterialSource = "default"
    """Where the density comes from; material_reason tells of the other properties."""
    material_reason: Annotated[str, Field(max_length=2000)] = ""
    supports: tuple[SupportRecord, ...]
    supported_by: IdOrGround | None
    lifted: bool = False
    """Whether its mesh was made from its mask and the photo."""
    motion: tuple[MotionRecord, ...]
    uncertainty: UncertaintyRecord | None = None

    @model_validator(mode="after")
    def _has_a_proxy(self) -> Self:
        if self.footing >= (parts := len(self.collision)):
            raise ValueError(f"a footing of {self.footing} of {parts} collision parts; accepted: at most {parts - 1}")
        return self

    @model_validator(mode="after")
    def _is_a_body(self) -> Self:
        """A volume, and an inertia, that a body of its mass can have."""
        volume = self.mass / self.density
        if not MIN_VOLUME <= volume <= MAX_VOLUME:
            raise ValueError(f"a volume of {volume:.3g} m3; accepted: {MIN_VOLUME:.0e} to {MAX_VOLUME:.0e} m3")
        if fault := inertia_fault(np.array(self.inertia), self.mass, free=self.mobility == "dynamic"):
            raise ValueError(fault)
        return self


class ExcludedRecord(_SceneRecord):
    """A mask that is not an object, and why."""

    mask: FileName
    reason: str


class RelationRecord(_SceneRecord):
    """``subject predicate object``, by object id."""

    subject: Id
    predicate: Predicate
    object: IdOrGround
    confidence: Share
    evidence: str
    source: RelationSource = "found"
    """``given`` where scene_graph.json says it and geometry does not contradict."""


class NodeRecord(_SceneRecord):
    """An object in words, and the share of its rendered silhouette that nothing hides or cuts."""

    id: Id
    label: str
    description: str
    visibility: Share


class SceneGraphRecord(_SceneRecord):
    """Relations with an inverse (inside, contains; in_front_of, behind) come both ways, symmetric ones (next_to,
    touching, overlaps_2d) once, the lower id first; only supported_by names the ground, -1, as its object."""

    relations: tuple[RelationRecord, ...]
    source: str
    nodes: tuple[NodeRecord, ...] = ()


class DirectObjectRecord(_SceneRecord):
    """Where the input put an object: world points are ``T_world_object @ (scale * v)`` of the package's mesh."""

    id: Id
    T_world_object: RigidMatrix4
    scale: Scale


class DirectRecord(_SceneRecord):
    """The levelled input. Moved vertically until its lowest vertex touches the ground, it is direct composition."""

    T_world_camera: RigidMatrix4
    objects: tuple[DirectObjectRecord, ...]


class SceneDocument(_SceneRecord):
    """scene.json of an f3sr scene package: right-handed world, +Z up, metres, kilograms, radians."""

    model_config = ConfigDict(title="f3sr scene")

    schema_: Annotated[str, Field(alias="$schema")] = SCHEMA_FILE
    schema_version: Version
    units: Literal["m"]
    up: Literal["z"]
    quaternion: Literal["wxyz"]
    camera: CameraRecord
    ground: GroundRecord
    objects: Annotated[tuple[ObjectRecord, ...], Field(min_length=1, max_length=MAX_OBJECTS)]
    excluded: tuple[ExcludedRecord, ...]
    scene_graph: SceneGraphRecord
    direct: DirectRecord | None = None
    metrics: dict[str, Number | None]
    provenance: dict[str, JsonValue]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Ids sorted and unique, masks unique, references to ids that exist, parts that can be held."""
        if (parts := sum(len(o.collision) for o in self.objects)) > MAX_SCENE_PARTS:
            raise ValueError(f"{parts:,} collision parts; accepted: at most {MAX_SCENE_PARTS:,}")
        ids = [o.id for o in self.objects]
        if ids != sorted(set(ids)):
            raise ValueError(f"object ids {ids}; accepted: unique and ascending")
        masks = [o.mask for o in self.objects] + [e.mask for e in self.excluded]
        if len(set(masks)) != len(masks):
            raise ValueError("a mask that occurs twice; accepted: once, of an object or excluded")
        named = {s.id for o in self.objects for s in o.supports} | {GROUND}
        named |= {o.supported_by for o in self.objects if o.supported_by is not None}
        named |= {i for r in self.scene_graph.relations for i in (r.subject, r.object)}
        named |= {n.id for n in self.scene_graph.nodes}
        if self.direct and [o.id for o in self.direct.objects] != ids:
            raise ValueError(f"direct composition of other objects; accepted: of {ids}")
        if unknown := sorted(named - {GROUND, *ids}):
            raise ValueError(f"references to ids {unknown}; accepted: {ids}")
        circle = circle_of({o.id: o.supported_by for o in self.objects if o.supported_by != GROUND})
        if circle is not None:
            raise ValueError(
                f"object {circle} supported by itself, directly or not; accepted: supports without circles"
            )
        return self


def scene_schema() -> dict[str, Any]:
    """The JSON Schema of scene.json."""
    schema = SceneDocument.model_json_schema(by_alias=True, mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def to_document(
    scene: Scene,
    *,
    direct: Scene | None,
    uncertainty: Mapping[int, PoseUncertainty],
    metrics: Mapping[str, float | None],
    provenance: Mapping[str, JsonValue],
) -> SceneDocument:
    """The scene as its document, beside where ``direct`` has the same objects; measures that are not finite become
    null."""
    camera, ground = scene.camera, scene.ground
    return _validated(
        {
            "schema_version": SCHEMA_VERSION,
            "units": "m",
            "up": "z",
            "quaternion": "wxyz",
            "camera": {
                "width": camera.width,
                "height": camera.height,
                "K": camera.K.tolist(),
                "T_world_camera": camera.T_world_camera.tolist(),
            },
            "ground": {
                "normal": np.asarray(ground.normal, float).tolist(),
                "offset": float(ground.offset),
                "source": ground.source,
                "confidence": float(ground.confidence),
                "friction": float(ground.friction),
            },
            "objects": [_object(o, uncertainty.get(o.id)) for o in scene.objects],
            "excluded": [{"mask": e.mask, "reason": e.reason} for e in scene.excluded],
            "scene_graph": {
                "relations": [vars(r) | {"evidence": _well_formed(r.evidence)} for r in scene.graph.relations],
                "source": scene.graph.source,
                "nodes": [vars(n) | {"label": _well_formed(n.label)} for n in scene.graph.nodes],
            },
            "direct": _direct(direct, scene) if direct else None,
            "metrics": {name: _finite(value) for name, value in metrics.items()},
            "provenance": dict(provenance),
        }
    )


def _validated(tree: dict[str, Any]) -> SceneDocument:
    """What is written can be read. Raises OutputError where a stage made what no package may hold."""
    try:
        return SceneDocument.model_validate(tree)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(SceneDocument.model_fields))
        raise OutputError(f"the scene is none that a package may hold: {found}; accepted: {accepted}") from error


def to_json(document: SceneDocument) -> bytes:
    """Text of the document, the same for the same values."""
    return dump_json(document.model_dump(by_alias=True, mode="json"))


def dump_json(value: Any) -> bytes:
    """Indented JSON with a row of numbers on one line. Strings, free of line breaks, cannot match."""
    text = json.dumps(value, indent=1, allow_nan=False)
    return re.sub(r"\[\n[-+.\deE,\s]+\]", lambda row: " ".join(row[0].split()), text).encode() + b"\n"


def mesh_path(id: int) -> str:
    """Where an object's mesh lies in the package."""
    return f"meshes/{id:02d}.glb"


def _object(o: SceneObject, known: PoseUncertainty | None) -> dict[str, Any]:
    body = body_of(o)
    return {
        "id": o.id,
        "label": _well_formed(o.label),
        "mask": o.mask_name,
        "mesh": mesh_path(o.id),
        "collision": [collision_path(o.id, k) for k in range(len(body.parts))],
        "footing": len(o.footing),
        "T_world_object": _list(o.T_world_object),
        "mobility": o.mobility,
        "mobility_source": o.mobility_source,
        "mass": float(body.mass),
        "inertia": _list(body.inertia),
        "center_of_mass": _list(body.center),
        "density": float(o.density),
        "volume_source": "mesh" if body.from_mesh else "proxies",
        "friction": float(o.friction),
        "rolling_friction": float(o.rolling_friction),
        "restitution": float(o.restitution),
        "damping": float(o.damping),
        "structure": o.structure,
        "material": _well_formed(o.material),
        "material_source": o.material_source,
        "material_reason": _well_formed(o.material_reason),
        "supports": [{"id": s.id, "share": float(s.share)} for s in o.supports],
        "supported_by": o.supported_by,
        "lifted": o.lifted,
        "motion": [vars(m) for m in o.motion],
        "uncertainty": vars(known) if known else None,
    }


def _direct(direct: Scene, scene: Scene) -> dict[str, Any]:
    return {
        "T_world_camera": _list(direct.camera.T_world_camera),
        "objects": [
            {"id": o.id, "T_world_object": _list(o.T_world_object), "scale": o.scale / scene[o.id].scale}
            for o in direct.objects
        ],
    }


def _list(values: Array) -> Any:
    return np.asarray(values, float).tolist()


def _well_formed(text: str) -> str:
    """The text itself, unless it holds halves of surrogate pairs, which JSON readers refuse."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
