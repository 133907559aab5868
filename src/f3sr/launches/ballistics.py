"""How hard to set something off: closed forms of sliding, toppling, flying and bouncing, where a search starts.

Points are world points [m], velocities those of the centre of mass [m/s]. Bodies fly as points without drag; contacts
do the rest, which is why what is found here is only where the search begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.scene import GRAVITY


@dataclass(frozen=True, eq=False, kw_only=True)
class Twist:
    """Velocity (3,) of a centre of mass [m/s] and of turning (3,) [rad/s], both in the world."""

    linear: Array
    angular: Array


def height_speed(height: float) -> float:
    """At which something leaves upwards that rises by a height [m]."""
    return math.sqrt(2 * GRAVITY * height)


def topple(
    corners: Array, center: Array, inertia: Array, mass: float, toward: Array, *, surplus: float
) -> Twist | None:
    """The motion about the edge of its base that takes a body over it, with ``surplus`` times the energy that this
    needs at least; None where its centre already is beyond that edge.

    ``corners`` (n, 3) of all that touches, ``center`` of mass, ``inertia`` (3, 3) about it, in the world; ``toward`` a
    horizontal unit vector. About the edge, with inertia I and the arm r from there to the centre, the energy is
    I w^2 / 2 = m g (|r| - r_z), r without its part along the edge.
    """
    base = corners[corners[:, 2] <= corners[:, 2].min() + 0.02 * np.ptp(corners[:, 2])]
    axis = np.cross([0.0, 0.0, 1.0], toward)
    edge = base[int(np.argmax(base @ toward))]
    arm = center - edge
    arm = arm - (arm @ axis) * axis
    if arm @ toward >= 0:
        return None
    about = float(axis @ inertia @ axis) + mass * float(arm @ arm)
    needed = mass * GRAVITY * (float(np.linalg.norm(arm)) - arm[2])
    spin: Array = math.sqrt(2 * surplus * needed / about) * axis
    return Twist(linear=np.asarray(np.cross(spin, arm), float), angular=spin)


def throw(start: Array, target: Array, apex: float) -> tuple[Array, float]:
    """Velocity (3,) that takes a point over ``apex`` [m], a height above both, down to the target, and how long it
    flies [s]."""
    if apex <= max(start[2], target[2]):
        raise ValueError(f"an apex above {max(start[2], target[2]):.3f} m, not {apex:.3f}")
    up = math.sqrt(2 * GRAVITY * (apex - start[2]))
    seconds = (up + math.sqrt(2 * GRAVITY * (apex - target[2]))) / GRAVITY
    return np.append((target - start)[:2] / seconds, up), seconds


def bounce(start: Array, target: Array, floor: float, restitution: float, apex: float) -> tuple[Array, float]:
    """Velocity (3,) that takes a point to the floor, from which it bounces once, over ``apex`` [m] and down to the
    target; and how long that takes [s]. ``floor``: height of the point when it bounces.

    The bounce gives back ``restitution`` of the vertical speed and leaves the horizontal one. What falls from so high
    that it bounces over the apex anyway is given no speed upwards.
    """
    if not 0 < restitution <= 1 or apex <= max(target[2], floor) or start[2] < floor:
        raise ValueError(f"a restitution in (0, 1] and an apex above {max(target[2], floor):.3f} m")
    drop = start[2] - floor
    needed = 2 * GRAVITY * (apex - floor) / restitution**2
    up = math.sqrt(max(0.0, needed - 2 * GRAVITY * drop))
    down = math.sqrt(up**2 + 2 * GRAVITY * drop)
    off = restitution * down
    first = (up + down) / GRAVITY
    second = (off + math.sqrt(off**2 - 2 * GRAVITY * (target[2] - floor))) / GRAVITY
    return np.append((target - start)[:2] / (first + second), up), first + second
