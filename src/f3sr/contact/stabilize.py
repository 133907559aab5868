"""The smallest shifts that make bodies stable: contact forces and shifts in one linear programme, repeated.

The weight of an unbalanced body acts beyond its contacts. Shifts of the bodies move weights, and contact points follow
the bodies on whose edges they lie. To first order the equations of balance are therefore linear in forces and shifts
together. The programme finds the smallest weighted shifts that balance gravity tilted by the margin in all directions.
Then every body is placed on its support again and contacts are found again, until all are stable.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from f3sr.contact.compounds import Compound, collide, forbidden_polygons, free_travel, smallest_shift
from f3sr.contact.force_balance import Balance, Eased
from f3sr.contact.linear_programme import LinearProgramme
from f3sr.contact.static_bodies import StaticBody, contacts_of, islands
from f3sr.core.support_forest import carried, chain_below, supports_first
from f3sr.core.transforms import UP, Array, pose
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.scene import Ground
from f3sr.settings import constants

DIRECTIONS = 6
"""Directions of tilted gravity. Their hexagon holds the circle of the margin, so that all tilts in it are balanced
too."""
CONE_EDGES = 4
"""Edges of friction pyramids while shifts are sought: fewer edges have less friction, so this is on the safe side."""
SIDES = 16
"""Sides of the polygons that stand for circles of shifts."""
CUTS = 12
"""How often a programme is solved at most: each time the polygons that measure shifts get a side where the last one
ended, until they measure right."""
EXACT = 1e-3
"""Share of a shift's cost that its polygon may miss."""
SEATED = 1e-7
"""Heights [m] that differ by less are the same: ten times what rounding leaves of a clearance."""
UNBALANCED = 1e3
"""What a wrench that is left unbalanced costs against shifts, in weights and sizes."""
BALANCED = 1e-5
"""Wrench [weights and sizes] that counts as none."""
BETTER = 0.99
"""Share of the unbalanced wrench that a round must be below to be worth it."""


@constants
class BalanceConfig:
    """How bodies are shifted until they stand. Lengths are shares of a body's size."""

    margin: float = 0.03
    """Least tilt of gravity [rad] that bodies bear after shifts: what proxies and masses are wrong by."""
    max_shift: float = 0.15
    """Largest shift, where the caller sets none."""
    max_step: float = 0.08
    """Largest shift of a body against its support in one round, after which contacts are found anew."""
    rounds: int = 10
    """Most rounds of shifts."""
    most_bodies: int = 16
    """Most bodies of an island that is shifted. Time grows with the cube of their number, 1 s a round for 16."""


DEFAULT_BALANCE = BalanceConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class Balanced:
    """Where the bodies are to be shifted, and how they stand then."""

    shifts: Mapping[int, Array]
    """(3,) [m] of every body that moves; zero for the others."""
    after: float
    """Margin of the whole scene [rad], as in ``Stability``."""
    unbalanced: frozenset[int]
    """Bodies that move without tilt even after the shifts."""
    below_margin: frozenset[int]
    """Bodies on islands that stand, but by less than the wanted margin."""
    rounds: int
    """Rounds of shifts that were made."""

    @property
    def success(self) -> bool:
        """Whether all bodies stand with the wanted margin."""
        return not self.unbalanced and not self.below_margin


def balance(
    bodies: Sequence[StaticBody],
    supports: Mapping[int, int | None],
    config: BalanceConfig = DEFAULT_BALANCE,
    *,
    contact: ContactMargin = DEFAULT_MARGIN,
    weights: Mapping[int, Array] | None = None,
    max_shifts: Mapping[int, float] | None = None,
    ground_friction: float = Ground.friction,
) -> Balanced:
    """Shift bodies, each with its subtree, so that all are stable with the margin.

    ``supports``: the main support of every body, GROUND or None. ``weights``: a positive definite W (2, 2) per id. d' W
    d is the cost of a shift d [m] in x and y; the default is 1 / size^2. ``max_shifts`` [m] per id are bounds. The sum
    of the square roots of the costs is minimised, so few bodies move. Raises ValueError for a weight that is not
    positive definite.
    """
    state = _State(bodies, supports, config, contact, weights or {}, max_shifts or {}, ground_friction)
    state.seat_all()
    rounds = 0
    seated = dict(state.bodies), dict(state.shifts)
    while rounds < config.rounds and state.improve():
        rounds += 1
    if rounds:
        state.undo_in_vain(*seated)
    return state.result(rounds)


class _State:
    """Bodies while they are being shifted."""

    def __init__(
        self,
        bodies: Sequence[StaticBody],
        supports: Mapping[int, int | None],
        config: BalanceConfig,
        contact: ContactMargin,
        weights: Mapping[int, Array],
        max_shifts: Mapping[int, float],
        ground_friction: float,
    ) -> None:
        self.bodies = {b.id: b for b in bodies}
        self.supports = {b.id: supports.get(b.id) for b in bodies}
        self.config = config
        self.contact = contact
        self.ground_friction = ground_friction
        self.roots = {b.id: _root(weights.get(b.id, np.eye(2) / b.size**2)) for b in bodies}
        self.bounds = {b.id: max_shifts.get(b.id, config.max_shift * b.size) for b in bodies}
        self.shifts = {b.id: np.zeros(3) for b in bodies}
        self.order = supports_first(self.supports)
        self.open = set(self.bodies)
        """Bodies on islands that may not stand."""
        self.overlapping = {pair for pair in combinations(self.bodies, 2) if self.collide(*pair)}

    def move(self, ids: frozenset[int] | tuple[int, ...], t: Array) -> None:
        for id in ids:
            if not self.bodies[id].fixed:
                self.bodies[id] = self.bodies[id].moved(pose(t=t))
                self.shifts[id] = self.shifts[id] + t

    def collide(self, a: int, b: int) -> bool:
        return collide(self.bodies[a].parts, self.bodies[b].parts)

    def beside(self, ids: Sequence[int]) -> Iterator[tuple[int, int, Array]]:
        """Pairs of bodies, one of ``ids``, that shifts could bring together, and the sides (k, 3) to stay beyond.

        Rows ``(n, h)``: the first's shift less the second's must keep ``n . x + h <= 0``.
        """
        for a, b in combinations(self.bodies, 2):
            if (a not in ids and b not in ids) or (a, b) in self.overlapping:
                continue
            far = self.config.max_step * (self.bodies[a].size + self.bodies[b].size)
            polygons = forbidden_polygons(self.bodies[a].parts, self.bodies[b].parts, within=far)
            sides = np.array([p[int(np.argmin(p[:, 2]))] for p in polygons]).reshape(-1, 3)
            sides = sides[(sides[:, 2] > -far) & (sides[:, 2] <= 0)]
            if len(sides):
                yield a, b, sides

    def seat_all(self) -> None:
        for id in self.order:
            self.seat(id)

    def seat(self, id: int) -> None:
        """Raise or lower a body, with what it carries, until it rests on its support or on what it meets before."""
        body, ids = self.bodies[id], carried(id, self.supports)
        if body.fixed:
            return
        chain = Compound.of(self.bodies[i].parts for i in chain_below(id, self.supports))
        over_ground = body.parts.lowest - self.contact.clearance
        rise = max(smallest_shift(body.parts, chain, UP, self.contact.clearance), -over_ground)
        if rise <= 0 and self.supports.get(id) is not None:
            others = Compound.of(b.parts for i, b in self.bodies.items() if i not in ids)
            drop = free_travel(body.parts, others, -UP) - self.contact.clearance
            rise = -max(0.0, min(drop, over_ground))
        if abs(rise) > SEATED:
            self.move(ids, rise * UP)

    def improve(self) -> bool:
        """One round: shifts for every island that does not stand with the margin; False when nothing got better."""
        programmes = [p for p in self.programmes(self.open) if p.unbalanced > BALANCED]
        self.open = {id for p in programmes for id in p.ids}
        better = False
        for programme in programmes:
            steps = programme.solve()
            if max(np.abs(d).max() for d in steps.values()) < SEATED:
                continue
            for share in (1.0, 0.5, 0.25, 0.1):
                if self.attempt({id: share * d for id, d in steps.items()}, programme.mean):
                    better = True
                    break
        return better

    def attempt(self, steps: Mapping[int, Array], before: float) -> bool:
        """Shift by horizontal steps (2,) and seat; kept where it balances more, drops nothing and overlaps no more."""
        kept_bodies, kept_shifts = dict(self.bodies), dict(self.shifts)
        for id in self.order:
            if id in steps:
                carrier = next((i for i in chain_below(id, self.supports) if i in steps), None)
                own = steps[id] - (steps[carrier] if carrier is not None else 0.0)
                self.move(carried(id, self.supports), np.r_[own, 0.0])
        self.seat_all()
        dropped = any(abs((self.shifts[i] - kept_shifts[i])[2]) > self.bounds[i] for i in self.bodies)
        overlaps = any(self.collide(*p) for p in combinations(self.bodies, 2) if p not in self.overlapping)
        if not dropped and not overlaps:
            after = max((p.mean for p in self.programmes(steps.keys())), default=0.0)
            if after < max(BETTER * before, BALANCED):
                return True
        self.bodies, self.shifts = kept_bodies, kept_shifts
        return False

    def falling(self) -> list[tuple[tuple[int, ...], frozenset[int]]]:
        """Per island that does not stand: its ids, and those that move."""
        bodies = tuple(self.bodies.values())
        contacts = contacts_of(bodies, reach=self.contact.reach)
        groups = [Balance(g, bodies, contacts, self.ground_friction) for g in islands(bodies, contacts)]
        return [(tuple(g.place), g.moving()) for g in groups if not g.stands()]

    def undo_in_vain(self, bodies: Mapping[int, StaticBody], shifts: Mapping[int, Array]) -> None:
        """Put islands back where they were before any shift if as many of their bodies fall as then."""
        now = self.falling()
        here = dict(self.bodies), dict(self.shifts)
        self.bodies = dict(bodies)
        fell = frozenset[int]().union(*(moving for _, moving in self.falling()))
        self.bodies, self.shifts = here
        for ids, moving in now:
            if len(moving) < len(fell.intersection(ids)):
                continue
            here = dict(self.bodies), dict(self.shifts)
            self.bodies = self.bodies | {id: bodies[id] for id in ids}
            self.shifts = self.shifts | {id: shifts[id] for id in ids}
            if any(self.collide(*p) for p in combinations(self.bodies, 2) if p not in self.overlapping):
                self.bodies, self.shifts = here

    def programmes(self, among: Collection[int] | None = None) -> list[_Programme]:
        """One per island; only those with one of some bodies."""
        bodies = tuple(self.bodies.values())
        contacts = contacts_of(bodies, reach=self.contact.reach)
        groups = [g for g in islands(bodies, contacts) if len(g) <= self.config.most_bodies]
        groups = [g for g in groups if among is None or any(b.id in among for b in g)]
        return [_Programme(Balance(g, bodies, contacts, self.ground_friction, edges=CONE_EDGES), self) for g in groups]

    def result(self, rounds: int) -> Balanced:
        bodies = tuple(self.bodies.values())
        contacts = contacts_of(bodies, reach=self.contact.reach)
        wanted = self.config.margin - 1e-3
        unbalanced: frozenset[int] = frozenset()
        below: frozenset[int] = frozenset()
        margins = [np.pi / 2]
        for group in islands(bodies, contacts):
            balance = Balance(group, bodies, contacts, self.ground_friction)
            margins.append(balance.margin())
            if margins[-1] < 0:
                unbalanced |= balance.moving()
            elif margins[-1] < wanted:
                below |= {b.id for b in group}
        return Balanced(
            shifts=self.shifts,
            after=min(margins),
            unbalanced=unbalanced,
            below_margin=below,
            rounds=rounds,
        )


class _Programme:
    """The linear programme of one island: shifts (2,) per body and forces for every tilt of gravity."""

    def __init__(self, balance: Balance, state: _State) -> None:
        self.balance, self.state = balance, state
        self.ids = [b.id for b in balance.group]
        # The hexagon's corners, so that its sides touch the circle of the margin. Balanced tilts are a convex set.
        reach = np.tan(state.config.margin) / np.cos(np.pi / DIRECTIONS)
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        tilts = reach * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        self.cases = [(tilt, c) for tilt in tilts for c in range(balance.choices)]
        eased, last = list[Eased](), dict[int, Eased]()
        for tilt, c in self.cases:
            last[c] = balance.eased(tilt, c, near=last.get(c))
            eased.append(last[c])
        self.forces = [e.forces for e in eased]
        self.unbalanced = max(e.left for e in eased)
        self.mean = float(np.mean([e.left for e in eased]))

    def solve(self) -> dict[int, Array]:
        """Horizontal steps (2,) [m] per id."""
        from scipy.sparse import block_diag, csc_array, eye_array, hstack

        rows, n = self.balance.wrenches.shape
        count, shifts = len(self.cases), 2 * len(self.ids)
        # Unknowns, in this order: per case n forces and two slacks per row; then 2 shifts a body; then a bound of each
        # body's cost. Per case: wrenches f + slack + moments(shifts) = weights. Shifts are shared by all cases, forces
        # are not.
        slacked = hstack([self.balance.wrenches, eye_array(rows), -eye_array(rows)])
        moved = np.concatenate([self._moments(forces) for forces in self.forces])
        equal = hstack([block_diag([slacked] * count), csc_array(moved), csc_array((len(moved), len(self.ids)))])
        wanted = np.concatenate([w + lean @ tilt for tilt, c in self.cases for w, lean in [self.balance.weights(c)]])
        free = count * (n + 2 * rows)
        slack = np.tile(np.r_[np.zeros(n), np.full(2 * rows, UNBALANCED / count)], count)
        cost = np.r_[slack, np.zeros(shifts), np.ones(len(self.ids))]
        low = np.r_[np.zeros(free), np.full(shifts, -np.inf), np.zeros(len(self.ids))]
        programme = LinearProgramme(cost, equal, wanted, low=low)
        below, limits = self._bounds()
        steps = np.zeros((len(self.ids), 2))
        for _ in range(CUTS):
            programme.add(hstack([csc_array((len(limits), free)), csc_array(below)]), limits)
            solution = programme.solve()
            if solution is None:
                break
            steps = solution.x[free : free + shifts].reshape(-1, 2)
            # The programme measures shifts by polygons around circles: in a corner it thinks them too short.
            told, true = solution.x[free + shifts :], [self._weighed(i, step) for i, step in enumerate(steps)]
            if sum(map(np.linalg.norm, true)) <= told.sum() * (1 + EXACT) + SEATED:
                break
            more = [self._measured(i, toward) for i, toward in enumerate(true)]
            below, limits = np.stack([r for r, _ in more]), np.array([limit for _, limit in more])
        return dict(zip(self.ids, steps, strict=True))

    def _weighed(self, i: int, step: Array) -> Array:
        """The shift of a body after a step, in the measure of its weight."""
        id = self.ids[i]
        return self.state.roots[id] @ (self.state.shifts[id][:2] + step)

    def _measured(self, i: int, toward: Array) -> tuple[Array, float]:
        """The row and limit by which a body's cost is at least its weighed shift along a direction."""
        length = float(np.linalg.norm(toward))
        e = toward / length if length > 1e-9 else np.array([1.0, 0.0])
        row = np.zeros(3 * len(self.ids))
        row[2 * i : 2 * i + 2] = e @ self.state.roots[self.ids[i]]
        row[2 * len(self.ids) + i] = -1
        return row, -float(e @ self._weighed(i, np.zeros(2)))

    def _moments(self, forces: Array) -> Array:
        """(6 n, 2 n): how the wrenches of given forces (k, 3) change with the bodies' shifts."""
        balance = self.balance
        change = np.zeros((len(self.ids), 6, len(self.ids), 2))
        sides = ((balance.contacts.upper.tolist(), 1.0), (balance.contacts.lower.tolist(), -1.0))
        follow = balance.contacts.follow
        for k, force in enumerate(forces):
            # How the contact's point follows each of its two bodies: ``follow`` the upper, the rest the lower.
            points = {ids[k]: f for (ids, _), f in zip(sides, (follow[k], np.eye(3) - follow[k]), strict=True)}
            for ids, sign in sides:
                if (i := balance.place.get(ids[k])) is None:
                    continue
                unit = sign / (balance.masses[i] * balance.sizes[i])
                turning = -_skew(force)  # arm x force = -force x arm
                for id, f in points.items():
                    if (j := balance.place.get(id)) is not None:
                        change[i, 3:, j] += unit * (turning @ f)[:, :2]
                # The moment is about the body's centre, which moves with its own shift.
                change[i, 3:, i] -= unit * turning[:, :2]
        return change.reshape(6 * len(self.ids), 2 * len(self.ids))

    def _bounds(self) -> tuple[Array, Array]:
        """Rows (k, 2 n + n) and limits (k,): costs, farthest shifts, largest steps, and no shift into each other."""
        state, n = self.state, len(self.ids)
        angles = 2 * np.pi * np.arange(SIDES) / SIDES
        around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        rows: list[Array] = []
        limits: list[float] = []

        def bound(parts: Mapping[int, Array], limit: float) -> None:
            row = np.zeros(3 * n)
            for j, part in parts.items():
                row[2 * j : 2 * j + 2] += part
            rows.append(row)
            limits.append(limit)

        for i, id in enumerate(self.ids):
            so_far, size = state.shifts[id][:2], self.balance.sizes[i]
            carrier = next(
                (self.balance.place[c] for c in chain_below(id, state.supports) if c in self.balance.place), None
            )
            # Three circles a body, each as SIDES half-planes: its cost, its whole shift, its step against what carries
            # it.
            for e in around:
                row, limit = self._measured(i, e)
                rows.append(row)
                limits.append(limit)
                bound({i: e}, state.bounds[id] - float(e @ so_far))
                against = {i: e} if carrier is None else {i: e, carrier: -e}
                bound(against, state.config.max_step * size)
        place = self.balance.place
        for a, b, sides in state.beside(self.ids):
            for side in sides:
                bound({place[id]: sign * side[:2] for id, sign in ((a, 1), (b, -1)) if id in place}, -float(side[2]))
        return np.array(rows), np.array(limits)


def _root(W: Array) -> Array:
    """The symmetric square root of a positive definite (2, 2)."""
    values, vectors = np.linalg.eigh(np.asarray(W, float))
    if values[0] <= 0:
        raise ValueError(f"a weight that is positive definite, not one of eigenvalues {values}")
    return vectors @ np.diag(np.sqrt(values)) @ vectors.T


def _skew(v: Array) -> Array:
    """(3, 3): _skew(v) @ w is v x w."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
