"""Initial velocities in closed form: sliding, toppling, flying and bouncing, as the start of a search.

Points are world points [m], velocities those of the centre of mass [m/s]. Bodies fly as points without drag. Contacts
are not modelled, so these values only start the search.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.goals.scene_layout import base_of
from f3sr.scene import GRAVITY


@dataclass(frozen=True, eq=False, kw_only=True)
class Twist:
    """``linear`` (3,), the velocity of a centre of mass [m/s], and ``angular`` (3,) [rad/s], both in the world."""

    linear: Array
    angular: Array


def height_speed(height: float) -> float:
    """Speed [m/s] at which something leaves upwards that rises by ``height`` [m], at least 0: v^2 = 2 g h."""
    return math.sqrt(2 * GRAVITY * height)


def topple(
    corners: Array, center: Array, inertia: Array, mass: float, toward: Array, *, surplus: float
) -> Twist | None:
    """The rotation about the edge of its base that topples a body, with ``surplus`` times the least energy.

    None if the centre of mass is already beyond that edge.

    ``corners`` (n, 3) of all colliders, ``center`` of mass, ``inertia`` (3, 3) about it, in the world; ``toward`` is a
    horizontal unit vector. The energy is I w^2 / 2 = m g (|r| - r_z). I is the inertia about the edge, and r the arm
    from the edge to the centre, normal to the edge.
    """
    base = base_of(corners)
    axis = np.cross([0.0, 0.0, 1.0], toward)
    edge = base[int(np.argmax(base @ toward))]
    arm = center - edge
    # Only the part across the axis turns about it.
    arm = arm - (arm @ axis) * axis
    if arm @ toward >= 0:
        return None
    # Parallel axis theorem.
    about = float(axis @ inertia @ axis) + mass * float(arm @ arm)
    needed = mass * GRAVITY * (float(np.linalg.norm(arm)) - arm[2])
    spin: Array = math.sqrt(2 * surplus * needed / about) * axis
    return Twist(linear=np.asarray(np.cross(spin, arm), float), angular=spin)


def throw(start: Array, target: Array, apex: float) -> tuple[Array, float]:
    """Velocity (3,) [m/s] of a flight over ``apex`` [m] down to the target, and its time [s].

    ``start`` and ``target`` (3,) are places of the centre of mass. ``apex`` is a height above both. Raises ValueError
    where it is not."""
    if apex <= max(start[2], target[2]):
        raise ValueError(f"an apex above {max(start[2], target[2]):.3f} m, not {apex:.3f}")
    up = math.sqrt(2 * GRAVITY * (apex - start[2]))
    seconds = (up + math.sqrt(2 * GRAVITY * (apex - target[2]))) / GRAVITY
    return np.append((target - start)[:2] / seconds, up), seconds


def bounce(start: Array, target: Array, floor: float, restitution: float, apex: float) -> tuple[Array, float]:
    """Velocity (3,) [m/s] of a flight to the floor and, after one bounce, over ``apex`` [m] to the target; its time
    [s].

    ``floor`` is the height of the point at the bounce. The bounce returns ``restitution`` of the vertical speed and
    keeps the horizontal one. A fall that bounces over the apex anyway gets no upward speed. Raises ValueError for a
    ``restitution`` outside (0, 1], an ``apex`` not above floor and target, or a start below the floor.
    """
    if not 0 < restitution <= 1 or apex <= max(target[2], floor) or start[2] < floor:
        raise ValueError(f"a restitution in (0, 1] and an apex above {max(target[2], floor):.3f} m")
    drop = start[2] - floor
    # Square of the speed with which it must hit the floor: e v must rise to the apex.
    needed = 2 * GRAVITY * (apex - floor) / restitution**2
    up = math.sqrt(max(0.0, needed - 2 * GRAVITY * drop))
    down = math.sqrt(up**2 + 2 * GRAVITY * drop)
    off = restitution * down
    first = (up + down) / GRAVITY
    second = (off + math.sqrt(off**2 - 2 * GRAVITY * (target[2] - floor))) / GRAVITY
    return np.append((target - start)[:2] / (first + second), up), first + second
