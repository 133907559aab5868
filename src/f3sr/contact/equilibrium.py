"""The equilibrium nearest to given poses: contact forces balance all weights, and no body moves without need.

Moves of bodies and the forces of contacts are sought together. A force acts only where bodies touch (complementarity:
force times gap is 0). Small moves x, measured by how well each pose is known, and forces f minimise

    |x|^2 / 2 + rho * sum(f * gap(x))

so that f balances all weights, with gravity tilted a little to several sides, and no bodies overlap. Each of two steps
lowers this sum: the forces of least virtual work for the present gaps (a linear programme), then the moves for these
forces (a least-distance programme). As rho grows, gaps that forces need close (a penalty for a mathematical programme
with complementarity constraints: Ralph and Wright, "Some properties of regularization and penalization schemes for
MPECs", 2004).

Forces act at points that move with the bodies. What that does to the balance is left out at first: as long as gaps
close, they decide. Where the steps come to no end, more of them count it, each halved until the sum falls. The
multipliers of the linear programme tell how the work changes with the arms of forces and weights.

Undersides are guesses, and a footing may fill them in (``contact.footing``). So a body need not turn until it lies on
its own facet. Forces act on the footing as it would be at the present poses, and close the gap of the body itself.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.compounds import Compound
from f3sr.contact.contact_patches import Contacts
from f3sr.contact.crowds import spread
from f3sr.contact.force_balance import Balance
from f3sr.contact.least_norm import nearly, shortest
from f3sr.contact.linear_programme import LinearProgramme
from f3sr.contact.near_contacts import NearContacts, footing_contacts, near_contacts
from f3sr.contact.stabilize import CONE_EDGES
from f3sr.contact.static_bodies import StaticBody
from f3sr.core.pose_uncertainty import PARAMETERS, SHIFT, TURN, motions_along, parameters, similarity
from f3sr.core.transforms import Array, pose
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.physics.release import RELEASE_FRICTION
from f3sr.scene import Ground

TILT = 0.02
"""Tangent of the tilts of gravity that are balanced: what proxies and masses are wrong by."""
TILTS = TILT * np.stack([np.cos(2 * np.pi * np.arange(3) / 3), np.sin(2 * np.pi * np.arange(3) / 3)], axis=1)
UNBALANCED = 0.03
"""Virtual work per unbalanced weight, as a gap [m]: wider ones are not closed."""
UNHELD = 0.01
"""Unbalanced weight from which on contacts below a body are sought farther away."""
NEEDLESS = 1e-7
"""Virtual work per force, as a gap [m], so that no contact pushes without need."""
STEP = 0.03
"""Largest shift in one step, as a share of the body's size: gaps are linear in small moves only."""
TURN_STEP = 0.12
"""Largest turn in one step [rad]."""
FIRST = ((1e2, 1e6),) * 4 + ((1e2, 1e7), (3e2, 1e8))
"""Steps in which deep overlap ends: rho [standard deviations squared per metre and mean weight], and the price of
squared overlap [the same per square metre]."""
RHOS = (1e3, 1e3, 3e3, 3e3, 1e4, 1e4, 1e4, 3e4, 3e4, 3e4, 1e5, 1e5, 1e5, 3e5, 3e5, 3e5)
"""Of the other steps, in which no overlap is allowed."""
BALANCED = 1e-5
"""Virtual work [mean weights times metres] from which on all gaps that forces need count as closed."""
STILL = 5e-5
"""Largest shift [m] of a step after which the search may end."""
ENOUGH = 1e4
"""Least rho with which it may end."""
WORK_COST, OVERLAP_COST = 1e6, 1e5
"""What virtual work that is left [per mean weight and metre] and overlap [1/m] count beside half the squared move.

Where the last steps come to no end, each holds by other contacts and moves farther, so the best of them is taken. With
a thirtieth of the first, 18 of 19 groups end alike, but what has yet to lie down stays tilted."""
DESCENTS = 15
"""Steps that count arms too. In ten groups that came to no end they leave a third of the work in the median."""
FITS = 2e-4
"""Travel [m] up to which a footing is not made anew."""
HOLDS = RELEASE_FRICTION[0]
"""Most friction that forces rely on in the search: a scene must rest with it too."""
TRIED = 1.0
"""Coefficient of friction that tells whether more of it helps. Pyramids of ``CONE_EDGES`` have .71 of it in some
directions, and ``TILTS`` ask for more than physics does."""
FINAL = 1e5
"""Least rho with which footings stay as they are, and keep out of other bodies like all parts."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyMove:
    """x -> T (scale x), ``T`` (4, 4)."""

    T: Array
    scale: float


@dataclass(frozen=True, eq=False, kw_only=True)
class FootedBody:
    """A body that may move, in some pose."""

    body: StaticBody
    """Without its footing."""
    footing: Compound | None
    """In the world; None where none would hold it."""


Footings = Callable[[Mapping[int, BodyMove], bool], Mapping[int, FootedBody]]
"""Gives bodies that may move after some moves, each with its footing there. The flag tells that bodies may still
overlap."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Equilibrium:
    """Where bodies are in balance."""

    moves: Mapping[int, BodyMove]
    """Of every body that may move, from where it was."""
    footed_at: Mapping[int, BodyMove]
    """The moves for which ``footings`` were made last. The bodies stand on those."""
    cost: float
    """Sum of the squared moves, in standard deviations."""
    work: float
    """Virtual work that is left [mean weights times metres]: 0 where all weights are balanced."""
    friction: Mapping[int, float]
    """Larger coefficients of bodies that would slide with theirs, by id."""
    unheld: int | None
    """Where weights are left unbalanced, with more friction too, the body that leaves least of them once something else
    carries it; None where none may be held."""


def nearest_equilibrium(
    bodies: Sequence[StaticBody],
    precisions: Mapping[int, Array],
    *,
    clearance: float = DEFAULT_MARGIN.clearance,
    ground_friction: float = Ground.friction,
    apart: bool = False,
    start: Mapping[int, BodyMove] | None = None,
    footings: Footings | None = None,
    guessed: Collection[int] = (),
    may_hold: Collection[int] = (),
    descends: bool = False,
) -> Equilibrium:
    """Move bodies by little so that they touch where forces must act and balance gravity, without overlap.

    The minimum is a local one. ``apart`` begins where one joint shift has ended all overlap (``crowds.spread``). A body
    deep inside thin parts is then on the side where the others leave it room. Otherwise overlap ends little by little.
    ``start`` are moves to poses at rest, by id: the search begins there and keeps to the contacts that it finds closed.
    ``footings`` are made anew after each step, until rho is large. Without, bodies stand on their parts alone. If the
    last steps come to no end, the best of them counts, or what it ``descends`` to.
    ``guessed``: ids of bodies whose friction is a guess, and may be larger. ``may_hold``: ids of bodies that something
    else may carry.

    ``precisions``: a positive definite (7, 7) per id that may move; the others stay. It is the inverse covariance of a
    shift [m], a rotation vector [rad] and the logarithm of the scale. Turn and scale are about the middle of the
    body's box. What is ``fixed`` and has a precision moves too, but something else than contact carries it.
    """
    search = _EquilibriumSearch(bodies, precisions, clearance, ground_friction, footings)
    if start:
        search.begin(start)
    elif apart:
        search.spread()
    else:
        for rho, price in FIRST:
            search.fit(overlapping=True)
            search.step(rho, price=price, tilts=np.zeros((1, 2)))
    work, best = np.inf, (np.inf, np.inf, search)
    for rho in RHOS:
        if start and rho < ENOUGH:
            continue
        if rho < FINAL:
            search.fit(overlapping=False)
        else:
            search.stand()
        here = search.copied()
        work, shift = search.step(rho, tilts=TILTS)
        if work < BALANCED and shift < STILL and rho >= (FINAL if footings else ENOUGH):
            break
        left = search.left(here.cost, work)
        if rho >= FINAL and left < best[0]:
            best = left, work, here
    else:
        left, work, search = best
        if descends and work >= BALANCED:
            work, search = search.descended(left)
    friction = search.friction_needed(guessed)
    return Equilibrium(
        moves=search.moves,
        footed_at=search.footed_at,
        cost=search.cost,
        work=work,
        friction=friction,
        unheld=search.unheld(may_hold) if work >= BALANCED and not friction else None,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Forces:
    """Contact forces of least virtual work, means over tilts and centres."""

    normal: Array
    """(k,) [mean weights]."""
    work: float
    """[mean weights times metres]."""
    arms: Array
    """(7 n,) how the work changes with x as points of contact and centres of mass move, with gaps as they are; 0 where
    nobody asks."""


class _EquilibriumSearch:
    """Bodies on their way. Moves are scaled so that the cost of x (7 n,) is |x|^2."""

    def __init__(
        self,
        bodies: Sequence[StaticBody],
        precisions: Mapping[int, Array],
        clearance: float,
        ground_friction: float,
        footings: Footings | None,
    ) -> None:
        self.bodies = {b.id: replace(b, fixed=b.id not in precisions) for b in bodies}
        self.held = frozenset(b.id for b in bodies if b.fixed and b.id in precisions)
        """What something else carries."""
        self.ids = [id for id, b in self.bodies.items() if not b.fixed]
        self.places = {id: slice(PARAMETERS * k, PARAMETERS * (k + 1)) for k, id in enumerate(self.ids)}
        self.clearance, self.ground_friction = clearance, min(ground_friction, HOLDS)
        self.middles = {id: self.bodies[id].parts.bounds.mean(0) for id in self.ids}
        # q' W q = |L' q|^2 with W = L L'; in x = L' q the cost is |x|^2, and q = L'^-1 x.
        self.units = {id: np.linalg.inv(np.linalg.cholesky(precisions[id]).T) for id in self.ids}
        self.moves = {id: BodyMove(T=np.eye(4), scale=1.0) for id in self.ids}
        self.x = np.zeros(PARAMETERS * len(self.ids))
        self.hanging = set[int]()
        """What some force could not hold where it was."""
        self.fitted = footings
        self.footings: dict[int, Compound] = {}
        """Those that carry and are no obstacle."""
        self.footed_at = dict(self.moves)
        self.travel = np.inf
        """How far bodies may have moved since then [m]."""
        self.overlapping = True
        """Whether they could overlap then."""
        self.overlap = np.inf
        """Largest lack of clearance before the last step [m]."""

    def left(self, cost: float, work: float) -> float:
        """What a state with this cost and virtual work is from its end; a step from there was the last one."""
        return cost / 2 + WORK_COST * work + OVERLAP_COST * self.overlap

    def descended(self, least: float) -> tuple[float, _EquilibriumSearch]:
        """The virtual work of the best state near this one, and that state; ``least`` is what is ``left`` here."""
        work, best, way, trial = np.inf, self, np.zeros_like(self.x), self.copied()
        for _ in range(DESCENTS):
            here = trial.copied()
            there, shift = trial.step(FINAL, tilts=TILTS, arms=True)
            left = trial.left(here.cost, there)
            if way.any() and left >= least:
                way = way / 2
                trial = best.copied()
                trial._move(way)
                continue
            work, least, best, way = there, left, here, trial.x - here.x
            if work < BALANCED and shift < STILL:
                break
        return work, best

    def copied(self) -> _EquilibriumSearch:
        """The same state, which further steps of this search do not change."""
        twin = copy(self)
        twin.bodies, twin.moves, twin.middles = dict(self.bodies), dict(self.moves), dict(self.middles)
        twin.footings, twin.hanging = dict(self.footings), set(self.hanging)
        return twin

    @property
    def cost(self) -> float:
        return float(self.x @ self.x)

    def fit(self, *, overlapping: bool) -> None:
        """Give bodies the footings for where they are."""
        if not self.fitted or (self.travel < FITS and overlapping == self.overlapping):
            return
        found = self.fitted(self.moves, overlapping)
        self.bodies.update({id: f.body for id, f in found.items()})
        self.footings = {id: f.footing for id, f in found.items() if f.footing}
        self.footed_at, self.travel, self.overlapping = dict(self.moves), 0.0, overlapping

    def stand(self) -> None:
        """Give bodies their last footings, as parts of them."""
        self.fit(overlapping=False)
        self.fitted = None
        for id, footing in self.footings.items():
            body = self.bodies[id]
            self.bodies[id] = replace(body, parts=Compound.of((body.parts, footing)))
        self.footings = {}

    def begin(self, moves: Mapping[int, BodyMove]) -> None:
        """Move all bodies at once."""
        dx = np.zeros_like(self.x)
        for id, place in self.places.items():
            q = parameters(moves[id].T, moves[id].scale, self.middles[id])
            dx[place] = np.linalg.solve(self.units[id], q)
        self._move(dx)

    def spread(self) -> None:
        """Shift all bodies out of overlap at once, with their turns and sizes as they are."""
        inverse = {id: np.asarray(np.linalg.inv(unit), float)[:, SHIFT] for id, unit in self.units.items()}
        weights = {id: to_x.T @ to_x for id, to_x in inverse.items()}
        found = spread({id: b.parts for id, b in self.bodies.items()}, weights, clearance=self.clearance)
        dx = np.zeros_like(self.x)
        for id, place in self.places.items():
            dx[place] = inverse[id] @ found.shifts[id]
        self._move(dx)

    def step(self, rho: float, *, tilts: Array, price: float | None = None, arms: bool = False) -> tuple[float, float]:
        """Forces for the present gaps, then moves for these forces. Returns the virtual work before, and the largest
        shift [m]. ``price``: of squared overlap, where it may be left. ``arms``: whether moves also count how they
        change the arms of forces and weights, as far as that may still lessen the work."""
        own, near, closing = self._near()
        self.overlap = float((self.clearance - own.gaps).max(initial=0.0))
        forces = self._forces(near, tilts, arms=arms)
        rates = self._rates(near.contacts)
        opening = np.column_stack([rates[: len(own.gaps)], self.clearance - own.gaps])
        pull = rho * forces.normal @ rates[closing]
        dx = self._pulled(pull, opening, price)
        if arms:
            far = self._pulled(pull + rho * forces.arms, opening, price)
            slope = pull / rho + forces.arms
            left, gain = forces.work + float(slope @ dx), float(slope @ (dx - far))
            dx = dx + np.clip(left / gain, 0.0, 1.0) * (far - dx) if gain > 0 else dx
        share = min(1.0, *(self._most(id, self.units[id] @ dx[place]) for id, place in self.places.items()))
        return forces.work, self._move(share * dx)

    def _pulled(self, pull: Array, opening: Array, price: float | None) -> Array:
        """(7 n,) the step that minimises |x|^2 / 2 + pull x where gaps stay open: ``opening @ (dx, -1) >= 0``."""
        # |x|^2 / 2 + pull x = |x + pull|^2 / 2 - ..: the shortest y = x + pull.
        rates, least = opening[:, :-1], opening[:, -1]
        rows = np.column_stack([rates, least + rates @ (self.x + pull)])
        y = nearly(rows, price) if price else shortest(rows)
        if y is None:
            y = nearly(rows, FIRST[-1][1])
        return y - pull - self.x

    def friction_needed(self, guessed: Collection[int]) -> Mapping[int, float]:
        """``HOLDS`` for those that are ``guessed`` lower, by id, where not all weights are balanced and more friction
        helps."""
        low = [id for id in guessed if self.bodies[id].friction < HOLDS]
        if not low:
            return {}
        _, near, _ = self._near()
        helps = self._forces(near, TILTS).work >= BALANCED
        helps = helps and self._forces(near, TILTS, dict.fromkeys(low, TRIED)).work < BALANCED
        return dict.fromkeys(low, HOLDS) if helps else {}

    def unheld(self, may_hold: Collection[int]) -> int | None:
        """The body that leaves least virtual work once something else carries it; None where none may be held."""
        free = [id for id in self.ids if id in may_hold and id not in self.held]
        if not free:
            return None
        _, near, _ = self._near()
        return min(free, key=lambda id: self._forces(near, TILTS, held={id}).work)

    def _near(self) -> tuple[NearContacts, NearContacts, NDArray[np.int64]]:
        """Contacts of bodies, the same with those of footings, and by which of the first each gap closes."""
        parts = {id: b.parts for id, b in self.bodies.items()}
        own = near_contacts(parts, self.ids, sorted(self.hanging))
        return own, *footing_contacts(own, self.footings, parts)

    def _move(self, dx: Array) -> float:
        """Move bodies by a step in x. Returns the largest shift [m]."""
        self.x = self.x + dx
        steps = {id: self.units[id] @ dx[place] for id, place in self.places.items()}
        for id, q in steps.items():
            T, scale = similarity(q, self.middles[id])
            whole = pose(scale * T[:3, :3], T[:3, 3])
            self.bodies[id] = self.bodies[id].moved(whole)
            if id in self.footings:
                self.footings[id] = self.footings[id].moved(whole)
            self.middles[id] = self.middles[id] + q[SHIFT]
            was = self.moves[id]
            t = scale * T[:3, :3] @ was.T[:3, 3] + T[:3, 3]
            self.moves[id] = BodyMove(T=pose(T[:3, :3] @ was.T[:3, :3], t), scale=scale * was.scale)
        shifts = {id: float(np.linalg.norm(q[SHIFT])) for id, q in steps.items()}
        turns = {id: float(np.linalg.norm(q[TURN])) for id, q in steps.items()}
        self.travel += max(shifts[id] + turns[id] * self.bodies[id].size for id in steps)
        return max(shifts.values())

    def _most(self, id: int, q: Array) -> float:
        """The share of a move that a step allows."""
        shift, turn = float(np.linalg.norm(q[SHIFT])), float(np.linalg.norm(q[TURN]))
        tiny = np.finfo(float).tiny
        return min(STEP * self.bodies[id].size / max(shift, tiny), TURN_STEP / max(turn, tiny))

    def _forces(
        self,
        near: NearContacts,
        tilts: Array,
        friction: Mapping[int, float] | None = None,
        held: Collection[int] = (),
        *,
        arms: bool = False,
    ) -> _Forces:
        """Contact forces of least virtual work, with what their ``arms`` do to it.

        ``friction``, by id, instead of that of the bodies, of which ``HOLDS`` counts at most. ``held`` ones need no
        force either."""
        from scipy.sparse import eye_array, hstack

        rough = {id: min(b.friction, HOLDS) for id, b in self.bodies.items()} | dict(friction or {})
        bodies = [replace(b, friction=rough[id]) for id, b in self.bodies.items()]
        group = [self.bodies[id] for id in self.ids]
        balance = Balance(group, bodies, near.contacts, self.ground_friction, edges=CONE_EDGES)
        rows, mean = 6 * len(group), float(balance.masses.mean())
        way = np.maximum(near.gaps[balance.rows] - self.clearance, 0.0) + NEEDLESS
        is_free = np.array([id not in self.held and id not in held for id in self.ids])
        unbalanced = np.repeat(UNBALANCED * is_free * balance.masses, 6)
        cost = np.r_[np.repeat(way * balance.units, CONE_EDGES), np.tile(unbalanced, 2)]
        equal = hstack([balance.wrenches, eye_array(rows), -eye_array(rows)], format="csc")
        normal, by_arms, left, work = np.zeros(len(near.gaps)), np.zeros(len(self.x)), np.zeros(rows), list[float]()
        cases = [(tilt, c) for tilt in tilts for c in range(balance.choices)]
        middles = np.array([self.middles[id] for id in self.ids])
        programme = LinearProgramme(cost, equal, np.zeros(rows))
        for tilt, c in cases:
            upright, lean = balance.weights(c)
            found = programme.solve(equal=upright + lean @ tilt)
            if found is None:  # rounding: no force is known to be needed
                work.append(np.inf)
                continue
            pushes, slack = found.x[: -2 * rows].reshape(-1, CONE_EDGES), found.x[-2 * rows :]
            normal[balance.rows] += pushes.sum(1) * balance.units / (mean * len(cases))
            if arms:
                on_upper = np.einsum("ke,keq,k->kq", pushes, balance.edges, balance.units)
                rates = balance.arm_rates(on_upper, found.duals, middles, center=c, tilt=tilt) / (mean * len(cases))
                by_arms += np.concatenate([self.units[id].T @ rate for id, rate in zip(self.ids, rates, strict=True)])
            left = np.maximum(left, slack.reshape(2, rows).max(0))
            work.append(found.value / mean)
        most = left.reshape(-1, 6).max(1) * is_free
        self.hanging |= {id for id, left in zip(self.ids, most.tolist(), strict=True) if left > UNHELD}
        return _Forces(normal=normal, work=float(np.mean(work)), arms=by_arms)

    def _rates(self, contacts: Contacts) -> Array:
        """(k, 7 n): how the gaps change with x."""
        rates = np.zeros((len(contacts), len(self.x)))
        for ids, sign in ((contacts.upper, 1.0), (contacts.lower, -1.0)):
            for id, place in self.places.items():
                on = ids == id
                n, arm = contacts.normals[on], contacts.points[on] - self.middles[id]
                rates[on, place] += sign * motions_along(n, arm) @ self.units[id]
        return rates
