"""What a folder's ``assets/`` gives before anybody knows what it means, and the one who tells: the masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from f3sr.backends.protocols import CameraByPoses, GeneratedAsset, PromptedImage
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.io.sam3d import AssetPose
from f3sr.report import Decision
from f3sr.scene import Geometry


@dataclass(frozen=True, eq=False, kw_only=True)
class GivenMeshes:
    """Meshes by object id, in the axes and unit of their files."""

    place: Path
    """What errors name: poses.json, or the folder of the meshes."""
    meshes: Mapping[int, Mesh]
    files: Mapping[int, Path]
    """Of the meshes."""
    poses: Mapping[int, AssetPose] | None
    """As poses.json has them; None without that file."""
    declared: bool
    """Whether poses.json says how it is to be read."""
    frame: str
    """As ``--asset-frame`` takes it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacedMeshes:
    """Assets by object id where they stand in the camera, and what a user should know of how that was told."""

    assets: Mapping[int, GeneratedAsset]
    decisions: tuple[Decision, ...] = ()


class MeshPlacer(Protocol):
    """Tells where meshes stand whose frame, or pose, nobody tells."""

    def place(self, image: PromptedImage, geometry: Geometry, K: Array, given: GivenMeshes) -> PlacedMeshes:
        """All meshes in OpenCV camera axes. Raises InputError where nothing decides: it names what may be told."""
        ...

    def camera(self, image: PromptedImage, given: GivenMeshes) -> CameraByPoses | None:
        """The camera in which meshes are posed, where nobody tells it; None if the poses do not."""
        ...
