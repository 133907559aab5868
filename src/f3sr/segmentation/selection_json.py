"""The JSON form of a selection: ``prompts.json`` beside the masks, so that a page or another run can go on from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.backends.protocols import Prompt
from f3sr.errors import LONGEST_LINE, InputError, cut
from f3sr.files import strict_json
from f3sr.files.bounds import MAX_LABEL, MAX_OBJECTS
from f3sr.segmentation.selection import MAX_POINTS, Selection

PROMPTS = "prompts.json"
FORMAT = "f3sr prompts"
"""What tells the file, and the folder around it, from others."""

Number = Annotated[float, Field(allow_inf_nan=False)]
Line = Annotated[list[tuple[Number, Number]], Field(min_length=1, max_length=MAX_POINTS)]
Lines = Annotated[list[Line], Field(max_length=MAX_POINTS)]


class _PromptForm(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    label: Annotated[str, Field(max_length=MAX_LABEL)] = ""
    box: tuple[Number, Number, Number, Number] | None = None
    inside: Lines = []
    outside: Lines = []

    def prompt(self) -> Prompt:
        inside, outside = (tuple(map(tuple, lines)) for lines in (self.inside, self.outside))
        return Prompt(label=self.label, box=self.box, inside=inside, outside=outside)


class _SelectionForm(BaseModel):
    model_config = ConfigDict(extra="forbid")

    format: Literal["f3sr prompts"]
    version: Literal[1]
    prompts: Annotated[list[_PromptForm], Field(max_length=MAX_OBJECTS)]
    ground: _PromptForm = _PromptForm()
    made_by: Annotated[str, Field(max_length=LONGEST_LINE)] = ""
    files: dict[str, str] = {}
    """SHA-256 of the files beside it, which are not of the selection."""


def selection_form(selection: Selection) -> dict[str, Any]:
    """The selection as values that JSON holds."""
    values = asdict(selection)
    made_by = values.pop("made_by")
    return {"format": FORMAT, "version": 1, **values, **({"made_by": cut(made_by, LONGEST_LINE)} if made_by else {})}


def selection_bytes(selection: Selection, files: Mapping[str, str] | None = None) -> bytes:
    """The selection as a document, and digests of ``files`` beside it; the same bytes for the same prompts."""
    form = selection_form(selection) | ({"files": files} if files else {})
    return (json.dumps(form, allow_nan=False, ensure_ascii=False) + "\n").encode()


def read_selection(file: Path) -> Selection:
    """The selection of such a file. Raises InputError for anything else; ``require_prompts`` checks it for a photo."""
    return selection_of(strict_json.read(file, accepted=f"{PROMPTS} as f3sr segment writes it"), file)


def selection_of(value: Any, where: str | Path) -> Selection:
    """The same of a value read from JSON."""
    try:
        form = _SelectionForm.model_validate(value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(_SelectionForm.model_fields))
        raise InputError(where, found=found, accepted=accepted) from error
    prompts = tuple(p.prompt() for p in form.prompts)
    return Selection(prompts=prompts, ground=form.ground.prompt(), made_by=form.made_by)
