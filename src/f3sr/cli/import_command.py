"""The command that makes a prompted-image folder of a scene that another program left."""

from __future__ import annotations

import json as json_
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from f3sr.cli.segment_command import FolderOut
from f3sr.errors import InputError

SceneFolder = Annotated[Positional[Path], arg(metavar="DIR")]


def import_scene(folder: SceneFolder, /, out: FolderOut, json: bool = False) -> None:
    """Turn a scene of another program into a prompted-image folder for ``f3sr reconstruct``.

    Args:
        folder: A session of Fysiverse-3D, with final_scene_manifest.json.
        out: A new folder, or one that this command wrote. Masks are drawn from the poses where there are none.
        json: Print one JSON object instead of text.
    """
    from f3sr.cli import console
    from f3sr.importing.composition import drawn
    from f3sr.importing.imported_folder import write_imported
    from f3sr.importing.producers import PRODUCERS

    reader = next((p for p in PRODUCERS if p.matches(folder)), None)
    if reader is None:
        accepted = "; ".join(p.accepted for p in PRODUCERS)
        raise InputError(folder, found="no scene of a known program", accepted=accepted)
    composition = reader.read(folder)
    view = drawn(composition)
    written = write_imported(out, composition, view)
    unseen = [o.label or str(o.id) for o in composition.objects if o.id not in view.masks]
    if json:
        print(json_.dumps({"folder": str(written), "objects": len(view.masks), "left_out": unseen}))
        return
    console.say(f"source:   {composition.source}")
    console.say(f"objects:  {len(view.masks)}, masks drawn from the poses")
    if unseen:
        console.say(f"left out: {', '.join(unseen)}; the camera does not see them")
    console.say(f"folder:   {written}")
