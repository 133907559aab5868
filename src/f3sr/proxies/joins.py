"""Neighbouring pieces joined again where one hull for both loses less than a part is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.hulls import Hull, hull_of, outermost, spread
from f3sr.proxies.loss import MOST_OFF, PART_WORTH, Loss, of_samples, of_surface, stand_off_in
from f3sr.proxies.surface import Subject

AROUND = spread(500)
"""Directions in which the corners of a joined hull are kept while it is only thought of: a ball's are then .1% of its
size too far in."""
LOOSE = 0.03
"""Thickness [size] of a layer around a hull that joining may add at most."""
NEXT_TO = 1e-3
"""How far apart the boxes of neighbours lie at most [size]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Joined:
    """A hull with its outermost corners in fixed directions, its loss, and its added volume.

    The added volume is that of the hull minus that of the hulls that it was joined from."""

    hull: Hull
    shape: Array
    loss: Loss
    added: float = 0.0
    is_looked_over: bool = True
    """Whether the loss tells of the hull's own surface as well, not only of the samples in it."""

    @property
    def box(self) -> tuple[Array, Array]:
        return self.hull.corners.min(0), self.hull.corners.max(0)


def joined(hulls: Sequence[Hull], subject: Subject, config: ProxyConfig) -> tuple[list[Hull], float]:
    """Fewer hulls that cover all the given ones, and their price: their losses and what they are worth as parts.

    Neighbours are joined where that loses less than a part is worth, and down to ``max_parts`` at any loss."""
    state = _Joining(hulls, subject, config)
    state.join()
    parts = state.parts.values()
    return [part.hull for part in parts], sum(part.loss.loss + PART_WORTH for part in parts)


class _Joining:
    """Parts by number, and what joining two neighbours would give."""

    def __init__(self, hulls: Sequence[Hull], subject: Subject, config: ProxyConfig) -> None:
        self._subject, self._config = subject, config
        self._pairs: dict[tuple[int, int], Joined] = {}
        self._next = len(hulls)
        self.parts = {k: self._alone(hull) for k, hull in enumerate(hulls)}
        for b in self.parts:
            self._look_around(b, range(b))

    def join(self) -> None:
        """Join pairs, one after the other: the one that loses least, of equals the one that adds least volume."""
        while self._pairs:
            many = len(self.parts) > self._config.max_parts
            price, pair = min((self._price(pair, p, many), pair) for pair, p in self._pairs.items())
            if price[0] > (np.finfo(float).max if many else PART_WORTH):
                return
            if self._pairs[pair].is_looked_over:
                self._replace(pair)
            else:
                self._look_over(pair)

    def _price(self, pair: tuple[int, int], both: Joined, many: bool) -> tuple[float, float]:
        """What joining loses more than both parts did, and the volume that it adds."""
        first, second = (self.parts[k] for k in pair)
        if both.loss.off > max(MOST_OFF, first.loss.off, second.loss.off) and not many:
            return np.inf, both.added
        return round(both.loss.loss - first.loss.loss - second.loss.loss, 4), both.added

    def _look_over(self, pair: tuple[int, int]) -> None:
        """A look at the hull itself costs more than at the samples in it: it is taken when the pair comes first."""
        self._pairs[pair] = self._looked_over(self._pairs[pair])

    def _looked_over(self, part: Joined) -> Joined:
        bare, share = self._subject.bare(part.hull), part.hull.area / self._subject.area
        loss = of_surface(bare, share, self._config.tolerance)
        return replace(part, loss=part.loss.with_(loss), is_looked_over=True)

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
        if added > LOOSE * hull.area:
            return None
        return Joined(hull=hull, shape=hull.corners, loss=self._of_samples(hull), added=added, is_looked_over=False)

    def _alone(self, hull: Hull) -> Joined:
        return self._looked_over(Joined(hull=hull, shape=outermost(hull.corners, AROUND), loss=self._of_samples(hull)))

    def _of_samples(self, hull: Hull) -> Loss:
        samples = self._subject.samples
        return of_samples(stand_off_in(hull, samples), len(samples.points), self._config.tolerance)
