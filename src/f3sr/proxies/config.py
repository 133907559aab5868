"""What may be set of collision proxies, and how much work is put into them."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from f3sr.settings import constants, settings

UNCUT = 2 / 3
"""Share of the allowed vertices that a part is made with: it is cut flush with its mesh and back at contacts later."""


@constants
class CutConfig:
    """How finely a mesh is measured and cut."""

    surplus: float = 2.0
    """Ratio of pieces cut to parts wanted, before neighbours are joined again."""
    target_faces: int = 3000
    """Triangles of the simplified mesh on which cuts are compared; the mesh itself is cut."""
    samples: int = 6000
    """Points of the surface at which the excess of parts is measured."""


@settings
class ProxyConfig:
    """How meshes become convex parts. Lengths are shares of the mesh's size, times per object and attempt."""

    tolerance: Annotated[float, Interval(ge=0.0005, le=0.2)] = 0.02
    """Largest depth by which something sinks past a part before it touches the mesh [size]. Half of it doubles the
    parts. In narrow hollows more is allowed, on the floor of a cavity less."""
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 32
    """Most convex parts of one object. The cost of contact grows with the square of their number. ``close`` may add
    some."""
    max_vertices: Annotated[int, Interval(ge=16, le=1000)] = 64
    """Most vertices of a part. PhysX takes 64, some engines on a GPU 32."""
    cpu_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 120.0
    """Most processor time [s]. Work cut short is lost; most meshes need 3 s."""
    wall_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 600.0
    """Most time by the clock [s], for a busy machine."""
    cuts: CutConfig = CutConfig()

    @property
    def made_vertices(self) -> int:
        """Most vertices of a part at first."""
        return round(UNCUT * self.max_vertices)
