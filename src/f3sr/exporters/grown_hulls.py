"""Convex parts grown by the contact margin, for programs that have no margin of their own.

Bodies of a package rest two margins apart: there f3sr's contacts end. Grown parts touch in the same place, so nothing
falls when another program starts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree

from f3sr.core.flats import ShortestWay, facets
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array

SHARPEST = 2.0
"""How far a corner moves at most [margins]: a box's moves by 1.7, that of a blade would move by any number."""
BEHIND = 0.125
"""Distance behind a facet up to which a corner belongs to it [margins]: .02 mm, as flats of delivered parts."""
ROUNDING = 1e-6
"""Of a move [margins]."""
LEAST_EDGE = 1e-6
"""Distance [m] below which two corners are one: Drake refuses the slivers between them."""
NO_FOOTING = np.array([0, 0, 0, -np.inf])
"""Of a part without a body: no corner is in it."""


def grown(part: ConvexPart, by: float, footing: Array = NO_FOOTING) -> ConvexPart:
    """The part [m] whose facets lie ``by`` [m] further out, with no more corners than it has.

    Every corner moves the shortest way that moves its facets at least so far, and its flats, of four corners or more,
    exactly so far: engines see several faces in what is not quite plane. Flats become plane within ``BEHIND``, and none
    of them lies further out than ``by``: overlaps would kick. No corner moves further than ``SHARPEST`` times ``by``.
    Where edges are too sharp for that, facets stay behind, flats bend: of two that meet, the smaller one, unless it
    lies in ``footing`` (4,), the plane n . x + d = 0 on which the body can stand. A sheet thinner than ``BEHIND`` grows
    to both sides alone.
    """
    if sheet := _thicker(part, by):
        return sheet
    whole = ConvexPart.hull_of(_without_twins(part.vertices))
    planes, touching = (np.array(each) for each in zip(*facets(whole, BEHIND * by), strict=True))
    off_footing = whole.vertices @ footing[:3] + footing[3] < -BEHIND * by
    first = np.argsort((touching & off_footing).any(1), kind="stable")
    planes, touching = planes[first], touching[first]
    behind = np.where(touching, -planes[:, 3:] - planes[:, :3] @ whole.vertices.T, 0) / by
    wanted = 1 + behind - behind.max(1, keepdims=True)
    flat = touching.sum(1) > 3
    moves = [
        _move(planes[on, :3], wanted[on, corner], np.flatnonzero(flat[on])) for corner, on in enumerate(touching.T)
    ]
    return ConvexPart.hull_of(whole.vertices + by * np.array(moves))


def _thicker(sheet: ConvexPart, by: float) -> ConvexPart | None:
    """A sheet whose corners move ``by`` off its middle plane; None where both its sides are not one flat."""
    off = sheet.vertices - sheet.vertices.mean(0)
    normal = np.linalg.svd(off, full_matrices=False)[2][2]
    height = off @ normal
    if np.ptp(height) > BEHIND * by:
        return None
    middle = (height.max() + height.min()) / 2
    return ConvexPart.hull_of(sheet.vertices + by * np.where(height > middle, 1.0, -1.0)[:, None] * normal)


def _without_twins(corners: Array) -> Array:
    """Of corners (n, 3) nearer to each other than ``LEAST_EDGE``, one."""
    later = sorted({j for _, j in KDTree(corners).query_pairs(LEAST_EDGE)})
    return np.delete(corners, later, axis=0) if len(corners) - len(later) >= 4 else corners


def _move(normals: Array, wanted: Array, flats: NDArray[np.intp]) -> Array:
    """The way (3,) of a corner of facets with ``normals`` (k, 3), which move ``wanted`` (k,) along them.

    ``flats`` move exactly so far, if they can, the first ones before others."""
    kept, met, near = np.zeros(len(normals), np.bool_), ShortestWay.none(), np.zeros(3)
    for flat in flats:
        if (more := met.onto(normals[flat], float(wanted[flat]), ROUNDING)) is None:
            continue
        kept[flat] = True
        way = _shortest(normals, np.where(kept, wanted, 0), kept, more)
        if way is None or way @ way > SHARPEST**2:
            kept[flat] = False
        else:
            met, near = more, way
    far = _shortest(normals, wanted, kept, met)
    return near if far is None else _reaching(near, far)  # the corner of a sheet lies on both of its sides


def _reaching(near: Array, far: Array) -> Array:
    """The point (3,) on the way from ``near`` to ``far``, as far on as lies within ``SHARPEST`` of the origin."""
    way = far - near
    a, b, c = way @ way, near @ way, near @ near - SHARPEST**2
    return far if far @ far <= SHARPEST**2 else near + way * (np.sqrt(b * b - a * c) - b) / a


def _shortest(normals: Array, wanted: Array, kept: NDArray[np.bool_], met: ShortestWay) -> Array | None:
    """The shortest d (3,) with ``normals @ d >= wanted``, and equal to it for those ``kept``. None where there is none.

    ``met`` is the shortest with the equalities alone. Least distance programming (Lawson and Hanson, chapter 23)."""
    lacking = np.where(kept, 0, wanted - normals @ met.way)
    if lacking.max(initial=0) <= ROUNDING:
        return met.way
    if len(met.basis) == 3:
        return None
    free = np.eye(3) - met.basis.T @ met.basis
    E = np.vstack([free @ normals[~kept].T, lacking[~kept]])
    f = np.array([0.0, 0, 0, 1])
    multipliers, residual = nnls(E, f)
    if residual < ROUNDING:
        return None
    r = E @ multipliers - f
    return met.way - free @ r[:3] / r[3]
