"""Undersides of bodies: what of a body may carry it on a plane below, and how much of it that is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Self, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.stable_facets import stable_normals
from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array, transform
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import SceneObject
from f3sr.settings import constants
from f3sr.vision import height_map

GRAIN = 1e-3
"""Unevenness of an underside, as a share of the object's size, up to which it needs no footing."""
SIDES = 16
"""Corners of a footing's outline: contacts cost with them, and a circle's outline is within 2 % of its radius."""
HALVINGS = 6
"""Halvings of the height at which a round underside is cut: they find it to 2 % of the largest."""


@constants
class FootingConfig:
    """Which undersides get a footing. Lengths are shares of the object's size."""

    enabled: bool = True
    """Fill in under undersides. Without, objects are laid down on them before physics."""
    max_turn: float = 0.22
    """Largest angle [rad] from the support to the facet an object would fall onto. Undersides are off by up to .21."""
    max_height: float = 0.03
    """Largest mean height of a footing: a higher one looks afloat."""
    flat: float = 0.01
    """Largest distance of an underside from that facet, and largest height up to which a round one is filled in."""
    min_area: float = 0.15
    """Least area of a flat underside's outline, as a share of the object's seen from above. A ball has .07."""
    min_margin: float = 0.05
    """Least tilt [rad] at which an object on its footing falls."""
    round_margin: float = 0.1
    """Least tilt [rad] at which a round object on its footing rolls. With .05, PhysX rolls two in 89 by 7 mm."""
    cells: int = 48
    """Cells along the longer side of the underside's height map."""
    pieces: int = 8
    """Most pieces, one for every patch of the underside: a chair has four legs."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SupportPlane:
    """``normal . x = offset`` in the world, the normal upward."""

    normal: Array
    offset: float
    tops: tuple[ConvexPart, ...] = ()
    """The convex parts whose upper hull it is a facet of; none for the ground."""

    def heights(self, points: Array) -> Array:
        """Signed distance (n,) of points (n, 3) above the plane [m]."""
        return points @ self.normal - self.offset

    def below(self, points: Array, height: float) -> Array:
        """Points (n, 3) moved vertically until they are ``height`` above the plane."""
        z = (self.offset + height - points[:, :2] @ self.normal[:2]) / self.normal[2]
        return np.column_stack([points[:, :2], z])


GROUND_PLANE = SupportPlane(normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
"""The ground z = 0."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StandingBody:
    """What decides whether a body stands, in the world: the hull of its mesh, and the centre of mass (3,) of it and all
    it carries."""

    hull: ConvexPart
    center: Array
    size: float
    flats: dict[tuple[bytes, FootingConfig], FlatUnderside | None] = field(default_factory=dict)
    """Undersides by the normals of their facets: most planes below lead to the same one."""

    @classmethod
    def of(cls, o: SceneObject, center: Array | None = None) -> StandingBody | None:
        """None for a sheet, whose mesh has no hull. By default it carries nothing."""
        whole = transform(o.T_world_object, body_of(o).center[None])[0] if center is None else center
        known = _STANDING.get(o)
        if known is None or not np.array_equal(known.center, whole):
            try:
                hull = o.mesh.hull.moved(o.T_world_asset)
            except ValueError:
                return None
            _STANDING[o] = known = cls(hull=hull, center=whole, size=o.size)
        return known

    @cached_property
    def stable_normals(self) -> Array:
        """Outward unit normals (k, 3) of the facets on which it would rest."""
        return stable_normals(self.hull, self.center)

    @cached_property
    def faces_down(self) -> Array:
        """Inward normals (m, 3) of the hull's triangles, twice as long as their areas: those that face down point
        up."""
        return -area_vectors(self.hull.vertices[self.hull.faces])

    @cached_property
    def outline(self) -> Outline | None:
        """That of the whole body."""
        return Outline.of(self.hull.vertices)

    def lowest(self, plane: SupportPlane) -> float:
        """Height [m] of the lowest point over a plane."""
        return float(plane.heights(self.hull.vertices).min())

    def stands_on(self, outline: Outline | None, plane: SupportPlane, lowest: float, margin: float) -> bool:
        """Whether it stands, even tilted by ``margin`` [rad], on an outline that is ``lowest`` [m] above the plane."""
        if outline is None:
            return False
        # A body tips over an edge at the tilt whose tangent is (distance to the edge) / (height of the centre).
        height = float(self.center[2] - plane.below(self.center[None], lowest)[0, 2])
        return outline.depth(self.center) >= np.tan(margin) * height

    def section(self, plane: SupportPlane, height: float) -> Array:
        """Where edges of the hull cross the plane ``height`` [m] above its lowest point: points (n, 3)."""
        heights = plane.heights(self.hull.vertices)
        heights -= heights.min() + height
        faces = self.hull.faces
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        # Every edge runs once in each direction: those upward are each edge once.
        a, b = edges[(heights[edges[:, 0]] < 0) & (heights[edges[:, 1]] >= 0)].T
        share = heights[a] / (heights[a] - heights[b])
        return self.hull.vertices[a] + share[:, None] * (self.hull.vertices[b] - self.hull.vertices[a])

    def round_underside(self, plane: SupportPlane, config: FootingConfig) -> float | None:
        """Height [m] of the lowest section on which the body stands; None where that is higher than ``flat``.

        A smooth body stands where its centre of mass is above its contact. Slopes and shapes are known to some degrees
        only. So the centre may be as far from it as the section reaches."""

        def stands(height: float) -> bool:
            return self.stands_on(Outline.of(self.section(plane, height)), plane, lowest, config.round_margin)

        lowest = self.lowest(plane)
        failed, stood = 0.0, config.flat * self.size
        if not stands(stood):
            return None
        for _ in range(HALVINGS):
            middle = (failed + stood) / 2
            failed, stood = (failed, middle) if stands(middle) else (middle, stood)
        return stood


_STANDING: WeakKeyDictionary[SceneObject, StandingBody] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False, kw_only=True)
class FlatUnderside:
    """What of a body lies on the facet it would fall onto, in the cells of a height map from below."""

    body: StandingBody
    facet: SupportPlane
    grid: height_map.Grid
    cells: NDArray[np.bool_]
    """Which cells (rows, columns) belong to it."""
    corners: Array
    """Their corners (4 n, 3) in the world."""
    patch: NDArray[np.int64]
    """To which connected patch each corner belongs (4 n,), from 1."""

    @classmethod
    def of(cls, o: SceneObject, body: StandingBody, plane: SupportPlane, config: FootingConfig) -> FlatUnderside | None:
        """The underside of ``o``; None where no stable facet is near, and where nothing is near the facet."""
        facet = _facet_below(body, plane, config)
        if facet is None:
            return None
        key = facet.normal.tobytes(), config
        if key not in body.flats:
            body.flats[key] = cls._on(o, body, facet, config)
        return body.flats[key]

    @classmethod
    def _on(
        cls, o: SceneObject, body: StandingBody, facet: SupportPlane, config: FootingConfig
    ) -> FlatUnderside | None:
        from scipy.ndimage import label

        low, high = o.bounds_world
        grid = height_map.Grid.over(low, high, float((high - low)[:2].max()) / config.cells)
        z = height_map.lower(o.vertices_world, o.mesh.faces, grid)
        points = grid.points(z)
        on_it = facet.heights(points) <= config.flat * body.size
        if not on_it.any():
            return None
        # Points come in the order of the finite cells, so a mask assigns them back.
        cells = np.isfinite(z)
        cells[cells] = on_it
        patches, _ = cast(tuple[NDArray[np.int64], int], label(cells, np.ones((3, 3))))
        half = 0.5 * grid.cell * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return cls(
            body=body,
            facet=facet,
            grid=grid,
            cells=cells,
            corners=(points[on_it, None] + half).reshape(-1, 3),
            patch=np.repeat(patches[cells], len(half)),
        )

    @cached_property
    def outline(self) -> Outline | None:
        """That of all cells: of the first and the last one in each row."""
        rows = np.nonzero(self.cells)[0]
        ends = np.flatnonzero(np.diff(rows, prepend=-1) | np.diff(rows, append=-1))
        return Outline.of(self.corners.reshape(len(rows), -1, 3)[ends].reshape(-1, 3))

    def carries(self, plane: SupportPlane, lowest: float, config: FootingConfig) -> bool:
        """Whether the body stands on it, were all of it ``lowest`` above the plane."""
        mine, whole = self.outline, self.body.outline
        wide = mine is not None and whole is not None and mine.area >= config.min_area * whole.area
        return wide and self.body.stands_on(mine, plane, lowest, config.min_margin)

    def patches(self, most: int) -> list[Array]:
        """The outermost points (k, 3) of every patch, the largest ``most`` of them."""
        sizes = np.bincount(self.patch)
        largest = np.argsort(-sizes, kind="stable")[:most]
        return [outermost(self.corners[self.patch == k]) for k in sorted(largest) if sizes[k]]


def _facet_below(body: StandingBody, plane: SupportPlane, config: FootingConfig) -> SupportPlane | None:
    """The plane (upward normal) of the facet that the body would fall onto: its nearest stable facet.

    Where that is far, as for a tall body with a bulging underside, it is the mean of all facets that face down. None
    where none does."""
    near, stable = np.cos(config.max_turn), -body.stable_normals
    along = stable @ plane.normal
    if len(stable) and along.max() >= near:
        normal = stable[int(np.argmax(along))]
    else:
        areas = body.faces_down
        lengths = np.linalg.norm(areas, axis=1)
        normal = areas[areas @ plane.normal >= near * lengths].sum(0)
        if not normal.any():
            return None
        normal /= np.linalg.norm(normal)
    return SupportPlane(normal=normal, offset=float((body.hull.vertices @ normal).min()))


def outermost(points: Array) -> Array:
    """Those of points (n, 3) that reach farthest in one of ``SIDES`` horizontal directions."""
    angles = np.arange(SIDES) * 2 * np.pi / SIDES
    # (n, SIDES): how far each point reaches in each direction.
    reach = points[:, :2] @ np.array([np.cos(angles), np.sin(angles)])
    return points[np.unique(reach.argmax(0))]


@dataclass(frozen=True, eq=False, kw_only=True)
class Outline:
    """The convex outline of points seen from above: corners (k, 2), unit outward normals (n, 2) and offsets (n,) of its
    sides, area [m2]."""

    corners: Array
    normals: Array
    offsets: Array
    area: float

    @classmethod
    def of(cls, points: Array) -> Self | None:
        """None when the points lie on a line, seen from above."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(points[:, :2])
        except (QhullError, ValueError):
            return None
        return cls(
            corners=points[hull.vertices, :2],
            normals=hull.equations[:, :2],
            offsets=-hull.equations[:, 2],
            area=float(hull.volume),
        )

    def depth(self, point: Array) -> float:
        """How far inside the outline a point (3,) lies [m]; negative outside."""
        return float((self.offsets - self.normals @ point[:2]).min())
