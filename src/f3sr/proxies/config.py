"""What may be set of collision proxies, and how much work is put into them."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from f3sr.settings import constants, settings

FEW_PARTS = 16
"""Parts at which ``loose_tolerance`` holds."""
LONE_HULL_FACES = 96
"""Most facets of a hull that is alone: a ball of 36 facets would stand on corners 1.6% of its size high."""
FACET_BUDGET = 768
"""Facets that all hulls share between the two limits: twelve hulls may have 64 each."""


@constants
class CutConfig:
    """How finely a mesh is measured and cut."""

    loose_tolerance: float = 0.01
    """Tolerance [size] of a mesh of ``FEW_PARTS`` that is no shell. It grows with the parts and does not fall below
    ``tolerance``: the cost of contact grows with the square of their number."""
    surplus: float = 2.0
    """Ratio of pieces cut to parts wanted, before neighbours are joined again."""
    target_faces: int = 3000
    """Triangles of the simplified mesh on which cuts are compared; the mesh itself is cut."""
    samples: int = 6000
    """Points of the surface at which the excess of parts is measured."""


@settings
class ProxyConfig:
    """How meshes become convex parts. Lengths are shares of the mesh's size, times per object and attempt."""

    tolerance: Annotated[float, Interval(ge=0.0005, le=0.2)] = 0.004
    """Largest distance of a part from the surface, where something can touch it [size]. Half of it doubles the parts.
    """
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 64
    """Most convex parts of one object. A bowl of curved walls needs them all."""
    max_hull_faces: Annotated[int, Interval(ge=8, le=1000)] = 36
    """Most facets of a part among many. The tolerance may double it."""
    cpu_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 120.0
    """Most processor time [s]. Work cut short is lost; most meshes need 3 s."""
    wall_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 600.0
    """Most time by the clock [s], for a busy machine."""
    cuts: CutConfig = CutConfig()

    def most_faces(self, parts: int) -> int:
        """Most facets of each of so many hulls."""
        return min(max(self.max_hull_faces, FACET_BUDGET // parts), max(self.max_hull_faces, LONE_HULL_FACES))

    def allowed(self, parts: float, *, is_shell: bool) -> float:
        """How far a hull may stand off in a mesh of so many parts [size]."""
        if is_shell:
            return self.tolerance
        return max(self.tolerance, self.cuts.loose_tolerance * parts / FEW_PARTS)
