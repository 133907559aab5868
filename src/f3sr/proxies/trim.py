"""Convex parts cut back to the mesh they cover, near points at which they are touched.

A part stands off its mesh in two ways. Where the mesh bulges, a polytope of few facets has corners: they are cut off
by planes of the hull of what the part holds of the mesh. Where the mesh is hollow, that hull itself bridges it: the
part is split there by planes through the surface, and each side is cut back. What a part holds of the mesh is clipped
exactly, so what was covered stays covered.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart, Mesh, places
from f3sr.core.transforms import Array, bounds_of, cross
from f3sr.proxies.cuts import OVERLAP, below
from f3sr.proxies.hulls import qhull_of
from f3sr.proxies.simplify import corners_of, merged

SLACK = 1e-9
"""What lies this far outside a part still counts as held by it [size of the mesh]."""
LEAST = 1e-8
"""Least volume of a part after cutting [size of the mesh, cubed]: MuJoCo rejects 1e-15 m3, and objects may have 5 mm.

Parts of real scenes are larger than 4e-8; smaller ones are rounding."""
DEPTHS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Where between the surface and the end of all parts it is looked for parts that stand in the way."""
TURNS = 6
"""Planes through a place that are tried for a split, at even angles."""
SPLITS = 2
"""Splits one after the other at a place: across a hollow and along it."""
MOST_CUTS = 16
"""Facets that one part gets at one place at most."""
PASSED = 20
"""Parts passed on the way out of all of them at most."""

Planes = tuple[Array, Array]
"""Outward unit normals (m, 3) and offsets (m,)."""


@dataclass(frozen=True, kw_only=True)
class Near:
    """Allowed stand-off of parts from their mesh within ``radius`` of a contact place.

    The place on the mesh is at most ``reach`` away from the contact."""

    tolerance: float
    radius: float
    reach: float

    def scaled(self, scale: float) -> Near:
        """The same in another unit."""
        return Near(tolerance=scale * self.tolerance, radius=scale * self.radius, reach=scale * self.reach)


@dataclass(frozen=True, eq=False, kw_only=True)
class Place:
    """A touched point (3,) of a mesh's surface, the unit direction (3,) of the contact, and the parts' reach along
    it."""

    point: Array
    outward: Array
    off: float


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshSurface:
    """A mesh's triangles (n, 3, 3) with their boxes (n, 3) and its size, and what parts hold of it, once that is
    known."""

    triangles: Array
    low: Array
    high: Array
    size: float
    held: WeakKeyDictionary[ConvexPart, _Held]

    @classmethod
    def of(cls, mesh: Mesh) -> MeshSurface:
        triangles = mesh.vertices[mesh.faces]
        return cls(
            triangles=triangles,
            low=triangles.min(1),
            high=triangles.max(1),
            size=mesh.diagonal,
            held=WeakKeyDictionary(),
        )

    def around(self, low: Array, high: Array) -> Array:
        """Triangles whose boxes reach into a box."""
        return self.triangles[((self.low <= high) & (self.high >= low)).all(1)]

    def nearest(self, x: Array, reach: float) -> Array | None:
        """Its point (3,) nearest to x (3,); None where that is farther than ``reach``."""
        a, b, c = np.moveaxis(self.around(x - reach, x + reach), 1, 0)
        sides = ((a, b), (b, c), (c, a))
        points = np.concatenate([_on_planes(a, b, c, x), *(_on_segments(start, end, x) for start, end in sides)])
        distances = np.linalg.norm(points - x, axis=1)
        return points[int(distances.argmin())] if distances.min(initial=np.inf) <= reach else None


def place_near(surface: MeshSurface, parts: Sequence[ConvexPart], x: Array, near: Near) -> Place | None:
    """The place of a surface nearest to a point (3,) off it; None if none is within reach or the point is on it."""
    y = surface.nearest(x, near.reach)
    if y is None or (length := float(np.linalg.norm(x - y))) <= SLACK * surface.size:
        return None
    return place_on(surface, parts, y, (x - y) / length)


def place_on(surface: MeshSurface, parts: Sequence[ConvexPart], point: Array, outward: Array) -> Place:
    """A point (3,) of a surface as a place, touched from a direction (3,)."""
    off = _way_out([Polytope.of(p) for p in parts], point, outward, SLACK * surface.size)
    return Place(point=point, outward=outward, off=off)


def trimmed(
    surface: MeshSurface, parts: Sequence[ConvexPart], place: Place, near: Near, *, most: int
) -> tuple[ConvexPart, ...]:
    """The parts, cut back or split where their stand-off at a place exceeds the allowed one.

    Unchanged parts are the same values. Together they cover all of the mesh that they covered before. What would have
    to be split into more than ``most`` parts in all stays; crumpled meshes would ask for it at every contact."""
    now, added = list(parts), list[ConvexPart]()
    for k, part in enumerate(parts):
        if (spot := _in_the_way(part, place, near.tolerance, SLACK * surface.size)) is None:
            continue
        if part not in surface.held:
            around = surface.around(*bounds_of(part.vertices))
            surface.held[part] = _Held.of(part, around, surface.size)
        room = most - len(now) - len(added)
        left = _trimmed(surface.held[part], place, spot, near, SPLITS if room > 0 else 0)
        if len(left) - 1 > max(room, 0):
            continue
        surface.held.update({h.part: h for h in left})
        now[k] = left[0].part
        added += [h.part for h in left[1:]]
    return (*now, *added)


def less(part: ConvexPart, normal: Array, offset: float, size: float) -> ConvexPart | None:
    """What of a part is below a plane; None where that is hardly a volume. ``size``: that of the mesh."""
    left = below(part.vertices[part.faces], normal, offset).reshape(-1, 3)
    if not len(left):
        return None
    facets, inside = Polytope.of(part), places(left)[0].mean(0)
    corners = corners_of(np.vstack([facets.normals, normal]), np.append(facets.offsets, offset), part, inside)
    try:
        smaller = None if corners is None else ConvexPart.hull_of(merged(corners, SLACK * size))
    except ValueError:
        return None
    return smaller if smaller is not None and smaller.volume >= LEAST * size**3 else None


def _way_out(parts: Sequence[Polytope], start: Array, direction: Array, slack: float) -> float:
    """How far from ``start`` along a direction the parts reach without a gap."""
    t = 0.0
    for _ in range(PASSED):
        at, farthest = start + t * direction, t
        for part in parts:
            room = part.offsets - part.normals @ at
            if (room >= -slack).all():
                speed = part.normals @ direction
                farthest = max(farthest, t + float((room[speed > 0] / speed[speed > 0]).min(initial=np.inf)))
        if farthest <= t + slack:
            break
        t = farthest
    return t


def _in_the_way(part: ConvexPart, place: Place, tolerance: float, slack: float) -> Array | None:
    """The outermost of some points (3,) over the place, farther off than the tolerance, that a part holds."""
    if place.off <= tolerance:
        return None
    depths = tolerance + (place.off - tolerance) * np.array(DEPTHS)
    points = place.point + depths[:, None] * place.outward
    facets = Polytope.of(part)
    held = np.flatnonzero((points @ facets.normals.T - facets.offsets).max(1) <= slack)
    return points[held[-1]] if len(held) else None


@dataclass(frozen=True, eq=False, kw_only=True)
class _Held:
    """A part, what it holds of the mesh (n, 3, 3), the corners of that (k, 3), and its hull's planes, None for a
    sheet."""

    part: ConvexPart
    triangles: Array
    corners: Array
    hull: Planes | None
    size: float

    @classmethod
    def of(cls, part: ConvexPart, triangles: Array, size: float) -> _Held:
        facets = Polytope.of(part)
        return cls.holding(part, _clipped(triangles, facets.normals, facets.offsets + SLACK * size), size)

    @classmethod
    def holding(cls, part: ConvexPart, held: Array, size: float) -> _Held:
        corners, _ = places(held.reshape(-1, 3))
        return cls(part=part, triangles=held, corners=corners, hull=_hull_planes(corners), size=size)

    def worst(self, points: Array) -> tuple[float, tuple[Array, float]] | None:
        """Distance of the worst of some points (n, 3) outside the hull of the covered points, and the plane it is
        beyond."""
        if self.hull is None or not len(points):
            return None
        normals, offsets = self.hull
        beyond = points @ normals.T - offsets
        plane = int(beyond.argmax()) % len(offsets)
        return float(beyond.max()), (normals[plane], float(offsets[plane]))

    def cut(self, normal: Array, offset: float) -> _Held | None:
        """The part below a plane above which nothing of the mesh is; None where too little would be left."""
        part = less(self.part, normal, offset, self.size)
        return None if part is None else replace(self, part=part)

    def half(self, normal: Array, offset: float) -> _Held | None:
        """What is below a plane; None where that is too little."""
        part = less(self.part, normal, offset, self.size)
        if part is None:
            return None
        return self.holding(part, below(self.triangles, normal, offset + SLACK * self.size), self.size)


def _trimmed(held: _Held, place: Place, spot: Array, near: Near, splits: int) -> list[_Held]:
    """A part cut back near a place, of which it holds ``spot`` (3,); split first where it bridges a hollow."""
    worst = held.worst(spot[None])
    if worst is not None and worst[0] >= near.tolerance / 2:
        return [_cut_back(held, spot, near)]
    halves = _best_split(held, place, spot) if splits else None
    if halves is None:
        return [held]
    return [h for half in halves for h in _trimmed(half, place, spot, near, splits - 1)]


def _cut_back(held: _Held, spot: Array, near: Near) -> _Held:
    """A spot cut off, then the corners near it, the farthest first, until all stand out less than allowed."""
    worst = held.worst(spot[None])
    for _ in range(MOST_CUTS):
        smaller = held.cut(*worst[1]) if worst else None
        if smaller is None:
            break
        held, corners = smaller, smaller.part.vertices
        worst = held.worst(corners[np.linalg.norm(corners - spot, axis=1) <= near.radius])
        if worst is None or worst[0] <= near.tolerance:
            break
    return held


def _best_split(held: _Held, place: Place, spot: Array) -> tuple[_Held, _Held] | None:
    """The halves by a plane through the place along its outward direction.

    The plane leaves the place farthest outside the hulls of both sides; None if it stays inside for all."""
    looks = [(_left_outside(held.corners, w, place.point, spot), k, w) for k, w in enumerate(_across(place.outward))]
    outside, _, w = max(looks)
    if outside <= SLACK * held.size:
        return None
    offset, overlap = float(w @ place.point), OVERLAP * held.size
    first, second = held.half(w, offset + overlap), held.half(-w, overlap - offset)
    return None if first is None or second is None else (first, second)


def _left_outside(points: Array, w: Array, at: Array, spot: Array) -> float:
    """How far a spot lies outside the hulls of points (n, 3) to either side of a plane through ``at``, added up."""
    height = (points - at) @ w
    total = 0.0
    for side in (points[height <= 0], points[height >= 0]):
        planes = _hull_planes(np.vstack([side, at]))
        if planes is not None:
            total += max(0.0, float((planes[0] @ spot - planes[1]).max()))
    return total


def _across(direction: Array) -> Iterator[Array]:
    """Unit vectors across a direction, at even angles."""
    u = cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    u /= np.linalg.norm(u)
    v = cross(direction, u)
    for angle in np.pi * np.arange(TURNS) / TURNS:
        yield np.cos(angle) * u + np.sin(angle) * v


def _clipped(triangles: Array, normals: Array, offsets: Array) -> Array:
    """The parts of triangles (n, 3, 3) below all planes."""
    over = (triangles.reshape(-1, 3) @ normals.T > offsets).reshape(len(triangles), -1)
    inside = ~over.any(1)
    whole, others, over = triangles[inside], triangles[~inside], over[~inside].reshape(-1, 3, len(offsets))
    outside, crossed = (over[:, 0] & over[:, 1] & over[:, 2]).any(1), over.any((0, 1))
    crossing = others[~outside]
    for u, offset in zip(normals[crossed], offsets[crossed], strict=True):
        crossing = below(crossing, u, float(offset))
    return np.concatenate([whole, crossing])


def _hull_planes(points: Array) -> Planes | None:
    """Planes of the hull of points (n, 3); None where they span no volume."""
    hull = qhull_of(points)
    return None if hull is None else (hull.equations[:, :3], -hull.equations[:, 3])


def _on_planes(a: Array, b: Array, c: Array, x: Array) -> Array:
    """The feet (k, 3) of x on the planes of triangles, of those in which they fall."""
    normal = cross(b - a, c - a)
    inside = np.einsum("ij,ij->i", normal, normal) > 0
    for start, end in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", cross(end - start, x - start), normal) >= 0
    a, normal = a[inside], normal[inside]
    t = np.einsum("ij,ij->i", normal, x - a) / np.einsum("ij,ij->i", normal, normal)
    return x - t[:, None] * normal


def _on_segments(start: Array, end: Array, x: Array) -> Array:
    """The points (k, 3) of segments nearest to x."""
    along = end - start
    t = np.einsum("ij,ij->i", x - start, along) / np.maximum(np.einsum("ij,ij->i", along, along), np.finfo(float).tiny)
    return start + np.clip(t, 0, 1)[:, None] * along
