"""Quasi-static tipping: one body turns about its contacts with fixed bodies until its weight is between them.

There is no slip. While the centre of mass is not above the support polygon, the body turns about the polygon's nearest
side or corner. It turns in the direction that lowers the centre, until it meets something new. No mass, friction or
speed enters, so the same start always ends in the same place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact.compounds import Compound, free_travel, smallest_shift
from f3sr.contact.contact_patches import find_contacts, hull_corners
from f3sr.contact.force_balance import Balance
from f3sr.contact.static_bodies import StaticBody, contacts_of
from f3sr.core.transforms import UP, Array, cross, pose, rotation_about, rotation_angle, turn_about
from f3sr.physics.contact_margin import DEFAULT_MARGIN, TOUCHING, ContactMargin
from f3sr.physics.mujoco_model import GROUND_ROLLING_FRICTION
from f3sr.scene import Ground
from f3sr.settings import constants

STEP = np.radians(2.0)
"""Largest turn [rad] between two looks at what is in the way: thin things are not turned through."""
SHARP = 1e-6
"""Turn [rad] to which the next contact is found."""
MEETS = 1e-7
"""Height [m] that a turned body may have to be raised without having met something."""
TRIES = 4
"""Shifts tried before a body that tips is given up."""
EVENTS = 200
"""Most contacts met: a round thing rolls from facet to facet."""
JAMMED = 3
"""So many turns in a row that end where they begin: it is held from the side."""
ROLLING = GROUND_ROLLING_FRICTION / 5
"""A weight so far outside of the contacts [m] does not roll a body over: rolling friction holds it, by a fifth of which
nothing creeps."""
STEEP = 0.2
"""Cosine between up and a contact's normal below which it carries nothing: the body leans there."""


@constants
class LandingConfig:
    """How far a body may go to lie down. What would have to go farther stays where it is. Lengths are shares of its
    size."""

    max_turn: float = 0.5
    """Largest turn on the way [rad]: farther is toppling, not lying down."""
    max_drop: float = 0.5
    """Largest height over what it lies down on."""
    max_shift: float = 0.1
    """Largest shift, before it lies down, of a body that would tip over an edge."""
    margin: float = 0.03
    """Tangent of the tilt that a body bears at that edge after the shift."""


DEFAULT_LANDING = LandingConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class Landing:
    """Where a body comes to lie."""

    T: Array
    """(4, 4) rigid motion of the world that takes it there."""
    turn: float
    """Angle [rad] between its orientations before and after."""
    shift: float
    """Horizontal shift [m] before it came down."""
    stands: bool
    """It is balanced there by friction."""
    tipped: bool
    """It would have gone farther than allowed; ``T`` then leaves it where it was."""


def land(
    body: StaticBody,
    surroundings: Sequence[StaticBody],
    config: LandingConfig = DEFAULT_LANDING,
    *,
    contact: ContactMargin = DEFAULT_MARGIN,
    ground_friction: float = Ground.friction,
) -> Landing:
    """Lower a body onto what is below, and let it turn until it is supported, a clearance above it.

    Where it would tip over an edge it is shifted over it, as far as ``config`` allows, and tried again.
    """
    shift = np.zeros(2)
    around = _in_reach(body, surroundings, config)
    for _ in range(TRIES):
        fall = _Fall(body, around, ground_friction, shift)
        if fall.lie_down(config):
            fall.rise(contact.clearance)
            T = fall.motion
            length = float(np.linalg.norm(shift))
            return Landing(
                T=T, turn=rotation_angle(T[:3, :3]), shift=length, stands=fall.stands(contact.reach), tipped=False
            )
        shift = shift + fall.way_in(config.margin)
        if not fall.missing or np.linalg.norm(shift) > config.max_shift * body.size:
            break
    return Landing(T=np.eye(4), turn=0.0, shift=0.0, stands=False, tipped=True)


def _in_reach(body: StaticBody, surroundings: Sequence[StaticBody], config: LandingConfig) -> list[StaticBody]:
    """The surroundings with only those parts that a body may meet: a turn takes no point of it farther than angle times
    size."""
    reach = (config.max_shift + config.max_turn + STEP) * body.size
    low, high = body.parts.bounds[:, :2]
    found: list[StaticBody] = []
    for b in surroundings:
        boxes = b.parts.boxes[:, :, :2]
        near = np.flatnonzero(((boxes[:, 0] <= high + reach) & (boxes[:, 1] >= low - reach)).all(1))
        if len(near):
            found.append(replace(b, parts=b.parts.some(near)))
    return found


class _Fall:
    """A body on its way, and what is held still around it."""

    def __init__(
        self, body: StaticBody, surroundings: Sequence[StaticBody], ground_friction: float, shift: Array
    ) -> None:
        self.body = body
        self.surroundings = [replace(b, fixed=True) for b in surroundings]
        self.around = Compound.of(b.parts for b in surroundings)
        self.ground_friction = ground_friction
        self.motion = pose(t=np.r_[shift, 0.0])
        self.turned = 0.0
        self.missing: list[tuple[float, Array]] = []
        """Per pivot: how high the centre of mass was above it [m], and its horizontal way (2,) to it [m]."""

    @property
    def motion(self) -> Array:
        """(4, 4) from the start to where it is."""
        return self._motion

    @motion.setter
    def motion(self, T: Array) -> None:
        self._motion, self.parts = T, self.body.parts.moved(T)

    def _raise(self, height: float) -> None:
        if height:
            self.motion = pose(t=height * UP) @ self.motion

    def lie_down(self, config: LandingConfig) -> bool:
        """Come down and turn until supported; False where that is farther than allowed."""
        farthest = config.max_drop * self.body.size
        self.rise(0.0)
        if self.motion[2, 3] > farthest or self.lower() > farthest:
            return False
        jammed = 0
        for _ in range(EVENTS):
            if (pivot := self.pivot()) is None or jammed == JAMMED:
                return True
            point, axis = pivot
            # Horizontal and at right angles to the axis: the way that the centre lacks.
            across = cross(UP, axis)
            across /= max(float(np.linalg.norm(across)), 1e-12)
            arm = self.center - point
            self.missing.append((float(arm[2]), -float(arm @ across) * across[:2]))
            jammed = 0 if self.turn(point, axis) > 2 * SHARP else jammed + 1
            if self.turned > config.max_turn:
                return False
        return False

    def way_in(self, margin: float) -> Array:
        """The shift (2,) that would have brought the centre over the nearest pivot, and by the margin inside it."""
        if not self.missing:
            return np.zeros(2)
        height, way = min(self.missing, key=lambda m: float(np.linalg.norm(m[1])))
        length = float(np.linalg.norm(way))
        # Over the pivot, and on by margin times height: then a tilt of that tangent is borne.
        return way * (1 + margin * max(height, 0.0) / length) if length > 1e-9 else np.zeros(2)

    @property
    def center(self) -> Array:
        return self.motion[:3, :3] @ self.body.centers[0] + self.motion[:3, 3]

    def lower(self) -> float:
        """Bring it down until it touches, and say how far."""
        drop = min(self.parts.lowest, free_travel(self.parts, self.around, -UP))
        self._raise(-drop)
        return drop

    def rise(self, clearance: float) -> None:
        """Raise it until it is free of everything with the clearance."""
        self._raise(max(0.0, self._lift(self.parts, clearance)))

    def _lift(self, parts: Compound, clearance: float = 0.0) -> float:
        return max(smallest_shift(parts, self.around, UP, clearance), clearance - parts.lowest)

    def stands(self, reach: float) -> bool:
        """Whether forces at contacts within reach, with friction, balance it."""
        everything = [self.body.moved(self.motion), *self.surroundings]
        contacts = contacts_of(everything, reach=reach)
        return Balance(everything[:1], everything, contacts, self.ground_friction).stands()

    def pivot(self) -> tuple[Array, Array] | None:
        """A point and a unit axis to turn about so that the centre of mass sinks; None when it is supported."""
        found = find_contacts({0: self.parts, 1: self.around} if self.around else {0: self.parts}, reach=TOUCHING)
        # Normals point from lower to upper: the sign makes them push the body.
        sign = np.where(found.upper == 0, 1.0, -1.0)
        mine, upward = (found.upper == 0) | (found.lower == 0), sign * found.normals[:, 2]
        points = found.points[mine & (upward > STEEP)]
        if not len(points):
            return None
        corners = points[hull_corners(np.ascontiguousarray(points[:, :2]), TOUCHING)]
        out = _way_out(corners, self.center, ROLLING)
        # A wall may hold what would tip: only then are forces and friction asked.
        leans = bool((mine & (np.abs(upward) <= STEEP)).any())
        return None if out is None or (leans and self.stands(TOUCHING)) else out

    def _may_meet(self, point: Array) -> Compound:
        """The body's parts, where it starts, that may meet something in a step about a point (3,): their boxes, wider
        by how far they go, reach it."""
        boxes = self.parts.boxes
        far = np.linalg.norm(np.maximum(np.abs(boxes[:, 0] - point), np.abs(boxes[:, 1] - point)), axis=1)
        low, high = boxes[:, 0] - STEP * far[:, None], boxes[:, 1] + STEP * far[:, None]
        meets = low[:, 2] <= 0
        if self.around:
            others = self.around.boxes
            meets |= ((low[:, None] <= others[None, :, 1]) & (high[:, None] >= others[None, :, 0])).all(-1).any(1)
        return self.body.parts.some(np.flatnonzero(meets))

    def turn(self, point: Array, axis: Array) -> float:
        """Turn about an axis until something new is met, at most one step; how far."""
        here, meeting = self.motion, self._may_meet(point)

        def turned(angle: float) -> Array:
            return turn_about(point, rotation_about(axis, angle)) @ here

        def excess(angle: float) -> float:
            """How much higher than tolerated it must be raised after a turn [m]."""
            T = turned(angle)
            return self._lift(meeting.moved(T)) - MEETS - angle * TOUCHING

        low = _first_meeting(excess) if meeting else STEP
        self.motion = turned(low)
        self.turned += low
        self.rise(0.0)
        self.lower()
        return low


def _first_meeting(excess: Callable[[float], float]) -> float:
    """The turn up to ``STEP`` at which something new is met, to ``SHARP``: just in it, not before it.

    Bisection; where the excess is known at two turns beyond the meeting, the line through them says where to look.
    """
    low, high = 0.0, STEP
    if (beyond := excess(high)) <= 0:
        return high
    guess, reach = None, SHARP
    while high - low > SHARP:
        middle = (low + high) / 2 if guess is None else min(max(guess, low + SHARP / 2), high - SHARP / 2)
        if (found := excess(middle)) <= 0:
            low, guess = middle, None if guess is None else middle + reach
            reach *= 8
        else:
            slope = (beyond - found) / (high - middle)
            high, beyond = middle, found
            guess = high - found / slope - SHARP / 2 if slope > 0 else None
            reach = SHARP
    return high


def _way_out(corners: Array, center: Array, rolling: float) -> tuple[Array, Array] | None:
    """The nearest side or corner (point, axis) of a support polygon (k, 3) to a centre outside it.

    None where the centre is inside or within ``rolling`` [m] of it."""
    c = center[:2]
    if len(corners) > 2:
        starts, ends = corners[:, :2], np.roll(corners[:, :2], -1, axis=0)
        along = ends - starts
        # Corners run counter-clockwise: inside is to the left of every side.
        left = along[:, 0] * (c[1] - starts[:, 1]) - along[:, 1] * (c[0] - starts[:, 0])
        if (left >= -1e-9 * np.linalg.norm(along, axis=1)).all():
            return None
    best, feature = np.inf, (corners[0], corners[0])
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        d = b[:2] - a[:2]
        # Share of the way along the side to its point nearest to the centre; 0 and 1 are its corners.
        w = float(np.clip((c - a[:2]) @ d / max(d @ d, 1e-300), 0, 1))
        distance = float(np.linalg.norm(c - a[:2] - w * d))
        if distance < best:
            best, feature = distance, (a, b) if 0 < w < 1 else ((a, a) if w == 0 else (b, b))
    if best <= rolling:
        return None
    a, b = feature
    axis = b - a
    if not axis.any():  # a corner: the axis is level and across the way to the centre
        axis = np.array([-(c - a[:2])[1], (c - a[:2])[0], 0.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return None
    axis = axis / length
    sinks = cross(axis, center - a)[2]  # the centre's vertical speed
    return (a, axis) if sinks < 0 else (a, -axis)
