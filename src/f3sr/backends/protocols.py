"""What a model can do. Back ends take and return these values; the adapter converts frames and units, nobody else.

Images are (H, W) of the photo, row 0 on top; pixel (0, 0) is the corner of the first pixel. Camera frame: OpenCV axes
(x right, y down, z forward), metres. Answers are checked as files from outside are (``io/answers.py``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.scene import Geometry, Instance, Photo, Relation


@dataclass(frozen=True, kw_only=True)
class KnownFocal:
    """A focal length of the photo that somebody tells."""

    pixels: float
    """[px] of the upright photo."""
    sigma: float
    """One standard error of its logarithm; 0 is exact."""
    source: str
    """Who tells it, for the report."""
    centre: tuple[float, float] | None = None
    """Principal point (x, y) [px], where known."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EstimatedNormals:
    """``values`` (h, w, 3): unit surface normals towards the camera, in camera axes, zero where unknown; h, w need not
    be the photo's."""

    values: NDArray[np.floating]
    error: float
    """One standard error [rad] of what may be wrong alike in all places, which no spread shows."""
    told: str = ""
    """What they rest on, and how their axes were found, for the report."""
    warning: str = ""
    """Why their axes are doubtful, for the report; empty where they are not."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraByPoses:
    """What meshes posed in a camera tell of it."""

    focal: KnownFocal
    upward: tuple[Array, ...]
    """Of each mesh: directions (m, 3) against gravity if it rests on one of its m stable facets. Empty where the
    meshes' axes are in doubt."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PromptedImage:
    """A photo and what is outlined in it."""

    photo: Photo
    instances: tuple[Instance, ...]
    """By id, masks (H, W) disjoint."""
    ground_mask: NDArray[np.bool_] | None = None
    """(H, W): the visible support surface, where somebody has outlined it."""
    focal: KnownFocal | None = None
    """By the user, by intrinsics.json or by EXIF; estimators may do without it."""
    camera_height: float | None = None
    """Of the camera above the ground [m], where the user gives it; likewise."""
    normals: EstimatedNormals | None = None
    """Of a network, only for estimators whose ``takes_normals`` is true."""
    posed: CameraByPoses | None = None
    """What the folder's meshes tell of the camera, for the built-in metrology: networks know their own."""


Stroke = tuple[tuple[float, float], ...]
"""A polyline through pixels (x, y); a click is a stroke of one point."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Prompt:
    """What points at one object of a photo; all places in pixels (x, y)."""

    label: str = ""
    box: tuple[float, float, float, float] | None = None
    """Left, top, right, bottom."""
    inside: tuple[Stroke, ...] = ()
    """Strokes on the object."""
    outside: tuple[Stroke, ...] = ()
    """Strokes on what is not the object."""


class Segmenter(Protocol):
    """Prompts to masks, for ``f3sr segment``. Masks may share pixels: ``segmentation/ownership.py`` parts them."""

    def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Sequence[NDArray[np.bool_]]:
        """One mask (H, W) per prompt, in their order, with at least one pixel each."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Detection:
    """An object of a photo that words name."""

    label: str
    """The phrase that was asked for."""
    score: float
    """Confidence from 0 to 1."""
    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""
    mask: NDArray[np.bool_] | None = None
    """(H, W), where the model gives masks too."""


class Detector(Protocol):
    """Words to objects, for ``--segment``."""

    def detect(self, photo: Photo, phrases: Sequence[str]) -> Sequence[Detection]:
        """What the phrases name, in any order and number; none where nothing is found."""
        ...


class GroundSegmenter(Protocol):
    """The visible support surface of a photo."""

    def ground(self, photo: Photo) -> NDArray[np.bool_]:
        """(H, W); objects may be in it."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class EstimatedGeometry:
    """``points`` (h, w, 3) float [m] in the camera frame, meaningful where ``valid`` (h, w) bool; h, w need not be the
    photo's. ``K`` (3, 3) in pixels of the photo; ``normals`` (h, w, 3) unit vectors or None."""

    points: NDArray[np.floating]
    valid: NDArray[np.bool_]
    K: Array
    normals: NDArray[np.floating] | None = None
    ground_only: bool = False
    """Only points of the ground are known, none of objects."""
    guessed_unit: bool = False
    """Whether its unit rests on a guess, as that of the camera's height: known lengths and usual sizes then change it.
    That of points of the ground only always does."""
    up_error: float | None = None
    """Two standard errors of the ground's normal [rad], where they are known: they show in no point of a plane."""
    focal_error: float | None = None
    """One standard error of the logarithm of the focal length, likewise."""
    told: str = ""
    """What it rests on, for the report."""


class GeometryEstimator(Protocol):
    """Estimates point map and intrinsics K of the photo. It is asked only where the folder has no geometry.

    Its distances count as accurate to 1 %, unlike those of a depth sensor.
    """

    def estimate(self, image: PromptedImage) -> EstimatedGeometry: ...


class NormalEstimator(Protocol):
    """Surface normals of the photo: evidence of the camera, and the normals of a geometry that has none."""

    def normals(self, image: PromptedImage, geometry: Geometry | None, K: Array | None) -> EstimatedNormals:
        """Normals in camera axes. ``geometry`` with ``K`` (3, 3) [px of the photo] is there where points are known:
        they tell axes and signs. It is asked without before a camera is found."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class GeneratedAsset:
    """A mesh in its own axes and where it stands: ``x_camera = T_camera_object (scale x)``, T (4, 4) rigid [m]."""

    mesh: Mesh
    T_camera_object: Array
    scale: float = 1.0
    told: str = ""
    """What it is, and what it might be, for the report."""
    doubted: bool = False
    """Whether its place may be wrong; ``told`` then says why."""
    fixed: str = ""
    """Why physics must not move it; empty where it may."""
    lifted: bool = False
    """Whether it was made from its own mask, upright on its support: the mask then tells nothing of its tilt."""
    file: Path | None = None
    """The file that says where it stands, which errors name; None where the back end itself does."""


Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


@dataclass(frozen=True, kw_only=True)
class GivenPose:
    """A pose as its producer writes it: four numbers of a quaternion, a place, and the size of the mesh's unit there.

    Order, direction and axes are not agreed; masks decide how it is read (``io/pose_conventions``)."""

    rotation: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    scale: float


@dataclass(frozen=True, eq=False, kw_only=True)
class ProducedMesh:
    """A mesh as a generator leaves it, in the axes of its file, with what is told of its place."""

    mesh: Mesh
    up: Axis | None = None
    """The axis of the file that points up; None where nobody tells."""
    pose: GivenPose | None = None
    """As the producer writes it; None where it gives none."""
    told: str = ""
    """Model, revision and licence, for the report."""
    file: Path | None = None
    """The file that tells this; None where no file is left."""


class MeshProducer(Protocol):
    """A mesh for every mask, without an agreed frame: ``mesh_poses/`` finds where each stands in the photo."""

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """One mesh per instance, by its id. ``K`` (3, 3) in pixels of the photo."""
        ...


class AssetGenerator(Protocol):
    """A mesh for every mask."""

    def generate(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, GeneratedAsset]:
        """One asset per instance, by its id. ``K`` (3, 3) in pixels of the photo."""
        ...


class BackgroundCompleter(Protocol):
    """The photo without what is in it."""

    def complete(self, photo: Photo, hole: NDArray[np.bool_], support: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
        """The photo (H, W, 3) uint8 sRGB with its ``hole`` (H, W) filled; nothing outside of it is taken. ``support``
        (H, W): where the completed photo shows what things stand on, in the hole too."""
        ...


class Labeler(Protocol):
    """Names of things, for masks whose files do not tell one."""

    def labels(self, image: PromptedImage, unnamed: Sequence[Instance]) -> Mapping[int, str]:
        """A label for every one of some instances, by its id: one to four plain words."""
        ...


class SceneGrapher(Protocol):
    """Relations between objects, from what the photo shows. They count as a folder's ``scene_graph.json`` does:
    geometry is asked before they move anything."""

    def relations(self, image: PromptedImage, geometry: Geometry) -> Sequence[Relation]:
        """Relations between ids of the instances; only ``supported_by`` may name the GROUND, as its object."""
        ...
