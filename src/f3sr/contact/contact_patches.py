"""Where resting bodies touch: contact patches between unions of convex parts and the ground, without a simulator.

Two convex parts touch if their gap along the axis of best separation is at most ``reach``. The contact region is where
one part, moved by ``reach`` along the axis, overlaps the other. So the patch is the projection of a convex polytope.
Its corners are ends of edges of one part clipped by the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.compounds import Compound, Parts, compound, near_parts, placed
from f3sr.contact.polytopes import Polytope, facets
from f3sr.contact.sort_order import sort_order
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, cross, frozen, pose
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.runtime.kernels import kernel
from f3sr.scene import GROUND

FACE_FIRST = 0.05
"""An axis across two edges replaces that of a face when it separates by this share of the reach more: the normals of
nearly parallel edges are noise."""
ONE_PLANE = np.radians(1.0)
"""Patches whose normals differ by less [rad] and which lie within reach of one plane are one patch."""
STEEP = 0.05
"""Sine of the angle between an edge and its end face below which the end is fixed to the edge.

Otherwise it would slide along the edge more than twenty times as fast as the bodies move."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Contacts:
    """Corners of contact patches, one row each.

    ``upper`` and ``lower`` (k,) are ids of the bodies; ``lower`` may be GROUND. ``points`` (k, 3) are in the world [m],
    ``normals`` (k, 3) unit, from lower to upper. ``follow`` (k, 3, 3): under small shifts of the bodies a point
    moves by ``follow @ shift_upper + (1 - follow) @ shift_lower``.
    """

    upper: NDArray[np.int64]
    lower: NDArray[np.int64]
    points: Array
    normals: Array
    follow: Array

    def __post_init__(self) -> None:
        for name in ("points", "normals", "follow"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        assert self.follow.shape == (len(self), 3, 3)

    def __len__(self) -> int:
        return len(self.points)

    def of(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Self:
        """Some of the rows."""
        return type(self)(
            upper=self.upper[rows],
            lower=self.lower[rows],
            points=self.points[rows],
            normals=self.normals[rows],
            follow=self.follow[rows],
        )

    def joined(self, other: Self) -> Self:
        """The rows of both."""
        return type(self)(
            upper=np.concatenate([self.upper, other.upper]),
            lower=np.concatenate([self.lower, other.lower]),
            points=np.concatenate([self.points, other.points]),
            normals=np.concatenate([self.normals, other.normals]),
            follow=np.concatenate([self.follow, other.follow]),
        )

    @property
    def pairs(self) -> frozenset[tuple[int, int]]:
        """(upper, lower) ids that touch."""
        return frozenset(zip(self.upper.tolist(), self.lower.tolist(), strict=True))


def find_contacts(bodies: Mapping[int, Parts], *, reach: float = DEFAULT_MARGIN.reach, ground: bool = True) -> Contacts:
    """All contacts between bodies, given by id with their parts in the world, and with the ground z = 0.

    Parts with gaps of at most ``reach`` [m] touch."""
    rows = list(_rows({id: compound(parts) for id, parts in bodies.items()}, reach, ground))
    owners = np.array([r.owners for r in rows], np.int64).reshape(-1, 2)
    counts = [len(r.patch.points) for r in rows]
    upper, lower = np.repeat(owners, counts, axis=0).T
    return Contacts(
        upper=upper,
        lower=lower,
        points=np.concatenate([np.empty((0, 3)), *(r.patch.points for r in rows)]),
        normals=np.repeat(np.array([r.patch.normal for r in rows]).reshape(-1, 3), counts, axis=0),
        follow=np.concatenate([np.empty((0, 3, 3)), *(r.patch.follow for r in rows)]),
    )


class _ContactPatch(NamedTuple):
    """One normal (3,), and corners (k, 3) with how they follow the upper body (k, 3, 3)."""

    normal: Array
    points: Array
    follow: Array


class _Row(NamedTuple):
    owners: tuple[int, int]
    patch: _ContactPatch


def _rows(bodies: Mapping[int, Compound], reach: float, ground: bool) -> Iterator[_Row]:
    boxes = {id: body.bounds for id, body in bodies.items()}
    for a, b in combinations(bodies, 2):
        if _apart(boxes[a], boxes[b], reach):
            continue
        patches = [
            patch
            for i, j in near_parts(bodies[a], bodies[b], reach).tolist()
            if (patch := _between(bodies[a][i], bodies[b][j], reach))
        ]
        if not patches:
            continue
        # One order per pair of bodies: the upper is the one that most corners push up.
        upward = sum(p.normal[2] * len(p.points) for p in patches) >= 0
        if not upward:
            patches = [_ContactPatch(-p.normal, p.points, np.eye(3) - p.follow) for p in patches]
        yield from (_Row((a, b) if upward else (b, a), patch) for patch in _merged(patches, reach))
    if ground:
        for id, body in bodies.items():
            low = np.flatnonzero(body.boxes[:, 0, 2] <= reach)
            patches = [_on_ground(body[k], reach) for k in low.tolist()]
            yield from (_Row((id, GROUND), patch) for patch in _merged(patches, reach))


def _apart(a: Array, b: Array, reach: float) -> bool:
    return bool(((a[0] > b[1] + reach) | (b[0] > a[1] + reach)).any())


def _between(a: Polytope, b: Polytope, reach: float) -> _ContactPatch | None:
    """The patch of two convex parts, its normal from b to a; None when they are further apart than reach."""
    n, gap = nearest_facet(a, b, reach)
    return None if gap > reach else patch_of(a, b, n, reach)


def nearest_facet(a: Polytope, b: Polytope, reach: float) -> tuple[Array, float]:
    """The axis of best separation of two convex parts: a unit normal (3,) from a to b, and the gap along it [m], which
    is negative where they overlap."""
    normals, heights = facets(a, b)
    faces = len(a.normals) + len(b.normals)
    # It has the least height; -height is the gap along it.
    best = int(np.argmin(heights[:faces]))
    if len(heights) > faces and heights[faces:].min() < heights[best] - FACE_FIRST * reach:
        best = faces + int(np.argmin(heights[faces:]))
    return normals[best], -float(heights[best])


def patch_of(a: Polytope, b: Polytope, n: Array, reach: float) -> _ContactPatch | None:
    """Where ``a``, moved by ``reach`` [m] along n (3,), overlaps ``b``: the corners, midway between the surfaces."""
    shift = reach * n
    rows = np.empty((2 * (len(a.edge_starts) + len(b.edge_starts)), 12))
    # a's planes move with a: normal . (x - shift) <= offset.
    along = a.normals[:, 0] * shift[0] + a.normals[:, 1] * shift[1] + a.normals[:, 2] * shift[2]
    # Corners of the overlap: ends of a's edges in b, then of b's in a.
    starts, offsets = frozen(a.edge_starts + shift), frozen(a.offsets + along)
    k = _clip(starts, a.edge_directions, a.edge_lengths, b.normals, b.offsets, True, rows, 0)
    k = _clip(b.edge_starts, b.edge_directions, b.edge_lengths, a.normals, offsets, False, rows, k)
    if not k:
        return None
    rows = rows[:k]
    # Corners are found with a moved by reach along n; half of it back is midway between the two surfaces.
    return _ContactPatch(-n, rows[:, :3] - reach / 2 * n, rows[:, 3:].reshape(-1, 3, 3))


def _on_ground(part: Polytope, reach: float) -> _ContactPatch:
    starts, ends = part.edge_starts, part.edge_starts + part.edge_lengths[:, None] * part.edge_directions
    with np.errstate(divide="ignore", invalid="ignore"):
        # The part below z = reach, seen from above: its own low corners, and where its edges pass that height.
        crossing = starts + ((reach - starts[:, 2]) / (ends[:, 2] - starts[:, 2]))[:, None] * (ends - starts)
    crosses = (starts[:, 2] > reach) != (ends[:, 2] > reach)
    points = np.concatenate([part.vertices[part.vertices[:, 2] <= reach], crossing[crosses]])
    points[:, 2] = 0
    return _ContactPatch(UP, points, np.tile(np.eye(3), (len(points), 1, 1)))


def _merged(patches: list[_ContactPatch], reach: float) -> Iterator[_ContactPatch]:
    """Patches in one plane as one, each reduced to the corners of its hull."""
    patches = sorted(patches, key=lambda p: -len(p.points))
    while patches:
        n, middle = patches[0].normal, patches[0].points.mean(0)
        same = [
            bool(p.normal @ n > np.cos(ONE_PLANE) and (np.abs((p.points - middle) @ n) < reach).all()) for p in patches
        ]
        group = [p for p, s in zip(patches, same, strict=True) if s] or patches[:1]
        patches = [p for p, s in zip(patches, same, strict=True) if not s and p is not patches[0]]
        points, follow = np.concatenate([p.points for p in group]), np.concatenate([p.follow for p in group])
        if np.ptp(points, axis=0).max() < reach:  # no larger than what is not told apart: a point
            yield _ContactPatch(n, points.mean(0)[None], follow.mean(0)[None])
            continue
        u, v = tangents(n)
        corners = hull_corners(np.stack([points @ u, points @ v], axis=1), reach / 100)
        yield _ContactPatch(n, points[corners], follow[corners])


def hull_corners(points: Array, tolerance: float) -> NDArray[np.int64]:
    """Indices of the corners of the convex hull of points (k, 2); a corner less than ``tolerance`` out is left out."""
    order = sort_order(points[:, 0] + 1e-9 * points[:, 1])  # by x, ties by y
    hull = np.empty(2 * len(points) + 2, np.int64)
    return hull[: _chain(points, order, tolerance, hull)]


def tangents(n: Array) -> tuple[Array, Array]:
    """Two unit vectors (..., 3) that make a right-handed frame with unit n (..., 3)."""
    across = cross(np.eye(3)[np.argmin(np.abs(n), axis=-1)], n)
    u = across / np.linalg.norm(across, axis=-1, keepdims=True)
    return u, cross(n, u)


# Kernels


@kernel
def _clip(
    starts: Array,
    directions: Array,
    lengths: Array,
    normals: Array,
    offsets: Array,
    first_body: bool,
    rows: Array,
    k: int,
) -> int:
    """Clip the edges of one body, the ``first_body`` or the other, by the planes of the other one.

    Their ends go to ``rows`` (n, 12) from row ``k`` on: the point, how it follows the first body (3, 3). Returns the
    row after the last."""
    for i in range(len(starts)):
        # Cyrus-Beck clipping of the edge to [first, last]; the face that cut an end, or -1 where it is the edge's own.
        first, last, face_first, face_last = 0.0, lengths[i], -1, -1
        # Relative to the edge, with a floor: an edge in a plane counts as inside it.
        slack = 1e-9 * (lengths[i] + 1e-3)
        for m in range(len(normals)):
            at = -offsets[m]
            speed = 0.0
            for c in range(3):
                at += normals[m, c] * starts[i, c]
                speed += normals[m, c] * directions[i, c]
            if abs(speed) < 1e-9:
                if at > slack:
                    last = -1.0
            elif speed > 0.0:
                t = -at / speed
                if t < last:
                    last, face_last = t, m
            else:
                t = -at / speed
                if t > first:
                    first, face_first = t, m
            if first > last + slack:
                break
        if first > last + slack:
            continue
        for end in range(2):
            t, face = (first, face_first) if end == 0 else (last, face_last)
            for c in range(3):
                rows[k, c] = starts[i, c] + t * directions[i, c]
            speed = 0.0
            if face >= 0:
                for c in range(3):
                    speed += normals[face, c] * directions[i, c]
            # An end cut by a face slides along its edge when edge and face shift apart: with edge direction d and face
            # normal n the point moves by s_edge + d n . (s_face - s_edge) / (n . d). So it follows its own body by
            # 1 - F and the other by F, where F = d n' / (n . d). Rows hold what follows the first body: 1 - F for its
            # own edges, F for the other's.
            own = 1.0 if first_body else 0.0
            for c in range(3):
                for d in range(3):
                    f = 0.0
                    if face >= 0 and abs(speed) > STEEP:
                        f = directions[i, c] * normals[face, d] / speed
                    same = own if c == d else 0.0
                    rows[k, 3 + 3 * c + d] = same - f if first_body else same + f
            k += 1
    return k


@kernel
def _chain(points: Array, order: NDArray[np.int64], tolerance: float, hull: NDArray[np.int64]) -> int:
    """Fill ``hull`` with the indices of ``hull_corners``, given the ``order`` (k,) of points; returns how many."""
    # Andrew's monotone chain: first the lower chain, then the upper one backwards.
    k = 0
    for turn in range(2):
        # The last corner of the first chain begins the second one and cannot be dropped from it.
        floor = k + 1
        for q in range(len(order)):
            i = order[q] if turn == 0 else order[len(order) - 1 - q]
            while k > floor:
                p, r = hull[k - 2], hull[k - 1]
                ax, ay = points[i, 0] - points[p, 0], points[i, 1] - points[p, 1]
                bx, by = points[r, 0] - points[p, 0], points[r, 1] - points[p, 1]
                # r lies to the right of p-i, outward, by more than the tolerance: it stays.
                if ax * by - ay * bx < -tolerance * np.sqrt(ax * ax + ay * ay):
                    break
                k -= 1
            hull[k] = i
            k += 1
        k -= 1
    return max(k, 1)


def warm_up() -> None:
    """Compile every kernel of this module by calling it once."""
    part = ConvexPart.hull_of(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]))
    find_contacts({0: placed([part], np.eye(4)), 1: placed([part], pose(t=[0.1, 0.1, 0.7]))})
