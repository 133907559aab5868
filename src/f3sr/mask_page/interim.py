"""Until the segmentation room has them: a Selection as JSON, its masks, and the folder they go to."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.backends.protocols import Prompt, Segmenter
from f3sr.backends.registry import Backend, Kind
from f3sr.errors import InputError, OutputError
from f3sr.files import strict_json
from f3sr.io.answers import checked_masks
from f3sr.io.images import encode_png
from f3sr.runtime.atomic_folder import claimed
from f3sr.scene import Photo
from f3sr.segmentation.selection import Outlines, Selection

PROMPTS = "prompts.json"
Pixel = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Line = Annotated[list[tuple[Pixel, Pixel]], Field(min_length=1, max_length=5000)]
Strokes = Annotated[list[Line], Field(max_length=500)]


class PromptForm(BaseModel):
    model_config = ConfigDict(extra="forbid")
    label: Annotated[str, Field(max_length=300)] = ""
    box: tuple[Pixel, Pixel, Pixel, Pixel] | None = None
    inside: Strokes = []
    outside: Strokes = []


class SelectionForm(BaseModel):
    model_config = ConfigDict(extra="forbid")
    prompts: Annotated[list[PromptForm], Field(max_length=500)]
    ground: PromptForm = PromptForm()


def read(value: Any, where: str = "the selection") -> Selection:
    try:
        f = SelectionForm.model_validate(value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, "prompts, ground")
        raise InputError(where, found=found, accepted=accepted) from error
    return Selection(prompts=tuple(map(_prompt, f.prompts)), ground=_prompt(f.ground))


def _prompt(f: PromptForm) -> Prompt:
    inside, outside = (tuple(tuple(s) for s in strokes) for strokes in (f.inside, f.outside))
    return Prompt(label=f.label, box=f.box, inside=inside, outside=outside)


def form(s: Selection) -> Any:
    def one(p: Prompt) -> dict[str, Any]:
        return {"label": p.label, "box": p.box, "inside": p.inside, "outside": p.outside}

    return {"prompts": [one(p) for p in s.prompts], "ground": one(s.ground)}


def outlined(photo: Photo, selection: Selection, segmenter: Backend[Segmenter]) -> Outlines:
    answer = segmenter.asked(lambda s: s.segment(photo, selection.prompts))
    masks = checked_masks(str(segmenter), answer, photo, len(selection.prompts))
    return Outlines(masks=masks, ground=np.zeros_like(masks[0]))


def earlier(folder: Path) -> Selection:
    """What an earlier run drew."""
    file = folder / PROMPTS
    return read(strict_json.read(file), str(file)) if os.path.lexists(file) else Selection(prompts=())


def require_ours(folder: Path) -> None:
    if os.path.lexists(folder) and not (folder / PROMPTS).exists() and any(folder.iterdir()):
        raise OutputError(f"{folder}: is there already, and not made by this page; move it away first")


def write(folder: Path, photo: Photo, selection: Selection, outlines: Outlines) -> Path:
    folder = folder.absolute()
    with claimed(folder, require_ours) as claim:
        claim.write("image.png", encode_png(photo.rgb))
        for k, (p, mask) in enumerate(zip(selection.prompts, outlines.masks, strict=True)):
            name = re.sub(r"[^\w-]+", "_", p.label)[:60].strip("_")
            claim.write(f"masks/{k:02d}{'_' if name else ''}{name}.png", encode_png(mask.astype(np.uint8) * 255))
        if outlines.ground.any():
            claim.write("ground.png", encode_png(outlines.ground.astype(np.uint8) * 255))
        claim.write(PROMPTS, json.dumps(form(selection)).encode())
        claim.replace()
    return folder


DEFAULT_SEGMENTER = "grabcut"
SEGMENTERS = Kind(name="segmentation", protocol=Segmenter, built_in={"grabcut": "f3sr.segmentation.grabcut:GrabCut"})
