"""What can be touched of a mesh: samples of its surface, the space around it that a probe reaches, its solid core.

All in normalised units: the diagonal of the mesh's box is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import area_vectors
from f3sr.core.transforms import Array, cross
from f3sr.proxies.hulls import Hull

PROBE = 0.03
"""Radius [size] of the ball that must fit where something can touch a point. Slots, pores and corners that it does not
fit into may be bridged, closed voids as well."""
CELL = 0.01
"""Cells [size] of the grid on which open space is told from the inside."""
FLOOR_WEIGHT = 3.0
"""Weight of the excess at the floor of a cavity. What lies in a pan is smaller and floats by more of its own size."""
GRID_CELLS = 600_000
"""Most cells of the grid over a mesh's box: at a hundredth of the diagonal a cube has 200,000."""
DENSE_POINTS = 3_000_000
"""Most points that mark the surface in the grid; meshes folded into many layers get a coarser grid."""
CORE_STEP = 4
"""Every how many cells along each axis a point of the solid core is kept."""
CORE_DEPTH = 5.0
"""Cells that core points lie below the surface at least: moved onto a cut, up to half a step, they stay inside."""
STEEPEST = 0.25
"""Cosine between a sample's normal and a facet's up to which the facet is what covers the sample."""
NEAREST_POINTS = 30_000
"""Points on the surface whose triangles may be the nearest ones."""
NEAREST_FEW = 4
"""How many of them are tried."""
HULL_POINTS = 150
"""Points of a single hull's surface at which it is looked how far they lie off the mesh."""
CAVITY_DEPTH = 0.03
"""Depth below the hull of the mesh from which on surface belongs to a cavity [size]."""
CAVITY_SHARE = 0.03
"""Least share of the surface that makes a cavity."""
CAVITY_LEAN = 0.12
"""Least length of the mean normal of its surface: that of a hole through the mesh is 0, of a tall mug .15, of half a
sphere .5."""
FLOOR_POWER = 4
"""Of the cosine to the opening: surface turned by 45 degrees has a quarter of the weight."""
FACING_AWAY = 1e-6
"""Cosine between a sample's normal and a facet's below which the sample's own normal never meets the facet."""
FAR_AWAY = np.float32(1e9)
"""Depth [size] below facets that a sample's normal never meets: other facets are always nearer."""
STAND_OFF_BLOCK = 40_000
"""Pairs of sample and facet at a time: what fits into a processor's cache."""

Faces = NDArray[np.int32]
Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False, kw_only=True)
class Samples:
    """Points (n, 3) spread evenly over a surface, the normals (n, 3) and the numbers (n,) of their triangles."""

    points: Array
    normals: Array
    triangle: NDArray[np.int64]
    weight: Array
    """How many times a stand-off counts here (n,)."""

    def chosen(self, which: NDArray[np.bool_]) -> Samples:
        return Samples(
            points=self.points[which],
            normals=self.normals[which],
            triangle=self.triangle[which],
            weight=self.weight[which],
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Surroundings:
    """A grid over the mesh: the distance [cells] of each cell's centre from closed space, and the solid core.

    The core is given as points (n, 3)."""

    clearance: NDArray[np.float32]
    low: Array
    cell: float
    core: Array

    def is_reached(self, points: Array, normals: Array, probe: float) -> NDArray[np.bool_]:
        """Whether a ball of radius ``probe`` fits in open space where it touches a surface at points (n, 3)."""
        where = ((points + (probe + self.cell) * normals - self.low) / self.cell).astype(int)
        where = np.clip(where, 0, np.array(self.clearance.shape) - 1)
        return self.clearance[tuple(where.T)] * self.cell >= probe - self.cell


@dataclass(frozen=True, eq=False, kw_only=True)
class NearestTriangles:
    """The nearest triangles to points: those of the nearest few of many points on the surface.

    Of each triangle: its corners, edges, the squares of their lengths, its unit normal, and the directions in its plane
    from its edges to its inside."""

    corners: Array
    edges: Array
    squares: Array
    normals: Array
    inward: Array
    triangle: NDArray[np.int64]
    tree: Any

    @classmethod
    def on(cls, vertices: Array, faces: Faces) -> NearestTriangles:
        from scipy.spatial import KDTree

        corners = vertices[faces]
        samples = samples_of(corners, NEAREST_POINTS)
        edges = np.roll(corners, -1, axis=1) - corners
        normals = cross(edges[:, 0], edges[:, 1])
        tiny = np.finfo(float).tiny
        normals /= np.maximum(np.linalg.norm(normals, axis=1), tiny)[:, None]
        inward = cross(normals[:, None], edges)
        return cls(
            corners=corners,
            edges=edges,
            squares=np.maximum((edges**2).sum(2), tiny),
            normals=normals,
            inward=inward,
            triangle=samples.triangle,
            tree=KDTree(samples.points),
        )

    def distance(self, points: Array) -> Array:
        """Of points (n, 3) from the surface (n,)."""
        _, near = self.tree.query(points, NEAREST_FEW)
        return self._to(np.repeat(points, NEAREST_FEW, axis=0), self.triangle[near.ravel()]).reshape(near.shape).min(1)

    def _to(self, points: Array, triangle: NDArray[np.int64]) -> Array:
        """Distances (n,) of points (n, 3), each to its triangle: to the plane where it lies over the inside, else to
        the nearest edge."""
        from_corners = points[:, None] - self.corners[triangle]
        over = (np.einsum("ijk,ijk->ij", self.inward[triangle], from_corners) >= 0).all(1)
        to_plane = np.abs(np.einsum("ij,ij->i", self.normals[triangle], from_corners[:, 0]))
        edges = self.edges[triangle]
        along = np.einsum("ijk,ijk->ij", edges, from_corners) / self.squares[triangle]
        to_edges = from_corners - np.clip(along, 0, 1)[..., None] * edges
        return np.where(over, to_plane, np.sqrt(np.einsum("ijk,ijk->ij", to_edges, to_edges).min(1)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Subject:
    """A mesh to be covered: its triangles (n, 3, 3), exact and simplified, and the reachable ones of ``taken`` samples.

    It also holds the grid of open space around it and a search tree for the nearest surface."""

    triangles: Array
    simplified: Array
    samples: Samples
    taken: int
    area: float
    around: Surroundings
    nearest: NearestTriangles

    @property
    def density(self) -> float:
        """Samples per area."""
        return self.taken / self.area

    def bare(self, hull: Hull) -> Array:
        """Stand-off (n,) of points of a hull's surface that would be reachable if no other part covered them.

        Each point stands for ``hull.area / n`` of the surface."""
        points = samples_of(hull.triangles, HULL_POINTS)
        inward = np.einsum("ij,ij->i", points.normals, points.points - hull.corners.mean(0)) < 0
        normals = np.where(inward[:, None], -points.normals, points.normals)
        touched = self.around.is_reached(points.points, normals, PROBE)
        off = np.zeros(HULL_POINTS)
        if touched.any():
            off[touched] = self.nearest.distance(points.points[touched])
        return off


def samples_of(triangles: Array, count: int) -> Samples:
    """``count`` points spread over triangles (n, 3, 3) by area, in their order, the same ones every time."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    areas = area_vectors(triangles)
    area = np.linalg.norm(areas, axis=1)
    reached = np.cumsum(area)
    triangle = np.searchsorted(reached, (np.arange(count) + 0.5) / count * reached[-1])
    triangle = np.minimum(triangle, len(triangles) - 1)
    u, v = np.random.default_rng(0).random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    points = a[triangle] + u * (b - a)[triangle] + v * (c - a)[triangle]
    normals = areas[triangle] / np.maximum(area[triangle], np.finfo(float).tiny)[:, None]
    return Samples(points=points, normals=normals, triangle=triangle, weight=np.ones(count))


def surroundings(vertices: Array, faces: Faces) -> Surroundings:
    """Open space: cells connected to the outside without crossing the surface. All other cells are solid.

    The mesh need not be closed."""
    import scipy.ndimage

    image: Any = scipy.ndimage
    cell = _cell(vertices, faces)
    low = vertices.min(0) - (PROBE + 4 * cell)
    shape = np.ceil((vertices.max(0) + PROBE + 4 * cell - low) / cell).astype(int) + 1
    occupied = np.zeros(shape, bool)
    occupied[tuple(((_dense(vertices, faces, 0.9 * cell) - low) / cell).astype(int).T)] = True
    # One cell thicker: points a cell apart may leave a gap that a path from face to face of cells slips through.
    regions = image.label(~image.binary_dilation(occupied))[0]
    is_open = regions == regions[0, 0, 0]
    deep = np.argwhere(image.distance_transform_edt(~is_open) >= CORE_DEPTH)
    core = low + (deep[(deep % CORE_STEP == 0).all(1)] + 0.5) * cell
    clearance = np.asarray(image.distance_transform_edt(image.binary_dilation(is_open)), np.float32)
    return Surroundings(clearance=clearance, low=low, cell=cell, core=core)


def _cell(vertices: Array, faces: Faces) -> float:
    area = area_of(vertices[faces])
    box = float(np.prod(np.ptp(vertices, axis=0) + 2 * PROBE))
    return max(CELL, (box / GRID_CELLS) ** (1 / 3), (4 * area / DENSE_POINTS) ** 0.5)


def area_of(triangles: Array) -> float:
    """Of triangles (n, 3, 3)."""
    return float(np.linalg.norm(area_vectors(triangles), axis=1).sum()) / 2


def _dense(vertices: Array, faces: Faces, step: float) -> Array:
    """Points on the surface, less than ``step`` apart: a lattice on every triangle, as fine as its edges are long."""
    corners = vertices[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(1)
    parts = np.maximum(1, np.ceil(edges / step)).astype(int)
    found = [vertices]
    for n in np.unique(parts[parts > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        shares = np.stack([i[inside], j[inside], n - i[inside] - j[inside]], axis=1) / n
        found.append(np.einsum("kc,mcd->mkd", shares, corners[parts == n]).reshape(-1, 3))
    return np.concatenate(found)


def stand_off(samples: Samples, normals: Array, offsets: Array) -> Array:
    """How far a hull that contains the samples stands off the surface there (n,), times their weight: along its
    facets' normals, for those that look the sample's way, else along the sample's own normal."""
    planes = normals.T.astype(np.float32), offsets.astype(np.float32)
    off = [
        least_off(
            depths(samples.points[b].astype(np.float32), *planes), samples.normals[b].astype(np.float32), planes[0]
        )
        for b in blocks(len(samples.points), len(offsets))
    ]
    return np.concatenate(off) * samples.weight


def blocks(rows: int, columns: int) -> list[slice]:
    """Rows of a table, as many at a time as fit into a processor's cache; at least one block."""
    step = max(1, STAND_OFF_BLOCK // max(1, columns))
    return [slice(start, start + step) for start in range(0, max(1, rows), step)]


def depths(points: Single, normals: Single, offsets: Single) -> Single:
    """Of points (n, 3) below planes with normals (3, m), in single precision, a ten millionth of the size: (n, m)."""
    below = points @ normals
    return np.subtract(offsets, below, out=below)


def least_off(depth: Single, facing_of: Single, normals: Single) -> Array:
    """Stand-off (n,) of samples with normals (n, 3) by their ``depths``, which are written over."""
    # Without masks: where a branch is hard to predict, they take five times as long.
    facing = facing_of @ normals
    np.maximum(depth, 0, out=depth)
    depth += np.multiply(facing <= FACING_AWAY, FAR_AWAY, dtype=np.float32)
    scale = np.maximum(facing, FACING_AWAY, out=facing, dtype=np.float32)
    np.maximum(scale, facing > STEEPEST, out=scale)  # 1 for those that look the sample's way
    depth /= scale
    return depth.min(1, initial=np.inf).astype(np.float64)


def weighted(samples: Samples, hull: tuple[Array, Array]) -> Samples:
    """Samples whose weight rises to ``floor_weight`` where the surface faces the opening of a cavity: the floor on
    which things come to rest. Surface deep below the hull of the mesh is a cavity's, and faces its opening on the
    average."""
    deep = stand_off(samples, *hull) > CAVITY_DEPTH
    if np.count_nonzero(deep) < CAVITY_SHARE * len(samples.points):
        return samples
    opening = samples.normals[deep].mean(0)
    if (length := float(np.linalg.norm(opening))) < CAVITY_LEAN:
        return samples
    facing = np.where(deep, np.maximum(samples.normals @ opening / length, 0), 0)
    return replace(samples, weight=1 + (FLOOR_WEIGHT - 1) * facing**FLOOR_POWER)
