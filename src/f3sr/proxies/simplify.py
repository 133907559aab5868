"""Simpler hulls that contain the exact one: polytopes of few of its own facet planes, with its flats kept."""

from __future__ import annotations

import numpy as np

from f3sr.contact.least_norm import shortest
from f3sr.core.mesh import ConvexPart, area_vectors
from f3sr.core.transforms import Array, bounds_of
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.hulls import planes

THICKNESS = 0.002
"""Largest distance of a simplified hull from the exact one [size]; it makes a can about 27-sided."""
FLAT_SHARE = 0.02
"""Least share of a hull's area by which facets of one direction are kept as one plane: bases stay flat."""
SAME_FLAT = np.radians(2.0)
"""Facets turned by less than this [rad] belong to one flat: the noise of generated meshes."""


Planes = tuple[Array, Array]
"""Outward unit normals (m, 3) and offsets (m,)."""


def simplified_outward(
    points: Array, config: ProxyConfig, base: Planes | None = None, *, most: int | None = None
) -> ConvexPart:
    """A polytope of few facets around points (n, 3), in normalised units; it contains all of them.

    Its planes are the hull's flats first. Then planes of the hull are added one by one: the one that cuts off most of
    the farthest protruding corner. This ends when corners protrude by less than ``THICKNESS``, or with ``most`` facets
    by less than ``loose_tolerance``. None is farther than that from the hull. Twice ``most`` are never exceeded.
    ``base`` holds the flats of the whole mesh. Flats that the points reach are used, so that all parts of an object end
    in one base. A hull too thin for that stays as it is. Raises ValueError when the points span no volume.
    """
    hull = ConvexPart.hull_of(points)
    normals, offsets = planes(hull)
    most = most or config.max_hull_faces
    kept_normals, kept_offsets = (x[: most // 2] for x in _first_planes(hull, base))
    while True:
        corners = corners_of(kept_normals, kept_offsets, hull)
        if corners is None:
            return hull
        excess = corners @ normals.T - offsets
        worst = int(excess.argmax())
        count = len(kept_offsets)
        if count >= 2 * most:
            break
        if excess.flat[worst] > (THICKNESS if count < most else config.cuts.loose_tolerance):
            plane = normals[worst % len(offsets)], offsets[worst % len(offsets)]
        elif spike := _plane_below_spike(corners, hull, (normals, offsets), config.cuts.loose_tolerance):
            plane = spike
        else:
            break
        kept_normals, kept_offsets = np.vstack([kept_normals, plane[0]]), np.append(kept_offsets, plane[1])
    return ConvexPart.hull_of(merged(corners))


def _plane_below_spike(corners: Array, hull: ConvexPart, facets: Planes, most: float) -> tuple[Array, float] | None:
    """The plane that separates a hull from a corner farther than ``most`` from it; None where there is none.

    Two facets that meet at a small angle may do so far away, hardly beyond the plane of either."""
    normals, offsets = facets
    # No corner is farther than the nearest vertex, nor than where the way from the middle to it leaves the hull.
    middle = hull.vertices.mean(0)
    from_middle = corners - middle
    inside = np.maximum(offsets - normals @ middle, np.finfo(float).tiny)
    leaves = 1 / np.maximum((from_middle @ normals.T / inside).max(1), 1)
    nearest = np.array([np.linalg.norm(hull.vertices - corner, axis=1).min() for corner in corners])
    nearest = np.minimum(nearest, (1 - leaves) * np.linalg.norm(from_middle, axis=1))
    for corner in corners[np.argsort(-nearest)[: np.count_nonzero(nearest > most)]]:
        way = shortest(np.column_stack([-normals, normals @ corner - offsets]))
        if way is not None and (distance := float(np.linalg.norm(way))) > most:
            normal = -way / distance
            return normal, float((hull.vertices @ normal).max())
    return None


def flats_of(hull: ConvexPart) -> Planes:
    """The planes that a hull's flats lie in: what an object stands on."""
    normals = _flats(hull, FLAT_SHARE)
    return normals, (hull.vertices @ normals.T).max(0)


def _first_planes(hull: ConvexPart, base: Planes | None) -> Planes:
    """The flats of the whole mesh that a part reaches, then its own ones that face elsewhere."""
    own, own_offsets = flats_of(hull)
    if base is None:
        return own, own_offsets
    shared, shared_offsets = base
    reached = shared_offsets - (hull.vertices @ shared.T).max(0) <= THICKNESS
    shared, shared_offsets = shared[reached], shared_offsets[reached]
    elsewhere = (own @ shared.T).max(1, initial=-1) < np.cos(SAME_FLAT)
    return np.vstack([shared, own[elsewhere]]), np.append(shared_offsets, own_offsets[elsewhere])


def _flats(hull: ConvexPart, share: float) -> Array:
    """Mean normals (k, 3) of facets that face nearly the same way and hold ``share`` of the hull's area."""
    areas = area_vectors(hull.vertices[hull.faces])
    area = np.linalg.norm(areas, axis=1)
    normals = areas / np.maximum(area, np.finfo(float).tiny)[:, None]
    left, flats = area.copy(), list[Array]()
    seeds = np.flatnonzero(_area_around(normals, area) >= share * area.sum())
    for seed in seeds[np.argsort(-area[seeds], kind="stable")]:
        near = (normals @ normals[seed] > np.cos(SAME_FLAT)) & (left > 0)
        if left[seed] > 0 and left[near].sum() >= share * area.sum():
            mean = areas[near].sum(0)
            flats.append(mean / np.linalg.norm(mean))
            left[near] = 0
    return np.array(flats).reshape(-1, 3)


def _area_around(normals: Array, area: Array) -> Array:
    """An upper bound (n,) of the area of facets nearly parallel to each facet.

    It is the area in its cell of a grid over the normals, of width SAME_FLAT, and in the neighbouring cells. It saves
    round bodies a quadratic search."""
    from scipy.spatial import KDTree

    cell = 2.001 * np.sin(SAME_FLAT / 2)
    cells, inverse = np.unique(np.floor(normals / cell), axis=0, return_inverse=True)
    held = np.bincount(inverse.ravel(), area)
    around = KDTree(cells).query_ball_point(cells, 1.5, p=np.inf)
    return np.array([held[near].sum() for near in around])[inverse.ravel()]


def corners_of(normals: Array, offsets: Array, hull: ConvexPart, inside: Array | None = None) -> Array | None:
    """Corners (n, 3) of ``normals . x <= offsets``, within a box far around the hull.

    None if the body is so thin that ``inside`` (3,), by default the hull's centre, is not clearly inside."""
    from scipy.spatial import HalfspaceIntersection, QhullError

    middle: Array = hull.vertices.mean(0) if inside is None else inside
    low, high = bounds_of(hull.vertices)
    margin = (high - low).max()
    box = np.concatenate([np.eye(3), -np.eye(3)])
    box_offsets = np.concatenate([high + margin, margin - low])
    halfspaces = np.column_stack([np.vstack([normals, box]), -np.append(offsets, box_offsets)])
    try:
        return np.asarray(HalfspaceIntersection(halfspaces, middle).intersections)
    except QhullError:
        return None


def merged(points: Array, tolerance: float = 1e-9) -> Array:
    """Points with all but the first of those within ``tolerance`` left out."""
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(tolerance, output_type="ndarray")
    return np.delete(points, np.unique(pairs[:, 1]), axis=0)
