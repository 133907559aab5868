"""What setting something off may take: what a hand can do, and what a scene of some size calls for."""

from __future__ import annotations

import math

import numpy as np

from f3sr.goals.plan import InitialConditions, Limits
from f3sr.scene import Scene
from f3sr.statics import GRAVITY

HIGHEST = 4.0
"""Diagonals of the scene that a throw rises at most: more is out of any picture."""
FASTEST = 12.0
"""Speed that a hand gives without a run-up [m/s]: an underarm throw of a ball."""
IMPULSE = 60.0
"""Blow of a person [N s]: a thrown medicine ball of 5 kg leaves at 12 m/s."""
FORCE = 400.0
"""Push of a person with both hands [N], for a moment; ISO 11228-2 has 230 to 320 for starting a cart."""


def limits_of(scene: Scene) -> Limits:
    """The limits that suit a scene: speeds that its size calls for, at most a person's."""
    highest = HIGHEST * scene.diagonal
    return Limits(speed=min(FASTEST, math.sqrt(2 * GRAVITY * highest)), impulse=IMPULSE, force=FORCE, lift=highest)


def beyond(initial: InitialConditions, mass: float, limits: Limits) -> str | None:
    """What of the initial conditions of an object of some mass [kg] is beyond the limits, in words."""
    for velocity in initial.velocities:
        speed = float(np.linalg.norm(velocity.linear))
        if speed > limits.speed * (1 + 1e-9):
            return f"a speed of {speed:.1f} m/s, at most {limits.speed:.1f} here"
        if speed * mass > limits.impulse * (1 + 1e-9):
            return f"a blow of {speed * mass:.0f} N s, at most {limits.impulse:.0f}"
    for impulse in initial.impulses:
        blow = float(np.linalg.norm(impulse.linear))
        if impulse.duration == 0 and blow > limits.impulse * (1 + 1e-9):
            return f"a blow of {blow:.0f} N s, at most {limits.impulse:.0f}"
        if impulse.duration > 0 and blow / impulse.duration > limits.force * (1 + 1e-9):
            return f"a push of {blow / impulse.duration:.0f} N, at most {limits.force:.0f}"
    for offset in initial.offsets:
        lift = float(np.linalg.norm(offset.translation))
        if lift > limits.lift * (1 + 1e-9):
            return f"a lift of {lift:.2f} m, at most {limits.lift:.2f} here"
    return None
