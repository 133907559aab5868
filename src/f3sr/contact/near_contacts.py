"""Where bodies touch, or would after small moves: corners of patches between near parts, with the gap at each."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.compounds import Compound, free_travel, near_parts
from f3sr.contact.contact_patches import Contacts, hull_corners, nearest_facet, patch_of, tangents
from f3sr.contact.polytopes import Polytope
from f3sr.core.transforms import UP, Array, pose
from f3sr.scene import GROUND

REACH = 0.05
"""Largest gap at which bodies may come to touch, as a share of the smaller body's size."""
ROOM = 2e-4
"""How much farther [m] than its least gap a patch of two parts reaches: curved surfaces touch in a small place."""
PARALLEL = float(np.radians(3))
"""Largest angle [rad] between faces that a small turn may lay on each other: then their far corners count too."""
FACES = 0.015
"""Least room between such faces, as a share of the smaller body's size."""
GROUND_ROOM = 0.02
"""How much farther than its least gap a patch on the ground reaches, as a share of the body's size."""
UNDER = 0.9
"""Least cosine between up and the normals at which a footing carries: footings are for slopes of up to .22 rad."""
ALIKE = 0.95
"""Least cosine between the normals of a contact of a footing and of the contact of its body that closes its gap."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NearContacts:
    """``gaps`` (k,) [m] along the normals of the ``contacts``, negative where bodies overlap."""

    contacts: Contacts
    gaps: Array

    def of(self, rows: NDArray[np.bool_]) -> NearContacts:
        """Some of the rows."""
        return NearContacts(contacts=self.contacts.of(rows), gaps=self.gaps[rows])

    def joined(self, other: NearContacts) -> NearContacts:
        """The rows of both."""
        return NearContacts(contacts=self.contacts.joined(other.contacts), gaps=np.concatenate([self.gaps, other.gaps]))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Corners:
    upper: int
    lower: int
    points: Array
    normal: Array
    follow: Array
    gaps: Array


def near_contacts(
    bodies: Mapping[int, Compound], moving: Collection[int], hanging: Collection[int] = ()
) -> NearContacts:
    """Contacts of ``moving`` bodies with all others and the ground that small moves may close.

    Bodies are parts in the world by id. What is ``hanging`` also gets the contacts that it would have if it were
    lowered, with the way down as their gaps."""
    corners = [*_between_bodies(bodies, moving), *_on_ground(bodies, moving)]
    for id in hanging:
        corners += _below(bodies, id)
    counts = [len(c.gaps) for c in corners]
    return NearContacts(
        contacts=Contacts(
            upper=np.repeat([c.upper for c in corners], counts).astype(np.int64),
            lower=np.repeat([c.lower for c in corners], counts).astype(np.int64),
            points=np.concatenate([np.empty((0, 3)), *(c.points for c in corners)]),
            normals=np.repeat(np.array([c.normal for c in corners]).reshape(-1, 3), counts, axis=0),
            follow=np.concatenate([np.empty((0, 3, 3)), *(c.follow for c in corners)]),
        ),
        gaps=np.concatenate([np.empty(0), *(c.gaps for c in corners)]),
    )


def footing_contacts(
    own: NearContacts, footings: Mapping[int, Compound], bodies: Mapping[int, Compound]
) -> tuple[NearContacts, NDArray[np.int64]]:
    """The contacts, then those of footings with what is below them; and by which contact each gap closes (n,).

    A body touches before its footing does, which fills the space above. So the gap of a footing closes by the contact
    of its body that is nearest, with the same other body and a similar normal. Where there is none, by its own."""
    near, closing = own, np.arange(len(own.gaps))
    for id, footing in footings.items():
        more = near_contacts({**bodies, id: footing}, [id])
        upward = more.contacts.normals[:, 2] * np.where(more.contacts.upper == id, 1.0, -1.0)
        more = more.of(upward > UNDER)
        first = len(closing)
        near = near.joined(more)
        closing = np.concatenate([closing, _closing(own, more, first)])
    return near, closing


def _closing(own: NearContacts, more: NearContacts, first: int) -> NDArray[np.int64]:
    """For contacts (k,), numbered from ``first``, the nearest one of ``own`` between the same bodies, or themselves."""
    a, b = own.contacts, more.contacts
    same = (a.upper == b.upper[:, None]) & (a.lower == b.lower[:, None])
    same |= (a.upper == b.lower[:, None]) & (a.lower == b.upper[:, None])
    gaps = np.where(same & (np.abs(b.normals @ a.normals.T) > ALIKE), own.gaps, np.inf)
    nearest = gaps.argmin(1) if len(own.gaps) else np.zeros(len(more.gaps), np.int64)
    return np.where(np.isfinite(gaps).any(1), nearest, first + np.arange(len(more.gaps)))


def _between_bodies(bodies: Mapping[int, Compound], moving: Collection[int]) -> Iterator[_Corners]:
    for a, b in combinations(bodies, 2):
        if a in moving or b in moving:
            size = min(bodies[k].size for k in (a, b))
            yield from _between(a, bodies[a], b, bodies[b], size, REACH * size)


def _between(a: int, first: Compound, b: int, second: Compound, size: float, reach: float) -> Iterator[_Corners]:
    for i, j in near_parts(first, second, reach).tolist():
        n, gap = nearest_facet(first[i], second[j], ROOM)
        if gap <= reach and (found := _corners(first[i], second[j], n, gap, size)):
            points, follow, gaps = found
            yield _Corners(upper=a, lower=b, points=points, normal=-n, follow=follow, gaps=gaps)


def _corners(a: Polytope, b: Polytope, n: Array, gap: float, size: float) -> tuple[Array, Array, Array] | None:
    """Corners of the patch between two parts along n (3,): points, ways in which they follow, and gaps."""
    angle = float(np.arccos(min(1.0, (a.normals @ n).max(), (b.normals @ -n).max())))
    nearest, room = gap + ROOM, size * max(FACES, np.sin(angle)) if angle < PARALLEL else 0.0
    wide = _patch(a, b, n, nearest + room)
    # A part that is thinner than the room has been moved past the places that are nearest.
    is_past = room and (not wide or wide[2].min() > gap + ROOM / 100)
    found = [patch for patch in (_patch(a, b, n, nearest) if is_past else None, wide) if patch]
    if not found:
        return None
    points, follow, gaps = map(np.concatenate, zip(*found, strict=True))
    # What lies inside an outline says nothing more, but for the nearest place of all, as of a bulge. The near half has
    # its own outline, as of an edge above a face.
    low = np.flatnonzero(gaps <= (gaps.min() + gaps.max()) / 2)
    u, v = tangents(n)
    places = np.stack([points @ u, points @ v], axis=1)
    outlines = hull_corners(places, ROOM / 100), low[hull_corners(places[low], ROOM / 100)]
    kept = np.unique(np.concatenate([*outlines, [gaps.argmin()]]))
    return points[kept], follow[kept], gaps[kept]


def _patch(a: Polytope, b: Polytope, n: Array, reach: float) -> tuple[Array, Array, Array] | None:
    """Corners of where ``a``, moved by ``reach`` [m] along n, overlaps ``b``, each with the gap there."""
    patch = patch_of(a, b, n, reach)
    if patch is None:
        return None
    at = patch.points + reach / 2 * n
    return patch.points, patch.follow, reach - _way_out(a, at - reach * n, n) - _way_out(b, at, -n)


def _way_out(part: Polytope, points: Array, direction: Array) -> Array:
    """(k,) distance [m] that points (k, 3) of a convex part go along a unit direction (3,) until they leave it."""
    speed = part.normals @ direction
    ahead = speed > 1e-6
    left = part.offsets[ahead, None] - part.normals[ahead] @ points.T
    return np.maximum((left / speed[ahead, None]).min(0), 0.0)


def _on_ground(bodies: Mapping[int, Compound], moving: Collection[int]) -> Iterator[_Corners]:
    for id in moving:
        size = bodies[id].size
        if bodies[id].lowest <= REACH * size:
            yield _above_ground(id, bodies[id], size * GROUND_ROOM)


def _above_ground(id: int, body: Compound, room: float, lift: float = 0.0) -> _Corners:
    """Corners up to ``room`` [m] above the lowest one, ``lift`` [m] added to their gaps."""
    points = body.arrays.vertices
    points = points[points[:, 2] <= body.lowest + room]
    follow = np.tile(np.eye(3), (len(points), 1, 1))
    return _Corners(upper=id, lower=GROUND, points=points, normal=UP, follow=follow, gaps=points[:, 2] + lift)


def _below(bodies: Mapping[int, Compound], id: int) -> Iterator[_Corners]:
    """What a body would meet if it were lowered."""
    body, size = bodies[id], bodies[id].size
    others = Compound.of(b for k, b in bodies.items() if k != id)
    drop = min(free_travel(body, others, -UP), body.lowest)
    if drop <= REACH * size:
        return
    lowered = body.moved(pose(t=-drop * UP))
    for k, other in bodies.items():
        if k != id:
            for c in _between(id, lowered, k, other, size, ROOM):
                way = drop * abs(float(c.normal[2]))
                points, gaps = c.points + drop * UP, c.gaps + way
                yield _Corners(upper=id, lower=k, points=points, normal=c.normal, follow=c.follow, gaps=gaps)
    if lowered.lowest <= ROOM:
        ground = _above_ground(id, lowered, size * GROUND_ROOM, lift=drop)
        points = ground.points + drop * UP
        yield _Corners(upper=id, lower=GROUND, points=points, normal=UP, follow=ground.follow, gaps=ground.gaps)
