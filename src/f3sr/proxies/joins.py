"""Neighbouring pieces joined again where one hull for both stands off the surface no more than it may.

``joined`` makes the parts of a mesh. ``join_order`` goes on from there to a single hull, and tells what every further
join would lose: few parts are enough where nothing touches (docs: proxies)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.cuts import MIN_TOUCHED
from f3sr.proxies.hulls import Hull, hull_of, outermost, spread
from f3sr.proxies.surface import Samples, Subject, stand_off

AROUND = spread(500)
"""Directions in which the corners of a joined hull are kept while it is only thought of: a ball's are then .1% of its
size too far in."""
NEXT_TO = 1e-3
"""How far apart the boxes of neighbours lie at most [size]."""
LAYER = 0.05
"""Thickness [size] of a layer around a hull that a further join may add at most."""
FELT = 0.02
"""Stand-off [size] that counts as 1 in a loss."""


@dataclass(frozen=True, kw_only=True)
class Join:
    """Two parts of a mesh that one hull may replace.

    Parts have numbers from 0; the hull that the k-th join gives is number ``parts + k``, and later joins name it."""

    first: int
    second: int
    loss: float
    """What contact feels of it more than of the two: the mean over the mesh's surface of the squared stand-off
    [squares of ``FELT``]. Floors of cavities count more."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Joined:
    """A hull with its outermost corners in fixed directions, its stand-off [size], its loss, and its added volume.

    The added volume is that of the hull minus that of the hulls that it was joined from."""

    hull: Hull
    shape: Array
    off: float
    loss: float
    """The squared stand-off, averaged over the mesh's surface."""
    added: float = 0.0
    is_looked_over: bool = True
    """Whether ``off`` and ``loss`` tell of the hull's own surface as well, not only of the samples in
    it."""

    @property
    def box(self) -> tuple[Array, Array]:
        return self.hull.corners.min(0), self.hull.corners.max(0)


def joined(hulls: Sequence[Hull], subject: Subject, config: ProxyConfig, *, is_shell: bool) -> list[Hull]:
    """Fewer hulls that cover all the given ones.

    Neighbours are joined within ``tolerance`` first, then as far as their number allows. Down to ``max_parts`` they
    are joined at any stand-off."""
    state = _Joining(hulls, subject, layer=config.cuts.loose_tolerance)
    state.join(lambda count, off: off <= config.tolerance, by_volume=True)
    state.join(lambda count, off: off <= config.allowed(count, is_shell=is_shell))
    state.join(lambda count, off: count > config.max_parts)
    return [part.hull for part in state.parts.values()]


def join_order(parts: Sequence[ConvexPart], subject: Subject) -> tuple[Join, ...]:
    """All further joins of neighbours, each time the one that loses least."""
    hulls = [hull_of(part.vertices) for part in parts]
    if any(hull is None for hull in hulls):  # a sheet stays as it is
        return ()
    state = _Joining([hull for hull in hulls if hull], subject, layer=LAYER)
    return tuple(state.by_loss())


class _Joining:
    """Parts by number, and what joining two neighbours would give."""

    def __init__(self, hulls: Sequence[Hull], subject: Subject, *, layer: float) -> None:
        """``layer``: thickness [size] of a layer around a hull that joining may add at most."""
        self._subject, self._layer = subject, layer
        self._pairs: dict[tuple[int, int], Joined] = {}
        self._next = len(hulls)
        self.parts = {k: self._of(hull, outermost(hull.corners, AROUND)) for k, hull in enumerate(hulls)}
        for b in self.parts:
            self._look_around(b, range(b))

    def join(self, may: Callable[[int, float], bool], *, by_volume: bool = False) -> None:
        """Join pairs, one after the other: the one that adds least volume, otherwise the one with the least stand-off.

        The number of parts and the stand-off of the common hull decide which pairs may be joined."""
        while True:
            prices = {pair: self._price(pair) for pair in self._pairs}
            allowed = [
                (p.added if by_volume else prices[pair], p.added, pair)
                for pair, p in self._pairs.items()
                if may(len(self.parts), prices[pair])
            ]
            if not allowed:
                return
            pair = min(allowed)[2]
            if self._pairs[pair].is_looked_over:
                self._replace(pair)
            else:
                self._look_over(pair)

    def by_loss(self) -> Iterator[Join]:
        """Join all neighbours, one pair after the other: the one that loses least, of equals the one that adds least
        volume."""
        self.parts = {k: self._looked_over(part) for k, part in self.parts.items()}
        while self._pairs:
            loss, _, pair = min((self._lost(pair), p.added, pair) for pair, p in self._pairs.items())
            if self._pairs[pair].is_looked_over:
                self._replace(pair)
                yield Join(first=pair[0], second=pair[1], loss=loss)
            else:
                self._look_over(pair)

    def _lost(self, pair: tuple[int, int]) -> float:
        """What joining loses, rounded so that noise decides nothing."""
        first, second = (self.parts[k].loss for k in pair)
        return max(0.0, round(self._pairs[pair].loss - first - second, 4))

    def _look_over(self, pair: tuple[int, int]) -> None:
        """A look at the hull itself costs more than at the samples in it: it is taken when the pair comes first."""
        self._pairs[pair] = self._looked_over(self._pairs[pair])

    def _looked_over(self, part: Joined) -> Joined:
        bare = self._subject.bare(part.hull)
        loss = float(((bare / FELT) ** 2).mean()) * part.hull.area / self._subject.area
        return replace(part, off=max(part.off, _but_a_few(bare)), loss=max(part.loss, loss), is_looked_over=True)

    def _price(self, pair: tuple[int, int]) -> float:
        """How far the joined hull stands off; nothing where that is no farther than one of the two did."""
        off = self._pairs[pair].off
        return 0.0 if off <= max(self.parts[k].off for k in pair) and off <= self._layer else off

    def _replace(self, pair: tuple[int, int]) -> None:
        part = self._pairs[pair]
        exact = hull_of(np.concatenate([self.parts[k].hull.corners for k in pair]))
        part = part if exact is None else replace(part, hull=exact, shape=outermost(exact.corners, AROUND))
        for k in pair:
            del self.parts[k]
        self._pairs = {other: p for other, p in self._pairs.items() if not set(pair) & set(other)}
        new, self._next = self._next, self._next + 1
        self.parts[new] = part
        self._look_around(new, [k for k in self.parts if k != new])

    def _look_around(self, b: int, others: Sequence[int]) -> None:
        low, high = self.parts[b].box
        for a in others:
            low_a, high_a = self.parts[a].box
            if np.all(low <= high_a + NEXT_TO) and np.all(low_a <= high + NEXT_TO) and (both := self._together(a, b)):
                self._pairs[a, b] = both

    def _together(self, a: int, b: int) -> Joined | None:
        """One hull for both; None where its new volume is more than a layer as thick as the loose tolerance."""
        first, second = self.parts[a], self.parts[b]
        hull = hull_of(np.concatenate([first.shape, second.shape]))
        if hull is None:
            return None
        added = hull.volume - first.hull.volume - second.hull.volume
        if added > self._layer * hull.area:
            return None
        return replace(self._of(hull, hull.corners), added=added, is_looked_over=False)

    def _of(self, hull: Hull, shape: Array) -> Joined:
        """A hull with how far it stands off the samples in it."""
        held = _held(hull, self._subject.samples)
        off = stand_off(held, hull.normals, hull.offsets) if len(held.points) else np.zeros(0)
        # ``off`` is weighted: squared, it has the weight twice.
        loss = float(((off / FELT) ** 2 / held.weight).sum()) / self._subject.taken
        return Joined(hull=hull, shape=shape, off=_but_a_few(off), loss=loss)


def _held(hull: Hull, samples: Samples) -> Samples:
    """Those of some samples that lie in a hull."""
    low, high = hull.corners.min(0), hull.corners.max(0)
    near = samples.chosen(np.all((samples.points >= low) & (samples.points <= high), axis=1))
    return near.chosen((near.points @ hull.normals.T - hull.offsets).max(1, initial=-1) <= 1e-9)


def _but_a_few(off: Array) -> float:
    """The largest but for the few that are noise."""
    return float(np.partition(off, -MIN_TOUCHED)[-MIN_TOUCHED]) if len(off) >= MIN_TOUCHED else 0.0
