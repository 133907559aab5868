"""Bodies brought to rest without a simulator: they lie down, are shifted where they would fall, and lie down again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.balancing import DEFAULT_BALANCE, BalanceConfig, balance
from f3sr.bodies import StaticBody
from f3sr.frames import Array, pose
from f3sr.landing import DEFAULT_LANDING, LandingConfig, land_all
from f3sr.physics import DEFAULT_PHYSICS
from f3sr.statics import Stability, stability

ROUNDS = 3
"""Of lying down and shifting; the first does nearly all."""
STILL = 1e-5
"""Turn or shift [rad, m] of a whole round that counts as none."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Rested:
    """How bodies were moved to stand."""

    motions: Mapping[int, Array]
    """(4, 4) rigid motion of the world per id."""
    before: Stability
    after: Stability
    tipped: frozenset[int]
    """Bodies that would have had to turn or drop too far to lie down; they were left as they were."""


def rest(
    bodies: Sequence[StaticBody],
    supports: Mapping[int, int | None],
    landing: LandingConfig = DEFAULT_LANDING,
    balancing: BalanceConfig = DEFAULT_BALANCE,
    *,
    clearance: float = 4e-4,
    weights: Mapping[int, Array] | None = None,
    max_shifts: Mapping[int, float] | None = None,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
) -> Rested:
    """Turn bodies onto their supports, then shift those that fall, until nothing changes; arguments as of ``land_all``
    and ``balance``. ``max_shifts`` bounds what is shifted in each round."""
    start = {b.id: b for b in bodies}
    motions = {b.id: np.eye(4) for b in bodies}
    tipped: frozenset[int] = frozenset()
    for _ in range(ROUNDS):
        now = [b.moved(motions[b.id]) for b in bodies]
        landed = land_all(now, supports, landing, clearance=clearance, ground_friction=ground_friction)
        now = [b.moved(landed.motions[b.id]) for b in now]
        balanced = balance(
            now,
            supports,
            balancing,
            clearance=clearance,
            weights=weights,
            max_shifts=max_shifts,
            ground_friction=ground_friction,
        )
        tipped = frozenset(id for id, x in landed.landings.items() if x.tipped)
        changed = max((float(np.abs(T - np.eye(4)).max()) for T in landed.motions.values()), default=0.0)
        motions = {id: pose(t=balanced.shifts[id]) @ landed.motions[id] @ T for id, T in motions.items()}
        if (balanced.success and not tipped) or (changed < STILL and not balanced.rounds):
            break
    return Rested(
        motions=motions,
        before=stability(bodies, ground_friction=ground_friction, per_body=False),
        after=stability([start[id].moved(T) for id, T in motions.items()], ground_friction=ground_friction),
        tipped=tipped,
    )
