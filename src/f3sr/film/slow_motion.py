"""Which time a frame shows: the rate of a film, and the samples that slow motion needs."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from f3sr.errors import InputError
from f3sr.goals.plan import Phase
from f3sr.goals.rollout import Rollout
from f3sr.goals.simulate import simulate_phase
from f3sr.scene import Scene

EVEN = 1e-6
"""How much sample times may differ from even ones [s]: the sums of time steps do."""
SAME = 1e-6
"""How much a pose may differ between two plays of a plan, in metres or sines."""
SLOWEST, FASTEST = Fraction(100), Fraction(1, 8)
"""Factors of slow motion; browsers play no slower or faster either."""


def rate_of(rollout: Rollout) -> Fraction:
    """Samples a second; InputError where they are not even."""
    time = np.asarray(rollout.time)
    if len(time) < 2:
        return Fraction(30)
    step = (time[-1] - time[0]) / (len(time) - 1)
    if step <= 0 or np.abs(time - step * np.arange(len(time))).max() > EVEN:
        accepted = "samples at even steps from 0 on, a frame each"
        raise InputError("rollout", found="uneven times", accepted=accepted)
    return (1 / Fraction(float(step))).limit_denominator(1001)


def factor(slow: Fraction | float) -> Fraction:
    """How many times slower than life a film is, as a fraction of small numbers. Raises InputError outside
    FASTEST to SLOWEST."""
    if not (math.isfinite(slow) and FASTEST <= Fraction(slow).limit_denominator(100) <= SLOWEST):
        accepted = f"a factor of {float(FASTEST)} to {SLOWEST}"
        raise InputError("--slow", found=f"{float(slow):g}", accepted=accepted)
    return Fraction(slow).limit_denominator(100)


def finer(scene: Scene, phase: Phase, rollout: Rollout, slow: Fraction | float) -> Rollout:
    """The same motion with so many times more samples that slow motion shows as many frames a second.

    The phase is played again: what happens between two samples is not made up. Raises InputError where it gives another
    motion, as on another machine it may.
    """
    steps = phase.simulation.steps_per_sample
    # The largest divisor of the phase's steps that is short enough: every old sample is then a new one too.
    fine = next((n for n in range(max(1, math.floor(steps / factor(slow))), 0, -1) if steps % n == 0), 1)
    if fine >= steps:
        return rollout
    simulation = phase.simulation.model_copy(update={"steps_per_sample": fine})
    found = simulate_phase(scene, phase.model_copy(update={"simulation": simulation}))
    every = found.T_world_object[:: steps // fine]
    if every.shape != rollout.T_world_object.shape or np.abs(every - rollout.T_world_object).max() > SAME:
        raise InputError(
            "rollout", found="another motion when its plan is played again", accepted="one that was simulated here"
        )
    return found
