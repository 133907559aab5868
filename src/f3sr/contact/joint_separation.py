"""One joint horizontal move that separates many overlapping bodies at the least weighted cost.

The free relative shifts of two bodies are the outside of a union of convex polygons. A body is outside a polygon when
it is beyond one of its sides. So branch and bound over sides, best first, finds the least move. Each choice of sides
leaves a quadratic programme whose cost bounds all choices below it (Lawson and Hanson, "Solving Least Squares
Problems", chapter 23: least distance by non-negative least squares). The first solution comes from a pairwise
iteration, shortened. So the search can stop at any time.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from f3sr.contact.compounds import Compound, forbidden_polygons
from f3sr.contact.horizontal_moves import nearest_free
from f3sr.core.transforms import Array
from f3sr.physics.contact_margin import DEFAULT_MARGIN

INSIDE = 1e-7
"""Depth [m] below which a point counts as outside a polygon: rounding of the programmes."""
NODES = 600
"""Quadratic programmes solved in one search; each takes a fifth of a millisecond."""
ROUNDS = 32
"""Most rounds of the pairwise iteration, as in the report, and of shortening."""

TRIED = 10
"""Of so many nodes of the search one is shortened to an answer: it costs more than a node, but prunes many."""

Pair = tuple[int, int]


@dataclass(frozen=True, eq=False, kw_only=True)
class Parted:
    """Where bodies go so that they overlap no more."""

    shifts: Mapping[int, Array]
    """(2,) [m] of every body, with what carries it."""
    own: Mapping[int, Array]
    """(2,) [m] of those that may move: against what carries them."""
    cost: float
    """Sum of the weighted squares of their own moves."""
    unsolved: tuple[Pair, ...]
    """Pairs that still overlap."""
    optimal: bool
    """No cheaper move exists; False when the search ended before that was known."""


def part(
    bodies: Mapping[int, Compound],
    pairs: Iterable[Pair],
    weights: Mapping[int, Array],
    *,
    carriers: Mapping[int, int | None] | None = None,
    clearance: float = DEFAULT_MARGIN.clearance,
    nodes: int = NODES,
) -> Parted:
    """Separate all ``pairs`` of bodies by the cheapest joint horizontal move.

    ``bodies``: parts in the world per id. ``weights``: a positive definite W (2, 2) per id that may move by itself.
    d' W d is the cost of moving it by d [m] with its subtree. A body without a weight moves only with its carrier.
    ``carriers``: the id that each body rests on. Overlapping pairs end with a gap of ``clearance`` [m]; other pairs
    keep their gap up to that. Pairs must not carry one another.
    """
    problem = _Problem(bodies, pairs, weights, carriers or {}, clearance)
    return problem.result(*problem.solve(nodes))


class _Obstacle:
    """The polygons a pair must stay out of, and how the moves of bodies make up its relative move."""

    def __init__(self, pair: Pair, polygons: Sequence[Array], matrix: Array) -> None:
        self.pair, self.polygons = pair, polygons
        self.matrix = matrix
        """(2, n): the first's move against the second's, from the vector of all scaled moves."""

    @property
    def can_move(self) -> bool:
        """Whether any move changes how the two lie to each other."""
        return bool(self.matrix.any())

    def deepest(self, x: Array) -> tuple[float, int]:
        """How deep the relative move lies inside the polygon it is deepest in, and which that is."""
        r = self.matrix @ x
        # The depth in a convex polygon is that of the side that is nearest; negative outside.
        depths = [float((p[:, :2] @ r + p[:, 2]).min()) for p in self.polygons]
        worst = int(np.argmax(depths)) if depths else 0
        return (depths[worst] if depths else -np.inf), worst

    def rows(self, polygon: Array) -> Array:
        """Rows (k, n + 1): being beyond side k is ``row[:-1] @ x >= row[-1]``."""
        return np.column_stack([-polygon[:, :2] @ self.matrix, polygon[:, 2]])

    def beyond(self, x: Array) -> Array:
        """One row per polygon: the side that x is farthest beyond."""
        r = self.matrix @ x
        sides = [p[[int(np.argmin(p[:, :2] @ r + p[:, 2]))]] for p in self.polygons]
        return self.rows(np.concatenate(sides))


class _Problem:
    """Moves x of all movable bodies, scaled so that the cost is |x|^2, and what they must avoid."""

    def __init__(
        self,
        bodies: Mapping[int, Compound],
        pairs: Iterable[Pair],
        weights: Mapping[int, Array],
        carriers: Mapping[int, int | None],
        clearance: float,
    ) -> None:
        self.ids = sorted(weights)
        self.bodies, self.carriers, self.clearance = bodies, carriers, clearance
        # d' W d = |L' d|^2 with W = L L'; in x = L' d the cost is |x|^2, and d = L'^-1 x.
        self.moves = {id: np.linalg.inv(np.linalg.cholesky(np.asarray(weights[id], float)).T) for id in self.ids}
        self.obstacles: list[_Obstacle] = []
        for a, b in pairs:
            polygons = [_grown(p, clearance) for p in forbidden_polygons(bodies[a], bodies[b])]
            if polygons:
                self.obstacles.append(_Obstacle((a, b), polygons, self.matrix(a) - self.matrix(b)))

    @property
    def size(self) -> int:
        return 2 * len(self.ids)

    def matrix(self, id: int) -> Array:
        """(2, n): the move of a body from x: its own and those of all below it."""
        M = np.zeros((2, self.size))
        chain: list[int] = []
        at: int | None = id
        while at is not None and at in self.bodies and at not in chain:
            chain.append(at)
            at = self.carriers.get(at)
        for i in chain:
            if i in self.moves:
                k = 2 * self.ids.index(i)
                M[:, k : k + 2] += self.moves[i]
        return M

    def solve(self, nodes: int) -> tuple[Array, bool]:
        """The cheapest x found, and whether none is cheaper."""
        movable = [o for o in self.obstacles if o.can_move]
        best = self.shortened(self.pairwise(movable), movable)
        x, optimal = np.zeros(self.size), True
        active: list[_Obstacle] = []
        while new := [o for o in movable if o not in active and o.deepest(x)[0] > INSIDE]:
            active += new
            x = np.zeros(self.size)
            for group in _independent(active):
                found, proven = self.search(group, nodes)
                x, optimal = x + found, optimal and proven
            if _violated(active, x):
                break
        overlaps, cost = _worth(movable, x)
        # Groups are solved one by one; the joint answer of the start may still be better.
        if _worth(movable, best) < (overlaps, cost * (1 - 1e-9)):
            return best, False
        return x, optimal and not overlaps

    def pairwise(self, obstacles: Sequence[_Obstacle]) -> Array:
        """Overlapping pairs one after the other by their nearest free place, until none is left."""
        x = np.zeros(self.size)
        for _ in range(ROUNDS):
            if not (violated := _violated(obstacles, x)):
                break
            for o in violated:
                r = o.matrix @ x
                # The polygons as seen from the present relative move r: n . (r + t) + h.
                here = [np.column_stack([p[:, :2], p[:, 2] + p[:, :2] @ r]) for p in o.polygons]
                t = nearest_free(here, 0.0)
                # The cheapest x that makes the relative move t: the pseudoinverse is least in |x|.
                x = x + np.linalg.pinv(o.matrix) @ (t * (1 + 1e-6))
        return x

    def shortened(self, x: Array, obstacles: Sequence[_Obstacle]) -> Array:
        """The end of a descent through convex regions, each given by the sides that x is farthest beyond or nearest to.

        What the first programme finds is outside all polygons; from there every next one allows the point it starts
        from, so that the cost never grows.
        """
        outside = not _violated(obstacles, x)
        for _ in range(ROUNDS if obstacles else 0):
            shorter = least_distance(np.concatenate([o.beyond(x) for o in obstacles]))
            if shorter is None or _violated(obstacles, shorter):
                return x
            if outside and shorter @ shorter > x @ x * (1 - 1e-6):
                return x
            x, outside = shorter, True
        return x

    def search(self, obstacles: Sequence[_Obstacle], nodes: int) -> tuple[Array, bool]:
        """Best-first search over the sides to leave polygons by, from time to time shortened to an answer to beat."""
        starts = (self.pairwise(obstacles), np.zeros(self.size))
        best = min((self.shortened(x, obstacles) for x in starts), key=lambda x: _worth(obstacles, x))
        order = count()
        waiting = [(0.0, next(order), np.zeros(self.size), np.empty((0, self.size + 1)))]
        solved = 0
        while waiting and solved < nodes:
            cost, turn, x, rows = heapq.heappop(waiting)
            overlaps, limit = _worth(obstacles, best)
            # Best first: no waiting choice is cheaper than this one, so none can beat the answer.
            if not overlaps and cost >= limit * (1 - 1e-9):
                return best, True
            worst = max(obstacles, key=lambda o: o.deepest(x)[0])
            depth, k = worst.deepest(x)
            # Its programme's optimum already avoids everything: the cheapest of all choices.
            if depth <= INSIDE:
                return x, True
            if turn % TRIED == 0:
                best = min(best, self.shortened(x, obstacles), key=lambda x: _worth(obstacles, x))
            for side in worst.rows(worst.polygons[k]):
                solved += 1
                chosen = np.concatenate([rows, side[None]])
                if (found := least_distance(chosen)) is not None and (overlaps or found @ found < limit):
                    heapq.heappush(waiting, (float(found @ found), next(order), found, chosen))
        return best, not waiting and not _worth(obstacles, best)[0]

    def result(self, x: Array, optimal: bool) -> Parted:
        own = {id: self.moves[id] @ x[2 * k : 2 * k + 2] for k, id in enumerate(self.ids)}
        return Parted(
            shifts={id: self.matrix(id) @ x for id in self.bodies},
            own=own,
            cost=float(x @ x),
            unsolved=tuple(o.pair for o in _violated(self.obstacles, x)),
            optimal=optimal,
        )


def _grown(polygon: Array, clearance: float) -> Array:
    """The polygon with its sides moved outward; what is outside it already keeps at most the gap it has."""
    # h of the side that the origin is farthest beyond: positive gap if the pair is apart already.
    gap = float(-polygon[:, 2].min())
    growth = clearance if gap < 0 else min(clearance, gap)
    return polygon + np.array([0, 0, growth])


def _violated(obstacles: Iterable[_Obstacle], x: Array) -> list[_Obstacle]:
    return [o for o in obstacles if o.deepest(x)[0] > INSIDE]


def _worth(obstacles: Iterable[_Obstacle], x: Array) -> tuple[int, float]:
    """How many pairs still overlap, then the cost: less is better."""
    return len(_violated(obstacles, x)), float(x @ x)


def _independent(obstacles: Sequence[_Obstacle]) -> Iterator[list[_Obstacle]]:
    """Groups that no move belongs to two of."""
    groups: list[tuple[set[int], list[_Obstacle]]] = []
    for o in obstacles:
        used, members = set(np.flatnonzero(np.abs(o.matrix).sum(0)).tolist()), [o]
        touching = [g for g in groups if not g[0].isdisjoint(used)]
        groups = [g for g in groups if g[0].isdisjoint(used)]
        groups.append((used.union(*(g[0] for g in touching)), [m for g in touching for m in g[1]] + members))
    for _, members in groups:
        yield members


def least_distance(rows: Array) -> Array | None:
    """The shortest x with ``rows[:, :-1] @ x >= rows[:, -1]``, None when there is none."""
    from scipy.optimize import nnls

    if not len(rows) or (rows[:, -1] <= 0).all():
        return np.zeros(rows.shape[1] - 1)
    # Lawson and Hanson's LDP: with E = [G'; h'] and f = (0, .., 0, 1), u >= 0 least in |E u - f|, r = E u - f, the
    # shortest x with G x >= h is -r[:n] / r[n]. r = 0 says that no x exists. h is scaled to 1 for the rounding test.
    unit = np.abs(rows[:, -1]).max()
    E = np.vstack([rows[:, :-1].T, rows[:, -1] / unit])
    target = np.zeros(len(E))
    target[-1] = 1
    scale = np.maximum(np.linalg.norm(E, axis=0), 1e-300)
    u, _ = nnls(E / scale, target, maxiter=30 * E.shape[1])
    left = (E / scale) @ u - target
    if abs(left[-1]) < 1e-10:
        return None
    return -left[:-1] / left[-1] * unit
