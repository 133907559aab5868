"""What everyday things are made of, by their labels: priors where a package knows only shapes.

``vocabulary/materials.toml`` holds them, with their sources.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from f3sr.language.grammar.lexicon import read
from f3sr.language.grammar.normaliser import words_of
from f3sr.language.grammar.nouns import singular
from f3sr.scene_package.bounds import Density, Friction, RollingFriction, Share

Structure = Literal["solid", "hollow"]


def _listed(labels: object) -> object:
    return [tuple(label.split()) for label in labels.split(",")] if isinstance(labels, str) else labels


class MaterialPrior(BaseModel):
    """What a thing is made of, as physics needs it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    structure: Structure
    density: Density
    """[kg/m3] over the volume that the mesh shows."""
    friction: Friction
    restitution: Share
    """Of speed, from a hard table."""
    rolling_friction: RollingFriction = 1e-3
    """[m]"""
    labels: Annotated[tuple[tuple[str, ...], ...], BeforeValidator(_listed)] = Field(repr=False)
    """The words of every name that tells this material, in the singular."""


class Materials(BaseModel):
    """The table of materials."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    materials: tuple[MaterialPrior, ...]

    @cached_property
    def by_label(self) -> dict[tuple[str, ...], MaterialPrior]:
        """The material of every name."""
        return {label: material for material in self.materials for label in material.labels}

    @model_validator(mode="after")
    def _checked(self) -> Materials:
        names = [label for material in self.materials for label in material.labels]
        if twice := next((label for label in names if names.count(label) > 1), None):
            raise ValueError(f"{' '.join(twice)!r} names two materials; accepted: every name once")
        return self


@cache
def materials() -> Materials:
    """The table of ``vocabulary/materials.toml``. Raises InputError where that file is faulty."""
    return read(Materials, "materials")


def material_of(label: str) -> MaterialPrior | None:
    """The material that a label tells; None where it tells none. English puts the head noun last: of several names in a
    label the last one counts, and of two that end together the longer."""
    words, known = tuple(singular(word) for word in words_of(label)), materials().by_label
    ends = range(len(words), 0, -1)
    return next((known[words[start:end]] for end in ends for start in range(end) if words[start:end] in known), None)
