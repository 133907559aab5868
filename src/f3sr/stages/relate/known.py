"""The data of relations: surfaces in one plan, views in one picture, neighbours."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import GROUND, Scene
from f3sr.stages.relate.config import RelateConfig
from f3sr.stages.relate.image_evidence import Common, Picture
from f3sr.stages.relate.surfaces import FloorPlan, Surfaces, near_in_plan, surfaces_of

NEAR = 0.5
"""Distance in plan, in sizes of the smaller one, within which two objects are looked at: shifts of three standard
deviations along a slanted viewing ray bring them over each other."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Known:
    """What is worked out once per scene; pairs are filled in when they are asked for."""

    scene: Scene
    config: RelateConfig
    plan: FloorPlan
    surfaces: Mapping[int, Surfaces]
    picture: Picture
    near: Mapping[int, tuple[int, ...]]
    """Ids near each object in plan."""
    _tops: dict[tuple[int, int], Surfaces] = field(default_factory=dict[tuple[int, int], Surfaces])
    _commons: dict[tuple[int, int], Common | None] = field(default_factory=dict[tuple[int, int], Common | None])

    @classmethod
    def of(cls, scene: Scene, config: RelateConfig) -> Self:
        plan = FloorPlan.of(scene.camera)
        surfaces = surfaces_of(scene, plan, config.cells)
        pairs = near_in_plan(surfaces.values(), max(NEAR, config.beside))
        near = {o.id: tuple(sorted(b for a, b in pairs if a == o.id)) for o in scene}
        return cls(scene=scene, config=config, plan=plan, surfaces=surfaces, picture=Picture.of(scene), near=near)

    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of near ids, the lower one first."""
        return [(a, b) for a in self.near for b in self.near[a] if a < b]

    def under(self, p: int, o: int) -> Surfaces:
        """The surfaces of ``p`` without what lies wholly above ``o``."""
        top = float(self.surfaces[o].bounds[1, 2])
        if self.surfaces[p].bounds[1, 2] <= top:
            return self.surfaces[p]
        if (p, o) not in self._tops:
            self._tops[p, o] = self.surfaces[p].below(top)
        return self._tops[p, o]

    def common(self, a: int, b: int) -> Common | None:
        """What the views of two objects have in common."""
        if (a, b) not in self._commons:
            self._commons[a, b] = self.picture.common(a, b)
        return self._commons[a, b]

    def distances(self, id: int, here: Array, carrier: int) -> Array:
        """From an object's underside, its cells moved to ``here`` (..., n, 3), to a carrier's top along their common
        normal, about: (..., n) [m], negative in depth, nan beside it."""
        level = self.surfaces[id].underside_level
        if carrier == GROUND:
            return here[..., 2] * level
        top, top_level = self.under(carrier, id).top_at(here[..., :2])
        return (here[..., 2] - top) * np.minimum(level, top_level)


def leads(start: int, goal: int, steps: Mapping[int, Collection[int]]) -> bool:
    """Whether steps from id to id lead from ``start`` to ``goal``."""
    seen, left = {start}, [start]
    while left:
        id = left.pop()
        if id == goal:
            return True
        new = set(steps.get(id, ())) - seen
        left += new
        seen |= new
    return False
