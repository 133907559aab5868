"""How one body comes to lie on what is held still: it turns about its contacts until its weight is between them.

Quasi-static and without slip: while the centre of mass is not above the polygon of its contact points, the body turns
about the side or corner of that polygon that is nearest, the way that lowers the centre, until it meets something new.
No mass, friction or speed enters, so the same start always ends in the same place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr import contact
from f3sr.contact import Polytope
from f3sr.frames import UP, Array, pose, rotation_about, rotation_angle
from f3sr.patches import find_contacts, hull_corners
from f3sr.physics import DEFAULT_PHYSICS
from f3sr.statics import Balance, StaticBody, contacts_of

STEP = np.radians(2.0)
"""Largest turn [rad] between two looks at what is in the way: thin things are not turned through."""
SHARP = 1e-6
"""Turn [rad] to which the next contact is found."""
MEETS = 1e-7
"""Height [m] that a turned body may have to be raised without having met something."""
TOUCHING = 3e-6
"""Gap [m] that counts as contact while landing; what is left at the end closes by as little."""
EVENTS = 200
"""Most contacts met: a round thing rolls from facet to facet."""
STEEP = 0.2
"""Cosine between up and a contact's normal below which it carries nothing."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Landing:
    """Where a body comes to lie."""

    T: Array
    """(4, 4) rigid motion of the world that takes it there."""
    turn: float
    """[rad] between its orientations before and after."""
    stands: bool
    """It is balanced there by friction."""
    tipped: bool
    """It would have turned farther than allowed; ``T`` then leaves it where it was."""


def land(
    body: StaticBody,
    surroundings: Sequence[StaticBody],
    *,
    max_turn: float,
    clearance: float = 4e-4,
    max_drop: float = np.inf,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
) -> Landing:
    """Lower a body that nothing overlaps onto what is below, and let it turn until it is supported.

    It ends ``clearance`` [m] above what it rests on. It is not lowered by more than ``max_drop`` [m] nor turned by more
    than ``max_turn`` [rad] on the way; what would need more has ``tipped``.
    """
    fall = _Fall(body, [p for b in surroundings for p in b.parts])
    nothing = Landing(T=np.eye(4), turn=0.0, stands=False, tipped=True)
    if fall.lower() > max_drop:
        return nothing
    for _ in range(EVENTS):
        if (pivot := fall.pivot()) is None:
            break
        fall.turn(*pivot)
        if fall.turned > max_turn:
            return nothing
    else:
        return nothing
    fall.rise(clearance)
    placed = body.moved(fall.motion)
    still = [StaticBody(id=b.id, parts=b.parts, mass=b.mass, centers=b.centers, friction=b.friction, fixed=True)
             for b in surroundings]  # fmt: skip
    everything = [placed, *still]
    balance = Balance([placed], everything, contacts_of(everything), ground_friction)
    return Landing(T=fall.motion, turn=rotation_angle(fall.motion[:3, :3]), stands=balance.stands(), tipped=False)


class _Fall:
    """A body on its way, and what is held still around it."""

    def __init__(self, body: StaticBody, around: Sequence[Polytope]) -> None:
        self.body, self.around = body, around
        self.motion = np.eye(4)
        self.turned = 0.0

    @property
    def parts(self) -> tuple[Polytope, ...]:
        return tuple(p.moved(self.motion) for p in self.body.parts)

    @property
    def center(self) -> Array:
        return self.motion[:3, :3] @ self.body.centers[0] + self.motion[:3, 3]

    def lower(self) -> float:
        """Bring it down until it touches, and say how far."""
        parts = self.parts
        drop = min(
            min(float(p.bounds[0, 2]) for p in parts),
            contact.free_travel(parts, self.around, -UP) if self.around else np.inf,
        )
        self.motion = pose(t=-drop * UP) @ self.motion
        return drop

    def rise(self, clearance: float) -> None:
        """Raise it until it is free of everything with the clearance."""
        self.motion = pose(t=self._lift(self.parts, clearance) * UP) @ self.motion

    def _lift(self, parts: Sequence[Polytope], clearance: float = 0.0) -> float:
        lift = contact.smallest_shift(parts, self.around, UP, clearance) if self.around else 0.0
        return max(lift, clearance - min(float(p.bounds[0, 2]) for p in parts))

    def pivot(self) -> tuple[Array, Array] | None:
        """A point and a unit axis to turn about so that the centre of mass sinks; None when it is supported."""
        everything: Mapping[int, Sequence[Polytope]] = {0: self.parts, 1: self.around}
        found = find_contacts(everything if self.around else {0: self.parts}, reach=TOUCHING)
        sign = np.where(found.upper == 0, 1.0, -1.0)
        mine = ((found.upper == 0) | (found.lower == 0)) & (sign * found.normals[:, 2] > STEEP)
        points = found.points[mine]
        if not len(points):
            return None
        corners = points[hull_corners(points[:, :2], TOUCHING)]
        return _way_out(corners, self.center)

    def turn(self, point: Array, axis: Array) -> None:
        """Turn about an axis until something new is met, at most one step."""
        here = self.motion

        def turned(angle: float) -> Array:
            R = rotation_about(axis, angle)
            return pose(R, point - R @ point) @ here

        def free(angle: float) -> bool:
            return self._lift([p.moved(turned(angle)) for p in self.body.parts]) <= MEETS + angle * TOUCHING

        low, high = 0.0, STEP
        if free(high):
            low = high
        else:
            while high - low > SHARP:
                middle = (low + high) / 2
                low, high = (middle, high) if free(middle) else (low, middle)
            low = high  # the new contact, not the gap before it
        self.motion = turned(low)
        self.turned += low
        self.motion = pose(t=max(0.0, self._lift(self.parts)) * UP) @ self.motion
        self.lower()


def _way_out(corners: Array, center: Array) -> tuple[Array, Array] | None:
    """The nearest side or corner (point, axis) of a support polygon (k, 3) that does not hold the centre."""
    c = center[:2]
    if len(corners) > 2:
        starts, ends = corners[:, :2], np.roll(corners[:, :2], -1, axis=0)
        along = ends - starts
        left = along[:, 0] * (c[1] - starts[:, 1]) - along[:, 1] * (c[0] - starts[:, 0])
        if (left >= -1e-9 * np.linalg.norm(along, axis=1)).all():
            return None
    best, feature = np.inf, (corners[0], corners[0])
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        d = b[:2] - a[:2]
        w = float(np.clip((c - a[:2]) @ d / max(d @ d, 1e-300), 0, 1))
        distance = float(np.linalg.norm(c - a[:2] - w * d))
        if distance < best:
            best, feature = distance, (a, b) if 0 < w < 1 else ((a, a) if w == 0 else (b, b))
    a, b = feature
    axis = b - a
    if not axis.any():  # a corner: the axis is level and across the way to the centre
        axis = np.array([-(c - a[:2])[1], (c - a[:2])[0], 0.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return None
    axis = axis / length
    sinks = np.cross(axis, center - a)[2]  # the centre's vertical speed
    return (a, axis) if sinks < 0 else (a, -axis)
