"""How near new parts of an object come to all that is around it: parts of other bodies, and the ground."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.contact import polytopes
from f3sr.contact.compounds import Arrays, Compound
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, bounds_of, transform
from f3sr.proxies.hulls import beyond
from f3sr.runtime.kernels import kernel
from f3sr.scene import SceneObject

ROUNDING = 1e-9
"""Depth [m] that is rounding."""

Faces = tuple[Array, Array]
"""Outward unit normals (m, 3) and offsets (m,) of a part's triangles (asset frame)."""


class NeighbouringParts:
    """What an object's parts may come near to. Its parts are in its asset frame, distances in metres.

    Distances have one entry for each of ``parts`` and the last one for the ground, (n + 1,). They are negative inside.
    """

    def __init__(self, o: SceneObject, others: Iterable[Polytope], *, within: float, reach: float) -> None:
        """``others`` are all parts of other bodies: those ``within`` a distance [m] of the object matter. What is
        farther than ``reach`` [m] counts as that far."""
        low, high = o.boxes_world[:, 0].min(0) - within, o.boxes_world[:, 1].max(0) + within
        self.parts = [p for p in others if (p.bounds[0] <= high).all() and (p.bounds[1] >= low).all()]
        self._T_world_asset, self._scale, self._reach = o.T_world_asset, o.scale, reach
        self._boxes = np.array([p.bounds for p in self.parts]).reshape(-1, 2, 3)
        T_asset_world: Array = np.linalg.inv(o.T_world_asset).astype(np.float64)
        self._vertices = [transform(T_asset_world, p.vertices) for p in self.parts]
        self._middles = np.array([v.mean(0) for v in self._vertices]).reshape(-1, 3)

    @cached_property
    def _arrays(self) -> Arrays:
        return Compound.of(self.parts).arrays

    def near(self, box: Array, apart: float) -> NDArray[np.int64]:
        """Which parts have boxes that come within ``apart`` [m] of a box (2, 3) (world)."""
        return np.flatnonzero(are_near(self._boxes, box, apart))

    def gaps(self, part: ConvexPart) -> Array:
        """Distances (n + 1,) of a part."""
        gaps = np.full(len(self.parts) + 1, self._reach)
        box = bounds_of(transform(self._T_world_asset, part.vertices))
        gaps[-1] = min(self._reach, float(box[0, 2]))
        for k in self.near(box, self._reach).tolist():
            gaps[k] = min(self._reach, self._gap(part, k, self._reach))
        return gaps

    def are_apart(self, part: ConvexPart, faces: Faces, allowed: Array) -> bool:
        """Whether a part with those faces is everywhere as far as ``allowed`` (n + 1,), which is at most ``reach``."""
        ours = transform(self._T_world_asset, part.vertices)
        box = bounds_of(ours)
        if box[0, 2] < allowed[-1]:
            return False
        near = self.near(box, self._reach)
        if not len(near):
            return True
        # A point that lies deep in a part is as far from where the two would be apart, at least.
        deepest = np.minimum(allowed[near], 0) / self._scale
        if (beyond(self._middles[near], *faces) < deepest).any():
            return False
        theirs, (normals, offsets) = [self._vertices[k] for k in near.tolist()], faces
        starts = np.cumsum([0, *map(len, theirs[:-1])])
        beside: Array = np.concatenate(theirs) @ normals.T - offsets
        if (np.minimum.reduceat(beside.max(1), starts) < deepest).any():
            return False
        separated = np.minimum.reduceat(beside, starts).max(1) * self._scale >= allowed[near]
        return all(
            _is_beside(self.parts[k], ours, float(allowed[k])) or self._gap(part, k, float(allowed[k])) >= allowed[k]
            for k in near[~separated].tolist()
        )

    def are_between(self, start: Array, ends: Array, allowed: Array) -> NDArray[np.bool_]:
        """Which segments from a point (3,) to others (m, 3) pass so deep through a part that no convex body that holds
        them is as far from it as ``allowed`` (m, n + 1) [m]: to part two bodies, every point of one has to leave the
        other."""
        points = transform(self._T_world_asset, np.concatenate([start[None], ends]))
        least = np.maximum(-allowed[:, :-1], 0) + ROUNDING
        return _pass_through(points[0], points[1:], self._arrays, least)

    def _gap(self, part: ConvexPart, other: int, enough: float) -> float:
        body = Polytope.of(part).moved(self._T_world_asset)
        return polytopes.separation(body, self.parts[other], enough)


def are_near(boxes: Array, box: Array, apart: float) -> NDArray[np.bool_]:
    """Which of boxes (n, 2, 3) come within ``apart`` of a box (2, 3)."""
    return ((boxes[:, 0] - apart < box[1]) & (box[0] - apart < boxes[:, 1])).all(1)


def _is_beside(part: Polytope, points: Array, enough: float) -> bool:
    """Whether a face of a part separates it from points (n, 3) by ``enough`` [m]: a look that costs little."""
    return bool(((points @ part.normals.T).min(0) - part.offsets).max() >= enough)


@kernel
def _pass_through(
    start: Array,
    ends: Array,
    parts: Arrays,
    least: Array,
) -> NDArray[np.bool_]:
    """Which segments from a point (3,) to others (m, 3) have a point at a depth of ``least`` (m, k) or more in one of k
    convex parts."""
    boxes, normals, offsets, begins = parts.boxes, parts.normals, parts.offsets, parts.begins
    found = np.zeros(len(ends), np.bool_)
    for i in range(len(ends)):
        for k in range(len(boxes)):
            is_near = True
            for axis in range(3):
                low, high = min(start[axis], ends[i, axis]), max(start[axis], ends[i, axis])
                is_near &= low <= boxes[k, 1, axis] and high >= boxes[k, 0, axis]
            if not is_near:
                continue
            enters, leaves = 0.0, 1.0
            for f in range(begins[k, 1], begins[k + 1, 1]):
                first = last = offsets[f] - least[i, k]
                for axis in range(3):
                    first -= normals[f, axis] * start[axis]
                    last -= normals[f, axis] * ends[i, axis]
                if first < 0 and last < 0:
                    leaves = -1.0
                elif first < 0:
                    enters = max(enters, first / (first - last))
                elif last < 0:
                    leaves = min(leaves, first / (first - last))
                if enters > leaves:
                    break
            if enters <= leaves:
                found[i] = True
                break
    return found


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    part = Polytope.of(ConvexPart.hull_of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])))
    _pass_through(np.zeros(3), np.ones((1, 3)), Compound.of([part]).arrays, np.zeros((1, 1)))
