"""What contact feels of convex parts that stand off their mesh, against what a part is worth.

The loss of a hull is the square of its stand-off in units of the tolerance, averaged over the surface of the mesh. The
recess of a can's lid is a small loss that only many parts avoid; the cavity of a bowl is a large one. So there are as
many parts as make loss plus ``PART_WORTH`` times their number small (Lagrangian of rate and distortion).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.proxies.hulls import Hull
from f3sr.proxies.surface import Samples, stand_off

PART_WORTH = 0.01
"""Loss that one part fewer is worth: a stand-off by the tolerance over 1% of the surface."""
MOST_OFF = 4.0
"""Largest stand-off that a part fewer may bring [tolerances]."""
NOISE = 3
"""Samples from the farthest on that are no longer noise."""
HELD = 1e-9
"""What lies this far outside a hull still counts as in it [size]."""


@dataclass(frozen=True, kw_only=True)
class Loss:
    """Largest stand-off of a hull, but for a few samples [tolerances], and its loss."""

    off: float = 0.0
    loss: float = 0.0

    @property
    def pays(self) -> bool:
        """Whether another part may pay: it saves at most the whole loss."""
        return self.loss > PART_WORTH or self.off > MOST_OFF

    def with_(self, other: Loss) -> Loss:
        """Of two views of the same hull: the worse one."""
        return Loss(off=max(self.off, other.off), loss=max(self.loss, other.loss))


def of_samples(off: Array, count: int, tolerance: float) -> Loss:
    """The loss of a hull that stands off (n,) [size] at the samples that it holds, of ``count`` of the mesh."""
    off = off / tolerance
    return Loss(off=_but_noise(off), loss=float((off**2).sum()) / count)


def of_surface(bare: Array, share: float, tolerance: float) -> Loss:
    """The loss of a hull at points of its own surface, which lie ``bare`` (n,) [size] off the mesh.

    ``share``: the hull's area as a share of the mesh's."""
    off = bare / tolerance
    return Loss(off=_but_noise(off), loss=float((off**2).mean()) * share)


def stand_off_in(hull: Hull, samples: Samples) -> Array:
    """How far a hull stands off at those of some samples that lie in it (n,) [size]."""
    low, high = hull.corners.min(0), hull.corners.max(0)
    near = samples.chosen(np.all((samples.points >= low) & (samples.points <= high), axis=1))
    held = near.chosen((near.points @ hull.normals.T - hull.offsets).max(1, initial=-1) <= HELD)
    return stand_off(held, hull.normals, hull.offsets) if len(held.points) else np.zeros(0)


def _but_noise(off: Array) -> float:
    """The largest but for the few that are noise."""
    return float(np.partition(off, -NOISE)[-NOISE]) if len(off) >= NOISE else 0.0
