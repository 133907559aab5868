"""A hole filled with patches of the rest of its picture, from coarse to fine, without a seam of light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.background import patchmatch
from f3sr.background.membrane import doubled, membrane, quads
from f3sr.background.patchmatch import RADIUS, SIDE, Picture
from f3sr.settings import settings
from f3sr.vision.regions import Mask, distance_to, grown, squared

T = TypeVar("T", bound=np.generic)

DEPTH = RADIUS + 1
"""Pixels from the deepest pixel of a hole to its border at the coarsest level: its patch still sees the border."""
ENOUGH_SOURCES = 64
"""Middles of patches without a hole below which a level is too coarse to choose from."""
KEPT = 0.6
"""Share of the finest level's sources below which a level is too coarse: between objects a material loses all its
patches first, and the hole would be filled with another."""
BOUNDARY = 1.3
"""What a pixel's say is divided by per pixel of its distance from the hole's border (Wexler et al. 2007)."""
AT_FIRST = 0.02
"""Weight of the hole's pixels against known ones in the first round: they are a membrane, which patches are not."""
SMOOTH_PERCENTILE, SHARP_PERCENTILE = 75.0, 10.0
"""Percentiles of the mismatches at which a vote's say falls to 1/e: on the way (Wexler et al. 2007) and in the last
round."""
HELD = 0.1
"""Share of the longer side over which votes for a colour outweigh those for its steps."""
RIM = 2
"""Pixels around a hole that patches vote for too [px]."""
NOWHERE = -1
"""Source of a pixel that has none."""
OPPONENT = np.array([[2, 2, 2], [6**0.5, -(6**0.5), 0], [2**0.5, 2**0.5, -(8**0.5)]], np.float32) / np.float32(12**0.5)
"""Rows: light, red against green, both against blue, of unit length and at right angles."""
LARGEST = np.array(patchmatch.LARGEST_SHIFT, np.float32)
"""(3,) largest step of light at the hole's border [log], per opponent channel."""


ROUNDS = 4
"""Rounds of search and vote at the finest level; coarser levels, cheap and decisive, have two more each."""


@settings
class CompletionConfig:
    """How the photo is completed behind its objects."""

    working_pixels: Annotated[int, Interval(ge=10_000, le=20_000_000)] = 400_000
    """Pixels of the finest level of the patch search [px]. Finer levels follow it; time grows with it."""
    seed: Annotated[int, Interval(ge=0, le=2**31 - 1)] = 0
    """Seed of the patch search. Another seed gives another, equally likely background."""


@dataclass(frozen=True, eq=False)
class _Level:
    """A picture (h, w, 3) at one resolution, its hole (h, w), and what is neither filled nor looked at (h, w)."""

    picture: Picture
    hole: Mask
    apart: Mask

    @property
    def known(self) -> Mask:
        return ~(self.hole | self.apart)

    def coarser(self) -> _Level:
        """Half the resolution. A pixel is in the hole if any of its four is, or if it has none.

        Of the others, one is apart if any of its four is."""
        # Counts (h / 2, w / 2, 1) among the four pixels of each kind.
        known, hole, apart = (
            quads(mask.astype(np.float32)[..., None]).sum(axis=(1, 3)) for mask in (self.known, self.hole, self.apart)
        )
        sums = quads(self.picture * self.known[..., None]).sum(axis=(1, 3))
        beside = (hole == 0) & (apart > 0)
        return _Level((sums / np.maximum(known, 1)).astype(np.float32), ((known < 4) & ~beside)[..., 0], beside[..., 0])

    @property
    def sources(self) -> Mask:
        """Middles of patches that lie in the picture and hold only what is known."""
        clear = ~squared(~self.known, SIDE)
        # The whole patch must lie in the picture.
        clear[:RADIUS] = clear[:, :RADIUS] = clear[max(len(clear) - RADIUS, 0) :] = False
        clear[:, max(clear.shape[1] - RADIUS, 0) :] = False
        return clear


def complete(picture: Picture, hole: Mask, config: CompletionConfig, *, apart: Mask | None = None) -> Picture | None:
    """``picture`` (h, w, 3), logarithms of colour, with ``hole`` (h, w) filled without pixels of ``apart`` (h, w).

    None if no patch is known. Neither the hole's old content nor the number of threads matters.
    """
    none = np.zeros_like(hole)
    levels = [_Level(np.asarray(picture @ OPPONENT.T, np.float32), hole, none if apart is None else apart & ~hole)]
    if not levels[0].sources.any():
        return None
    while levels[-1].hole.size > config.working_pixels and _enough(coarser := levels[-1].coarser()):
        levels.append(coarser)
    voted, nearest = _searched(levels[-1], config)
    while len(levels) > 1:  # what is done with is let go: a large photo's levels take as much as the process
        coarse = levels.pop()
        voted, nearest = _detailed(levels[-1], coarse, voted, nearest)
    del nearest
    return np.asarray(_seamless(levels.pop(), voted) @ OPPONENT, np.float32)


def _enough(level: _Level) -> bool:
    return int(np.count_nonzero(level.sources)) >= ENOUGH_SOURCES


def _searched(finest: _Level, config: CompletionConfig) -> tuple[Picture, NDArray[np.int32]]:
    """What patches vote for (h, w, 3) in and around the hole, and where each pixel's patch comes from (h, w, 2)."""
    levels = list(_pyramid(finest))
    guess: Picture | None = None
    nearest: NDArray[np.int32] | None = None
    for depth, level in reversed(list(enumerate(levels))):
        em = _Rounds(level, config.seed + 1000 * depth)
        if nearest is None:
            em.begin(membrane(level.picture, level.known))
        else:
            assert guess is not None
            em.resume(nearest, guess)
        em.run(ROUNDS + 2 * depth, first=nearest is None)
        guess = em.melded()
        nearest = em.nearest
    assert guess is not None and nearest is not None
    return guess, _unpadded(nearest) - RADIUS


def _pyramid(level: _Level) -> Iterator[_Level]:
    """From fine to coarse, until a patch in the middle of the hole sees its border or too few sources are left."""
    sources = np.count_nonzero(level.sources) / level.hole.size
    while True:
        yield level
        deep = distance_to(level.known)[level.hole].max() > DEPTH
        coarser = level.coarser()
        if not deep or not _enough(coarser) or np.count_nonzero(coarser.sources) < KEPT * sources * coarser.hole.size:
            return
        level = coarser


class _Rounds:
    """Search and vote, in turn, at one level; all fields are padded by ``RADIUS``."""

    def __init__(self, level: _Level, seed: int) -> None:
        pad = ((RADIUS, RADIUS), (RADIUS, RADIUS))
        self.seed = seed
        self.hole, self.apart = np.pad(level.hole, pad), np.pad(level.apart, pad)
        self.picture = np.pad(level.picture, (*pad, (0, 0)), mode="edge")
        self.source = np.pad(level.sources, pad)
        # Trust falls by BOUNDARY per pixel into the hole; apart pixels and the padding have none.
        inside = np.where(self.hole, distance_to(np.pad(level.known, pad, constant_values=True)), np.float32(0))
        self.weight = np.pad((~level.apart).astype(np.float32), pad) * np.power(np.float32(BOUNDARY), -inside)
        self.targets = np.ascontiguousarray(np.argwhere(squared(level.hole, SIDE) & ~level.apart) + RADIUS, np.int32)
        self.nearest = np.full((*self.hole.shape, 2), NOWHERE, np.int32)
        self.cost = np.zeros(self.hole.shape, np.float32)

    def begin(self, start: Picture) -> None:
        """Random sources and a first guess."""
        self.picture = np.pad(start, ((RADIUS, RADIUS), (RADIUS, RADIUS), (0, 0)), mode="edge")
        choices = np.argwhere(self.source).astype(np.int32)
        rng = np.random.default_rng(self.seed)
        y, x = self.targets.T
        self.nearest[y, x] = choices[rng.integers(len(choices), size=len(y))]

    def resume(self, coarse: NDArray[np.int32], guess: Picture) -> None:
        """The sources of a level of half the resolution, and what they vote for in the light of its result."""
        y, x = self.targets.T
        inner = self.picture[RADIUS:-RADIUS, RADIUS:-RADIUS]
        hole = _unpadded(self.hole)
        inner[hole] = doubled(guess, hole.shape)[hole]
        self.nearest[y, x] = _finer(_unpadded(coarse) - RADIUS, y - RADIUS, x - RADIUS) + RADIUS
        self._measure(self.weight)
        self._vote(SMOOTH_PERCENTILE)

    def run(self, rounds: int, *, first: bool) -> None:
        h, w = self.hole.shape
        for k in range(rounds):
            weight: NDArray[np.float32] = self.weight
            # The first guess is smooth: compared by it alone, smooth patches would win. Its weight grows by 4 per
            # round.
            if first and AT_FIRST * 4**k < 1:
                weight = np.where(self.hole, np.float32(AT_FIRST * 4**k) * weight, weight).astype(np.float32)
            self._measure(weight)
            for turn in range(2 if k == 0 else 1):
                patchmatch.search(
                    *(self.picture, weight, self.source, self.targets, self.nearest, self.cost),
                    *(max(h, w), self.seed + 10 * k + turn, bool((k + turn) % 2)),
                )
            self._vote(SHARP_PERCENTILE if k == rounds - 1 else SMOOTH_PERCENTILE)

    def melded(self) -> Picture:
        """The picture (h, w, 3), unpadded, in and around the hole with the steps that are voted for, so that no light
        changes where sources meet (Darabi et al. 2012): f minimises |grad f - steps|^2 + hold |f - votes|^2."""
        voted = self._vote(SHARP_PERCENTILE)
        spread = self._spread(SHARP_PERCENTILE)
        sums, counts = np.zeros((2, *self.picture.shape)), np.zeros((2, *self.hole.shape))
        patchmatch.vote_slopes(self.picture, self.weight, self.targets, self.nearest, self.cost, spread, sums, counts)
        steps = [_unpadded(s) for s in (sums / np.maximum(counts, 1e-30)[..., None]).astype(np.float32)]
        u, hole = _unpadded(voted), _unpadded(self.hole)
        bend = np.zeros_like(u)
        for axis, step in enumerate(steps):
            # Steps between two pixels of which one or both are in the hole: only these may change.
            ends = np.take(hole, range(1, hole.shape[axis]), axis) | np.take(hole, range(hole.shape[axis] - 1), axis)
            lacking = np.where(ends[..., None], np.delete(step, -1, axis) - np.diff(u, axis=axis), np.float32(0))
            # Divergence of the lacking steps: each adds to the pixel it starts from and is taken from the one it ends
            # in.
            bend[: -1 if axis == 0 else None, : -1 if axis == 1 else None] += lacking
            bend[1 if axis == 0 else 0 :, 1 if axis == 1 else 0 :] -= lacking
        # Screened Poisson equation: 1 / sqrt(hold) is the length over which the votes win.
        hold = (1 / (HELD * max(hole.shape))) ** 2
        known = _unpadded(self.picture)
        ring = np.where(hole[..., None], np.float32(0), known - u)
        ring = np.clip(ring, -LARGEST, LARGEST)
        around = _ring(hole, _unpadded(self.apart))
        return u + np.where((hole | around)[..., None], membrane(ring, around, bend * hole[..., None], hold), 0)

    def _measure(self, weight: NDArray[np.float32]) -> None:
        patchmatch.measure(self.picture, weight, self.targets, self.nearest, self.cost)

    def _vote(self, percentile: float) -> Picture:
        spread = self._spread(percentile)
        sums, counts = np.zeros(self.picture.shape), np.zeros(self.hole.shape)
        patchmatch.vote(self.picture, self.weight, self.targets, self.nearest, self.cost, spread, sums, counts)
        voted = (sums / np.maximum(counts, 1e-30)[..., None]).astype(np.float32)
        self.picture = np.where(self.hole[..., None], voted, self.picture)
        return voted

    def _spread(self, percentile: float) -> float:
        y, x = self.targets.T
        return max(float(np.percentile(self.cost[y, x], percentile)), 1e-9)


def _ring(hole: Mask, apart: Mask) -> Mask:
    """The pixels around a hole that hold what it is filled with."""
    return grown(hole, RIM) & ~hole & ~apart


def _finer(nearest: NDArray[np.int32], y: NDArray[np.int32], x: NDArray[np.int32]) -> NDArray[np.int32]:
    """Sources (k, 2) of pixels at twice the resolution: as far from theirs as their coarse pixel's from its."""
    return np.stack([y % 2, x % 2], axis=-1) + 2 * nearest[y // 2, x // 2]


def _detailed(
    fine: _Level, coarse: _Level, voted: Picture, nearest: NDArray[np.int32]
) -> tuple[Picture, NDArray[np.int32]]:
    """The coarser result at twice the resolution, each pixel with the detail that its source has there."""
    y, x = np.nonzero(doubled_mask(nearest[..., 0] >= 0, fine.hole.shape))
    result = doubled(voted, fine.hole.shape)
    finer = np.full((*fine.hole.shape, 2), NOWHERE, np.int32)
    finer[y, x] = _finer(nearest, y.astype(np.int32), x.astype(np.int32))
    sy, sx = finer[y, x].T
    # Laplacian detail of the source: its fine pixel less what its own coarse level shows there.
    result[y, x] += fine.picture[sy, sx] - _doubled_at(coarse.picture, sy, sx)
    return result, finer


def _doubled_at(values: Picture, y: NDArray[np.int32], x: NDArray[np.int32]) -> Picture:
    """``doubled`` at some pixels (k,) only: (k, c)."""
    h, w = values.shape[:2]
    near, far = (y // 2, x // 2), (y // 2 + np.where(y % 2, 1, -1), x // 2 + np.where(x % 2, 1, -1))
    far = np.clip(far[0], 0, h - 1), np.clip(far[1], 0, w - 1)
    rows = [np.float32(0.75) * values[near[0], c] + np.float32(0.25) * values[far[0], c] for c in (near[1], far[1])]
    return (np.float32(0.75) * rows[0] + np.float32(0.25) * rows[1]).astype(np.float32)


def doubled_mask(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """At twice the resolution, cut to ``shape``."""
    return np.repeat(np.repeat(mask, 2, 0), 2, 1)[: shape[0], : shape[1]]


def _seamless(level: _Level, voted: Picture) -> Picture:
    """What was voted for, shifted by a membrane that meets the photo at the hole's border (Perez et al., "Poisson image
    editing", 2003): the gradients stay, the light goes over without a step."""
    rows, columns = np.flatnonzero(level.hole.any(1)), np.flatnonzero(level.hole.any(0))
    box = slice(max(rows[0] - RIM, 0), rows[-1] + RIM + 1), slice(max(columns[0] - RIM, 0), columns[-1] + RIM + 1)
    hole, votes = level.hole[box], voted[box]
    ring = _ring(hole, level.apart[box])
    step = np.zeros_like(votes)
    step[ring] = np.clip(level.picture[box][ring] - votes[ring], -LARGEST, LARGEST)
    step = membrane(step, ring)
    result = level.picture.copy()
    result[box][hole] = votes[hole] + step[hole]
    return result


def _unpadded(values: NDArray[T]) -> NDArray[T]:
    return values[RADIUS:-RADIUS, RADIUS:-RADIUS]
