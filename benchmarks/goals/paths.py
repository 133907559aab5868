"""When two bodies come to touch, also between the samples of a film."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation
from seen import GROUND, Film, placed

TOUCH = 5e-4
"""[m] Bodies nearer than this touch; at rest they are held .2 to .4 mm apart."""
LOOSE = 3e-3
"""[m] A body farther than this from everything flies; one that stands off by it after touching has let go."""
STEPS = 8
"""Positions looked at between two samples."""
UNHIT = 12.0
"""[m/s2] Gravity and friction change a path by no more; where more is seen, something hit it."""

Pair = tuple[np.ndarray, np.ndarray | None]


def touch(film: Film, a: int, b: int) -> tuple[float | None, float]:
    """When two bodies come to touch, None if never, and the least gap [m] that was seen on the way, at most FAR.

    Between samples they are looked at on straight paths. Where the rollout recorded a contact, also on the paths by
    which both would have gone on, or must have come, without a hit: who would have gone into the other has met it.
    """
    least, start = np.inf, 0
    while start < len(film.time) and film.gap(a, b, start) <= (LOOSE if start else TOUCH):
        start += 1  # they began together
    for k in range(start, len(film.time)):
        gap = film.gap(a, b, k)
        least = min(least, gap)
        if gap <= TOUCH:
            return float(film.time[k]), gap
        if k + 1 < len(film.time) and gap <= reach(film, a, b, k):
            for s in (np.arange(STEPS) + 1) / (STEPS + 1):
                gap = min(film.gap_of(a, Ta, b, Tb) for Ta, Tb in on_the_way(film, a, b, k, float(s)))
                least = min(least, gap)
                if gap <= TOUCH:
                    return float(film.time[k] + s * (film.time[k + 1] - film.time[k])), gap
    return None, float(least)


def recorded(film: Film, a: int, b: int) -> np.ndarray:
    """Times [s] at which the rollout has the two in contact."""
    return np.array([t for t, i, j, _ in film.contacts if {i, j} == {a, b} and t > 0])


def reach(film: Film, a: int, b: int, k: int) -> float:
    """How much two bodies' gap can change from a sample to the next [m]: what both travel then, or beside it."""
    around = slice(max(0, k - 1), k + 2)
    return 1.2 * sum(float(travels(film, id)[around].max(initial=0)) for id in (a, b) if id != GROUND)


@lru_cache(maxsize=64)
def travels(film: Film, id: int) -> np.ndarray:
    """(T-1,) the most [m] that any point of a body moves from each sample to the next."""
    at = [film.points(id, k) for k in range(len(film.time))]
    return np.array([np.linalg.norm(q - p, axis=1).max() for p, q in pairwise(at)])


def on_the_way(film: Film, a: int, b: int, k: int, s: float) -> list[Pair]:
    """Poses of both in between: straight, and, where a contact was recorded then or just beside, on the unhit paths."""
    ways: list[tuple[int, int, int | None, float]] = [(k + 1, k, None, -s)]
    rows, around = recorded(film, a, b), film.time[[max(0, k - 1), min(k + 2, len(film.time) - 1)]]
    if ((rows >= around[0]) & (rows <= around[1])).any():
        ways += [(k - 1, k, k - 2, s), (k + 2, k + 1, k + 3, 1 - s)]
    found: list[Pair] = []
    for i, j, h, share in ways:
        Ta = gone_on(film, a, i, j, h, share)
        Tb = None if b == GROUND else gone_on(film, b, i, j, h, share)
        if Ta is not None and (b == GROUND or Tb is not None):
            found.append((Ta, Tb))
    return found


def mixed(film: Film, id: int, k: int, s: float) -> np.ndarray:
    """The pose a share of the way from a sample to the next."""
    T = gone_on(film, id, k + 1, k, None, -s)
    assert T is not None
    return T


def gone_on(film: Film, id: int, i: int, j: int, h: int | None, s: float) -> np.ndarray | None:
    """The pose a share of an interval after sample ``j`` on the path that led from ``i`` to it, bent as from ``h`` on;
    None where there is no such path or something hit it."""
    if any(not 0 <= n < len(film.time) for n in (i, j, *(() if h is None else (h,)))):
        return None
    com, bend = film.bodies[id].com, np.zeros(3)
    pi, pj = placed(film.T[id][i], com), placed(film.T[id][j], com)
    if h is not None:
        bend = pj - 2 * pi + placed(film.T[id][h], com)
        if np.linalg.norm(bend) > UNHIT * (film.time[j] - film.time[i]) ** 2:
            return None
    turn = Rotation.from_matrix(film.T[id][j][:3, :3] @ film.T[id][i][:3, :3].T).as_rotvec()
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(s * turn).as_matrix() @ film.T[id][j][:3, :3]
    T[:3, 3] = pj + s * (pj - pi) + (s * s + s) / 2 * bend - T[:3, :3] @ com
    return T
