"""Bouncing in MuJoCo: the damping of a contact that gives back a share of the speed.

MuJoCo has no coefficient of restitution, but a contact whose ``solref`` is negative is a spring and a dashpot. They
push and never pull, so a body leaves when the force is nothing, not when the spring is relaxed; for a head-on impact
the speed that is left follows in closed form (Schwager and Poeschel, "Coefficient of restitution and linear-dashpot
model revisited", 2007).
"""

from __future__ import annotations

import math

FREQUENCY = 200.0
"""Natural frequency of a bouncing contact [rad/s]: things sink in by speed over frequency, 5 mm at 1 m/s. At time steps
of 1/960 s impacts begin up to a step late, and .85 comes out as .84 to .85, .6 as .57 to .6, .3 as .24 to .29. Stiffer
contacts miss by more (500: .85 as .83, .3 as .19)."""


def restitution_of(damping_ratio: float) -> float:
    """The share of the speed that a contact with a damping ratio in [0, 1) gives back."""
    z, w = damping_ratio, math.sqrt(1 - damping_ratio**2)
    return math.exp(-z / w * math.atan2(2 * z * w, 2 * z * z - 1)) if z else 1.0


LEAST = math.exp(-2.0)
"""What critical damping gives back; what bounces less has MuJoCo's usual contact, which gives back nothing."""


def damping_ratio_of(restitution: float) -> float:
    """The damping ratio that gives back a share of the speed in (LEAST, 1]."""
    if not LEAST < restitution <= 1:
        raise ValueError(f"a restitution above {LEAST:.3f} and at most 1, not {restitution}")
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if restitution_of(middle) > restitution else (low, middle)
    return low


def solref(restitution: float) -> tuple[float, float] | None:
    """MuJoCo's ``solref`` (minus stiffness [1/s2], minus damping [1/s]) of what bounces; None for what hardly does."""
    if restitution <= LEAST:
        return None
    return -(FREQUENCY**2), -2 * damping_ratio_of(restitution) * FREQUENCY
