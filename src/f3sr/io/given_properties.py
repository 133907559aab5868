"""materials.json: what the user knows of objects as physics needs it; it overrules what labels tell."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS, Damping, Density, Friction, Id, RollingFriction, Share
from f3sr.io.input_folder import InputFolder
from f3sr.scene import Mobility, Structure

MATERIALS = "materials.json"
ABOUT = {"id", "reason"}
"""Fields that are no property."""


class GivenProperties(BaseModel):
    """Physical properties of one object; what is absent is told by the label or the default."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    id: Id
    material: Annotated[str, Field(min_length=1, max_length=80)] | None = None
    density: Density | None = None
    friction: Friction | None = None
    rolling_friction: RollingFriction | None = None
    restitution: Share | None = None
    damping: Damping | None = None
    structure: Structure | None = None
    mobility: Mobility | None = None
    reason: Annotated[str, Field(max_length=1000)] = ""

    @property
    def properties(self) -> dict[str, Any]:
        """What is given, by the names of an object's fields."""
        return self.model_dump(exclude=ABOUT, exclude_none=True)

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if not self.properties:
            names = ", ".join(name for name in type(self).model_fields if name not in ABOUT)
            raise ValueError(f"no property of object {self.id}; accepted: at least one of {names}")
        return self


class _PropertiesDocument(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")

    objects: Annotated[list[GivenProperties], Field(max_length=MAX_OBJECTS)]


def read_properties(folder: InputFolder, ids: Collection[int]) -> Mapping[int, GivenProperties]:
    """The given properties by object id. Raises InputError for ids that are unknown or occur twice."""
    found = dict[int, GivenProperties]()
    for given in folder.document(MATERIALS, _PropertiesDocument).objects:
        if given.id not in ids or given.id in found:
            twice = " twice" if given.id in found else ""
            accepted = f"each of {sorted(ids)} at most once"
            raise InputError(folder.path(MATERIALS), found=f"object {given.id}{twice}", accepted=accepted)
        found[given.id] = given
    return found
