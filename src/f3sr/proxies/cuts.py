"""A mesh cut into pieces by planes until the hull of each piece has a small stand-off from the surface.

The piece with the largest stand-off is cut next, by the plane that leaves the least volume in the two hulls. A cut
saves volume only where the hull of a piece holds open space: pieces hold the mesh's solid core as well as its
surface. Cuts go exactly through the triangles, so the hulls of the pieces together cover the whole surface.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.cut_volumes import LAYER, FirstLook, SimplifiedSurface, bulk_of_sides, parted
from f3sr.proxies.hulls import Hull, bulk, distinct, hull_of, outermost, spread
from f3sr.proxies.surface import CORE_STEP, Samples, Subject, stand_off

OVERLAP = 2e-4
"""How far both parts reach beyond their common cut [size]: no crack lies between them."""
MIN_TOUCHED = 3
"""Samples that are no longer noise, of a hull's surface or of what faces one way."""
STRAY = 8
"""Samples of the mesh's surface, of thousands, that a piece may stand off too far from."""
STEPS = 6
"""Cuts across a piece that are tried at even distances."""
LEVELS = (0.05, 0.5, 0.95)
"""Quantiles of the height of surface that faces along a direction, just above which a cut is tried: floors."""
FACING = 0.85
"""Cosine from which on surface faces a direction."""
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
AROUND = spread(128)
"""Directions of outermost points whose hull is enough where cuts are thought of two steps ahead."""
AHEAD = (0.3, 0.5, 0.7)
"""Where across a half the next cut is tried."""

TURNED = np.array([[0, 1, 2], [1, 2, 0], [2, 0, 1]])
"""Corners of a triangle from each of them on."""
TIP, REST = (0, 3, 4), ((3, 1, 2), (3, 2, 4))
"""Triangles of the corners a, b, c and of two points ab, ac: the tip a, and what is left without it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
    """What lies in one cell of space: the surface exactly (k, 3, 3) and simplified, its samples, the core (n, 3)."""

    triangles: Array
    outline: SimplifiedSurface
    core: Array
    samples: Samples
    hull: Hull | None
    off: Array
    """How far the hull stands off the samples [size]."""
    bare: Array
    """How far points of the hull's surface lie off the mesh [size]: a ring cut into slices is still filled by them."""

    def urgency(self, subject: Subject, tolerance: float) -> float:
        """Volume between the hull and the surface, beyond the tolerance."""
        off = np.maximum(self.off - tolerance, 0).sum() / subject.density
        if self.hull is None:
            return float(off)
        return float(off + np.maximum(self.bare - tolerance, 0).mean() * self.hull.area)

    @property
    def is_hollow(self) -> bool:
        return any(len(off) and float((off > HOLLOW).mean()) > HOLLOW_SHARE for off in (self.off, self.bare))

    def is_close(self, tolerance: float) -> bool:
        off, bare = (int(np.count_nonzero(x > tolerance)) for x in (self.off, self.bare))
        return off < STRAY and bare < MIN_TOUCHED


@dataclass(frozen=True, eq=False, kw_only=True)
class Cut:
    """The plane ``normal . x = offset`` and the volume that the hulls of both sides have."""

    normal: Array
    offset: float
    bulk: float


def cut_up(subject: Subject, config: ProxyConfig, most: int, *, is_shell: bool) -> list[Piece]:
    """At most ``most`` pieces of a mesh, ``surplus`` times as many as are wanted in the end."""
    whole = _piece(subject, subject.triangles, subject.simplified, subject.around.core, subject.samples)
    queue, done, count = [(0.0, 0, whole)], list[Piece](), 0
    while queue and len(queue) + len(done) < most:
        _, _, piece = heapq.heappop(queue)
        wanted = (len(queue) + len(done) + 1) / config.cuts.surplus
        halves = _halved(piece, subject, replace(config, tolerance=config.allowed(wanted, is_shell=is_shell)))
        if halves is None:
            done.append(piece)
            continue
        for half in halves:
            count += 1
            heapq.heappush(queue, (-half.urgency(subject, config.tolerance), count, half))
    return done + [piece for *_, piece in sorted(queue)]


def _piece(subject: Subject, triangles: Array, outline: Array, core: Array, samples: Samples) -> Piece:
    hull = hull_of(np.concatenate([distinct(triangles.reshape(-1, 3))[0], core]))
    off = np.zeros(len(samples.points))
    if hull is not None and len(off):
        off = stand_off(samples, hull.normals, hull.offsets)
    return Piece(
        triangles=triangles,
        outline=SimplifiedSurface.of(outline),
        core=core,
        samples=samples,
        hull=hull,
        off=off,
        bare=np.zeros(0) if hull is None else subject.bare(hull),
    )


def _halved(piece: Piece, subject: Subject, config: ProxyConfig) -> tuple[Piece, Piece] | None:
    """Both sides of the best cut; None where nothing stands off too far or no cut leaves surface on both."""
    if piece.is_close(config.tolerance):
        return None
    reach = subject.around.cell * CORE_STEP / 2
    cut = best_cut(piece, reach, config)
    if cut is None:
        return None
    u, offset = cut.normal, cut.offset
    below = piece.samples.points @ u <= offset
    surface = clipped(piece.triangles, u, offset, OVERLAP)
    outline = clipped(piece.outline.triangles, u, offset, 0.0)
    if not all(map(len, (*surface, *outline))):
        return None
    sides = zip(surface, outline, parted(piece.core, u, offset, reach), (below, ~below), strict=True)
    first, second = (_piece(subject, s, o, c, piece.samples.chosen(which)) for s, o, c, which in sides)
    return first, second


def clipped(triangles: Array, u: Array, offset: float, overlap: float) -> tuple[Array, Array]:
    """The parts of triangles (n, 3, 3) below and above a plane, both reaching ``overlap`` beyond it."""
    return below(triangles, u, offset + overlap), below(triangles, -u, overlap - offset)


def below(triangles: Array, u: Array, offset: float) -> Array:
    """The parts of triangles (n, 3, 3) below a plane."""
    height = triangles @ u - offset
    over = height > 0
    count = over.sum(1)
    kept, mixed = triangles[count == 0], (count == 1) | (count == 2)
    if not mixed.any():
        return kept
    single = count[mixed] == 1
    alone = np.where(single, over[mixed].argmax(1), (~over[mixed]).argmax(1))
    # Corners a, b, c from the one that is alone on its side, and where edges ab and ac meet the plane.
    rows, order = np.arange(len(alone))[:, None], TURNED[alone]
    corners, height = triangles[mixed][rows, order], height[mixed][rows, order]
    share = height[:, :1] / (height[:, :1] - height[:, 1:])
    met = corners[:, :1] + share[:, :, None] * (corners[:, 1:] - corners[:, :1])
    points = np.concatenate([corners, met], axis=1)
    tips, others = points[~single], points[single]
    return np.concatenate([kept, tips[:, TIP], others[:, REST[0]], others[:, REST[1]]])


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
    look = FirstLook.at(piece.outline, piece.core, reach)
    cuts: list[Cut] = []
    for u in directions:
        offsets = _offsets(piece, u, config)
        cuts += [
            Cut(normal=u, offset=float(o), bulk=float(b)) for o, b in zip(offsets, look.bulks(u, offsets), strict=True)
        ]
    best: Cut | None = None
    for cut in sorted(cuts, key=lambda cut: cut.bulk)[:FINALISTS]:
        if best and cut.bulk >= best.bulk:  # a hull is no smaller than what its outermost points span
            break
        exact = replace(cut, bulk=bulk_of_sides(piece.outline, piece.core, cut.normal, cut.offset, reach))
        best = exact if best is None or exact.bulk < best.bulk else best
    return best


def _looked_ahead(piece: Piece, u: Array, directions: Array, reach: float) -> Cut:
    """A cut through the middle, with the volume that one more cut of each half can leave."""
    height = piece.outline.corners @ u
    offset = float(height.min() + height.max()) / 2
    total = 0.0
    triangles = clipped(piece.outline.triangles, u, offset, 0.0)
    for half, core in zip(triangles, parted(piece.core, u, offset, reach), strict=True):
        if len(half):
            total += _after_best(SimplifiedSurface.of(half), core, directions, reach)
    return Cut(normal=u, offset=offset, bulk=total)


def _after_best(outline: SimplifiedSurface, core: Array, directions: Array, reach: float) -> float:
    """The volume that one more cut can leave, or none, where that is less, of hulls of the outermost points."""
    look = FirstLook.at(outline, core, reach)
    least, cut = look.whole, None
    for w in directions:
        across = outline.corners @ w
        offsets = across.min() + np.ptp(across) * np.array(AHEAD)
        bulks = look.bulks(w, offsets)
        if bulks.min() < least:
            least, cut = float(bulks.min()), (w, float(offsets[bulks.argmin()]))
    if cut is None:
        return bulk(outermost(look.points, AROUND), LAYER)
    return bulk_of_sides(outline, core, *cut, reach, around=np.vstack([AROUND, cut[0], -cut[0]]))


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
    while len(found) < most and len(normals) >= MIN_TOUCHED:
        some = normals[:: max(1, len(normals) // seeds)]
        seed = some[int(np.count_nonzero(some @ normals.T > 0.95, axis=1).argmax())]
        near = normals @ seed > 0.95
        found.append(normals[near].mean(0))
        normals = normals[~near]
    return found


def _offsets(piece: Piece, u: Array, config: ProxyConfig) -> Array:
    height = piece.outline.corners @ u
    low, high = float(height.min()), float(height.max())
    step = config.tolerance / 4
    found = [low + (high - low) * np.arange(1, STEPS) / STEPS]
    bad = piece.off > config.tolerance
    for side in (1, -1):
        facing = bad & (side * (piece.samples.normals @ u) > FACING)
        if np.count_nonzero(facing) >= MIN_TOUCHED:
            levels = _quantiles(side * (piece.samples.points[facing] @ u), LEVELS)
            found.append(side * (levels + config.tolerance / 2))
    offsets = np.unique(np.round(np.concatenate(found) / step)) * step
    return offsets[(offsets > low + step) & (offsets < high - step)]


def _quantiles(values: Array, levels: Sequence[float]) -> Array:
    """As ``np.quantile``, which takes ten times as long for few values."""
    return np.interp(levels, np.linspace(0, 1, len(values)), np.sort(values))
