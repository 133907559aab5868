"""Programs whose outputs can be imported: how each is told by what is there, and read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from f3sr.errors import InputError, require_known
from f3sr.importing import comfyui, composed_glb, embodiedgen, fal_result, fysiverse, sam3d_notebook, single_meshes
from f3sr.importing.composition import Composition
from f3sr.importing.found_meshes import FoundMeshes
from f3sr.importing.import_source import PHOTO_NAMES, ImportSource


@dataclass(frozen=True, kw_only=True)
class Producer:
    """A program: how its outputs are told, and how they are read."""

    name: str
    """For ``--from``."""
    accepted: str
    """What it leaves, for messages."""
    matches: Callable[[ImportSource], bool]
    read: Callable[[ImportSource], Composition | FoundMeshes]


PRODUCERS = (
    Producer(
        name="fysiverse",
        accepted=f"a session with {fysiverse.MANIFEST}",
        matches=fysiverse.matches,
        read=fysiverse.read,
    ),
    Producer(
        name="sam3d",
        accepted="image.png, masks N.png and meshes N.glb",
        matches=sam3d_notebook.matches,
        read=sam3d_notebook.read,
    ),
    Producer(
        name="comfyui",
        accepted="object_N/mesh.glb, or GLBs with ComfyUI's counter or time",
        matches=comfyui.matches,
        read=comfyui.read,
    ),
    Producer(
        name="fal",
        accepted="a saved reply with model_glb or individual_glbs",
        matches=fal_result.matches,
        read=fal_result.read,
    ),
    Producer(
        name="trellis",
        accepted="sample.glb, or by name any GLB per object",
        matches=single_meshes.matches,
        read=single_meshes.read,
    ),
    Producer(
        name="embodiedgen",
        accepted=f"{embodiedgen.LAYOUT}, or NAME.urdf with mesh/NAME.glb",
        matches=embodiedgen.matches,
        read=embodiedgen.read,
    ),
    Producer(
        name="glb",
        accepted="one GLB with a node per object",
        matches=composed_glb.matches,
        read=composed_glb.read,
    ),
)


def producer_of(source: ImportSource, name: str | None = None) -> Producer:
    """The program of that name, else the one whose outputs are there.

    Raises InputError where there is none, and where there are several."""
    if name is not None:
        require_known("--from", [name], [p.name for p in PRODUCERS])
        return next(p for p in PRODUCERS if p.name == name)
    if not source.path.exists():
        raise InputError(source.path, found="nothing there", accepted="a folder or a GLB that a program left")
    if _is_input_folder(source):
        raise InputError(
            source.path, found="a prompted-image folder", accepted="it as it is: f3sr reconstruct takes it"
        )
    found = [p for p in PRODUCERS if p.matches(source)]
    if not found:
        accepted = "; ".join(f"{p.name}: {p.accepted}" for p in PRODUCERS)
        raise InputError(source.path, found="no output of a known program", accepted=accepted)
    if len(found) > 1:
        names = " and ".join(p.name for p in found)
        raise InputError(source.path, found=f"what {names} leave", accepted="one of them by --from NAME")
    return found[0]


def _is_input_folder(source: ImportSource) -> bool:
    """Whether it has what ``f3sr reconstruct`` reads, assets or geometry included."""
    place = source.path
    if not (place / "masks").is_dir() or not any((place / name).exists() for name in PHOTO_NAMES):
        return False
    return any((place / name).exists() for name in ("assets", "geometry.npz", "depth.png", "depth.npy"))
