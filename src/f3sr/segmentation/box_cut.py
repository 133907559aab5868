"""One object cut out of its window: colours and border in turn (Rother 2004), from several starts, of which the
likeliest that fills its box is taken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.segmentation.box_fill import LOOSE, fills, gaps, inner, strip
from f3sr.segmentation.colour_mixture import ColourMixture, colour_mixture
from f3sr.segmentation.grid_cut import Mask
from f3sr.segmentation.object_window import EDGE, Box, ObjectWindow
from f3sr.vision.regions import distance_to, grown, parts_of, without_holes

ROUNDS = 4
"""Times that colours are learnt again from the last cut."""
LEAST = 5
"""Fewest pixels that colours are learnt from."""
ODD = 0.9
"""Quantile of the surroundings' costs beyond which a colour is odd there."""
CENTRE = 0.5
"""Squared radius of the ellipse in the middle of a box that is one start; the box is 1 wide."""
OPEN = 0.05
"""Most of a box's outline at which a mask may end without contrast: where the box is tight and the contrast low."""
LIKE = 0.95
"""Quantile of the costs of known pixels, up to which a colour is like theirs."""
TOLD = 0.1
"""Least share of strokes among the colours that a mixture is learnt from: a few pixels stand for a part."""
SURE = 1e4
"""Stands for a pixel that cannot be object, where a path looks for a way."""


@dataclass(frozen=True, eq=False, kw_only=True)
class WindowEvidence:
    """What is known of one object in its window (h, w) before any colour is looked at."""

    window: ObjectWindow
    allowed: Mask
    """Where the object may be: in its box, and no other object."""
    inside: Mask
    """Decided object pixels."""
    outside: Mask
    """Decided surroundings that a user points at."""
    box: Box | None = None
    """In pixels of the window; None where nobody drew one."""
    rivals: Mask | None = None
    """Other objects."""
    starts: tuple[Mask, ...] = ()
    """Further first guesses."""


def cut_out(evidence: WindowEvidence) -> Mask:
    """The object (h, w); its box where nothing in it looks like one."""
    found = [cut for start in _told_starts(evidence) if (cut := settled(evidence, start)).any()]
    if not found:
        return evidence.allowed | evidence.inside
    best = min(found, key=lambda mask: _rank(evidence, mask))
    if not _is_full(evidence, best):
        filled = [_filling(evidence, mask) for mask in found]
        best = min([best, *filled], key=lambda mask: _rank(evidence, mask))
    return best


def _rank(evidence: WindowEvidence, mask: Mask) -> tuple[bool, bool, float]:
    """Less is better: a mask that ends inside its box, then one that fills it, then the likelier one."""
    return _openness(evidence, mask) > OPEN, not _is_full(evidence, mask), _energy(evidence, mask)


def _openness(evidence: WindowEvidence, mask: Mask) -> float:
    """Length of a mask's border that is cut off by its box where no contrast ends it, as a share of the box's outline.

    There the object would go on beyond its box: it is a part of the surroundings."""
    if evidence.box is None:
        return 0.0
    grid, flat, beyond = evidence.window.grid, mask.ravel(), ~inner(mask.shape, evidence.box).ravel()
    first, second = grid.pairs.T
    wall = (flat[first] & beyond[second]) | (flat[second] & beyond[first])
    straight = grid.pairs[:, 1] - grid.pairs[:, 0]
    beside = (straight == 1) | (straight == mask.shape[1])
    left, top, right, bottom = evidence.box
    return float((wall & beside & (grid.prices > EDGE / 2)).sum() / (2 * (right - left + bottom - top)))


def refined(evidence: WindowEvidence, mask: Mask, width: float) -> Mask:
    """The mask (h, w) with its border cut again within some distance [px] of where it is."""
    near = np.where(mask, distance_to(~mask), distance_to(mask)) <= width
    fixed = replace(evidence, allowed=evidence.allowed & (near | mask), inside=evidence.inside | (mask & ~near))
    if mask.sum() < LEAST or not (~mask).any():
        return mask | evidence.inside
    cut = evidence.window.grid.cut(_cost(fixed, mask))
    return _whole(evidence, cut) if cut.any() else mask


def alike(window: ObjectWindow, seeds: Mask, allowed: Mask) -> Mask:
    """Allowed pixels (h, w) with the colours of some seeds, not empty, that hang together with them."""
    cost = colour_mixture(window.colours[seeds]).cost(window.colours)
    parts = parts_of(seeds | (allowed & (cost <= np.quantile(cost[seeds], LIKE))), diagonal=True)
    return np.isin(parts, np.unique(parts[seeds])) & allowed


def _told_starts(evidence: WindowEvidence) -> Iterator[Mask]:
    """First guesses with what looks like strokes inside, without what looks like strokes outside.

    Strokes correct what was found without them: other guesses are not made."""
    more, less = (
        alike(evidence.window, strokes, evidence.allowed) if strokes.any() else strokes
        for strokes in (evidence.inside, evidence.outside)
    )
    corrected = bool(evidence.starts) and bool(evidence.inside.any() or evidence.outside.any())
    for start in evidence.starts if corrected else _starts(evidence):
        told = (start & ~less) | (more & ~less) | evidence.inside
        yield told if told.sum() >= LEAST else start


def _starts(evidence: WindowEvidence) -> Iterator[Mask]:
    """First guesses: all of the box, its middle, colours that are odd in the surroundings, and given ones."""
    allowed = evidence.allowed
    yield allowed
    if evidence.box:
        left, top, right, bottom = evidence.box
        x = 2 * (np.arange(allowed.shape[1]) + 0.5 - left) / (right - left) - 1
        y = 2 * (np.arange(allowed.shape[0]) + 0.5 - top) / (bottom - top) - 1
        yield allowed & (x[None] ** 2 + y[:, None] ** 2 < CENTRE)
    elsewhere = ~allowed & ~evidence.inside
    if elsewhere.sum() >= LEAST:
        colours = evidence.window.colours
        cost = colour_mixture(colours[elsewhere]).cost(colours)
        yield allowed & (cost > np.quantile(cost[elsewhere], ODD))
    yield from (allowed & start for start in evidence.starts)


def settled(evidence: WindowEvidence, start: Mask) -> Mask:
    """Colours and cut in turn until neither changes."""
    mask = start | evidence.inside
    for _ in range(ROUNDS):
        if mask.sum() < LEAST or (~mask).sum() < LEAST:
            break
        cut = evidence.window.grid.cut(_cost(evidence, mask))
        if (cut == mask).all():
            break
        mask = cut
    return _whole(evidence, mask)


def _mixtures(evidence: WindowEvidence, mask: Mask) -> tuple[ColourMixture, ColourMixture]:
    """Colours of the object and of its surroundings, strokes with a share of their own."""
    colours = evidence.window.colours
    own, other = _told(colours, mask, evidence.inside), _told(colours, ~mask, evidence.outside)
    return colour_mixture(own), colour_mixture(other)


def _told(colours: Array, mask: Mask, strokes: Mask) -> Array:
    if not strokes.any():
        return colours[mask]
    times = int(np.ceil(TOLD * mask.sum() / strokes.sum()))
    return np.concatenate([colours[mask & ~strokes], *[colours[strokes]] * max(1, times)])


def _cost(evidence: WindowEvidence, mask: Mask) -> Array:
    """What every pixel costs as object beyond its cost as surroundings, infinite where it is decided."""
    own, other = _mixtures(evidence, mask)
    colours, free = evidence.window.colours, evidence.allowed & ~evidence.inside
    cost = np.where(evidence.inside, -np.inf, np.inf)
    cost[free] = own.cost(colours[free]) - other.cost(colours[free])
    return cost


def _energy(evidence: WindowEvidence, mask: Mask) -> float:
    """-log likelihood of the window's colours under both mixtures, and the price of the border."""
    if mask.sum() < LEAST or (~mask).sum() < LEAST:
        return np.inf
    own, other = _mixtures(evidence, mask)
    colours = evidence.window.colours
    return float(own.cost(colours[mask]).sum() + other.cost(colours[~mask]).sum() + evidence.window.grid.price(mask))


def _whole(evidence: WindowEvidence, mask: Mask) -> Mask:
    """The largest part, and those that strokes or other objects join to it, without holes."""
    if not mask.any():
        return mask
    rivals = np.zeros_like(mask) if evidence.rivals is None else evidence.rivals
    numbers = parts_of(mask)
    kept = set(np.unique(numbers[evidence.inside]).tolist()) - {0}
    if evidence.box or not kept:
        kept.add(1 + int(np.argmax(np.bincount(numbers.ravel())[1:])))
    joined = parts_of(mask | rivals)
    reached = np.unique(joined[np.isin(numbers, list(kept))])
    whole = mask & np.isin(joined, reached)
    holes = without_holes(whole | rivals) & ~whole & ~rivals
    blocked = np.unique((blocks := parts_of(holes))[evidence.outside])
    return whole | (holes & ~np.isin(blocks, blocked[blocked > 0]) & evidence.allowed)


# --- a mask that fills its box --------------------------------------------------------------------------------------


def _is_full(evidence: WindowEvidence, mask: Mask) -> bool:
    """Whether a mask reaches all sides of its box, where somebody drew one and nothing takes parts of it away."""
    return evidence.box is None or bool(evidence.outside.any()) or fills(mask, evidence.box)


def _filling(evidence: WindowEvidence, mask: Mask) -> Mask:
    """The mask led to each side of its box that it does not reach, along the way that looks most like it."""
    for side in range(4):
        if evidence.box is None or mask.sum() < LEAST or gaps(mask, evidence.box)[side] <= LOOSE:
            continue
        goal = strip(mask.shape, evidence.box, side) & evidence.allowed
        if not goal.any():
            return mask
        way = _way(evidence, mask, goal)
        evidence = replace(evidence, inside=evidence.inside | way)
        mask = settled(evidence, mask)
    return mask


def _way(evidence: WindowEvidence, mask: Mask, goal: Mask) -> Mask:
    """The cheapest path (h, w) of object pixels from a mask to a goal, three pixels wide."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    grid = evidence.window.grid
    toll = 1 + np.logaddexp(0, np.clip(_cost(evidence, mask), -SURE, SURE)).ravel()
    first, second = grid.pairs.T
    graph = coo_array(((toll[first] + toll[second]) / 2, (first, second)), shape=(mask.size, mask.size)).tocsr()
    graph.indices, graph.indptr = graph.indices.astype(np.int32), graph.indptr.astype(np.int32)
    far, before, _ = dijkstra(
        graph, directed=False, indices=np.flatnonzero(mask), min_only=True, return_predecessors=True
    )
    ends = np.flatnonzero(goal)
    at = int(ends[np.argmin(far[ends])])
    way = np.zeros(mask.size, np.bool_)
    while at >= 0:
        way[at] = True
        at = int(before[at])
    return grown(way.reshape(mask.shape), 1) & evidence.allowed
