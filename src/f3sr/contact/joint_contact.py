"""One joint move that brings bodies into contact from above and ends all their overlap, at the least weighted cost.

A body is free of a convex part of another when it is beyond one facet of their Minkowski difference. It stands on what
it would meet first if it were lowered: it lies in an upper facet. So each choice of facets leaves a least distance
problem. The facets are chosen where the bodies are, and chosen anew where its solution puts them (an active set of a
sequential quadratic programme). What overlaps leaves by the facet that costs least.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from f3sr.contact import polytopes
from f3sr.contact.compounds import Compound, near_parts
from f3sr.contact.least_norm import nearly, shortest
from f3sr.core.transforms import Array
from f3sr.physics.contact_margin import DEFAULT_MARGIN

INSIDE = 1e-6
"""Depth [m] up to which parts count as free of each other: rounding of the programmes."""
MET = 5e-5
"""Height [m] above its support up to which a body counts as in contact."""
BEARING = 0.35
"""Least vertical share of a unit normal of a facet that bears a body: it slides down walls steeper than 70 degrees."""
ROUNDS = 15
"""Most choices of facets; two to six suffice, others alternate between two corners."""
PRICE = 1e7
"""Cost per squared metre of what no move can satisfy, where choices of facets contradict each other [1/m2]: a
millimetre costs ten standard deviations."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Together:
    """Where bodies go so that each stands on something and none overlaps another."""

    shifts: Mapping[int, Array]
    """(3,) [m] of every body that may move."""
    overlap: float
    """The deepest overlap that is left [m]."""
    hanging: float
    """The largest height above a support that is left [m]."""
    cost: float
    """Sum of the weighted squares of the ways from where the bodies are wanted."""


def bring_together(
    bodies: Mapping[int, Compound],
    weights: Mapping[int, Array],
    *,
    wanted: Mapping[int, Array] | None = None,
    standing: Collection[int] = (),
    above: Collection[tuple[int, int]] = (),
    reach: float,
    clearance: float = DEFAULT_MARGIN.clearance,
) -> Together:
    """End all overlap of bodies, with the ground too, and bring those that are ``standing`` onto what is below them.

    ``bodies``: parts in the world per id. ``weights``: a positive definite W (3, 3) per id that may move: d' W d is the
    cost of being d [m] from where it is wanted. ``wanted``: shifts (3,) [m] to there, by default none. ``above``: pairs
    of ids of which the first never stands on the second, as it carries it. Parts whose gap exceeds ``reach`` [m] are
    free of each other wherever they go, so moves should be shorter. Gaps of ``clearance`` [m] are left.
    """
    problem = _Problem(bodies, weights, wanted or {}, standing, above, reach, clearance)
    x, (_, overlap, hanging, cost) = problem.solved()
    return Together(shifts=problem.shifts(x), overlap=overlap, hanging=hanging, cost=cost)


class _Problem:
    """Moves x of all bodies that may move, scaled so that costs are squared distances from ``wanted``."""

    def __init__(
        self,
        bodies: Mapping[int, Compound],
        weights: Mapping[int, Array],
        wanted: Mapping[int, Array],
        standing: Collection[int],
        above: Collection[tuple[int, int]],
        reach: float,
        clearance: float,
    ) -> None:
        self.ids = sorted(weights)
        # d' W d = |L' d|^2 with W = L L'; in x = L' d the cost is |x|^2, and d = L'^-1 x.
        self.moves = {id: np.linalg.inv(np.linalg.cholesky(np.asarray(weights[id], float)).T) for id in self.ids}
        shift = [np.linalg.solve(self.moves[id], wanted.get(id, np.zeros(3))) for id in self.ids]
        self.wanted = np.concatenate(shift) if shift else np.zeros(0)
        self.standing = [id for id in self.ids if id in standing]
        self.ground = {id: np.append(self.matrix(id)[2], clearance - bodies[id].lowest) for id in self.ids}
        """Row (n + 1,) per body: it is above the ground where ``row[:-1] @ x >= row[-1]``."""
        self._meet(bodies, set(above), reach, clearance)

    @property
    def size(self) -> int:
        return 3 * len(self.ids)

    def matrix(self, id: int) -> Array:
        """(3, n): the shift of a body from x."""
        M = np.zeros((3, self.size))
        if id in self.moves:
            k = 3 * self.ids.index(id)
            M[:, k : k + 3] = self.moves[id]
        return M

    def _meet(self, bodies: Mapping[int, Compound], above: set[tuple[int, int]], reach: float, clearance: float):
        """Note the Minkowski differences of all parts that are near each other, one after the other."""
        normals, heights, matrices = [np.zeros((0, 3))], [np.zeros(0)], list[Array]()
        self.pairs = list[tuple[int, int]]()
        for a, b in combinations(bodies, 2):
            if a not in self.moves and b not in self.moves:
                continue
            matrix = self.matrix(a) - self.matrix(b)
            for i, j in near_parts(bodies[a], bodies[b], reach):
                n, h = polytopes.facets(bodies[a][int(i)], bodies[b][int(j)])
                normals.append(n)
                heights.append(h + clearance)
                matrices.append(matrix)
                self.pairs.append((a, b))
        counts = [len(h) for h in heights[1:]]
        self.normals, self.heights = np.concatenate(normals), np.concatenate(heights)
        """Of all facets: ``a`` moved by r against ``b`` is inside one where ``normal . r + height > 0``."""
        self.matrices = np.array(matrices).reshape(len(matrices), 3, self.size)
        """(k, 3, n): r of every pair of parts, from x."""
        self.starts = np.cumsum([0, *counts[:-1]]) if counts else np.zeros(0, int)
        self.pair = np.repeat(np.arange(len(counts)), counts)
        """Index of its pair of parts per facet."""
        rates = np.einsum("fi,fin->fn", self.normals, self.matrices[self.pair])
        self.exits = 1 / np.maximum(np.linalg.norm(rates, axis=1), np.finfo(float).tiny)
        """Way in x per metre out of a facet: small where leaving by it is cheap."""
        # Per body that stands, its pairs of parts, and those in which it may stand on the other, first or second.
        first, second = np.array(self.pairs, int).reshape(-1, 2).T
        carries = np.array([pair in above for pair in self.pairs], bool)
        carried = np.array([(b, a) in above for a, b in self.pairs], bool)
        self.lowered = {
            id: (np.flatnonzero((first == id) & ~carries), np.flatnonzero((second == id) & ~carried))
            for id in self.standing
        }

    def solved(self) -> tuple[Array, tuple[bool, float, float, float]]:
        """The best x found, and how good it is: whether something overlaps, by how much, how high a body hangs, and the
        cost."""
        x, best = np.zeros(self.size), list[tuple[tuple[bool, float, float, float], Array]]()
        for _ in range(ROUNDS):
            depths = self.depths(x)
            on, _ = self._stands(x, depths)
            rows = np.concatenate([self._free(depths), *(r[None] for r in self.ground.values()), on])
            rows[:, -1] -= rows[:, :-1] @ self.wanted
            found = shortest(rows)
            after = self.wanted + (nearly(rows, PRICE) if found is None else found)
            depths = self.depths(after)
            hanging = self._stands(after, depths)[1]
            overlap = self._overlap(after, depths)
            way = after - self.wanted
            worth = (overlap > INSIDE, overlap if overlap > INSIDE else 0.0, hanging, float(way @ way))
            best.append((worth, after))
            if np.abs(after - x).max(initial=0.0) < 1e-9:
                break
            x = after
        worth, x = min(best, key=lambda b: b[0])
        return x, worth

    def shifts(self, x: Array) -> dict[int, Array]:
        return {id: self.moves[id] @ x[3 * k : 3 * k + 3] for k, id in enumerate(self.ids)}

    def depths(self, x: Array) -> Array:
        """(f,): how deep the relative move of its pair of parts is below every facet."""
        return np.einsum("fi,fi->f", self.normals, (self.matrices @ x)[self.pair]) + self.heights

    def _overlap(self, x: Array, depths: Array) -> float:
        below = max((float(row[-1] - row[:-1] @ x) for row in self.ground.values()), default=0.0)
        deepest = float(np.minimum.reduceat(depths, self.starts).max()) if len(depths) else 0.0
        return max(below, deepest, 0.0)

    def _free(self, depths: Array) -> Array:
        """Rows (k, n + 1) of being beyond one facet of every pair: what overlaps leaves by the cheapest one."""
        if not len(depths):
            return np.zeros((0, self.size + 1))
        overlaps = (np.minimum.reduceat(depths, self.starts) > INSIDE)[self.pair]
        chosen = self._least(np.where(overlaps, depths * self.exits, depths))
        return self._rows(chosen)

    def _rows(self, facets: NDArray[np.int64]) -> Array:
        sides = -np.einsum("fi,fin->fn", self.normals[facets], self.matrices[self.pair[facets]])
        return np.column_stack([sides, self.heights[facets]])

    def _least(self, values: Array) -> NDArray[np.int64]:
        """The first facet of every pair with its least value."""
        least = np.minimum.reduceat(values, self.starts)
        equal = np.flatnonzero(values == least[self.pair])
        return equal[np.unique(self.pair[equal], return_index=True)[1]]

    def _stands(self, x: Array, depths: Array) -> tuple[Array, float]:
        """Rows (s, n + 1) that hold every body that stands down on what it would meet first, and the largest height of
        one above that [m]. What overlaps something leaves it first."""
        rows, highest = [np.zeros((0, self.size + 1))], 0.0
        free = np.minimum.reduceat(depths, self.starts) <= INSIDE if len(depths) else np.zeros(0, bool)
        heights, facets = self._met(depths)
        for id, pairs in self.lowered.items():
            if not (free[pairs[0]].all() and free[pairs[1]].all()):
                continue
            on = self.ground[id]
            height = float(on[:-1] @ x - on[-1])
            below = np.concatenate([heights[k, pairs[k]] for k in range(2)])
            if below.min(initial=np.inf) < height:
                at = int(below.argmin())
                facet = np.concatenate([facets[k, pairs[k]] for k in range(2)])[[at]]
                height, on = float(below[at]), self._rows(facet)[0]
            rows.append(-on[None])
            highest = max(highest, height if height > MET else 0.0)
        return np.concatenate(rows), highest

    def _met(self, depths: Array) -> tuple[Array, NDArray[np.int64]]:
        """How far (2, k) the first of every pair of parts, or the second, can be lowered until it meets the other, and
        the facet in which it does. Infinite where it never does, or meets a wall that bears nothing."""
        if not len(depths):
            return np.zeros((2, 0)), np.zeros((2, 0), int)
        speed = -self.normals[:, 2]
        level = np.abs(speed) <= INSIDE
        ways = -depths / np.where(level, 1.0, speed)
        # The first enters the second by the last facet of these, and leaves it by the first of those.
        enters = np.where(~level & (speed > 0), ways, -np.inf)
        leaves = np.where(~level & (speed < 0), ways, np.inf)
        facets = np.stack([self._least(-enters), self._least(leaves)])
        start, end = enters[facets[0]], leaves[facets[1]]
        meets = (start < end) & ~np.logical_or.reduceat(level & (depths <= 0), self.starts)
        # Lowering the second is lifting the first.
        below = meets & (end > 0) & (speed[facets[0]] >= BEARING), meets & (start < 0) & (speed[facets[1]] <= -BEARING)
        return np.stack([np.where(below[0], start, np.inf), np.where(below[1], -end, np.inf)]), facets
