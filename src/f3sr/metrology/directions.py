"""Which cameras explain the directions of line segments: edges of things are vertical, or in two horizontal directions
at right angles, a pair for each object, the ground and the room (Coughlan and Yuille 1999, a world per object).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.runtime.kernels import inner_kernel, kernel
from f3sr.settings import constants
from f3sr.vision.rasterizer import THREADS, in_bands

FARTHEST = 15.0
"""Half the squared standard errors from which on a segment does not follow a direction: exp(-15) is 3e-7."""

LEANS = np.array([[0.0, 0.0], [1.5, 0], [-1.5, 0], [0, 1.5], [0, -1.5]])
"""Tilts of an object that are weighed, about the two horizontal axes [standard deviations]."""


@constants
class DirectionModel:
    """How segments scatter about the directions of edges."""

    end: float = 0.7
    """Standard deviation of a segment's end across it [px]."""
    shape: float = math.radians(0.6)
    """Standard deviation of an object's edge from its direction [rad]: real boxes bulge a little."""
    lean: float = math.radians(2.0)
    """Standard deviation of the tilt of an object as a whole, about each horizontal axis [rad]: of 0 to 3 degrees, the
    photos of shared data are likeliest with 2."""
    flat: float = math.radians(0.3)
    """The same of the ground and of what is no object: tables and walls are straight."""
    strange: float = 0.35
    """Share of segments that follow none of the three directions: print, texture, slanted edges."""
    vertical: float = 0.25
    """Share of vertical segments; the horizontal directions have the rest in halves."""
    weight: float = 0.25
    """Share of its log-likelihood that each segment has: segments of one print or one edge repeat each other."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GroupedSegments:
    """Line segments about the principal point: ``middles`` (n, 2), unit ``directions`` (n, 2), ``sigmas`` (n,) [rad] of
    their directions, and the group (n,) of each, from 0 to ``groups`` - 1. The first ``objects`` groups may lean."""

    middles: Array
    directions: Array
    sigmas: Array
    group: NDArray[np.int64]
    groups: int
    objects: int


def grouped(
    segments: Array, group: NDArray[np.int64], *, objects: int, centre: Array, model: DirectionModel
) -> GroupedSegments:
    """Segments (n, 4) [px] with the group (n,) of each; groups from ``objects`` on are no objects."""
    start, end = segments[:, :2] - centre, segments[:, 2:] - centre
    along = end - start
    length = np.linalg.norm(along, axis=1)
    spread = np.where(group < objects, model.shape, model.flat)
    return GroupedSegments(
        middles=(start + end) / 2,
        directions=along / length[:, None],
        sigmas=np.hypot(np.arctan(2 * model.end / length), spread),
        group=group,
        groups=int(group.max(initial=-1)) + 1,
        objects=objects,
    )


def log_likelihoods(
    found: GroupedSegments, focals: Array, rotations: Array, model: DirectionModel, *, step: float, blur: float = 0.0
) -> Array:
    """The log-likelihood (t, groups) of every group's segments under cameras, over that of segments of any direction.

    ``focals`` (t,) [px]; ``rotations`` (t, 3, 3) hold the world's right, forward and up in camera axes, as columns.
    Each group has its best horizontal direction of those ``step`` [rad] apart, and each object its own tilt, which is
    summed over. ``blur`` [rad] widens each direction: then a coarse search misses none. It stands for tilts too."""
    out = np.zeros((len(focals), found.groups))
    if not len(found.sigmas):
        return out
    angles = np.arange(0, np.pi / 2, step)
    turns = np.column_stack([np.cos(angles), np.sin(angles)])
    segments = found.directions, found.middles, np.hypot(found.sigmas, blur), found.group, found.objects
    cameras = np.ascontiguousarray(rotations), focals
    leans, lean_shares = _leans(0.0 if blur else model.lean)
    shares = np.array([model.strange, model.vertical])

    def sum_groups(band: tuple[int, int]) -> None:
        _sum_groups(*segments, *cameras, turns, leans, lean_shares, shares, model.weight, *band, out)

    in_bands(sum_groups, (0, len(focals)), THREADS)
    return out


def _leans(sigma: float) -> tuple[Array, Array]:
    """Rotations (k, 3, 3) of leaning objects, that of upright ones first, and their shares (k,)."""
    if sigma == 0:
        return np.eye(3)[None], np.ones(1)
    shares = np.exp(-0.5 * (LEANS**2).sum(1))
    return np.array([rotation_from_vector([a, b, 0.0]) for a, b in sigma * LEANS]), shares / shares.sum()


def warm_up() -> None:
    """Call every kernel once, with the types that the product uses."""
    model = DirectionModel()
    one = grouped(np.array([[0.0, 0, 9, 0]]), np.zeros(1, np.int64), objects=1, centre=np.zeros(2), model=model)
    log_likelihoods(one, np.ones(1), np.eye(3)[None], model, step=1.0)


@kernel
def _sum_groups(
    directions: Array,
    middles: Array,
    sigmas: Array,
    group: NDArray[np.int64],
    objects: int,
    rotations: Array,
    focals: Array,
    turns: Array,
    leans: Array,
    lean_shares: Array,
    shares: Array,
    weight: float,
    first: int,
    stop: int,
    out: Array,
) -> None:
    groups = out.shape[1]
    total, best = np.zeros((groups, len(turns))), np.zeros((len(leans), groups))
    strange = shares[0] * 2 / np.pi
    each = (1 - shares[0] - shares[1]) / 2
    off, along = np.zeros(3), np.zeros(3)
    for t in range(first, stop):
        f = focals[t]
        for lean in range(len(leans)):
            R = rotations[t] @ leans[lean]
            total[:] = 0
            for s in range(len(sigmas)):
                if lean > 0 and group[s] >= objects:
                    continue
                ux, uy = directions[s]
                mx, my = middles[s]
                for k in range(3):  # of each axis' image at the segment's middle: its parts across and along it
                    x, y = f * R[0, k] - mx * R[2, k], f * R[1, k] - my * R[2, k]
                    off[k], along[k] = ux * y - uy * x, ux * x + uy * y
                height = math.sqrt(2 / np.pi) / sigmas[s]
                curve = 0.5 / sigmas[s] ** 2
                base = strange + shares[1] * height * _bell(off[2], along[2], curve)
                neither = math.log(base / strange)
                for j in range(len(turns)):
                    c, n = turns[j]
                    both = _bell(off[0] * c + off[1] * n, along[0] * c + along[1] * n, curve)
                    both += _bell(off[1] * c - off[0] * n, along[1] * c - along[0] * n, curve)
                    total[group[s], j] += math.log((base + each * height * both) / strange) if both > 0 else neither
            for g in range(groups):
                best[lean, g] = weight * total[g].max()
        for g in range(groups):
            out[t, g] = best[0, g]
            if g < objects:
                highest = best[:, g].max()
                out[t, g] = highest + math.log((lean_shares * np.exp(best[:, g] - highest)).sum())


@inner_kernel
def _bell(off: float, along: float, curve: float) -> float:
    """exp(-curve x^2) for the sine x of the angle whose tangent is off / along."""
    far, all = off * off * curve, off * off + along * along + 1e-30
    return math.exp(-far / all) if far < FARTHEST * all else 0.0
