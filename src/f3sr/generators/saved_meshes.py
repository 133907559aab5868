"""Meshes that a generator left on disk: ``NN.glb`` and ``NN.json`` as workers answer, one of each per mask."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.generators.posed_assets import PosedMaker
from f3sr.io.input_folder import InputFolder
from f3sr.scene import Geometry
from f3sr.workers.mesh_job import read_answer

SUFFIXES = (".glb", ".json")
ONE_EACH = "NN.glb and NN.json for every mask, NN its id"


@dataclass(frozen=True)
class SavedMeshes:
    """The MeshProducer of a folder; it makes nothing."""

    folder: Path | None

    def needs(self) -> tuple[Need, ...]:
        """A folder."""
        remedy = "--assets saved:DIR, or leave it to a folder's own assets/"
        return (Need(what="folder", met=self.folder is not None, found=str(self.folder or "none"), remedy=remedy),)

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """The saved mesh of every instance, by its id. Raises InputError likewise."""
        del geometry, K
        return self.made(image)

    def made(self, image: PromptedImage) -> Mapping[int, ProducedMesh]:
        """The same before any geometry is known.

        Raises InputError, naming the file, for one that is missing, left over or broken."""
        if (folder := self.folder) is None:
            raise InputError("assets back end saved", found="no folder", accepted=f"saved:DIR with {ONE_EACH}")
        names = [
            name
            for name in InputFolder(folder, accepted=f"a folder with {ONE_EACH}").names()
            if Path(name).suffix.lower() in SUFFIXES
        ]
        wanted = {f"{i.id:02d}{suffix}" for i in image.instances for suffix in SUFFIXES}
        if extra := sorted(set(names) - wanted):
            raise InputError(folder / extra[0], found="a file of no mask", accepted=ONE_EACH)
        if missing := sorted(wanted - set(names)):
            raise InputError(folder, found=f"no {missing[0]}", accepted=ONE_EACH)
        return {i.id: _told(read_answer(folder, i.id)) for i in image.instances}


def _told(mesh: ProducedMesh) -> ProducedMesh:
    return mesh if mesh.told else replace(mesh, told="saved mesh")


def _folder_of(choice: ModelChoice) -> SavedMeshes:
    return SavedMeshes(folder=Path(choice.model) if choice.model else None)


saved = PosedMaker(_folder_of)
"""Meshes of a folder after the colon."""
