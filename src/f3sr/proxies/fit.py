"""How well finished convex parts fit their mesh: volume, what sticks out of them, how far they stand off it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, MassProperties, is_closed, signed_volume
from f3sr.core.transforms import Array, bounds_of
from f3sr.proxies.hulls import outside, planes
from f3sr.proxies.surface import Faces, NearestTriangles, Samples, Surroundings, samples_of, stand_off

PART_POINTS = 20_000
"""Points spread over all parts by area, at which the excess is measured."""
HIDDEN = 1e-6
"""Depth below the surface of another part from which on a point does not show [size]."""


@dataclass(frozen=True, kw_only=True)
class Excess:
    """How far the exposed surface of the parts stands off the mesh, where something can touch it [size]."""

    mean: float
    most: float
    """At the 99th of a hundred parts of the exposed surface."""
    largest: float
    at: tuple[float, float, float]
    """Where it is largest."""
    floor: float | None = None
    """99th percentile over the surface that faces the opening of a cavity; None without a cavity."""


def inflation(solid: MassProperties, vertices: Array, faces: Faces) -> float | None:
    """Volume of parts, as one ``solid``, over that of the mesh; None when the mesh has none."""
    if not is_closed(faces) or (volume := signed_volume(vertices, faces)) <= 0:
        return None
    return solid.volume / volume


def largest_outside(parts: Sequence[ConvexPart], vertices: Array) -> float:
    return float(np.maximum(outside(parts, vertices).min(1), 0).max())


def excess(parts: Sequence[ConvexPart], nearest: NearestTriangles, around: Surroundings | None, probe: float) -> Excess:
    """Stand-off at points of the parts that lie in no other part.

    With ``around``, only points that a ball of radius ``probe`` can touch are measured."""
    corners = np.concatenate([p.vertices for p in parts])
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    triangles = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]).astype(np.int32)
    samples = samples_of(corners[triangles], PART_POINTS)
    shown = ~_hidden(parts, samples.points)
    if around is not None:
        shown &= around.is_reached(samples.points, samples.normals, probe)
    points = samples.points[shown]
    if not len(points):
        return Excess(mean=0.0, most=0.0, largest=0.0, at=(0.0, 0.0, 0.0))
    far = nearest.distance(points)
    x, y, z = map(float, points[int(far.argmax())])
    return Excess(mean=float(far.mean()), most=float(np.quantile(far, 0.99)), largest=float(far.max()), at=(x, y, z))


def floor_excess(parts: Sequence[ConvexPart], samples: Samples) -> float | None:
    """Of the surface on which things in a cavity come to rest: where its weight is more than half of the most."""
    most = float(samples.weight.max(initial=1.0))
    if most == 1.0:
        return None
    floor = samples.chosen(samples.weight > (1 + most) / 2)
    floor = replace(floor, weight=np.ones(len(floor.points)))
    off = np.zeros(len(floor.points))
    for part in parts:
        normals, offsets = planes(part)
        held = (floor.points @ normals.T - offsets).max(1, initial=-1) <= HIDDEN
        if held.any():
            off[held] = np.maximum(off[held], stand_off(floor.chosen(held), normals, offsets))
    return float(np.quantile(off, 0.99)) if len(off) else None


def _hidden(parts: Sequence[ConvexPart], points: Array) -> NDArray[np.bool_]:
    hidden = np.zeros(len(points), bool)
    for part in parts:
        low, high = bounds_of(part.vertices)
        near = np.flatnonzero(np.all((points > low) & (points < high), axis=1))
        hidden[near] |= outside([part], points[near])[:, 0] < -HIDDEN if len(near) else False
    return hidden
