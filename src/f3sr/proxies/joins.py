"""Neighbouring pieces joined again where one hull for both stands off the surface no more than it may.

``joined`` makes the parts of a mesh. ``join_order`` goes on from there to a single hull, and tells what every further
join would lose: few parts are enough where nothing touches (docs: proxies)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.cuts import MIN_TOUCHED
from f3sr.proxies.hulls import Hull, hull_of, outermost, spread
from f3sr.proxies.surface import Samples, Subject, blocks, depths, least_off

AROUND = spread(500)
"""Directions in which the corners of a joined hull are kept while it is only thought of: a ball's are then .1% of its
size too far in."""
NEXT_TO = 1e-3
"""How far apart the boxes of neighbours lie at most [size]."""
LAYER = 0.05
"""Thickness [size] of a layer around a hull that a further join may add at most."""
FELT = 0.02
"""Stand-off [size] that counts as 1 in a loss."""


ON_HULL = 1e-6
"""How far samples may lie outside a hull that holds them [size]: rounding in single precision."""
FEW = 6
"""Every how many samples the first look takes one."""


Pair = tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Join:
    """Two parts of a mesh that one hull may replace.

    Parts have numbers from 0; the hull that the k-th join gives is number ``parts + k``, and later joins name it."""

    first: int
    second: int
    loss: float
    """What contact feels of it more than of the two: the mean over the mesh's surface of the squared stand-off
    [squares of ``FELT``]. Floors of cavities count more."""


class Look(IntEnum):
    """How much of a hull is looked at; each look costs more than the one before."""

    FEW = 0
    """Some of the samples in it."""
    ALL = 1
    """All of them."""
    OWN = 2
    """Its own surface as well."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Joined:
    """A hull with its outermost corners in fixed directions, its stand-off [size], its loss, and its added volume.

    The added volume is that of the hull minus that of the hulls that it was joined from."""

    hull: Hull
    shape: Array
    box: tuple[Array, Array]
    off: float
    loss: float
    """The squared stand-off, averaged over the mesh's surface."""
    added: float = 0.0
    look: Look = Look.ALL
    """What ``off`` and ``loss`` tell of: what is not looked at yet can only raise them."""


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
        self._pairs: dict[Pair, Joined] = {}
        self._next = len(hulls)
        samples = subject.samples
        self._held = {
            Look.FEW: _SampleTable(samples.chosen(np.arange(len(samples.points)) % FEW == 0)),
            Look.ALL: _SampleTable(samples),
        }
        self.parts = {k: self._of(hull, outermost(hull.corners, AROUND)) for k, hull in enumerate(hulls)}
        for b in self.parts:
            self._look_around(b, range(b))

    def join(self, may: Callable[[int, float], bool], *, by_volume: bool = False) -> None:
        """Join pairs, one after the other: the one that adds least volume, otherwise the one with the least stand-off.

        The number of parts and the stand-off of the common hull decide which pairs may be joined; fewer parts and more
        stand-off never allow more."""
        key = self._added if by_volume else self._price
        for _ in self._least_first(key, lambda pair: may(len(self.parts), self._price(pair))):
            pass

    def by_loss(self) -> Iterator[Join]:
        """Join all neighbours, one pair after the other: the one that loses least, of equals the one that adds least
        volume."""
        self.parts = {k: self._looked_over(part) for k, part in self.parts.items()}
        for pair, loss in self._least_first(self._lost, lambda _: True):
            yield Join(first=pair[0], second=pair[1], loss=loss)

    def _least_first(self, key: Callable[[Pair], float], may: Callable[[Pair], bool]) -> Iterator[tuple[Pair, float]]:
        """Join the pair with the least key, then the next one. A pair is looked at more closely when it comes first:
        until then its key is a lower bound."""
        queue = [(key(pair), self._added(pair), pair) for pair in self._pairs]
        heapify(queue)
        while queue:
            least, _, pair = heappop(queue)
            if pair not in self._pairs or not may(pair):
                continue
            if self._pairs[pair].look is Look.OWN:
                changed = self._replace(pair)
                yield pair, least
            else:
                self._pairs[pair] = self._looked_over(self._pairs[pair])
                changed = [pair]
            for pair in changed:
                heappush(queue, (key(pair), self._added(pair), pair))

    def _added(self, pair: Pair) -> float:
        return self._pairs[pair].added

    def _lost(self, pair: Pair) -> float:
        """What joining loses, rounded so that noise decides nothing."""
        first, second = (self.parts[k].loss for k in pair)
        return max(0.0, round(self._pairs[pair].loss - first - second, 4))

    def _looked_over(self, part: Joined) -> Joined:
        """After the next look, which is taken when a pair comes first."""
        if part.look is Look.FEW:
            return self._of(part.hull, part.shape, added=part.added)
        bare = self._subject.bare(part.hull)
        loss = float(((bare / FELT) ** 2).mean()) * part.hull.area / self._subject.area
        return replace(part, off=max(part.off, _but_a_few(bare)), loss=max(part.loss, loss), look=Look.OWN)

    def _price(self, pair: Pair) -> float:
        """How far the joined hull stands off; nothing where that is no farther than one of the two did."""
        off = self._pairs[pair].off
        return 0.0 if off <= max(self.parts[k].off for k in pair) and off <= self._layer else off

    def _replace(self, pair: Pair) -> list[Pair]:
        """One part for two; the pairs that it makes with its neighbours."""
        part = self._pairs[pair]
        exact = hull_of(np.concatenate([self.parts[k].hull.corners for k in pair]))
        if exact is not None:
            part = replace(part, hull=exact, shape=outermost(exact.corners, AROUND), box=_box(exact))
        for k in pair:
            del self.parts[k]
        self._pairs = {other: p for other, p in self._pairs.items() if not set(pair) & set(other)}
        new, self._next = self._next, self._next + 1
        self.parts[new] = part
        return self._look_around(new, [k for k in self.parts if k != new])

    def _look_around(self, b: int, others: Sequence[int]) -> list[Pair]:
        """The pairs of a part with those of ``others`` that are its neighbours and may be joined with it."""
        touching = [a for a in others if _touch(self.parts[a], self.parts[b])]
        found = {(a, b): both for a in touching if (both := self._together(a, b))}
        self._pairs |= found
        return list(found)

    def _together(self, a: int, b: int) -> Joined | None:
        """One hull for both; None where its new volume is more than a layer as thick as the loose tolerance."""
        first, second = self.parts[a], self.parts[b]
        hull = hull_of(np.concatenate([first.shape, second.shape]))
        if hull is None:
            return None
        added = hull.volume - first.hull.volume - second.hull.volume
        if added > self._layer * hull.area:
            return None
        return self._of(hull, hull.corners, look=Look.FEW, added=added)

    def _of(self, hull: Hull, shape: Array, *, look: Look = Look.ALL, added: float = 0.0) -> Joined:
        """A hull with how far it stands off the samples in it."""
        off, weight = self._held[look].stand_off(hull)
        # ``off`` is weighted: squared, it has the weight twice.
        loss = float(((off / FELT) ** 2 / weight).sum()) / self._subject.taken
        return Joined(hull=hull, shape=shape, box=_box(hull), off=_but_a_few(off), loss=loss, added=added, look=look)


def _touch(first: Joined, second: Joined) -> bool:
    """Whether neither their boxes nor a facet of theirs has the two hulls apart."""
    (low, high), (low_2, high_2) = first.box, second.box
    if np.any(low > high_2 + NEXT_TO) or np.any(low_2 > high + NEXT_TO):
        return False
    return not any(
        ((b.shape @ a.hull.normals.T).min(0) > a.hull.offsets + NEXT_TO).any()
        for a, b in ((first, second), (second, first))
    )


def _box(hull: Hull) -> tuple[Array, Array]:
    return hull.corners.min(0), hull.corners.max(0)


class _SampleTable:
    """The samples that lie in hulls."""

    def __init__(self, samples: Samples) -> None:
        self._points, self._normals = (x.astype(np.float32) for x in (samples.points, samples.normals))
        self._weight = samples.weight
        self._axes = np.ascontiguousarray(samples.points.T)

    def stand_off(self, hull: Hull) -> tuple[Array, Array]:
        """How far a hull stands off the samples in it (n,), times their weight, and these weights (n,)."""
        low, high = (x[:, None] for x in _box(hull))
        near = np.flatnonzero(((self._axes >= low) & (self._axes <= high)).all(0))
        normals, offsets = hull.normals.T.astype(np.float32), hull.offsets.astype(np.float32)
        found, which = list[Array](), list[NDArray[np.int64]]()
        for block in blocks(len(near), len(offsets)):
            depth = depths(self._points[near[block]], normals, offsets)
            inside = np.flatnonzero(depth.min(1, initial=np.inf) >= -ON_HULL)
            which.append(near[block][inside])
            found.append(least_off(depth.take(inside, 0), self._normals[which[-1]], normals))
        weight = self._weight[np.concatenate(which)]
        return np.concatenate(found) * weight, weight


def _but_a_few(off: Array) -> float:
    """The largest but for the few that are noise."""
    return float(np.partition(off, -MIN_TOUCHED)[-MIN_TOUCHED]) if len(off) >= MIN_TOUCHED else 0.0
