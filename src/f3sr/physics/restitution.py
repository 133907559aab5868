"""Restitution in MuJoCo: the damping ratio of a contact for a coefficient of restitution (docs: physics).

MuJoCo has no coefficient of restitution, but a contact with a negative ``solref`` is a spring and a dashpot. They push
and never pull, so a body leaves at zero force, before the spring is relaxed. For a head-on impact the remaining speed
has a closed form (Schwager and Poeschel, "Coefficient of restitution and linear-dashpot model revisited", 2007).
"""

from __future__ import annotations

import math

FREQUENCY = 200.0
"""Natural frequency of a bouncing contact [rad/s]: the penetration is speed over frequency, 5 mm at 1 m/s.

At time steps of 1/960 s impacts begin up to a step late. So .85 becomes .84 to .85, .6 becomes .57 to .6, .3 becomes
.24 to .29. Stiffer contacts are less accurate (500: .85 becomes .83, .3 becomes .19)."""


def restitution_of(damping_ratio: float) -> float:
    """The coefficient of restitution of a contact with a damping ratio in [0, 1)."""
    z, w = damping_ratio, math.sqrt(1 - damping_ratio**2)
    return math.exp(-z / w * math.atan2(2 * z * w, 2 * z * z - 1)) if z else 1.0


LEAST = math.exp(-2.0)
"""Restitution at critical damping. Objects with less have MuJoCo's usual contact, whose restitution is 0."""


def damping_ratio_of(restitution: float) -> float:
    """The damping ratio for a coefficient of restitution in (LEAST, 1]. Raises ValueError outside of it."""
    if not LEAST < restitution <= 1:
        raise ValueError(f"a restitution above {LEAST:.3f} and at most 1, not {restitution}")
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if restitution_of(middle) > restitution else (low, middle)
    return low


def solref(restitution: float) -> tuple[float, float] | None:
    """MuJoCo's ``solref`` (minus stiffness [1/s2], minus damping [1/s]) for a restitution; None up to LEAST."""
    if restitution <= LEAST:
        return None
    return -(FREQUENCY**2), -2 * damping_ratio_of(restitution) * FREQUENCY
