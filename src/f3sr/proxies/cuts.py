"""A mesh cut into pieces by planes until no further part pays.

The piece with the largest loss is cut next, by the plane that leaves the least volume in the two hulls. A cut
saves volume only where the hull of a piece holds open space: pieces hold the mesh's solid core as well as its
surface. Cuts go exactly through the triangles, so the hulls of the pieces together cover the whole surface.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.hulls import Hull, bulk, hull_of, outermost, spread
from f3sr.proxies.loss import NOISE, Loss, of_samples, of_surface
from f3sr.proxies.surface import CORE_STEP, Samples, Subject, stand_off
from f3sr.proxies.symmetry import Axis

OVERLAP = 2e-4
"""How far both parts reach beyond their common cut [size]: no crack lies between them."""
SECTORS = (6, 12)
"""Least and most sectors about an axis."""
STEPS = 6
"""Cuts across a piece that are tried at even distances."""
LEVELS = (0.05, 0.5, 0.95)
"""Quantiles of the height of surface that faces along a direction, just above which a cut is tried: floors."""
ABOVE = 0.002
"""How far above such a level the cut is tried, so that bumps stay below it [size]."""
STEP = 0.001
"""Distance of cuts that are different [size]."""
FACING = 0.85
"""Cosine from which on surface faces a direction."""
LAYER = 0.003
"""A hull counts as much thicker, on all sides [size]: slices across a bowl save what is below its rim, but they are
full discs, each to be cut again."""
ALIKE = 0.985
"""Cosine from which on two directions are one."""
USELESS = 0.98
"""Largest share of the volume that a cut may leave; otherwise the saving of the next cut decides."""
HOLLOW = 0.05
"""How far a piece must stand off for that, dents save little volume anyway [size], ..."""
HOLLOW_SHARE = 0.1
"""... and over how much of its surface or of its hull's."""
FINALISTS = 8
"""Cuts that are compared by all points."""
AHEAD = (0.3, 0.5, 0.7)
"""Where across a half the next cut is tried."""


AROUND = spread(128)
"""Directions in which the outermost points of a body are kept for a first look at its hull."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SimplifiedSurface:
    """Corners (n, 3), edges (m, 2) and triangles (k, 3, 3) of a simplified surface on which cuts are compared."""

    triangles: Array
    corners: Array
    edges: NDArray[np.int64]

    @classmethod
    def of(cls, triangles: Array) -> SimplifiedSurface:
        corners, inverse = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        edges = np.sort(inverse.reshape(-1, 3)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        return cls(triangles=triangles, corners=corners, edges=np.unique(edges, axis=0))

    def halves(self, u: Array, offsets: Array) -> Iterator[tuple[Array, Array]]:
        """The points below and above ``u . x = offset``, each with those where the edges cross it."""
        height = self.corners @ u
        first, second = height[self.edges[:, 0]], height[self.edges[:, 1]]
        for offset in offsets:
            cut = (first < offset) != (second < offset)
            t = ((offset - first[cut]) / (second[cut] - first[cut]))[:, None]
            start, end = self.corners[self.edges[cut, 0]], self.corners[self.edges[cut, 1]]
            crossed = start + t * (end - start)
            yield (
                np.concatenate([self.corners[height <= offset], crossed]),
                np.concatenate([self.corners[height >= offset], crossed]),
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
    """What lies in one cell of space: the surface exactly (k, 3, 3) and simplified, its samples, the core (n, 3)."""

    triangles: Array
    outline: SimplifiedSurface
    core: Array
    samples: Samples
    hull: Hull | None
    loss: Loss
    off: Array
    """How far the hull stands off the samples [size]."""
    bare: Array
    """How far points of the hull's surface lie off the mesh [size]: a ring cut into slices is still filled by them."""

    @property
    def is_hollow(self) -> bool:
        return any(len(off) and float((off > HOLLOW).mean()) > HOLLOW_SHARE for off in (self.off, self.bare))


@dataclass(frozen=True, eq=False, kw_only=True)
class Cut:
    """The plane ``normal . x = offset`` and the volume that the hulls of both sides have."""

    normal: Array
    offset: float
    bulk: float


def cut_up(subject: Subject, config: ProxyConfig, most: int, fan: Axis | None = None) -> list[Piece]:
    """At most ``most`` pieces of a mesh, ``surplus`` times as many as are wanted in the end.

    With ``fan``, the mesh is first cut into sectors about an axis."""
    whole = _piece(subject, subject.triangles, subject.simplified, subject.around.core, subject.samples, config)
    start = _sectors(whole, fan, subject, config) if fan else [whole]
    queue = [(-piece.loss.loss, k, piece) for k, piece in enumerate(start)]
    heapq.heapify(queue)
    done, count = list[Piece](), len(queue)
    while queue and len(queue) + len(done) < most:
        _, _, piece = heapq.heappop(queue)
        halves = _halved(piece, subject, config)
        if halves is None:
            done.append(piece)
            continue
        for half in halves:
            count += 1
            heapq.heappush(queue, (-half.loss.loss, count, half))
    return done + [piece for *_, piece in sorted(queue, key=lambda entry: entry[:2])]


def _sectors(whole: Piece, axis: Axis, subject: Subject, config: ProxyConfig) -> list[Piece]:
    """A mesh cut by half planes at an axis, into as many sectors as walls about it need to be flat in each."""
    # A chord of a circle of radius r over an angle a stands off by r (1 - cos(a / 2)).
    flat = np.arccos(np.clip(1 - config.tolerance / max(axis.radius, config.tolerance), -1, 1))
    count = int(np.clip(np.ceil(np.pi / flat), *SECTORS))
    normals = axis.fan(count)
    found: list[Piece] = []
    for u, w in zip(normals, np.roll(normals, -1, 0), strict=True):
        sector = whole
        first, last = np.cross(axis.direction, u), np.cross(w, axis.direction)
        for side in (np.asarray(first, np.float64), np.asarray(last, np.float64)):
            halves = _parts_of(sector, side, float(side @ axis.point), subject, config)
            if halves is None:
                break
            sector = halves[1]
        else:
            found.append(sector)
    return found if len(found) == count else [whole]


def _piece(
    subject: Subject, triangles: Array, outline: Array, core: Array, samples: Samples, config: ProxyConfig
) -> Piece:
    hull = hull_of(np.concatenate([np.unique(triangles.reshape(-1, 3), axis=0), core]))
    off, bare, loss = np.zeros(len(samples.points)), np.zeros(0), Loss()
    if hull is not None:
        off = stand_off(samples, hull.normals, hull.offsets) if len(off) else off
        bare = subject.bare(hull)
        loss = of_samples(off, len(subject.samples.points), config.tolerance)
        loss = loss.with_(of_surface(bare, hull.area / subject.area, config.tolerance))
    return Piece(
        triangles=triangles,
        outline=SimplifiedSurface.of(outline),
        core=core,
        samples=samples,
        hull=hull,
        loss=loss,
        off=off,
        bare=bare,
    )


def _halved(piece: Piece, subject: Subject, config: ProxyConfig) -> tuple[Piece, Piece] | None:
    """Both sides of the best cut; None where another part does not pay or no cut leaves surface on both."""
    if not piece.loss.pays:
        return None
    reach = subject.around.cell * CORE_STEP / 2
    cut = best_cut(piece, reach, config)
    if cut is None:
        return None
    return _parts_of(piece, cut.normal, cut.offset, subject, config)


def _parts_of(
    piece: Piece, u: Array, offset: float, subject: Subject, config: ProxyConfig
) -> tuple[Piece, Piece] | None:
    """Both sides of a plane; None where there is no surface on one."""
    reach = subject.around.cell * CORE_STEP / 2
    below = piece.samples.points @ u <= offset
    surface = clipped(piece.triangles, u, offset, OVERLAP)
    outline = clipped(piece.outline.triangles, u, offset, 0.0)
    if not all(map(len, (*surface, *outline))):
        return None
    sides = zip(surface, outline, _parted(piece.core, u, offset, reach), (below, ~below), strict=True)
    first, second = (_piece(subject, s, o, c, piece.samples.chosen(which), config) for s, o, c, which in sides)
    return first, second


def clipped(triangles: Array, u: Array, offset: float, overlap: float) -> tuple[Array, Array]:
    """The parts of triangles (n, 3, 3) below and above a plane, both reaching ``overlap`` beyond it."""
    return below(triangles, u, offset + overlap), below(triangles, -u, overlap - offset)


def below(triangles: Array, u: Array, offset: float) -> Array:
    height = triangles @ u - offset
    over = height > 0
    mixed = over.any(1) & ~over.all(1)
    corners, height, over = triangles[mixed], height[mixed], over[mixed]
    single = over.sum(1) == 1
    alone = np.where(single, over.argmax(1), (~over).argmax(1))
    order = (alone[:, None] + np.arange(3)) % 3
    rows = np.arange(len(corners))[:, None]
    corners, height = corners[rows, order], height[rows, order]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab = a + (height[:, 0] / (height[:, 0] - height[:, 1]))[:, None] * (b - a)
    ac = a + (height[:, 0] / (height[:, 0] - height[:, 2]))[:, None] * (c - a)
    tips = np.stack([a, ab, ac], axis=1)[~single]
    first, second = np.stack([ab, b, c], axis=1)[single], np.stack([ab, c, ac], axis=1)[single]
    return np.concatenate([triangles[~(triangles @ u - offset > 0).any(1)], tips, first, second])


def _parted(core: Array, u: Array, offset: float, reach: float) -> tuple[Array, Array]:
    """The core below and above a cut, both with its points next to the cut moved onto it."""
    height = core @ u - offset
    near = np.abs(height) <= reach
    moved = core[near] - height[near, None] * u
    return np.concatenate([core[height <= 0], moved]), np.concatenate([core[height >= 0], moved])


# Which cut


def best_cut(piece: Piece, reach: float, config: ProxyConfig) -> Cut | None:
    """The cut whose halves have the least volume.

    Where no cut saves volume, as through a ring, it is the cut after which the next one saves most."""
    directions = _directions(piece, config)
    best = _least(piece, directions, reach, config)
    if best is None or piece.hull is None or best.bulk <= USELESS * (piece.hull.volume + LAYER * piece.hull.area):
        return best
    if not piece.is_hollow:
        return best
    ahead = (_looked_ahead(piece, u, directions, reach) for u in directions)
    return min((best, *ahead), key=lambda cut: cut.bulk)


def _least(piece: Piece, directions: Array, reach: float, config: ProxyConfig) -> Cut | None:
    """Of all cuts by their outermost points, then of the best few by all points."""
    cuts: list[Cut] = []
    for u in directions:
        offsets = _offsets(piece, u, config)
        bulks = _bulks(piece.outline, piece.core, u, offsets, reach, few=True)
        cuts += [Cut(normal=u, offset=float(o), bulk=b) for o, b in zip(offsets, bulks, strict=True)]
    finalists = sorted(cuts, key=lambda cut: cut.bulk)[:FINALISTS]
    exact = [
        replace(cut, bulk=next(_bulks(piece.outline, piece.core, cut.normal, np.array([cut.offset]), reach)))
        for cut in finalists
    ]
    return min(exact, key=lambda cut: cut.bulk, default=None)


def _bulks(
    outline: SimplifiedSurface, core: Array, u: Array, offsets: Array, reach: float, *, few: bool = False
) -> Iterator[float]:
    """Volumes of the hulls of both sides together, for cuts at some offsets; ``few`` points suffice for a first
    rank."""
    for offset, sides in zip(offsets, outline.halves(u, offsets), strict=True):
        if len(core):
            sides = tuple(map(np.concatenate, zip(sides, _parted(core, u, offset, reach), strict=True)))
        yield sum(bulk(_first_look(side, u) if few else side, LAYER) for side in sides)


def _first_look(points: Array, u: Array) -> Array:
    return outermost(points, np.concatenate([AROUND, [u, -u]]))


def _looked_ahead(piece: Piece, u: Array, directions: Array, reach: float) -> Cut:
    """A cut through the middle, with the volume that one more cut of each half can leave."""
    height = piece.outline.corners @ u
    offset = float(height.min() + height.max()) / 2
    total = 0.0
    triangles = clipped(piece.outline.triangles, u, offset, 0.0)
    for half, core in zip(triangles, _parted(piece.core, u, offset, reach), strict=True):
        if not len(half):
            continue
        outline = SimplifiedSurface.of(half)
        least = bulk(_first_look(np.concatenate([outline.corners, core]), u), LAYER)
        for w in directions:
            across = outline.corners @ w
            offsets = across.min() + np.ptp(across) * np.array(AHEAD)
            least = min(least, *_bulks(outline, core, w, offsets, reach, few=True))
        total += least
    return Cut(normal=u, offset=offset, bulk=total)


def _directions(piece: Piece, config: ProxyConfig) -> Array:
    """Where cuts may face (k, 3): the axes, those of the piece and of what it stands off from, and its flats."""
    points, bad = piece.samples.points, piece.off > config.tolerance
    found = [*np.eye(3)]
    for some in (points, points[bad]):
        if len(some) > 3:
            found += list(np.linalg.svd(some - some.mean(0), full_matrices=False)[2])
    found += _main_normals(piece.samples.normals[bad])
    kept: list[Array] = []
    for u in found:
        if all(abs(u @ w) < ALIKE for w in kept):
            kept.append(u / np.linalg.norm(u) * np.sign(u[np.abs(u).argmax()]))
    return np.array(kept)


def _main_normals(normals: Array, most: int = 3, seeds: int = 60) -> list[Array]:
    """The directions that most of some normals face, one after the other."""
    found: list[Array] = []
    while len(found) < most and len(normals) >= NOISE:
        some = normals[:: max(1, len(normals) // seeds)]
        seed = some[int(np.count_nonzero(some @ normals.T > 0.95, axis=1).argmax())]
        near = normals @ seed > 0.95
        found.append(normals[near].mean(0))
        normals = normals[~near]
    return found


def _offsets(piece: Piece, u: Array, config: ProxyConfig) -> Array:
    height = piece.outline.corners @ u
    low, high = float(height.min()), float(height.max())
    found = [low + (high - low) * np.arange(1, STEPS) / STEPS]
    bad = piece.off > config.tolerance
    for side in (1, -1):
        facing = bad & (side * (piece.samples.normals @ u) > FACING)
        if np.count_nonzero(facing) >= NOISE:
            levels = np.quantile(side * (piece.samples.points[facing] @ u), LEVELS)
            found.append(side * (levels + ABOVE))
    offsets = np.unique(np.round(np.concatenate(found) / STEP)) * STEP
    return offsets[(offsets > low + STEP) & (offsets < high - STEP)]
