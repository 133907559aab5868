"""One joint move in space that ends all overlap of a crowd of bodies, at little weighted cost.

Two convex parts are apart where one lies beyond a facet of their Minkowski difference (``polytopes``). In a crowd there
are too many facets for a search over all choices, as ``joint_separation`` makes it for horizontal moves. So the deepest
overlap of each pair of bodies ends first, through the nearest facet. Where all overlap has ended, each pair of
parts takes the facet that it is farthest beyond. The cheapest move with those is cheaper, and this repeats. What it
finds overlaps nowhere, but a cheaper move may exist.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from f3sr.contact.compounds import Compound, near_parts
from f3sr.contact.joint_separation import INSIDE
from f3sr.contact.least_norm import shortest
from f3sr.contact.polytopes import facets
from f3sr.core.transforms import UP, Array
from f3sr.physics.contact_margin import DEFAULT_MARGIN

REACH = 0.1
"""Distance of two parts, as a share of the smaller body's size, from which on they are taken not to meet."""
DIVES = 40
"""Most rounds in which the deepest overlaps are ended."""
SHORTENINGS = 16
"""Most rounds in which the move is made cheaper."""
SHORTER = 1e-3
"""Share of the cost that a round must gain for another one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Spread:
    """Where the bodies of a crowd go so that they overlap no more."""

    shifts: Mapping[int, Array]
    """(3,) [m] of every body that may move."""
    cost: float
    """Sum of the weighted squares of the shifts."""
    solved: bool
    """Whether no parts that were near each other overlap."""


def spread(
    bodies: Mapping[int, Compound], weights: Mapping[int, Array], *, clearance: float = DEFAULT_MARGIN.clearance
) -> Spread:
    """End the overlap of all pairs of bodies, and with the ground, by one joint move in space of little cost.

    ``weights``: a positive definite W (3, 3) per id that may move. d' W d is the cost of moving it by d [m]. The others
    stay. Bodies keep a ``clearance`` [m]."""
    return _Crowd(bodies, weights, clearance).result()


@dataclass(frozen=True, eq=False, kw_only=True)
class _Meeting:
    """Two bodies of which parts may meet."""

    matrix: Array
    """(3, n): the first's move against the second's, from the vector of all scaled moves."""
    facets: Sequence[tuple[Array, Array]]
    """Normals (k, 3) and heights (k,) for each pair of parts: it overlaps where ``normal . move > -height`` for all."""

    def depths(self, x: Array) -> list[Array]:
        """How far each pair of parts is inside each of its facets."""
        move = self.matrix @ x
        return [heights + normals @ move for normals, heights in self.facets]

    def beyond(self, k: int, depths: Array) -> Array:
        """The row (n + 1,) of the k-th pair of parts for the facet of least depth: ``row[:-1] @ x >= row[-1]``."""
        normals, heights = self.facets[k]
        facet = int(np.argmin(depths))
        return np.append(-normals[facet] @ self.matrix, heights[facet])


class _Crowd:
    """Moves x of all movable bodies, scaled so that the cost is |x|^2, and what they must avoid."""

    def __init__(self, bodies: Mapping[int, Compound], weights: Mapping[int, Array], clearance: float) -> None:
        self.ids = sorted(weights)
        self.matrices = {id: self._matrix(id, weights) for id in bodies}
        self.ground = [np.append(UP @ self.matrices[id], clearance - bodies[id].lowest) for id in self.ids]
        self.meetings: list[_Meeting] = []
        for a, b in combinations(bodies, 2):
            matrix = self.matrices[a] - self.matrices[b]
            reach = REACH * min(bodies[k].size for k in (a, b))
            if matrix.any() and (near := near_parts(bodies[a], bodies[b], reach)).size:
                planes = [facets(bodies[a][i], bodies[b][j]) for i, j in near.tolist()]
                self.meetings.append(_Meeting(matrix=matrix, facets=[(n, h + clearance) for n, h in planes]))

    def _matrix(self, id: int, weights: Mapping[int, Array]) -> Array:
        """(3, n): the move of a body from x."""
        M = np.zeros((3, 3 * len(self.ids)))
        if id in weights:
            k = 3 * self.ids.index(id)
            # d' W d = |L' d|^2 with W = L L'; in x = L' d the cost is |x|^2, and d = L'^-1 x.
            M[:, k : k + 3] = np.linalg.inv(np.linalg.cholesky(weights[id]).T)
        return M

    def result(self) -> Spread:
        x, solved = self.apart()
        if solved:
            x = self.shortened(x)
        return Spread(shifts={id: self.matrices[id] @ x for id in self.ids}, cost=float(x @ x), solved=solved)

    def apart(self) -> tuple[Array, bool]:
        """A move after which nothing overlaps, and whether it was found."""
        x, rows = np.zeros(3 * len(self.ids)), list(self.ground)
        for _ in range(DIVES):
            if (found := shortest(np.array(rows))) is None:
                return x, False
            x, known = found, len(rows)
            for meeting in self.meetings:
                depths = meeting.depths(x)
                deepest = int(np.argmax([d.min() for d in depths]))
                if depths[deepest].min() > INSIDE:
                    rows.append(meeting.beyond(deepest, depths[deepest]))
            if len(rows) == known:
                return x, True
        return x, False

    def shortened(self, x: Array) -> Array:
        """The end of a descent through convex regions: every programme allows the point that it starts from."""
        for _ in range(SHORTENINGS):
            rows = [m.beyond(k, d) for m in self.meetings for k, d in enumerate(m.depths(x))]
            shorter = shortest(np.array([*self.ground, *rows]))
            if shorter is None or shorter @ shorter > x @ x * (1 - SHORTER):
                return x
            x = shorter
        return x
