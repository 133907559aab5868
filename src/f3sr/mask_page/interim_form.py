"""Until the segmentation room has it: a Selection as JSON."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.backends.protocols import Prompt
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.segmentation.selection import Selection

Pixel = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Strokes = Annotated[
    list[Annotated[list[tuple[Pixel, Pixel]], Field(min_length=1, max_length=5000)]], Field(max_length=500)
]


class PromptForm(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)
    label: Annotated[str, Field(max_length=300)] = ""
    box: tuple[Pixel, Pixel, Pixel, Pixel] | None = None
    inside: Strokes = []
    outside: Strokes = []


class SelectionForm(BaseModel):
    model_config = ConfigDict(extra="forbid")
    prompts: Annotated[list[PromptForm], Field(max_length=500)]
    ground: PromptForm = PromptForm()


def read(value: Any) -> Selection:
    try:
        f = SelectionForm.model_validate(value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, "prompts, ground")
        raise InputError("the selection", found=found, accepted=accepted) from error
    return Selection(prompts=tuple(map(_prompt, f.prompts)), ground=_prompt(f.ground))


def _prompt(f: PromptForm) -> Prompt:
    inside, outside = (tuple(tuple(s) for s in strokes) for strokes in (f.inside, f.outside))
    return Prompt(label=f.label, box=f.box, inside=inside, outside=outside)


def form(s: Selection) -> Any:
    def one(p: Prompt) -> dict[str, Any]:
        return {"label": p.label, "box": p.box, "inside": p.inside, "outside": p.outside}

    return {"prompts": [one(p) for p in s.prompts], "ground": one(s.ground)}
