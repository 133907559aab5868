"""Whether resting bodies stand, by how much, and who carries whom: balance of contact forces against gravity.

Bodies stand when forces at their contacts, each within its friction cone, balance every body's weight. Bodies that
touch only what is fixed do not act on each other and are judged apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.bodies import StaticBody, contacts_of, islands, rigid
from f3sr.equilibrium import Balance
from f3sr.frames import Array
from f3sr.patches import Contacts
from f3sr.physics import DEFAULT_PHYSICS
from f3sr.scene import GROUND

GRAVITY = 9.81
"""[m/s2]; only loads depend on it."""


@dataclass(frozen=True, kw_only=True)
class Stability:
    """Whether bodies stand, and how well. Angles in radians."""

    margin: float
    """The least tilt of gravity at which something moves. Negative when something moves without: so much tilt, the
    other way, would balance it, ``FALLS`` when none would. pi / 2 when nothing can move."""
    margins: Mapping[int, float]
    """The same for every body with what it carries, as one rigid thing, on its own supports held still."""
    moving: frozenset[int]
    """Bodies that move without tilt; empty when the scene stands."""
    first: frozenset[int]
    """Bodies that move first when gravity tilts by the margin."""
    needs_friction: bool
    """The scene stands, but would not without friction."""

    @property
    def stands(self) -> bool:
        return not self.moving


def stability(
    bodies: Sequence[StaticBody],
    contacts: Contacts | None = None,
    *,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
    per_body: bool = True,
) -> Stability:
    """Whether the bodies stand, by what margin, and what moves. Without ``per_body`` no margins of single bodies."""
    contacts = contacts_of(bodies) if contacts is None else contacts
    margin, first = np.pi / 2, frozenset[int]()
    moving: set[int] = set()
    margins: dict[int, float] = {}
    needs_friction = False
    for group in islands(bodies, contacts):
        balance = Balance(group, bodies, contacts, ground_friction)
        least, leaders = balance.margin()
        if len(group) == 1:
            margins[group[0].id] = least
        if least < margin:
            margin, first = least, leaders
        if least < 0:
            moving |= balance.moving()
        elif not needs_friction:
            needs_friction = not Balance(group, bodies, contacts, 0.0, friction=0.0).stands()
    if per_body:
        forces = contact_forces(bodies, contacts, ground_friction=ground_friction)
        stacked = [b for b in bodies if not b.fixed and b.id not in margins]
        margins |= _single_margins(stacked, bodies, contacts, forces, ground_friction)
    return Stability(
        margin=margin,
        margins=margins if per_body else {},
        moving=frozenset(moving),
        first=first,
        needs_friction=needs_friction and not moving,
    )


def stands(
    bodies: Sequence[StaticBody],
    contacts: Contacts | None = None,
    *,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
) -> bool:
    """Whether the bodies stand under untilted gravity: one linear programme per island, the quickest answer."""
    contacts = contacts_of(bodies) if contacts is None else contacts
    return all(Balance(group, bodies, contacts, ground_friction).stands() for group in islands(bodies, contacts))


def contact_loads(
    bodies: Sequence[StaticBody],
    contacts: Contacts | None = None,
    *,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
) -> dict[tuple[int, int], float]:
    """Who carries whom: (carried, carrier) to the net upward force [N], as ``physics.contact_loads`` says it of a
    simulated state. Where several distributions balance, the one of least squares, as of equally soft contacts."""
    contacts = contacts_of(bodies) if contacts is None else contacts
    forces = contact_forces(bodies, contacts, ground_friction=ground_friction)
    loads: dict[tuple[int, int], float] = {}
    for a, b, up in zip(contacts.upper.tolist(), contacts.lower.tolist(), forces[:, 2].tolist(), strict=True):
        loads[a, b] = loads.get((a, b), 0.0) + up
        loads[b, a] = loads.get((b, a), 0.0) - up
    least = 1e-6 * GRAVITY * min((b.mass for b in bodies), default=0.0)
    return {(a, b): force for (a, b), force in loads.items() if force > least and a != GROUND}


def contact_forces(
    bodies: Sequence[StaticBody],
    contacts: Contacts,
    *,
    tilt: tuple[float, float] = (0.0, 0.0),
    center: int = 0,
    ground_friction: float = DEFAULT_PHYSICS.ground_friction[0],
) -> Array:
    """Forces (k, 3) [N] on the upper bodies: those of least squares that balance gravity, tilted by tangents ``tilt``.

    Where none balance, they leave the least unbalanced.
    """
    forces = np.zeros((len(contacts), 3))
    for group in islands(bodies, contacts):
        balance = Balance(group, bodies, contacts, ground_friction)
        forces[balance.rows] = balance.forces(np.array(tilt), center)
    return GRAVITY * forces


# Single bodies with what they carry


def _single_margins(
    asked: Sequence[StaticBody],
    bodies: Sequence[StaticBody],
    contacts: Contacts,
    forces: Array,
    ground_friction: float,
) -> dict[int, float]:
    """Per body asked for: the margin of it and all that it carries as one rigid thing, on what carries them held still.

    Contacts that press on that thing from above hold it no better and are left out.
    """
    load_on = _load_on(contacts, forces)
    margins: dict[int, float] = {}
    for b in asked:
        members = {b.id, *load_on(b.id)}
        whole = rigid([m for m in bodies if m.id in members], b.id)
        inner = np.isin(contacts.upper, list(members)) & np.isin(contacts.lower, list(members))
        upward = np.where(np.isin(contacts.upper, list(members)), 1, -1) * contacts.normals[:, 2] > -1e-3
        outer = contacts.of(~inner & upward)
        named = replace(
            outer,
            upper=np.where(np.isin(outer.upper, list(members)), b.id, outer.upper),
            lower=np.where(np.isin(outer.lower, list(members)), b.id, outer.lower),
        )
        margins[b.id] = Balance([whole], bodies, named, ground_friction).margin()[0]
    return margins


def _load_on(contacts: Contacts, forces: Array) -> Callable[[int], set[int]]:
    """A function from an id to the ids it carries, directly or not: those with at least half their load on it."""
    up: dict[tuple[int, int], float] = {}
    for a, b, force in zip(contacts.upper.tolist(), contacts.lower.tolist(), forces[:, 2].tolist(), strict=True):
        carried, carrier = (a, b) if force > 0 else (b, a)
        up[carried, carrier] = up.get((carried, carrier), 0.0) + abs(force)
    total: dict[int, float] = {}
    for (a, _), force in up.items():
        total[a] = total.get(a, 0.0) + force
    on: dict[int, list[int]] = {}
    for (a, b), force in up.items():
        if force >= 0.5 * total[a] and a != GROUND:
            on.setdefault(b, []).append(a)

    def all_on(id: int) -> set[int]:
        found: set[int] = set()
        waiting = [id]
        while waiting:
            new = [c for c in on.get(waiting.pop(), []) if c not in found and c != id]
            found.update(new)
            waiting.extend(new)
        return found

    return all_on
