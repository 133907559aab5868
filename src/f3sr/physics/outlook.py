"""How far bodies will have travelled at the end of a release, told from its first windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from f3sr.core.transforms import Array
from f3sr.physics.mujoco_model import MjData

LOOK = 2
"""Windows whose largest travel is compared with that of as many before: contacts tremble from one to the next."""
STILL = 1e-9
"""Travel in a window that is rounding [m]."""
DOUBT = 4.0
"""Factor on a foreseen drift, to either side. With it none of 16 checks that failed, of 173 in eleven scenes, would
have passed; with 2 one would have."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Outlook:
    """What an undamped check would end with: what creeps goes on, what tips grows by the same factor in every
    window."""

    drifts: Array
    """(n,) [m] so far."""
    before: Array
    now: Array
    """(n,) [m]: the largest travel in a window, of ``LOOK`` windows and of the ``LOOK`` last ones."""
    left: int
    """Windows."""
    limit: float
    """Of the drift [m]."""

    @classmethod
    def of(cls, seen: Sequence[Snapshot], drifts: Array, limit: float, left: int) -> Outlook | None:
        """None in the first second: in its first window wider margins push."""
        if len(seen) < 2 * LOOK + 2:
            return None
        recent = seen[-2 * LOOK - 1 :]
        ways = np.stack([np.linalg.norm(b.centers - a.centers, axis=1)[1:] for a, b in pairwise(recent)])
        before, now = np.maximum(ways[:LOOK].max(0), STILL), np.maximum(ways[LOOK:].max(0), STILL)
        return cls(drifts=drifts, before=before, now=now, left=left, limit=limit)

    @property
    def rests(self) -> bool:
        """Whether every body's drift stays allowed, were all of them ``DOUBT`` times faster."""
        return bool((self.drifts + DOUBT * self._ahead(np.maximum(1.0, self._growth)) <= self.limit).all())

    @property
    def creeps(self) -> bool:
        """Whether a body's drift will not stay allowed, were it ``DOUBT`` times slower, and none is ever faster that
        drifts too far at its present speed."""
        slower = self._growth <= 1
        faster = ~slower & (self.drifts + self.now * self.left > self.limit)
        too_far = self.drifts + self._ahead(self._growth) / DOUBT > self.limit
        return bool((slower & too_far).any() and not faster.any())

    @property
    def foreseen(self) -> Array:
        """(n,) [m]: the drifts at the end."""
        return self.drifts + self._ahead(np.minimum(1.0, self._growth))

    @property
    def _growth(self) -> Array:
        """(n,): factor on the travel from one window to the next."""
        return (self.now / self.before) ** (1 / LOOK)

    def _ahead(self, growth: Array) -> Array:
        """Travel (n,) [m] in the windows that are left."""
        return self.now * (growth[:, None] ** np.arange(1, self.left + 1)).sum(1)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Centres of mass (n, 3) [m] and orientations (n, 3, 3) of all bodies."""

    centers: Array
    turns: Array

    @classmethod
    def of(cls, data: MjData) -> Snapshot:
        return cls(data.xipos.copy(), data.xmat.copy().reshape(-1, 3, 3))
