"""Where the meshes of objects would first meet what is below them, were they lowered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.scene import GROUND, SceneObject
from f3sr.vision import height_map

CELLS = 96
"""Cells along the longer side of what two objects share, seen from above."""
LOOKS = 2
"""Height maps per pair: the second one is taken in a few cells around what the first one finds."""
THROUGH = 5e-5
"""Largest overlap of two meshes that counts as contact [m]; a deeper one belongs to an overhang."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Meeting:
    """The vertical gap [m] between a mesh and ``other`` below it where that is smallest, and both ends (3,) of it."""

    gap: float
    other: int
    above: Array
    below: Array


_Known = WeakKeyDictionary[Mesh, WeakKeyDictionary[Mesh, dict[tuple[object, ...], Meeting | None]]]
_KNOWN: _Known = WeakKeyDictionary()
"""Of meshes that are in use, at poses that they had: most objects stay where others are lowered and settle."""


def meeting(o: SceneObject, others: Iterable[SceneObject]) -> Meeting:
    """Where an object would first meet the ground or one of some others."""
    vertices = o.vertices_world
    lowest = vertices[int(vertices[:, 2].argmin())]
    on_the_ground = Meeting(gap=float(lowest[2]), other=GROUND, above=lowest, below=lowest * [1, 1, 0])
    found = [on_the_ground, *(m for other in others if (m := _between(o, other)))]
    return min(found, key=lambda m: m.gap)


def _between(upper: SceneObject, lower: SceneObject) -> Meeting | None:
    """Where a mesh would first meet another one; None where no part of it is over the other."""
    low = np.maximum(upper.bounds_world[0], lower.bounds_world[0])[:2]
    high = np.minimum(upper.bounds_world[1], lower.bounds_world[1])[:2]
    if (high <= low).any():
        return None
    known = _KNOWN.setdefault(upper.mesh, WeakKeyDictionary()).setdefault(lower.mesh, {})
    poses = (lower.id, *(value for o in (upper, lower) for value in (o.scale, o.T_world_object.tobytes())))
    if poses not in known:
        known[poses] = _nearest(upper, lower, low, high)
    return known[poses]


def _nearest(upper: SceneObject, lower: SceneObject, low: Array, high: Array) -> Meeting | None:
    """The same over a rectangle of the xy plane. What lies above all of the upper mesh's underside there hides nothing:
    a shelf's boards above a box."""
    found = None
    for _ in range(LOOKS):
        if (high <= low).any():
            break
        grid = height_map.Grid.over(low, high, float((high - low).max()) / CELLS)
        above = height_map.lower(upper.vertices_world, _over(upper, low, high), grid)
        if np.isnan(above).all():
            break
        below = height_map.upper(lower.vertices_world, _over(lower, low, high, under=np.nanmax(above)), grid)
        gap = np.where(above - below > -THROUGH, above - below, np.inf)
        k = int(np.argmin(gap))
        if not np.isfinite(gap.flat[k]):
            break
        row, column = divmod(k, grid.columns)
        at = np.array(grid.origin) + grid.cell * (np.array([column, row]) + 0.5)
        start, end = np.append(at, above.flat[k]), np.append(at, below.flat[k])
        found = Meeting(gap=max(0.0, float(gap.flat[k])), other=lower.id, above=start, below=end)
        low, high = at - 2 * grid.cell, at + 2 * grid.cell
    return found


def _over(o: SceneObject, low: Array, high: Array, *, under: float = np.inf) -> NDArray[np.int32]:
    """An object's triangles over a rectangle of the xy plane, and ``under`` a height: those not wholly beyond."""
    x, y = o.vertices_world[:, 0], o.vertices_world[:, 1]
    # One bit per side (Cohen and Sutherland).
    beyond = (x < low[0]) | (x > high[0]) * np.uint8(2) | (y < low[1]) * np.uint8(4) | (y > high[1]) * np.uint8(8)
    beyond |= (o.vertices_world[:, 2] > under + THROUGH) * np.uint8(16)
    a, b, c = o.mesh.faces.T
    return o.mesh.faces[beyond[a] & beyond[b] & beyond[c] == 0]
