"""What may be set of collision proxies."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from f3sr.settings import settings


@settings
class ProxyConfig:
    """How meshes become convex parts. Lengths are shares of the mesh's size, times per object and attempt."""

    hull_volume_ratio: Annotated[float, Interval(gt=0, le=1)] = 0.93
    """One hull if the closed mesh fills this share of it: splitting would add little."""
    tolerance: Annotated[float, Interval(ge=0.0005, le=0.2)] = 0.004
    """How far a part may stand off the surface where something can touch it [size]. A mesh that lies nowhere deeper
    below its hull gets one part. Halving it doubles the parts of a bowl."""
    loose_tolerance: Annotated[float, Interval(ge=0.0005, le=0.2)] = 0.01
    """The same for a mesh that is no shell once it has ``few_parts``; with twice as many parts twice as much is let
    be, and so on, down to ``tolerance``: the cost of contact grows with the square of their number."""
    few_parts: Annotated[int, Interval(ge=1, le=256)] = 16
    """Parts for which ``loose_tolerance`` is meant."""
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 64
    """Most parts, whatever the excess: a bowl of curved walls needs them all."""
    shell_fill: Annotated[float, Interval(ge=0, le=1)] = 0.5
    """A mesh that fills less of its hull than this is a shell: a bowl, a mug, a pan. What lies in it would float on
    parts that bridge its curved wall."""
    surplus: Annotated[float, Interval(ge=1, le=8)] = 2.0
    """How many times the parts that are wanted a mesh is cut into before neighbours are joined again."""
    target_faces: Annotated[int, Interval(ge=100, le=100_000)] = 3000
    """Triangles of the simplified mesh on which cuts are compared; the cuts are made through the mesh itself."""
    samples: Annotated[int, Interval(ge=500, le=100_000)] = 6000
    """Points of the surface at which it is measured how far parts stand off."""
    floor_weight: Annotated[float, Interval(ge=1, le=20)] = 3.0
    """How many times as near parts must come to the floor of a cavity as elsewhere: what lies in a pan is smaller than
    the pan and floats by more of its own size."""
    probe: Annotated[float, Interval(ge=0.005, le=0.2)] = 0.03
    """Radius of the ball that must fit where a point counts as one that something can touch [size]: slots, pores and
    corners that it does not fit into may be bridged, closed voids as well."""
    cell: Annotated[float, Interval(ge=0.004, le=0.1)] = 0.01
    """Cells of the grid on which open space is told from the inside [size]."""
    overlap: Annotated[float, Interval(ge=0, le=0.01)] = 0.0002
    """How far both parts reach beyond their common cut [size]: no crack lies between them."""
    cpu_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 120.0
    """Processor time [s] after which the work is cut short; most meshes need 3. Work cut short is lost and not
    cached, so the limit is generous."""
    wall_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 600.0
    """Time [s] after which it is cut short even if the machine was busy."""
    thickness: Annotated[float, Interval(ge=0, le=0.1)] = 0.002
    """How far a simplified hull may stand out from the exact one [size]; makes a can about 27-sided."""
    max_hull_faces: Annotated[int, Interval(ge=8, le=1000)] = 36
    """Most facets of a simplified hull among many: up to 68 corners. This outranks ``thickness``, and
    ``loose_tolerance`` outranks it up to twice as many."""
    lone_hull_faces: Annotated[int, Interval(ge=8, le=1000)] = 96
    """Most facets of a hull that is alone: a ball of 36 facets would stand on corners 1.6% of its size high."""
    facet_budget: Annotated[int, Interval(ge=8, le=100_000)] = 768
    """Facets of all hulls together that are shared between the two limits: twelve hulls may have 64 each."""
    flat_share: Annotated[float, Interval(gt=0, lt=1)] = 0.02
    """Facets that face one way and hold this share of a hull's area are kept as one plane: what an object stands on
    stays flat."""
    sheet: Annotated[float, Interval(gt=0, le=0.1)] = 0.004
    """Thickness given to a mesh that spans no volume [size]."""
    inflation_limit: Annotated[float, Interval(ge=1, le=100)] = 1.4
    """Volume of the parts over that of the mesh above which a decision names the object."""

    def most_faces(self, parts: int) -> int:
        """Most facets of each of so many hulls."""
        return min(max(self.max_hull_faces, self.facet_budget // parts), max(self.max_hull_faces, self.lone_hull_faces))

    def allowed(self, parts: float, *, is_shell: bool) -> float:
        """How far a hull may stand off in a mesh of so many parts [size]."""
        if is_shell:
            return self.tolerance
        return max(self.tolerance, self.loose_tolerance * parts / self.few_parts)
