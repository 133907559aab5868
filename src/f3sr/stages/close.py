"""close: colliders cut back to the meshes where things touch, so that nothing that rests shows a gap."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr import contact, heights
from f3sr.bodies import supports_first
from f3sr.contact import Polytope
from f3sr.frames import UP, Array, pose, transform
from f3sr.patches import find_contacts
from f3sr.proxies import trim
from f3sr.proxies.trim import Near, Place, Surface
from f3sr.report import Decision, Measure, Report
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.settings import settings

TOUCHING = 3e-6
"""Gap [m] that counts as contact while something is lowered."""
FAR = 4e-3
"""How far colliders may stand off a mesh where they are cut back [m]."""
CELLS = 96
"""Cells along the longer side of what two objects share, seen from above, to find where they would meet."""
STEPS = 24
"""Contacts that are cut free, one after the other, while one object is lowered."""


@settings
class CloseConfig:
    tolerance: Annotated[float, Interval(gt=0, le=0.01)] = 5e-4
    """How far colliders may stand off the mesh where something touches, on each side, as a share of the smaller of the
    two sizes."""
    radius: Annotated[float, Interval(gt=0, le=0.5)] = 0.03
    """How far around such a place they are cut back, as a share of the same size."""
    clearance: Annotated[float, Interval(ge=0, le=0.01)] = 3.2e-4
    """Gap left below what is lowered [m], as in ``separate``."""


def close(scene: Scene, config: CloseConfig | None = None) -> tuple[Scene, Report]:
    """Cut the colliders free under every object that nowhere touches what it rests on, and lower it.

    An object touches where, at one contact, the colliders of both sides stand off the meshes less than
    ``tolerance``. Others are lowered, with all they carry, until colliders meet; those are cut back there, and so on
    until meshes meet. What is left to tilt or roll is for physics.
    """
    config = config or CloseConfig()
    layout = _Layout(scene, config)
    for id in supports_first({o.id: o.supported_by for o in scene}):
        layout.lower(id)
    moved = scene.with_objects(*(layout.object(o.id) for o in scene))
    measures = [Measure(name="lowered", after=1000 * layout.drop[o.id], unit="mm", about=o.id) for o in scene]
    measures += [
        Measure(name="convex parts", before=len(o.parts), after=len(moved[o.id].parts), about=o.id) for o in scene
    ]
    return moved, Report(stage="close", measures=tuple(measures))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Meeting:
    """Where one mesh is nearest above another, or the ground: the vertical gap [m] and both points (3,)."""

    gap: float
    other: int
    above: Array
    below: Array


def _first_contact(upper: SceneObject, lower: SceneObject) -> _Meeting | None:
    """Where a mesh would first meet another one below it; None where neither is over the other."""
    low = np.maximum(upper.bounds_world[0], lower.bounds_world[0])[:2]
    high = np.minimum(upper.bounds_world[1], lower.bounds_world[1])[:2]
    if (high <= low).any() or upper.bounds_world[0, 2] > lower.bounds_world[1, 2] + FAR:
        return None
    found = None
    for _ in range(2):
        grid = heights.Grid.over(low, high, float((high - low).max()) / CELLS)
        above = heights.lower(upper.vertices_world, _over(upper, low, high), grid)
        below = heights.upper(lower.vertices_world, _over(lower, low, high), grid)
        gap = above - below
        if not np.isfinite(gap).any():
            break
        k = int(np.nanargmin(gap))
        row, column = divmod(k, grid.columns)
        at = np.array(grid.origin) + grid.cell * (np.array([column, row]) + 0.5)
        found = _Meeting(gap=float(gap.flat[k]), other=lower.id, above=np.append(at, above.flat[k]), below=np.append(at, below.flat[k]))
        low, high = at - 2 * grid.cell, at + 2 * grid.cell
    return found


def _over(o: SceneObject, low: Array, high: Array) -> NDArray[np.int32]:
    """Its triangles over a rectangle of the xy plane."""
    corners = o.vertices_world[:, :2][o.mesh.faces]
    return o.mesh.faces[((corners.min(1) <= high) & (corners.max(1) >= low)).all(1)]


class _Layout:
    """Objects while they are lowered and their parts cut back: polytopes in the world."""

    def __init__(self, scene: Scene, config: CloseConfig) -> None:
        self.scene, self.config = scene, config
        self.parts = {o.id: o.parts for o in scene}
        self.footing = {o.id: o.footing for o in scene}
        self.bodies = {o.id: _polytopes(o, o.solids) for o in scene}
        self.drop = {o.id: 0.0 for o in scene}
        self._surfaces: dict[int, Surface] = {}

    def object(self, id: int) -> SceneObject:
        o = replace(self.scene[id], parts=self.parts[id], footing=self.footing[id])
        if not self.drop[id]:
            return o
        return o.moved(pose(t=-self.drop[id] * UP), stage="close", reason="lowered onto what it rests on")

    def lower(self, id: int) -> None:
        """Lower an object with all it carries until its mesh meets another one, or nothing more can be cut back."""
        meeting = self._meeting(id)
        size = min(self.scene[k].size for k in (id, meeting.other) if k != GROUND)
        if meeting.gap <= self.config.clearance + 2 * self.config.tolerance * size:
            return
        members = self.scene.subtree(id)
        start = self.drop[id]
        near = self._near(id, meeting.other)
        self._cut(id, meeting.above, -UP, near)
        if meeting.other != GROUND:
            self._cut(meeting.other, meeting.below, UP, near)
        for _ in range(STEPS):
            self._move(members, self._room(members))
            left = meeting.gap - (self.drop[id] - start)
            if left <= 2 * near.tolerance or not self._cut_free(members, left):
                break
        self._move(members, self._room(members) - self.config.clearance)

    def _meeting(self, id: int) -> _Meeting:
        """Where an object would first meet what is below it, were it lowered."""
        o = self.object(id)
        lowest = o.vertices_world[int(o.vertices_world[:, 2].argmin())]
        best = _Meeting(gap=float(lowest[2]), other=GROUND, above=lowest, below=lowest * [1, 1, 0])
        for other in self.scene:
            if other.id not in self.scene.subtree(id):
                found = _first_contact(o, self.object(other.id))
                if found and found.gap < best.gap:
                    best = found
        return best

    def _cut(self, id: int, point: Array, outward: Array, near: Near) -> None:
        o = self.object(id)
        T = np.linalg.inv(o.T_world_asset)
        place = trim.place_on(
            self._surface(id), self.parts[id], transform(T, point[None])[0], o.scale * T[:3, :3] @ outward
        )
        self._trim_asset(id, place, near)
        o = self.object(id)
        self.bodies[id] = _polytopes(o, o.solids)

    def _room(self, members: tuple[int, ...]) -> float:
        mine = [p for k in members for p in self.bodies[k]]
        others = [p for k in self.bodies if k not in members for p in self.bodies[k]]
        lowest = min(float(p.bounds[0, 2]) for p in mine)
        return min(lowest, contact.free_travel(mine, others, -UP)) if others else lowest

    def _move(self, members: tuple[int, ...], drop: float) -> None:
        T = pose(t=-drop * UP)
        for k in members:
            self.bodies[k] = tuple(p.moved(T) for p in self.bodies[k])
            self.drop[k] += drop

    def _shave(self, id: int, normal: Array, point: Array, height: float) -> None:
        """Cut a layer off the underside of an object's footing, where it lies on a plane."""
        o = self.object(id)
        T = np.linalg.inv(o.T_world_asset)
        n = -o.T_world_object[:3, :3].T @ normal
        offset = float(n @ transform(T, point[None])[0]) - height / o.scale
        cut = [trim.less(p, n, offset, o.mesh.diagonal) for p in o.footing]
        self.footing[id] = tuple(p for p in cut if p is not None)

    def _on_footing(self, id: int, x: Array) -> bool:
        n = len(self.footing[id])
        return any(float((p.normals @ x - p.offsets).max()) < 2 * TOUCHING for p in self.bodies[id][len(self.bodies[id]) - n:]) if n else False

    def _cut_free(self, members: tuple[int, ...], left: float) -> bool:
        """Cut back what meets under an object; whether anything was."""
        found = find_contacts(self.bodies, reach=TOUCHING)
        was = dict(self.parts)
        footings = dict(self.footing)
        for a, b, x, n in zip(found.upper.tolist(), found.lower.tolist(), found.points, found.normals, strict=True):
            if (a in members) == (b in members):
                continue
            near = self._near(a, b)
            if a in members and self._on_footing(a, x) and self.footing[a] is footings[a] and not self._holds(a, x, near):
                self._shave(a, n, x, left * n[2])
            for i in (a, b):
                if (place := self._place(i, x)) and place.off > near.tolerance:
                    self._trim(i, place, near)
        for id, parts in self.parts.items():
            if parts is not was[id] or self.footing[id] is not footings[id]:
                o = self.object(id)
                self.bodies[id] = _polytopes(o, o.solids)
        return any(parts is not was[id] or self.footing[id] is not footings[id] for id, parts in self.parts.items())

    def _holds(self, id: int, x: Array, near: Near) -> bool:
        """Whether the mesh itself is near a point (3,)."""
        place = self._place(id, x)
        return place is not None and float(np.linalg.norm(place.point - x)) <= near.tolerance

    def _trim(self, id: int, place: Place, near: Near) -> None:
        scale = self.scene[id].scale
        T = np.linalg.inv(self.object(id).T_world_asset)
        place = Place(
            point=transform(T, place.point[None])[0], outward=scale * T[:3, :3] @ place.outward, off=place.off / scale
        )
        self._trim_asset(id, place, near)

    def _trim_asset(self, id: int, place: Place, near: Near) -> None:
        scale = self.scene[id].scale
        near = Near(tolerance=near.tolerance / scale, radius=near.radius / scale)
        parts = trim.trimmed(self._surface(id), self.parts[id], place, near)
        if any(a is not b for a, b in zip(parts, self.parts[id], strict=False)):
            self.parts[id] = parts

    def _place(self, id: int, x: Array) -> Place | None:
        """Of the mesh nearest to a point (3,) in the world."""
        if id == GROUND or not self.parts[id]:
            return None
        o = self.object(id)
        T, T_inv = o.T_world_asset, np.linalg.inv(o.T_world_asset)
        place = trim.place_at(self._surface(id), self.parts[id], transform(T_inv, x[None])[0], reach=FAR / o.scale)
        if place is None:
            return None
        return Place(
            point=transform(T, place.point[None])[0],
            outward=o.T_world_object[:3, :3] @ place.outward,
            off=place.off * o.scale,
        )

    def _near(self, a: int, b: int) -> Near:
        size = min(self.scene[k].size for k in (a, b) if k != GROUND)
        return Near(tolerance=self.config.tolerance * size, radius=self.config.radius * size)

    def _surface(self, id: int) -> Surface:
        if id not in self._surfaces:
            self._surfaces[id] = Surface.of(self.scene[id].mesh)
        return self._surfaces[id]


def _polytopes(o: SceneObject, parts: tuple) -> tuple[Polytope, ...]:
    return tuple(Polytope.of(p).moved(o.T_world_asset) for p in parts)
