"""A producer of meshes as an asset generator: what it makes stands where the masks put it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import CameraByPoses, GeneratedAsset, MeshProducer, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.mesh_poses.posed_meshes import camera_of, posed_meshes
from f3sr.scene import Geometry


@dataclass(frozen=True, eq=False)
class PosedAssets:
    """The AssetGenerator of a MeshProducer."""

    producer: MeshProducer

    def generate(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, GeneratedAsset]:
        """Assets by id, each with what its producer tells. ``K`` (3, 3) in pixels of the photo."""
        return posed_meshes(image, geometry, K, self.producer.produce(image, geometry, K))

    def camera(self, image: PromptedImage) -> CameraByPoses | None:
        """What meshes tell of their camera that are made before geometry is known; None of others."""
        return camera_of(image, self._made(image)) if self._made else None

    @property
    def tells_camera(self) -> bool:
        return self._made is not None

    @property
    def _made(self) -> Callable[[PromptedImage], Mapping[int, ProducedMesh]] | None:
        return getattr(self.producer, "made", None)

    @property
    def provenance(self) -> Mapping[str, str]:
        """What the producer tells of its model."""
        return getattr(self.producer, "provenance", {})

    def telling(self, tell: Callable[[str], None]) -> PosedAssets:
        """The same, whose producer tells what it is at."""
        ask: Callable[[Callable[[str], None]], MeshProducer] | None = getattr(self.producer, "telling", None)
        return PosedAssets(ask(tell)) if ask else self

    def needs(self) -> tuple[Need, ...]:
        """What the producer cannot answer without."""
        ask = getattr(self.producer, "needs", tuple)
        return tuple(ask())


@dataclass(frozen=True, eq=False)
class PosedMaker:
    """Makes the AssetGenerator of a producer, for what follows its name: a model, an address, a command."""

    maker: Callable[[ModelChoice], MeshProducer]
    takes_model = True

    def __call__(self, choice: ModelChoice) -> PosedAssets:
        """Raises InputError for what the producer does not take."""
        return PosedAssets(self.maker(choice))
