"""From what a program left to an input folder: masks and meshes for the pose search, or a composition."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from f3sr.importing.composition import Composition, LeftOut, drawn
from f3sr.importing.found_meshes import FoundMeshes
from f3sr.importing.import_source import ImportSource
from f3sr.importing.imported_folder import left_out, write_imported
from f3sr.importing.masked_meshes import MaskedMeshes, with_masks, write_masked_meshes
from f3sr.importing.posed_in_camera import composed
from f3sr.importing.producers import producer_of


@dataclass(frozen=True, kw_only=True)
class Imported:
    """An input folder that was written, and what is to be known of it."""

    folder: Path
    source: str
    objects: int
    masks: str
    poses: str
    remarks: tuple[str, ...] = ()
    left_out: tuple[LeftOut, ...] = ()


def import_output(source: ImportSource, out: Path, producer: str | None = None) -> Imported:
    """Read what a program left and write an input folder, whole or not at all.

    Raises InputError for what cannot be read, OutputError for a place that holds something else."""
    found = producer_of(source, producer).read(source)
    ready = _ready(found, source) if isinstance(found, FoundMeshes) else found
    if isinstance(ready, MaskedMeshes):
        return Imported(
            folder=write_masked_meshes(out, ready),
            source=ready.found.source,
            objects=len(ready.masks),
            masks="given",
            poses="given, read as the masks show" if ready.has_poses else "none, found by the masks",
            remarks=ready.remarks,
        )
    view = drawn(ready)
    return Imported(
        folder=write_imported(out, ready, view),
        source=ready.source,
        objects=len(view.masks),
        masks="given" if ready.masks else "drawn from the poses",
        poses="given",
        remarks=(*ready.remarks, *(() if ready.photo else ("photo: drawn from the meshes",))),
        left_out=left_out(ready, view),
    )


def _ready(found: FoundMeshes, source: ImportSource) -> MaskedMeshes | Composition:
    """With masks, by the user's or the program's own; without, by the poses."""
    masks = source.named_masks() or found.masks
    return with_masks(found, masks, source) if masks else composed(found, source)
