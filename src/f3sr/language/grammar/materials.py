"""What everyday things are made of, by their labels: priors where a package knows only shapes.

``vocabulary/materials.toml`` holds them, with their sources.
"""

from __future__ import annotations

from functools import cache, cached_property
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from f3sr.files.bounds import Density, Friction, RollingFriction, Share
from f3sr.language.grammar.lexicon import read
from f3sr.language.grammar.normaliser import words_of
from f3sr.language.grammar.nouns import singular
from f3sr.scene import SceneObject, Structure

COMPACT = 0.003
"""Volume up to which an unknown thing weighs as a compact one [m3]. Larger things are mostly walls around air: a
microwave of 50 l has 260 kg/m3, a refrigerator of .9 m3 has 90, a wardrobe of 1.8 m3 has 55."""

LIGHTEST = 30.0
"""Least density of an unknown thing [kg/m3]: foam and mattresses have it, and a hut of 24 m3."""


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
    whole: bool = False
    """Whether contents or air decide the density, and not what the thing is made of."""
    labels: Annotated[tuple[tuple[str, ...], ...], BeforeValidator(_listed)] = Field(repr=False)
    """The words of every name that tells this material, in the singular."""

    @property
    def properties(self) -> dict[str, Any]:
        """What an object of it is, by the names of an object's fields."""
        return {"material": self.name, **self.model_dump(exclude={"name", "labels", "whole"})}


class Materials(BaseModel):
    """The table of materials."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    materials: tuple[MaterialPrior, ...]
    substances: tuple[MaterialPrior, ...]

    @cached_property
    def by_label(self) -> dict[tuple[str, ...], MaterialPrior]:
        """The material of every name."""
        return {label: material for material in self.materials for label in material.labels}

    @cached_property
    def by_substance(self) -> dict[str, MaterialPrior]:
        """The material of every word that says what a thing is made of."""
        return {word: substance for substance in self.substances for (word,) in substance.labels}

    @model_validator(mode="after")
    def _checked(self) -> Materials:
        for group in (self.materials, self.substances):
            names = [label for material in group for label in material.labels]
            if twice := next((label for label in names if names.count(label) > 1), None):
                raise ValueError(f"{' '.join(twice)!r} names two materials; accepted: every name once")
        if several := next((label for s in self.substances for label in s.labels if len(label) > 1), None):
            raise ValueError(f"{' '.join(several)!r} names a substance; accepted: one word")
        return self


@cache
def materials() -> Materials:
    """The table of ``vocabulary/materials.toml``. Raises InputError where that file is faulty."""
    return read(Materials, "materials")


def material_of(label: str) -> MaterialPrior | None:
    """The material that a label tells; None where it tells none.

    English puts the head noun last: of several names the last one counts, and of two that end together the longer. A
    substance before it says more, ``wooden spoon``, unless contents or air decide the density."""
    words = tuple(singular(word) for word in words_of(label))
    known, substances = materials().by_label, materials().by_substance
    spans = ((start, end) for end in range(len(words), 0, -1) for start in range(end))
    start, end = next((span for span in spans if words[slice(*span)] in known), (len(words), len(words)))
    made_of = next((substances[word] for word in reversed(words[:start]) if word in substances), None)
    named = known.get(words[start:end])
    return named if made_of is None or (named and named.whole) else made_of


def unknown_density(volume: float) -> float:
    """Density of a thing of unknown material [kg/m3], of the volume that its mesh shows [m3].

    Walls of one thickness weigh as the surface, so the density falls with the cube root of the volume."""
    if volume <= COMPACT:
        return SceneObject.density
    return max(LIGHTEST, SceneObject.density * (COMPACT / volume) ** (1 / 3))
