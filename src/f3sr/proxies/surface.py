"""What can be touched of a mesh: samples of its surface, the space around it that a probe reaches, its solid core.

All in normalised units: the diagonal of the mesh's box is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array
from f3sr.proxies.config import ProxyConfig

GRID_CELLS = 600_000
"""Most cells of the grid over a mesh's box: at a hundredth of the diagonal a cube has 200,000."""
DENSE_POINTS = 3_000_000
"""Most points that mark the surface in the grid; meshes folded into many layers get a coarser grid."""
CORE_STEP = 3
"""Every how many cells along each axis a point of the solid core is kept."""
CORE_DEPTH = 4.5
"""Cells that core points lie below the surface at least: moved onto a cut, up to half a step, they stay inside."""
STEEPEST = 0.25
"""Cosine between a sample's normal and a facet's up to which the facet is what covers the sample."""
CAVITY_DEPTH = 0.03
"""Depth below the hull of the mesh from which on surface belongs to a cavity [size]."""
CAVITY_SHARE = 0.03
"""Least share of the surface that makes a cavity."""
CAVITY_LEAN = 0.2
"""Least length of the mean normal of its surface: that of a hole through the mesh is 0, of half a sphere .5."""
FLOOR_POWER = 4
"""Of the cosine to the opening: surface turned by 45 degrees has a quarter of the weight."""

Faces = NDArray[np.int32]


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
    """A grid over the mesh: how far the middle of each cell lies from what is no open space [cells], and the solid
    core as points (n, 3)."""

    clearance: NDArray[np.float32]
    low: Array
    cell: float
    core: Array

    def is_reached(self, points: Array, normals: Array, probe: float) -> NDArray[np.bool_]:
        """Whether a ball of radius ``probe`` fits in open space where it touches a surface at points (n, 3)."""
        where = ((points + (probe + self.cell) * normals - self.low) / self.cell).astype(int)
        where = np.clip(where, 0, np.array(self.clearance.shape) - 1)
        return self.clearance[tuple(where.T)] * self.cell >= probe - self.cell


def samples_of(vertices: Array, faces: Faces, count: int) -> Samples:
    """``count`` points spread by area, in the order of the triangles, the same ones every time."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    reached = np.cumsum(area)
    triangle = np.searchsorted(reached, (np.arange(count) + 0.5) / count * reached[-1])
    triangle = np.minimum(triangle, len(faces) - 1)
    u, v = np.random.default_rng(0).random((2, count, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    points = a[triangle] + u * (b - a)[triangle] + v * (c - a)[triangle]
    normals = cross[triangle] / np.maximum(area[triangle], np.finfo(float).tiny)[:, None]
    return Samples(points=points, normals=normals, triangle=triangle, weight=np.ones(count))


def surroundings(vertices: Array, faces: Faces, config: ProxyConfig) -> Surroundings:
    """Open space is what can be walked to from outside, cell by cell, without touching the surface; the rest is
    solid, be the mesh closed or not."""
    from scipy.ndimage import binary_dilation, distance_transform_edt, label

    cell = _cell(vertices, faces, config)
    low = vertices.min(0) - (config.probe + 4 * cell)
    shape = np.ceil((vertices.max(0) + config.probe + 4 * cell - low) / cell).astype(int) + 1
    occupied = np.zeros(shape, bool)
    occupied[tuple(((_dense(vertices, faces, 0.9 * cell) - low) / cell).astype(int).T)] = True
    # One cell thicker: points a cell apart may leave a gap that a path from face to face of cells slips through.
    regions = label(~binary_dilation(occupied))[0]
    is_open = regions == regions[0, 0, 0]
    deep = np.argwhere(distance_transform_edt(~is_open) >= CORE_DEPTH)
    core = low + (deep[(deep % CORE_STEP == 0).all(1)] + 0.5) * cell
    clearance = np.asarray(distance_transform_edt(binary_dilation(is_open)), np.float32)
    return Surroundings(clearance=clearance, low=low, cell=cell, core=core)


def _cell(vertices: Array, faces: Faces, config: ProxyConfig) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    box = float(np.prod(np.ptp(vertices, axis=0) + 2 * config.probe))
    return max(config.cell, (box / GRID_CELLS) ** (1 / 3), (4 * area / DENSE_POINTS) ** 0.5)


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
    facing = samples.normals @ normals.T
    depth = np.maximum(offsets - samples.points @ normals.T, 0)
    along = depth / np.where(facing > STEEPEST, 1.0, np.maximum(facing, 1e-6))
    return np.where(facing > 1e-6, along, np.inf).min(1) * samples.weight


def weighted(samples: Samples, hull: tuple[Array, Array], config: ProxyConfig) -> Samples:
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
    return replace(samples, weight=1 + (config.floor_weight - 1) * facing**FLOOR_POWER)
