"""Bodies brought to rest without a simulator: they lie down, are shifted where they would fall, and lie down again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact.stability import Stability, stability
from f3sr.contact.stabilize import DEFAULT_BALANCE, BalanceConfig, balance
from f3sr.contact.static_bodies import StaticBody, rigid
from f3sr.contact.tipping import DEFAULT_LANDING, Landing, LandingConfig, land
from f3sr.core.support_forest import carried, supports_first
from f3sr.core.transforms import Array, pose
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.scene import Ground

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
    contact: ContactMargin = DEFAULT_MARGIN,
    weights: Mapping[int, Array] | None = None,
    max_shifts: Mapping[int, float] | None = None,
    ground_friction: float = Ground.friction,
) -> Rested:
    """Turn bodies onto their supports, then shift those that fall, until nothing changes; arguments as of ``land_all``
    and ``balance``. ``max_shifts`` bounds what is shifted in each round."""
    start = {b.id: b for b in bodies}
    motions = {b.id: np.eye(4) for b in bodies}
    tipped: frozenset[int] = frozenset()
    for _ in range(ROUNDS):
        now = [b.moved(motions[b.id]) for b in bodies]
        landed = land_all(now, supports, landing, contact=contact, ground_friction=ground_friction)
        now = [b.moved(landed.motions[b.id]) for b in now]
        balanced = balance(
            now,
            supports,
            balancing,
            contact=contact,
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
        before=stability(bodies, ground_friction=ground_friction),
        after=stability([start[id].moved(T) for id, T in motions.items()], ground_friction=ground_friction),
        tipped=tipped,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Landed:
    """Where all bodies come to lie, one after the other."""

    motions: Mapping[int, Array]
    """(4, 4) rigid motion of the world per id."""
    landings: Mapping[int, Landing]
    """How each body came to lie, with what it carries, after all below it had."""


def land_all(
    bodies: Sequence[StaticBody],
    supports: Mapping[int, int | None],
    config: LandingConfig = DEFAULT_LANDING,
    *,
    contact: ContactMargin = DEFAULT_MARGIN,
    ground_friction: float = Ground.friction,
) -> Landed:
    """Land every movable body with what it carries as one rigid thing, supports first, all others held still.

    ``supports``: what each body rests on, None for those that stay where they are with what they carry. What overlaps
    at the start is raised out of it. What tips with its load lies down as it would without, and does not stand.
    """
    now = {b.id: b for b in bodies}
    motions = {b.id: np.eye(4) for b in bodies}
    landings: dict[int, Landing] = {}
    for id in supports_first(supports):
        if now[id].fixed or supports[id] is None:
            continue
        members = {i for i in carried(id, supports) if not now[i].fixed}
        whole = rigid([now[i] for i in sorted(members)], id)
        others = [b for i, b in now.items() if i not in members]
        found = land(whole, others, config, contact=contact, ground_friction=ground_friction)
        if found.tipped and len(members) > 1:  # what it carries lies too far out, which other shifts may mend
            unladen = replace(whole, centers=now[id].centers)
            found = land(unladen, others, config, contact=contact, ground_friction=ground_friction)
            found = replace(found, stands=False)
        landings[id] = found
        for i in members:
            now[i] = now[i].moved(found.T)
            motions[i] = found.T @ motions[i]
    return Landed(motions=motions, landings=landings)
