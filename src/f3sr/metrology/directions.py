"""Which cameras explain the directions of line segments: edges of things are vertical, or in two horizontal directions
at right angles, a pair for each object, the ground and the room (Coughlan and Yuille 1999, a world per object).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.runtime.kernels import inner_kernel, kernel
from f3sr.settings import constants

FARTHEST = 15.0
"""Half the squared standard errors from which on a segment does not follow a direction: exp(-15) is 3e-7."""


@constants
class DirectionModel:
    """How segments scatter about the directions of edges."""

    end: float = 0.7
    """Standard deviation of a segment's end across it [px]."""
    shape: float = math.radians(1.0)
    """Standard deviation of an object's edge from its direction [rad]: real boxes bulge and lean a little."""
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
    their directions, and the group (n,) of each, from 0 to ``groups`` - 1."""

    middles: Array
    directions: Array
    sigmas: Array
    group: NDArray[np.int64]
    groups: int


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
    )


def log_likelihoods(
    found: GroupedSegments, focals: Array, rotations: Array, model: DirectionModel, *, step: float, blur: float = 0.0
) -> Array:
    """The log-likelihood (t, groups) of every group's segments under cameras, over that of segments of any direction.

    ``focals`` (t,) [px]; ``rotations`` (t, 3, 3) hold the world's right, forward and up in camera axes, as columns.
    Each group has its best horizontal direction of those ``step`` [rad] apart. ``blur`` [rad] widens each: then
    a coarse search misses none."""
    turns = np.arange(0, np.pi / 2, step)
    out = np.zeros((len(focals), found.groups))
    if len(found.sigmas):
        _sum_groups(
            found.directions,
            found.middles,
            np.hypot(found.sigmas, blur),
            found.group,
            np.ascontiguousarray(rotations),
            focals,
            np.column_stack([np.cos(turns), np.sin(turns)]),
            np.array([model.strange, model.vertical]),
            out,
        )
    return model.weight * out


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
    rotations: Array,
    focals: Array,
    turns: Array,
    shares: Array,
    out: Array,
) -> None:
    groups = out.shape[1]
    total = np.zeros((groups, len(turns)))
    strange = shares[0] * 2 / np.pi
    each = (1 - shares[0] - shares[1]) / 2
    off, along = np.zeros(3), np.zeros(3)
    for t in range(len(focals)):
        f, R = focals[t], rotations[t]
        total[:] = 0
        for s in range(len(sigmas)):
            ux, uy = directions[s]
            mx, my = middles[s]
            for k in range(3):  # of each axis' image at the segment's middle: its parts across and along the segment
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
            best = -np.inf
            for j in range(len(turns)):
                best = max(best, total[g, j])
            out[t, g] = best


@inner_kernel
def _bell(off: float, along: float, curve: float) -> float:
    """exp(-curve x^2) for the sine x of the angle whose tangent is off / along."""
    far, all = off * off * curve, off * off + along * along + 1e-30
    return math.exp(-far / all) if far < FARTHEST * all else 0.0
