"""Footings: convex wedges under an underside that hold an object in the pose of the photo.

No photo shows an underside, so a generated one is a guess, commonly turned by some degrees against its body. Physics
would tip the object onto it, against the picture. A footing fills the space between the underside and the plane below
(docs: contact). It is collision geometry only; the mesh does not change. A round object that is balanced gets a foot: a
small flat under its centre of mass. Without, a facet of its proxy decides where it rests. Pushed, it can still roll.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.polytopes import Polytope
from f3sr.contact.stable_facets import stable_normals
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, transform
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import SceneObject
from f3sr.settings import constants
from f3sr.vision import height_map


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
    """Largest distance of the underside from that facet's plane."""
    min_area: float = 0.15
    """Area of a flat underside's outline from which on it gets a footing, else a foot, as a share of the object's seen
    from above. A ball has .07."""
    min_margin: float = 0.05
    """Least tilt [rad] at which an object on its footing falls."""
    cells: int = 48
    """Cells along the longer side of the underside's height map."""
    pieces: int = 8
    """Most pieces, one for every patch of the underside: a chair has four legs."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SupportPlane:
    """``normal . x = offset`` in the world, the normal upward."""

    normal: Array
    offset: float

    def heights(self, points: Array) -> Array:
        """Signed distance (n,) of points (n, 3) above the plane [m]."""
        return points @ self.normal - self.offset

    def below(self, points: Array, height: float) -> Array:
        """Points (n, 3) moved vertically until they are ``height`` above the plane."""
        z = (self.offset + height - points[:, :2] @ self.normal[:2]) / self.normal[2]
        return np.column_stack([points[:, :2], z])


GROUND_PLANE = SupportPlane(normal=np.array([0.0, 0.0, 1.0]), offset=0.0)
"""The ground z = 0."""


def footing(
    o: SceneObject, plane: SupportPlane, config: FootingConfig, *, below: float = 0.0
) -> tuple[ConvexPart, ...]:
    """Wedges (asset frame) that keep an object in its pose on a plane below it (world frame).

    They reach down to ``below`` [m] under its lowest point. There are none for an object that needs none, is round,
    would fall anyway, or would need more than ``max_height``.
    """
    hull = _hull_of(o)
    if hull is None:
        return ()
    underside = _Underside.of(o, hull, plane, config)
    if underside is None:
        return ()
    lowest = float(plane.heights(hull.vertices).min()) - below
    if underside.share >= config.min_area:
        wedges = _under_a_flat(o, underside, plane, lowest, config)
    else:
        wedges = _under_a_round(o, hull, plane, lowest, config)
    T_asset_world: Array = np.linalg.inv(o.T_world_asset).astype(np.float64)
    return tuple(wedge.moved(T_asset_world) for wedge in wedges)


def _under_a_flat(
    o: SceneObject, underside: _Underside, plane: SupportPlane, lowest: float, config: FootingConfig
) -> list[ConvexPart]:
    """A wedge (world) under every patch of a nearly flat underside that carries the object."""
    missing = plane.heights(underside.corners) - lowest
    if not len(missing) or missing.mean() > config.max_height * o.size or missing.max() <= GRAIN * o.size:
        return []
    if not underside.carries(plane, lowest, config):
        return []
    return [_wedge(patch, underside.facet, plane, lowest, o) for patch in underside.patches(config.pieces)]


def _under_a_round(
    o: SceneObject, hull: ConvexPart, plane: SupportPlane, lowest: float, config: FootingConfig
) -> list[ConvexPart]:
    """A foot (world) under the centre of mass of an object that is balanced on a round underside.

    It is as small as ``min_margin`` allows."""
    center = _center_of(o)
    foot = plane.below(center[None], lowest)[0]
    angles = np.arange(SIDES) * 2 * np.pi / SIDES
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(SIDES)])
    radius = FOOT * np.tan(config.min_margin) * float(center[2] - foot[2])
    bottom = plane.below(foot + radius * circle, lowest)
    top = _lower_side(hull, bottom)
    if top is None or (top - bottom[:, 2]).max() > config.flat * o.size:
        return []
    return [_raised(bottom, np.column_stack([bottom[:, :2], top]), o)]


def _lower_side(hull: ConvexPart, points: Array) -> Array | None:
    """Heights (n,) of the underside of a hull over or under points (n, 3); None where one is beside it."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    offsets = np.einsum("ij,ij->i", normals, a)

    def heights(side: NDArray[np.bool_]) -> Array:
        return (offsets[side] - points[:, :2] @ normals[side, :2].T) / normals[side, 2]

    low, high = heights(normals[:, 2] < 0).max(1), heights(normals[:, 2] > 0).min(1)
    return low if (low < high).all() else None


def supplied(o: SceneObject) -> float:
    """Height [m] that the footing of an object supplies below the lowest point of its mesh; 0 without one."""
    lowest = min((float(p.moved(o.T_world_asset).vertices[:, 2].min()) for p in o.footing), default=np.inf)
    return max(0.0, float(o.vertices_world[:, 2].min()) - lowest)


def flush(o: SceneObject, plane: SupportPlane) -> tuple[ConvexPart, ...]:
    """The parts of an object (asset frame), cut at the mesh's lowest point along the plane's normal.

    Below that point they cover nothing. Without them the object rests on its footing alone."""
    lowest = float(plane.heights(o.vertices_world).min())
    # World plane to asset frame: x_world = R (scale x) + t, so n' = R' n and the offset loses n . t and the scale.
    normal = plane.normal @ o.T_world_object[:3, :3]
    offset = (plane.offset + lowest - float(plane.normal @ o.T_world_object[:3, 3])) / o.scale
    return tuple(_above(part, normal, offset) for part in o.parts)


def _above(part: ConvexPart, normal: Array, offset: float) -> ConvexPart:
    try:
        return part.above(normal, offset)
    except ValueError:  # hardly a volume is left
        return part


def _wedge(outline: Array, facet: SupportPlane, plane: SupportPlane, lowest: float, o: SceneObject) -> ConvexPart:
    """The wedge inside an outline (k, 3), from ``lowest`` above the plane up to the facet under the body."""
    bottom, top = plane.below(outline, lowest), facet.below(outline, 0.0)
    # Where the facet dips below the wedge's bottom, the wedge keeps a height.
    top[:, 2] = np.maximum(top[:, 2], bottom[:, 2])
    return _raised(bottom, top, o)


def _raised(bottom: Array, top: Array, o: SceneObject) -> ConvexPart:
    """The hull of a wedge's corners, both (k, 3), raised into the object by ``THICK``: engines lose thin hulls.

    Where the object is thinner, the wedge is raised by ``GRAIN`` only, so that it has a volume."""
    T_asset_world: Array = np.linalg.inv(o.T_world_asset).astype(np.float64)
    heights = (o.size * share * UP for share in (THICK, THICK / 2))
    all_over = np.concatenate([top, (top + top.mean(0)) / 2, top.mean(0, keepdims=True)])  # bowls are thin inside
    inside = (top + h for h in heights if _are_inside(o.colliders, transform(T_asset_world, all_over + h)))
    return ConvexPart.hull_of(np.concatenate([next(inside, top + GRAIN * o.size * UP), bottom]))


def _are_inside(parts: Sequence[ConvexPart], points: Array) -> bool:
    """Whether every one of points (n, 3) lies in some part, in its frame."""
    facets = map(Polytope.of, parts)
    return bool(np.any([(points @ f.normals.T <= f.offsets).all(1) for f in facets], axis=0).all())


def _center_of(o: SceneObject) -> Array:
    """Its centre of mass (3,) in the world."""
    return transform(o.T_world_object, body_of(o).center[None])[0]


def support_plane(o: SceneObject, tops: Sequence[ConvexPart], config: FootingConfig) -> SupportPlane | None:
    """The plane on which a flat underside of ``o`` would come to rest on ``tops`` (convex parts, world frame).

    It is a facet of the hull of their upper surfaces under the object's outline: the one under its centre of mass. None
    if there is none or it is steep."""
    hull = _hull_of(o)
    underside = _Underside.of(o, hull, GROUND_PLANE, config) if hull else None
    if underside is None or not tops:
        return None
    vertices = np.concatenate([p.vertices for p in tops])
    starts = np.cumsum([0, *(len(p.vertices) for p in tops)])
    faces = np.concatenate([p.faces + start for p, start in zip(tops, starts, strict=False)])
    top = height_map.upper(vertices, faces, underside.grid)
    try:
        tops_hull = ConvexPart.hull_of(underside.grid.points(np.where(underside.cells, top, np.nan)))
    except ValueError:
        return None
    return _facet_above(tops_hull, underside.center, config)


def _hull_of(o: SceneObject) -> ConvexPart | None:
    """The hull of the mesh in the world; None for a sheet."""
    try:
        return o.mesh.hull.moved(o.T_world_asset)
    except ValueError:
        return None


def _facet_above(hull: ConvexPart, center: Array, config: FootingConfig) -> SupportPlane | None:
    """The upper facet of a hull that a vertical line through ``center`` meets."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    met = normals[:, 2] > np.cos(config.max_turn)
    # Inside the triangle seen from above: to the left of its three edges, which run counter-clockwise.
    for p, q in ((a, b), (b, c), (c, a)):
        met &= (q - p)[:, 0] * (center[1] - p[:, 1]) - (q - p)[:, 1] * (center[0] - p[:, 0]) >= 0
    if not met.any():
        return None
    k = int(np.argmax(met))
    return SupportPlane(normal=normals[k], offset=float(normals[k] @ a[k]))


def _facet_below(hull: ConvexPart, center: Array, plane: SupportPlane, config: FootingConfig) -> SupportPlane | None:
    """The plane (upward normal) of the facet that the body would fall onto: its nearest stable facet.

    Where that is far, as for a tall body with a bulging underside, it is the mean of all facets that face down. None
    where none does."""
    near = np.cos(config.max_turn)
    stable = -stable_normals(hull, center)
    if len(stable) and (stable @ plane.normal).max() >= near:
        normal = stable[int(np.argmax(stable @ plane.normal))]
    else:
        a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
        # Inward normals as long as twice the area: those of facets that face down point up.
        areas = -np.cross(b - a, c - a)
        lengths = np.linalg.norm(areas, axis=1)
        normal = areas[areas @ plane.normal >= near * lengths].sum(0)
        if not normal.any():
            return None
        normal /= np.linalg.norm(normal)
    return SupportPlane(normal=normal, offset=float((hull.vertices @ normal).min()))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Underside:
    """What of a body lies on the facet it would fall onto, in the cells of a height map from below."""

    facet: SupportPlane
    grid: height_map.Grid
    cells: NDArray[np.bool_]
    """Which cells (rows, columns) belong to it."""
    corners: Array
    """Their corners (4 n, 3) in the world."""
    patch: NDArray[np.int64]
    """To which connected patch each corner belongs (4 n,), from 1."""
    center: Array
    """The body's centre of mass (3,)."""
    outline: _Outline
    """Of the whole body."""

    @classmethod
    def of(cls, o: SceneObject, hull: ConvexPart, plane: SupportPlane, config: FootingConfig) -> _Underside | None:
        """The underside of ``o``, whose ``hull`` is in the world; None where no stable facet is near, or of a body that
        is a line from above."""
        from scipy.ndimage import label

        center = _center_of(o)
        facet, outline = _facet_below(hull, center, plane, config), _Outline.of(hull.vertices)
        if facet is None or outline is None:
            return None
        low, high = o.bounds_world
        grid = height_map.Grid.over(low, high, float((high - low)[:2].max()) / config.cells)
        z = height_map.lower(o.vertices_world, o.mesh.faces, grid)
        points = grid.points(z)
        on_it = facet.heights(points) <= config.flat * o.size
        # Points come in the order of the finite cells, so a mask assigns them back.
        cells = np.isfinite(z)
        cells[cells] = on_it
        patches, _ = cast(tuple[NDArray[np.int64], int], label(cells, np.ones((3, 3))))
        half = 0.5 * grid.cell * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return cls(
            facet=facet,
            grid=grid,
            cells=cells,
            corners=(points[on_it, None] + half).reshape(-1, 3),
            patch=np.repeat(patches[cells], len(half)),
            center=center,
            outline=outline,
        )

    def carries(self, plane: SupportPlane, lowest: float, config: FootingConfig) -> bool:
        """Whether the body stands on it, were all of it ``lowest`` above the plane."""
        outline = _Outline.of(self.corners)
        if outline is None:
            return False
        height = float(self.center[2] - plane.below(self.center[None], lowest)[0, 2])
        # A body tips over an edge at the tilt whose tangent is (distance to the edge) / (height of the centre).
        return outline.depth(self.center) >= np.tan(config.min_margin) * height

    @property
    def share(self) -> float:
        """Area of its outline over that of the whole body's, seen from above."""
        outline = _Outline.of(self.corners)
        return outline.area / self.outline.area if outline else 0.0

    def patches(self, most: int) -> list[Array]:
        """The outermost points (k, 3) of every patch, the largest ``most`` of them."""
        sizes = np.bincount(self.patch)
        largest = np.argsort(-sizes, kind="stable")[:most]
        return [_outermost(self.corners[self.patch == k]) for k in sorted(largest) if sizes[k]]


def _outermost(points: Array) -> Array:
    """Those of points (n, 3) that reach farthest in one of ``SIDES`` horizontal directions."""
    angles = np.arange(SIDES) * 2 * np.pi / SIDES
    # (n, SIDES): how far each point reaches in each direction.
    reach = points[:, :2] @ np.array([np.cos(angles), np.sin(angles)])
    return points[np.unique(reach.argmax(0))]


GRAIN = 1e-3
"""Unevenness of an underside, as a share of the object's size, up to which it needs no footing."""
FOOT = 1.5
"""Radius of a round object's foot, in radii that give it the least margin."""
THICK = 0.02
"""Thickness of a footing inside its object, as a share of its size: 2 mm of a thing of 10 cm."""
SIDES = 16
"""Corners of a footing's outline: contacts cost with them, and a circle's outline is within 2 % of its radius."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Outline:
    """The convex outline of points seen from above: unit outward normals (k, 2), offsets (k,), area [m2]."""

    normals: Array
    offsets: Array
    area: float

    @classmethod
    def of(cls, points: Array) -> _Outline | None:
        """None when the points lie on a line, seen from above."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            hull = ConvexHull(points[:, :2])
        except (QhullError, ValueError):
            return None
        return cls(normals=hull.equations[:, :2], offsets=-hull.equations[:, 2], area=float(hull.volume))

    def depth(self, point: Array) -> float:
        """How far inside the outline a point (3,) lies [m]; negative outside."""
        return float((self.offsets - self.normals @ point[:2]).min())
