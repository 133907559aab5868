"""The equations of balance of bodies that touch: contact forces within friction cones against tilted weights.

The tilts of gravity for which such forces exist form a convex set. Linear programmes give its reach in a direction. So
the least tilt at which the bodies move is exact (Bretl and Lall, "Testing Static Equilibrium for Legged Robots", 2008).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.contact.contact_patches import Contacts, hull_corners, tangents
from f3sr.contact.linear_programme import LinearProgramme
from f3sr.contact.static_bodies import StaticBody
from f3sr.core.pose_uncertainty import PARAMETERS, TURN, motions_along
from f3sr.core.transforms import UP, Array, cross
from f3sr.scene import GROUND

EDGES = 8
"""Edges of the pyramid inscribed in a friction cone: it has .92 of the cone's friction, cos(pi / 8), where it has
least."""
STEEPEST = 4.0
"""Tangent of the largest tilt that is distinguished: 76 degrees; what bears it counts as immovable."""
TOLERANCE = 1e-3
"""Tangent to which the least tilt is known."""
MOVES = 0.01
"""A body whose part in a virtual motion is smaller than this share of the largest does not move."""
STIFF = 1e7
"""What a wrench that is not balanced costs against contact forces, both in weights: see ``least_multipliers``."""
FALLS = -np.pi / 2
"""The margin [rad] of what no tilt would balance."""


class Balance:
    """The equations ``wrenches @ f = weights`` of a group of n bodies, f >= 0 along the edges of the friction cones.

    f (k e,) holds e numbers per contact, one an edge, in the contact's unit of force. Six rows a body: force in its
    weights, moment about its first centre in its weights times its size. Everything else is held still. ``rows`` are
    the contacts that act on the group.
    """

    def __init__(
        self,
        group: Sequence[StaticBody],
        bodies: Sequence[StaticBody],
        contacts: Contacts,
        ground_friction: float,
        *,
        edges: int = EDGES,
    ) -> None:
        self.group = tuple(group)
        self.edge_count = edges
        self.place = {b.id: k for k, b in enumerate(self.group)}
        members = np.array([b.id for b in self.group])
        self.rows = np.flatnonzero(np.isin(contacts.upper, members) | np.isin(contacts.lower, members))
        self.contacts = contacts.of(self.rows)
        rough = {GROUND: ground_friction, **{b.id: b.friction for b in bodies}}
        pairs = zip(self.contacts.upper.tolist(), self.contacts.lower.tolist(), strict=True)
        self.friction = np.array([max(rough[a], rough[b]) for a, b in pairs])
        self.sizes = np.array([b.size for b in self.group])
        self.masses = np.array([b.mass for b in self.group])
        self.edges = self._cone_edges()
        self.units = self._units()
        self.wrenches = self._wrenches()
        self._programmes: dict[tuple[int, bool], LinearProgramme] = {}

    def _cone_edges(self) -> Array:
        """(k, e, 3): forces with a normal part of 1 along the edges of every contact's pyramid."""
        angles = 2 * np.pi * np.arange(self.edge_count) / self.edge_count
        around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        frames = np.stack(tangents(self.contacts.normals), axis=1)
        # (e, 2) @ (k, 2, 3) = (k, e, 3): e unit tangents of every contact, n + mu t is an edge of its cone.
        return self.contacts.normals[:, None] + self.friction[:, None, None] * (around @ frames)

    def _units(self) -> Array:
        """(k,) unit of force [kg]: between the weights of the two bodies."""
        mass = dict(zip(self.place, self.masses, strict=True))
        pairs = zip(self.contacts.upper.tolist(), self.contacts.lower.tolist(), strict=True)
        # The geometric mean keeps the numbers of both bodies near 1. What is outside the group has the other's mass.
        return np.array([np.sqrt(mass.get(a, mass.get(b, 1.0)) * mass.get(b, mass.get(a, 1.0))) for a, b in pairs])

    def _wrenches(self) -> Any:
        """Sparse (6 n, k e)."""
        from scipy.sparse import csc_array

        blocks: list[tuple[Array, NDArray[np.int64], NDArray[np.int64]]] = []
        # Forces act on the upper body; the lower one takes the reaction.
        for ids, sign in ((self.contacts.upper, 1.0), (self.contacts.lower, -1.0)):
            on = np.flatnonzero(np.isin(ids, list(self.place)))
            if not len(on):
                continue
            body = np.array([self.place[i] for i in ids[on].tolist()])
            # (c, e, 3) for the c contacts on members: force per weight of the body, and its moment per weight and size.
            force = sign * self.edges[on] * (self.units[on] / self.masses[body])[:, None, None]
            arm = self.contacts.points[on] - np.array([b.centers[0] for b in self.group])[body]
            moment = cross(arm[:, None] / self.sizes[body][:, None, None], force)
            rows = 6 * body[:, None, None] + np.arange(6)
            columns = self.edge_count * on[:, None, None] + np.arange(self.edge_count)[:, None]
            # Six rows per body (force / weight, moment / (weight * size)), one column per cone edge of each contact.
            values = np.concatenate([force, moment], axis=2)
            rows, columns = np.broadcast_arrays(rows, columns)
            blocks.append((values.ravel(), rows.ravel(), columns.ravel()))
        values, rows, columns = (np.concatenate(x) for x in zip(*blocks, strict=True)) if blocks else ([], [], [])
        shape = (6 * len(self.group), self.edge_count * len(self.contacts))
        return csc_array((values, (rows, columns)), shape=shape)

    @property
    def choices(self) -> int:
        """How many sets of centres of mass there are."""
        return max(len(b.centers) for b in self.group)

    def weights(self, center: int = 0) -> tuple[Array, Array]:
        """(6 n,) what contacts must balance untilted, and (6 n, 2) how tilt tangents change it."""
        arms = [(b.centers[min(center, len(b.centers) - 1)] - b.centers[0]) / b.size for b in self.group]
        # Gravity (a, b, -1) with tangents a, b of tilt: contacts must give (-a, -b, 1) at the centre of mass.
        upright = np.concatenate([np.r_[UP, cross(arm, UP)] for arm in arms])
        lean = [np.concatenate([np.r_[-e, cross(arm, -e)] for arm in arms]) for e in np.eye(3)[:2]]
        return upright, np.stack(lean, axis=1)

    def arm_rates(self, forces: Array, duals: Array, middles: Array, *, center: int, tilt: Array) -> Array:
        """(n, 7) how a cost changes with each body's pose, of ``forces`` (k, 3) on upper bodies [kg] that balance the
        weights of a tilt (2,): only by where forces and weights act, with normals and gaps as they are.

        ``duals`` (6 n,) are rates at which that cost changes with what must be balanced. With m of them for a body's
        moment, the cost of a force F changes by F x m with its arm. ``middles`` (n, 3): what poses are about."""
        n, contacts = len(self.group), self.contacts
        moments = duals.reshape(n, 6)[:, 3:]
        # All that is held still has the place n, and no moment to be balanced.
        per_force = np.vstack([moments / (self.masses * self.sizes)[:, None], np.zeros(3)])
        upper, lower = (
            np.array([self.place.get(id, n) for id in ids.tolist()], int) for ids in (contacts.upper, contacts.lower)
        )
        on_upper, on_lower = cross(forces, per_force[upper]), cross(forces, per_force[lower])
        # A point follows the upper body by ``follow`` and the lower one by the rest.
        with_upper = np.einsum("kji,kj->ki", contacts.follow, on_lower - on_upper)
        centers, about = (np.vstack([at, np.zeros(3)]) for at in ([b.centers[0] for b in self.group], middles))
        rates = np.zeros((n + 1, PARAMETERS))
        for body, points, pulls in (
            (upper, contacts.points, with_upper),
            (lower, contacts.points, on_lower - on_upper - with_upper),
            (upper, centers[upper], on_upper),
            (lower, centers[lower], -on_lower),
        ):
            np.add.at(rates, body, motions_along(pulls, points - about[body]))
        # The weight acts at the chosen centre, the moments are about the first one: that arm turns and grows.
        arms = np.array([b.centers[min(center, len(b.centers) - 1)] - b.centers[0] for b in self.group])
        weights = motions_along(cross(np.r_[-tilt, 1.0], moments / self.sizes[:, None]), arms)
        rates[:n, TURN.start :] += weights[:, TURN.start :]
        return rates[:n]

    def stands(self) -> bool:
        """Whether it stands untilted, with every set of centres."""
        return all(self._farthest(np.zeros(2), c, still=True) is not None for c in range(self.choices))

    def margin(self) -> float:
        """The least tilt that moves it [rad]."""
        return min(self._margin(c) for c in range(self.choices))

    def bears(self, tilt: float) -> bool:
        """Whether no tilt up to this one [rad] moves it: ``margin() >= tilt``, but for the rounding, in fewer steps."""
        wanted = float(np.tan(tilt))
        return all(self._bears(wanted, c) for c in range(self.choices))

    def _margin(self, center: int) -> float:
        least = -np.inf
        for inner, least in self._bounds(center):
            if least - inner < TOLERANCE:
                break
        # The programme bounds tilts by this tangent: what bears that much counts as immovable.
        return np.pi / 2 if least >= STEEPEST * (1 - 1e-9) else float(np.arctan(least))

    def _bears(self, wanted: float, center: int) -> bool:
        for inner, least in self._bounds(center):
            if least < wanted or inner >= wanted or least - inner < TOLERANCE:
                return least >= wanted
        return False

    def _bounds(self, center: int) -> Iterator[tuple[float, float]]:
        """Ever closer bounds, lower and upper, of how far the origin lies inside the set of tilts that are balanced
        [tangent]; only an upper one of -inf where there is none.

        The signed distance is the least reach of the set over all directions. Corners found so far span an inner
        bound; the next direction is that in which the inner bound is nearest.
        """
        corners: list[Array] = []
        least = np.inf
        # Three directions give a triangle; then each step asks where the inner bound is nearest to the origin.
        directions = [np.array([np.cos(a), np.sin(a)]) for a in 2 * np.pi * np.arange(3) / 3]
        for _ in range(40):
            found = self._farthest(directions.pop(0), center)
            if found is None:
                yield -np.inf, -np.inf
                return
            corner, reach = found
            corners.append(corner)
            least = min(least, reach)
            inner = -np.inf
            if not directions:
                inner, direction = _signed_distance(np.array(corners))
                directions = [direction]
            yield inner, least

    def _farthest(self, u: Array, center: int, *, still: bool = False) -> tuple[Array, float] | None:
        """The balanced tilt (2,) farthest along u, and how far; None when there is none.

        ``still``: no tilt at all.
        """
        n = self.wrenches.shape[1]
        programme = self._programme(center, still=still)
        # Maximise u . tilt.
        solution = programme.solve(cost=np.r_[np.zeros(n), -u])
        if solution is None:
            return None
        tilt = solution.x[n:]
        return tilt, float(u @ tilt)

    def _programme(self, center: int, *, still: bool) -> LinearProgramme:
        """That of forces along edges and of the tilt's two tangents, (k e + 2,), with a set of centres:
        ``wrenches f = upright + lean tilt``."""
        if (center, still) not in self._programmes:
            from scipy.sparse import csc_array, hstack

            upright, lean = self.weights(center)
            equations = hstack([self.wrenches, csc_array(-lean)], format="csc")
            n, reach = self.wrenches.shape[1], 0.0 if still else STEEPEST
            low, high = np.r_[np.zeros(n), -reach, -reach], np.r_[np.full(n, np.inf), reach, reach]
            self._programmes[center, still] = LinearProgramme(np.zeros(n + 2), equations, upright, low=low, high=high)
        return self._programmes[center, still]

    def moving(self) -> frozenset[int]:
        """Which bodies move under untilted gravity, with one set of centres or another."""
        return frozenset[int]().union(*(self._moving(c) for c in range(self.choices)))

    def _moving(self, center: int) -> frozenset[int]:
        """Those of the virtual motion that gains most at bounded speed: it is dual to the least unbalanced wrench."""
        from scipy.sparse import eye_array, hstack

        rows, n = self.wrenches.shape
        # Least L1 norm of an unbalanced wrench, split into positive and negative parts; its dual is a virtual motion.
        upright, _ = self.weights(center)
        cost = np.r_[np.zeros(n), np.ones(2 * rows)]
        equations = hstack([self.wrenches, eye_array(rows), -eye_array(rows)])
        solution = LinearProgramme(cost, equations, upright).solve()
        if solution is None:  # rounding: not known to be balanced
            return frozenset(self.place)
        return self._movers(solution.duals) if solution.value > 1e-6 else frozenset()

    def _movers(self, motion: Array) -> frozenset[int]:
        # Six marginals a body: its velocity, and its angular velocity times its size.
        speeds = np.abs(motion).reshape(-1, 6).max(1)
        return frozenset(b.id for b, s in zip(self.group, speeds, strict=True) if s > MOVES * max(speeds.max(), 1e-9))

    def eased(self, tilt: Array, center: int = 0, *, near: Eased | None = None) -> Eased:
        """The forces of least squares; ``near`` are those of a tilt that differs little: it takes less time then."""
        upright, lean = self.weights(center)
        wanted = upright + lean @ tilt
        dense = self._dense
        multipliers = least_multipliers(dense, wanted, near.multipliers if near else None)
        f = np.maximum(dense.T @ multipliers, 0)
        left = float(np.linalg.norm(dense @ f - wanted))
        return Eased(forces=self._on_upper(f), left=left, multipliers=multipliers)

    @cached_property
    def _dense(self) -> Array:
        """``wrenches`` (6 n, k e), for all tilts."""
        return np.asarray(self.wrenches.toarray(), np.float64)

    def _on_upper(self, f: Array) -> Array:
        # Sum over a contact's edges of f times the edge's force, in the contact's unit.
        return np.einsum("ke,keq,k->kq", f.reshape(-1, self.edge_count), self.edges, self.units)


@dataclass(frozen=True, eq=False, kw_only=True)
class Eased:
    """Contact forces of least squares."""

    forces: Array
    """(k, 3) on the upper bodies [kg]."""
    left: float
    """What they leave unbalanced: the length of the wrench, in weights and sizes."""
    multipliers: Array
    """(6 n,) of the balance."""


def least_multipliers(wrenches: Array, wanted: Array, start: Array | None = None) -> Array:
    """Multipliers l (6 n,) of f >= 0 with the least ``|f|^2 + STIFF |wrenches f - wanted|^2``.

    f is the positive part of ``wrenches.T l``.

    Newton's method on the dual, whose gradient is piecewise linear. Without a ``start`` near the end, the stiffness
    grows by steps, each from where the last one ended.
    """
    if start is not None:
        return _ascend(wrenches, wanted, start, STIFF)
    multipliers = np.zeros(len(wanted))
    for stiffness in STIFF ** np.linspace(0.2, 1, 5):
        multipliers = _ascend(wrenches, wanted, multipliers, stiffness)
    return multipliers


def _ascend(dense: Array, wanted: Array, at: Array, stiffness: float) -> Array:
    """Where the dual ``wanted . l - |f|^2 / 2 - |l|^2 / (2 stiffness)`` is largest, from ``at``."""
    pull = dense.T @ at
    for _ in range(50):
        f = np.maximum(pull, 0)
        gradient = wanted - dense @ f - at / stiffness
        if np.abs(gradient).max() < 1e-10:
            break
        active = dense[:, pull > 0]  # the dual's Hessian is that of the forces that push
        step = np.asarray(np.linalg.solve(active @ active.T + np.eye(len(at)) / stiffness, gradient), float)
        along = dense.T @ step
        size = _line_search(pull, along, float(wanted @ step), at, step, stiffness)
        at, pull = at + size * step, pull + size * along
        if size == 0:
            break
    return at


def _line_search(pull: Array, along: Array, gain: float, at: Array, step: Array, stiffness: float) -> float:
    """Where the dual is largest along a step: its slope falls from positive and is linear between breakpoints."""

    def slope(t: float) -> float:
        return gain - float(along @ np.maximum(pull + t * along, 0)) - float(step @ (at + t * step)) / stiffness

    if slope(0.0) <= 0:
        return 0.0
    # The whole Newton step is too short where forces stop to push on the way: it is doubled until the slope turns.
    if slope(1.0) >= 0:
        low, high = 1.0, 1.0
        while slope(high) > 0 and high < 1e9:
            low, high = high, 2 * high
    else:
        low, high = 0.0, 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        # Where a force begins or ends to push, the slope has a kink; between two kinks it is linear and its zero is
        # exact.
        breaks = -pull / along
    breaks = np.sort(breaks[(breaks > low) & (breaks < high)])
    while len(breaks):
        middle = float(breaks[len(breaks) // 2])
        if slope(middle) > 0:
            low, breaks = middle, breaks[len(breaks) // 2 + 1 :]
        else:
            high, breaks = middle, breaks[: len(breaks) // 2]
    first, last = slope(low), slope(high)
    return low + (high - low) * first / (first - last) if first > last else low


def _signed_distance(corners: Array) -> tuple[float, Array]:
    """How deep the origin lies in the hull of points (k, 2), negative outside, and the direction (2,) out of it."""
    hull = corners[hull_corners(corners, 0.0)]
    starts, ends = hull, np.roll(hull, -1, axis=0)
    along = ends - starts
    lengths = np.linalg.norm(along, axis=1)
    # A polygon: outward normals of its counter-clockwise sides; the origin is inside if it is behind all of them.
    if len(hull) > 2 and lengths.min() > 0:
        outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths[:, None]
        depths = np.einsum("ij,ij->i", outward, starts)
        if depths.min() >= 0:
            nearest = int(np.argmin(depths))
            return float(depths[nearest]), outward[nearest]
    # Outside, or on a segment or a point: the nearest point of the sides.
    squared = np.maximum(lengths**2, 1e-300)
    feet = starts + np.clip(-np.einsum("ij,ij->i", starts, along) / squared, 0, 1)[:, None] * along
    distances = np.linalg.norm(feet, axis=1)
    nearest = int(np.argmin(distances))
    if distances[nearest] > 1e-12:
        return -float(distances[nearest]), -feet[nearest] / distances[nearest]
    # The origin on a segment, or a point: any direction out of it.
    side = along[nearest] / max(lengths[nearest], 1e-300)
    return 0.0, np.array([side[1], -side[0]]) if lengths[nearest] else np.array([1.0, 0.0])
