"""Whether resting bodies stand, and by how much: balance of contact forces against gravity.

Bodies stand when forces at their contacts, each within its friction cone, balance every body's weight. Bodies that
touch only what is fixed do not act on each other and are judged apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.contact.contact_patches import Contacts
from f3sr.contact.force_balance import Balance
from f3sr.contact.static_bodies import StaticBody, contacts_of, islands
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import Ground


@dataclass(frozen=True, kw_only=True)
class Stability:
    """Whether bodies stand, and how well. Angles in radians."""

    margin: float
    """The least tilt of gravity at which something moves. Negative when something moves without: so much tilt, the
    other way, would balance it, ``FALLS`` when none would. pi / 2 when nothing can move."""
    moving: frozenset[int]
    """Bodies that move without tilt; empty when the scene stands."""

    @property
    def stands(self) -> bool:
        """Whether nothing moves under untilted gravity."""
        return not self.moving


def stability(
    bodies: Sequence[StaticBody],
    contacts: Contacts | None = None,
    *,
    reach: float = DEFAULT_MARGIN.reach,
    ground_friction: float = Ground.friction,
) -> Stability:
    """Whether the bodies stand, by what margin, and what moves; contacts are found within ``reach`` [m]."""
    contacts = contacts_of(bodies, reach=reach) if contacts is None else contacts
    margin, moving = np.pi / 2, frozenset[int]()
    for group in islands(bodies, contacts):
        balance = Balance(group, bodies, contacts, ground_friction)
        least = balance.margin()
        margin = min(margin, least)
        if least < 0:
            moving |= balance.moving()
    return Stability(margin=margin, moving=moving)


def stands(
    bodies: Sequence[StaticBody],
    contacts: Contacts | None = None,
    *,
    reach: float = DEFAULT_MARGIN.reach,
    ground_friction: float = Ground.friction,
) -> bool:
    """Whether the bodies stand under untilted gravity: one linear programme per island, the quickest answer."""
    contacts = contacts_of(bodies, reach=reach) if contacts is None else contacts
    return all(Balance(group, bodies, contacts, ground_friction).stands() for group in islands(bodies, contacts))
