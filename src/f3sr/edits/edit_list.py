"""edits.json: a typed, bounded list of what a user changes in a scene, hostile until it is checked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from f3sr.errors import InputError, require_path
from f3sr.files import strict_json
from f3sr.files.bounds import (
    MAX_DENSITY,
    MAX_FRICTION,
    MAX_MASS,
    MIN_DENSITY,
    MIN_MASS,
    Id,
    IdOrGround,
    Label,
    NewLabel,
)
from f3sr.scene_package.scene_json import Version

VERSION = 1
MAX_EDITS = 500
"""Most edits of a list: one by one they take minutes."""
MAX_EDITS_BYTES = 1_000_000
"""Largest file: 500 edits with labels of 300 characters take 300 kB."""
MAX_MOVE = 100.0
"""Largest shift of an edit along an axis [m]."""
MIN_AXIS = 1e-3
"""Least length of an axis of turning: below it the direction is rounding."""
MAX_FACTOR = 20.0
"""Largest factor on a size, and 1 over the least."""
PAGE = "docs/editing.md"

Shift = Annotated[float, Field(strict=True, ge=-MAX_MOVE, le=MAX_MOVE, allow_inf_nan=False)]
Component = Annotated[float, Field(strict=True, ge=-1, le=1, allow_inf_nan=False)]
Degrees = Annotated[float, Field(strict=True, ge=-360, le=360, allow_inf_nan=False)]
Factor = Annotated[float, Field(strict=True, ge=1 / MAX_FACTOR, le=MAX_FACTOR, allow_inf_nan=False)]
GivenDensity = Annotated[float, Field(strict=True, ge=MIN_DENSITY, le=MAX_DENSITY, allow_inf_nan=False)]
GivenMass = Annotated[float, Field(strict=True, ge=MIN_MASS, le=MAX_MASS, allow_inf_nan=False)]
GivenFriction = Annotated[float, Field(strict=True, ge=0, le=MAX_FRICTION, allow_inf_nan=False)]


class _EditRecord(BaseModel):
    """What every edit has: the object, and its label as the user saw it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Id
    label: Label
    """Of the object when the edit was made: an edit for another label is not applied."""


class MoveEdit(_EditRecord):
    """Shift an object, with what it carries, along the world's axes [m]."""

    kind: Literal["move"] = "move"
    by: tuple[Shift, Shift, Shift]


class TurnEdit(_EditRecord):
    """Turn an object, with what it carries, about the centre of its box: ``axis`` in the world, right-handed."""

    kind: Literal["turn"] = "turn"
    axis: tuple[Component, Component, Component]
    degrees: Degrees

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if sum(c * c for c in self.axis) < MIN_AXIS**2:
            raise ValueError(f"axis {list(self.axis)}; accepted: a direction of length {MIN_AXIS} or more")
        return self


class ScaleEdit(_EditRecord):
    """Change an object's size by a factor, about its place on its support."""

    kind: Literal["scale"] = "scale"
    factor: Factor


class SupportEdit(_EditRecord):
    """Put an object, with what it carries, onto another one, or onto the ground (-1), along its viewing ray."""

    kind: Literal["support"] = "support"
    on: IdOrGround

    @model_validator(mode="after")
    def _is_another(self) -> Self:
        if self.on == self.id:
            raise ValueError(f"object {self.id} on itself; accepted: the id of another object, or -1 for the ground")
        return self


class MaterialEdit(_EditRecord):
    """What an object is made of: its density [kg/m3] or its mass [kg], and its coefficient of sliding friction."""

    kind: Literal["material"] = "material"
    density: GivenDensity | None = None
    mass: GivenMass | None = None
    friction: GivenFriction | None = None

    @model_validator(mode="after")
    def _says_one_thing(self) -> Self:
        if self.density is not None and self.mass is not None:
            raise ValueError("both density and mass; accepted: one of them")
        if self.density is None and self.mass is None and self.friction is None:
            raise ValueError("no property; accepted: density, mass or friction")
        return self


class LabelEdit(_EditRecord):
    """Call an object by another name."""

    kind: Literal["label"] = "label"
    to: Annotated[NewLabel, Field(min_length=1)]


class DeleteEdit(_EditRecord):
    """Take an object out of the scene; its mask is excluded."""

    kind: Literal["delete"] = "delete"


class FixEdit(_EditRecord):
    """Hold an object where it is, whatever acts on it."""

    kind: Literal["fix"] = "fix"


class ReleaseEdit(_EditRecord):
    """Let physics move an object again."""

    kind: Literal["release"] = "release"


Edit = Annotated[
    MoveEdit | TurnEdit | ScaleEdit | SupportEdit | MaterialEdit | LabelEdit | DeleteEdit | FixEdit | ReleaseEdit,
    Field(discriminator="kind"),
]
EDITS: tuple[type, ...] = get_args(get_args(Edit)[0])
"""The classes of edits."""
KINDS = ("move", "turn", "scale", "support", "material", "label", "delete", "fix", "release")
_EDIT: TypeAdapter[Edit] = TypeAdapter(Edit)


class EditList(BaseModel):
    """What edits.json holds."""

    model_config = ConfigDict(extra="forbid", frozen=True, title="f3sr edits")

    version: Version
    edits: Annotated[tuple[Edit, ...], Field(max_length=MAX_EDITS)]


def read_edits(file: Path) -> tuple[Edit, ...]:
    """The edits of a file, in order. Raises InputError naming the file, what was found and what is accepted."""
    accepted = f"a list of edits, version {VERSION} ({PAGE})"
    tree = strict_json.read(require_path("file", file), most=MAX_EDITS_BYTES, accepted=accepted)
    try:
        return EditList.model_validate(tree).edits
    except ValidationError as error:
        found, wanted = _problem(error, ", ".join(EditList.model_fields))
        raise InputError(file, found=found, accepted=wanted) from None


def edit_of(tree: object) -> Edit:
    """One edit of outside, as of a page's request. Raises InputError."""
    try:
        return _EDIT.validate_python(tree)
    except ValidationError as error:
        found, wanted = _problem(error, "kind, id, label")
        raise InputError("edit", found=found, accepted=wanted) from None


def edits_json(edits: Sequence[Edit]) -> bytes:
    """The text of edits.json, the same for equal edits: one a line."""
    lines = ",\n  ".join(json.dumps(e.model_dump(exclude_none=True), allow_nan=False) for e in edits)
    body = f"[\n  {lines}\n ]" if edits else "[]"
    return f'{{\n "version": {VERSION},\n "edits": {body}\n}}\n'.encode()


def edits_digest(edits: Sequence[Edit]) -> str:
    """What tells one list from another, for provenance."""
    return hashlib.sha256(edits_json(edits)).hexdigest()


def _problem(error: ValidationError, fields: str) -> tuple[str, str]:
    first = error.errors(include_url=False)[0]
    where = ".".join(map(str, first["loc"])) or "the edit"
    if first["type"] == "union_tag_invalid":
        return f"{where} = {first['input']!r:.60}", f"kind {', '.join(KINDS)}"
    if first["type"] == "union_tag_not_found":
        return f"{where} without a kind", f"kind {', '.join(KINDS)}"
    return strict_json.problem(error, fields, page=PAGE)
