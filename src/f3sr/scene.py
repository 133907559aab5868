"""The one immutable value that all stages share: photo, camera, ground and objects.

Frames and units (docs: conventions): world +Z up, metres; camera axes as in OpenCV; ``T_a_b`` maps points of b into a.
Arrays are read-only. A stage returns a new scene with ``with_objects`` or ``dataclasses.replace``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self
from weakref import ReferenceType, ref

import numpy as np
from numpy.typing import NDArray

from f3sr.core import support_forest
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, MassProperties, Mesh
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array, bounds_of, boxes_of, frozen, rotation_angle, transform

GROUND = -1
"""The id of the ground in supports and contacts."""
GRAVITY = 9.81
"""Acceleration of free fall along -Z [m/s2]."""

SENSOR_NOISE = 0.005
"""Most noise of a depth sensor [share of the distance], half of what networks are off by."""

Structure = Literal["solid", "hollow"]
MaterialSource = Literal["given", "label", "default", "model"]
"""Where the density comes from: materials.json, the label, the default, or a model."""
Mobility = Literal["dynamic", "fixed"]
MobilitySource = Literal["default", "given", "found"]
GeometrySource = Literal["estimate", "sensor", "ground"]


def name_of(id: int) -> str:
    """The name of an object in decisions, which know no labels."""
    return "the ground" if id == GROUND else f"object {id}"


def names_of(ids: Collection[int]) -> str:
    """``object 3``, ``objects 1, 3 and 4``, in the order of their ids."""
    *first, last = map(str, sorted(ids))
    return f"objects {', '.join(first)} and {last}" if first else f"object {last}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Photo:
    """The photo, (height, width, 3) uint8 sRGB."""

    rgb: NDArray[np.uint8]

    def __post_init__(self) -> None:
        object.__setattr__(self, "rgb", frozen(self.rgb, np.uint8))

    @property
    def width(self) -> int:
        return self.rgb.shape[1]

    @property
    def height(self) -> int:
        return self.rgb.shape[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Instance:
    """One masked object of the photo."""

    id: int
    label: str
    name: str
    """File name of the mask."""
    mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        self.mask.setflags(write=False)  # what cannot change is shared, not copied


@dataclass(frozen=True, eq=False, kw_only=True)
class Geometry:
    """Per-pixel geometry of the photo, in camera axes; its resolution need not be the photo's.

    ``points`` (h, w, 3) [m], meaningful where ``valid`` (h, w); ``normals`` (h, w, 3) unit or None.
    ``source``: a depth sensor measured it, or a network estimated it. An estimate has errors of focal length, scale
    and shift that show in no residual. "ground": only the ground plane is known, and objects have no points.
    """

    points: NDArray[np.float32]
    valid: NDArray[np.bool_]
    normals: NDArray[np.float32] | None = None
    normals_error: float | None = None
    """One standard error [rad] of what the normals may have wrong alike in all places; None: as good as the points'."""
    source: GeometrySource = "estimate"
    noise: float | None = None
    """Standard deviation of its depths [share of the distance], where a user gives it."""
    up_error: float | None = None
    """Two standard errors of the ground's normal [rad], where an estimator tells them."""
    focal_error: float | None = None
    """One standard error of the logarithm of the focal length, likewise."""
    guessed_unit: bool = False
    """Whether it claims no metres: known lengths and usual sizes may change its unit."""
    zooms: tuple[float, ...] = ()
    """Factors by which ``zoomed`` has changed it, in order."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float32))
        object.__setattr__(self, "valid", frozen(self.valid, np.bool_))
        if self.normals is not None:
            object.__setattr__(self, "normals", frozen(self.normals, np.float32))

    def zoomed(self, factor: float) -> Geometry:
        """The same depths under ``factor`` times the focal length."""
        points = self.points / np.array([factor, factor, 1], np.float32)
        return replace(self, points=points, zooms=(*self.zooms, float(factor)))

    def inside(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Valid geometry pixels (h, w) whose centres fall into a photo-sized mask."""
        h, w = self.valid.shape
        return self.valid & resample(mask, w, h)


@dataclass(frozen=True, eq=False, kw_only=True)
class Ground:
    """The support plane ``normal . x = offset`` in the world; after ``level`` it is z = 0."""

    normal: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    offset: float = 0.0
    source: str = "provisional"
    confidence: float = 0.0
    """In [0, 1]: the share of candidate ground points that lie on the plane."""
    tilt_error: float = np.inf
    """Two standard errors of the normal [rad]; inf where nothing measured it."""
    height_error: float = np.inf
    """Two standard errors of the plane's height amid its points [m]; inf where nothing measured it."""
    friction: float = 0.6
    """Coefficient of sliding friction; a contact takes the larger of two."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How far a stage moved an object: centre of its box [m], rotation angle [rad], scale factor, and why."""

    stage: str
    translation: tuple[float, float, float]
    rotation: float
    scale: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class Support:
    """A support of an object: the ``id`` of its carrier (GROUND for the ground) and the share of the load in [0, 1]."""

    id: int
    share: float = 1.0


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneObject:
    """One instance: its mask (H, W) in the photo and its mesh in the world.

    ``mesh`` and ``parts`` are in the asset's own axes and unit. World points are
    ``T_world_object @ (scale * v)``, with ``T_world_object`` (4, 4) rigid and ``scale`` in metres per unit.
    """

    id: int
    label: str
    mask_name: str
    mask: NDArray[np.bool_]
    mesh: Mesh
    T_world_object: Array
    scale: float = 1.0
    parts: tuple[ConvexPart, ...] = ()
    """Collision proxies, same frame and unit as ``mesh``."""
    footing: tuple[ConvexPart, ...] = ()
    """Convex wedges under the mesh that hold it in the pose of the photo; same frame and unit (docs: contact)."""
    mobility: Mobility = "dynamic"
    mobility_source: MobilitySource = "default"
    """``found``: fixed because nothing that is seen can carry it where the photo shows it."""
    density: float = 600.0
    """[kg/m3]"""
    solid: MassProperties | None = None
    """Volume, centre and inertia per density of the solid, asset frame, scale 1, where a package gives them. None: they
    are those of the mesh or its proxies."""
    friction: float = 0.6
    """Coefficient of sliding friction; a contact takes the larger of two."""
    rolling_friction: float = 0.001
    """[m]"""
    restitution: float = 0.0
    """Coefficient of restitution in [0, 1]; only rollouts use it, of what is sent at something (docs: physics)."""
    damping: float = 0.0
    """Rate of velocity loss [1/s]; only rollouts use it."""
    structure: Structure = "solid"
    """A description: mass and inertia are those of the solid at ``density``, air inside included."""
    material: str = "unknown"
    material_source: MaterialSource = "default"
    """Where the density comes from; ``material_reason`` tells of the other properties."""
    material_reason: str = ""
    supports: tuple[Support, ...] = ()
    supported_by: int | None = None
    """Id of the main support in the forest; GROUND for the ground, None if unknown."""
    lifted: bool = False
    """Whether its mesh was made from its own mask, upright: the mask tells nothing of its tilt or the camera."""
    motion: tuple[Motion, ...] = ()
    """What the stages did to it, in order."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", frozen(self.mask, np.bool_))
        object.__setattr__(self, "T_world_object", frozen(self.T_world_object))

    def __repr__(self) -> str:
        return f"SceneObject({self.id}, {self.label!r})"

    @cached_property
    def T_world_asset(self) -> Array:
        """The similarity that maps asset coordinates into the world: T_world_object @ diag(scale)."""
        T = self.T_world_object.copy()
        T[:3, :3] *= self.scale
        return T

    @property
    def vertices_world(self) -> Array:
        """(n, 3) [m], the mesh's vertices in the world. The cache is weak: scenes of all stages stay alive."""
        known: ReferenceType[Array] | None = self.__dict__.get("_vertices_world")
        vertices = known() if known else None
        if vertices is None:
            vertices = frozen(transform(self.T_world_asset, self.mesh.vertices))
            object.__setattr__(self, "_vertices_world", ref(vertices))
        return vertices

    @cached_property
    def bounds_world(self) -> Array:
        """Lowest and highest corner (2, 3) of the axis-aligned world box [m]."""
        return bounds_of(self.vertices_world)

    @property
    def middle(self) -> Array:
        """Middle (3,) of the world bounding box [m]."""
        return self.bounds_world.mean(0)

    @property
    def size(self) -> float:
        """Diagonal of the world bounding box [m]."""
        return float(np.linalg.norm(self.bounds_world[1] - self.bounds_world[0]))

    @property
    def colliders(self) -> tuple[ConvexPart, ...]:
        """All collision geometry in the asset frame: proxies and footing."""
        return (*self.parts, *self.footing)

    @property
    def solids(self) -> tuple[ConvexPart, ...]:
        """What physics simulates, in the asset frame: the colliders, or the mesh's hull where there are no proxies.
        Raises ValueError where that hull spans no volume."""
        return (*(self.parts or (self.mesh.hull,)), *self.footing)

    @property
    def carriers(self) -> list[int]:
        """Ids of all that it rests on, GROUND included: its support in the forest and its other supports, sorted."""
        main = () if self.supported_by is None else (self.supported_by,)
        return sorted({*main, *(s.id for s in self.supports)})

    @cached_property
    def colliders_world(self) -> tuple[ConvexPart, ...]:
        """``colliders`` in the world [m]."""
        return tuple(part.moved(self.T_world_asset) for part in self.colliders)

    @cached_property
    def boxes_world(self) -> Array:
        """Lowest and highest corners (k, 2, 3) of the world boxes of its colliders [m]; its own where it has none."""
        return boxes_of([p.vertices for p in self.colliders_world] or [self.vertices_world])

    def on_something_unseen(self) -> Self:
        """Held still, as no other object carries it."""
        source = self.mobility_source if self.mobility == "fixed" else "found"
        return replace(self, supported_by=None, supports=(), mobility="fixed", mobility_source=source)

    @property
    def is_on_something_unseen(self) -> bool:
        return self.supported_by is None and self.mobility == "fixed"

    def moved(self, T: Array, *, stage: str, reason: str, scale: float = 1.0) -> Self:
        """Apply the world similarity ``x -> T (scale * x)``, T rigid (4, 4), and note it in ``motion``."""
        R, t = T[:3, :3], T[:3, 3]
        T_new = np.eye(4)
        T_new[:3, :3] = R @ self.T_world_object[:3, :3]
        T_new[:3, 3] = R @ (scale * self.T_world_object[:3, 3]) + t
        center = self.middle
        shift = R @ (scale * center) + t - center
        note = Motion(
            stage=stage,
            translation=(float(shift[0]), float(shift[1]), float(shift[2])),
            rotation=rotation_angle(R),
            scale=float(scale),
            reason=reason,
        )
        return replace(self, T_world_object=T_new, scale=self.scale * scale, motion=(*self.motion, note))

    def motion_to(self, other: SceneObject) -> tuple[Array, float]:
        """The T (4, 4) and the scale with which ``moved`` takes the object to where another scene has it."""
        scale = other.scale / self.scale
        T = np.eye(4)
        T[:3, :3] = other.T_world_object[:3, :3] @ self.T_world_object[:3, :3].T
        T[:3, 3] = other.T_world_object[:3, 3] - T[:3, :3] @ (scale * self.T_world_object[:3, 3])
        return T, scale

    def way_to(self, other: SceneObject) -> Array:
        """From the middle of its box to where another scene has that, (3,) [m]."""
        return other.middle - self.middle

    def angle_to(self, other: SceneObject) -> float:
        """The turn [rad] to how another scene has the object."""
        return rotation_angle(self.motion_to(other)[0][:3, :3])


Predicate = Literal[
    "supported_by",
    "contains",
    "inside",
    "leaning_on",
    "in_front_of",
    "behind",
    "next_to",
    "touching",
    "overlaps_2d",
    "unknown",
]


RelationSource = Literal["found", "given"]


@dataclass(frozen=True, kw_only=True)
class Relation:
    """``subject predicate object`` with a confidence in [0, 1] and its evidence in words (docs: relations).

    Only supports name the ground, as the object. Relations with an inverse occur in both directions. Symmetric ones
    occur once, the lower id first.
    """

    subject: int
    predicate: Predicate
    object: int
    confidence: float
    evidence: str
    source: RelationSource = "found"
    """``given``: scene_graph.json names the relation, and geometry does not contradict it."""


@dataclass(frozen=True, kw_only=True)
class Node:
    """An object of the scene graph in words. ``visibility`` in [0, 1]: the share of its rendered silhouette that
    neither another object nor the photo's border hides."""

    id: int
    label: str
    description: str
    visibility: float


@dataclass(frozen=True, kw_only=True)
class SceneGraph:
    """Nodes and typed relations of a scene; ``source`` names what made them."""

    relations: tuple[Relation, ...] = ()
    source: str = "provisional"
    nodes: tuple[Node, ...] = ()

    def of(self, predicate: Predicate) -> frozenset[tuple[int, int]]:
        """The (subject, object) pairs of one predicate."""
        return frozenset((r.subject, r.object) for r in self.relations if r.predicate == predicate)


@dataclass(frozen=True, kw_only=True)
class Excluded:
    """A mask that is not an object, and why."""

    mask: str
    reason: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """Everything known after a stage. Object ids, their order (by id) and the photo never change.

    ``scene[id]`` is an object, iteration gives all of them by id. ``ground_mask`` (H, W) is the visible support
    surface in the photo. Raises ValueError for ids out of order and masks of another size than the photo.
    """

    photo: Photo
    camera: Camera
    objects: tuple[SceneObject, ...]
    ground: Ground = field(default_factory=Ground)
    ground_mask: NDArray[np.bool_] | None = None
    geometry: Geometry | None = None
    graph: SceneGraph = field(default_factory=SceneGraph)
    excluded: tuple[Excluded, ...] = ()

    def __post_init__(self) -> None:
        ids = [o.id for o in self.objects]
        if ids != sorted(set(ids)):
            raise ValueError(f"objects must be unique and sorted by id, found {ids}")
        for o in self.objects:
            if o.mask.shape != (self.photo.height, self.photo.width):
                raise ValueError(f"mask of object {o.id} is {o.mask.shape}, the photo {self.photo.rgb.shape}")

    def __repr__(self) -> str:
        return f"Scene({self.summary})"

    @property
    def summary(self) -> str:
        """Its objects and pixels in words."""
        count = len(self.objects)
        return f"{count} object{'s' * (count != 1)}, {self.photo.width}x{self.photo.height}"

    def __iter__(self) -> Iterator[SceneObject]:
        return iter(self.objects)

    def __getitem__(self, id: int) -> SceneObject:
        return self._by_id[id]

    @cached_property
    def _by_id(self) -> Mapping[int, SceneObject]:
        return {o.id: o for o in self.objects}

    def with_objects(self, *changed: SceneObject) -> Self:
        """The scene with some objects replaced by new values of the same id. Raises KeyError for an unknown id."""
        new = {o.id: o for o in changed}
        if unknown := new.keys() - self._by_id.keys():
            raise KeyError(f"no objects {sorted(unknown)}; the scene has {sorted(self._by_id)}")
        return replace(self, objects=tuple(new.get(o.id, o) for o in self.objects))

    def may_be_unsupported(self, id: int) -> bool:
        """Whether something unseen may carry an object: not where it is given that it moves, or what it rests on."""
        given = (r.subject for r in self.graph.relations if r.source == "given" and r.predicate == "supported_by")
        return self[id].mobility_source != "given" and id not in given

    def children(self, id: int) -> tuple[int, ...]:
        """Ids of the objects whose main support is ``id``."""
        return tuple(o.id for o in self.objects if o.supported_by == id)

    def load(self, id: int) -> tuple[int, ...]:
        """Ids of an object and all that rests on it alone: what rests on other things too is left out."""
        found = {id}
        for k in self.supports_first:
            if k in self.subtree(id) and found.issuperset(self[k].carriers):
                found.add(k)
        return tuple(sorted(found))

    def subtree(self, id: int) -> tuple[int, ...]:
        """``id``, then everything that rests on it by main supports, directly or not."""
        found = [id]
        for i in found:
            found.extend(c for c in self.children(i) if c not in found)
        return tuple(found)

    def ancestors(self, id: int) -> tuple[int, ...]:
        """The chain of supports below ``id``, nearest first, without the ground."""
        return support_forest.chain_below(id, self._carriers)

    @cached_property
    def _carriers(self) -> dict[int, int | None]:
        return {o.id: o.supported_by for o in self.objects}

    @property
    def has_measured_depth(self) -> bool:
        """Whether the geometry knows distances better than generated shapes are known: a depth sensor's, unless its
        noise is given."""
        if self.geometry is None:
            return False
        noise = self.geometry.noise
        return self.geometry.source == "sensor" if noise is None else noise <= SENSOR_NOISE

    @property
    def supports_first(self) -> tuple[int, ...]:
        """Ids of all objects, each after those below it in the support forest."""
        return tuple(support_forest.supports_first(self._carriers))

    @cached_property
    def diagonal(self) -> float:
        """Diagonal [m] of the box around all objects."""
        corners = np.concatenate([o.bounds_world for o in self.objects])
        return float(np.linalg.norm(np.ptp(corners, axis=0)))
