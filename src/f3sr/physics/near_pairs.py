"""Only parts that are near are tested for contact, until a body has moved so far that others may be (Verlet lists).

MuJoCo's broad and middle phase compare boxes. Of parts whose boxes overlap one pair in ten touches, and every test
costs microseconds in every step. So the pairs whose exact distance allows a contact are listed, and no others are
tested (Verlet, "Computer experiments on classical fluids", Physical Review 159, 1967). The contacts are those of the
whole model, in its order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.physics.mujoco_model import (
    GROUND_NAME,
    MjData,
    MjModel,
    MjSpec,
    PhysicsConfig,
    compiled,
    contact_options,
    engine,
)

SKIN = 1e-3
"""Distance [m] beyond the margin up to which parts are listed. They are listed again when a body has moved half of it;
bodies at rest creep by less."""
SHORT_LIVED, PAUSE = 20, 100
"""Steps: a list that serves for fewer costs more than it saves, as while things fall. Then all parts are tested for so
many."""
ROOM = 3
"""Pairs of a list per part; with more than that all parts are tested. Piles have one or two."""
GROUND_GEOM = 0
"""Index of the ground."""
SHIFT_AND_TURN = np.array([0, 3])
"""Where the position and the quaternion of a free joint begin."""


class NearPairs:
    """A model that is stepped with contacts of near parts."""

    def __init__(self, spec: MjSpec, config: PhysicsConfig) -> None:
        """Takes a specification whose first geom is the ground; all have the margin of ``config``."""
        options = contact_options(config)
        options["margin"] *= 2  # MuJoCo adds the margins of two geoms
        for _ in range(ROOM * len(spec.geoms)):
            spec.add_pair(geomname1=GROUND_NAME, geomname2=GROUND_NAME, **options)
        self.model: MjModel = compiled(spec)
        m = self.model
        self._margin = options["margin"]
        self._types = [m.geom_contype, m.geom_conaffinity, m.body_contype, m.body_conaffinity]
        self._all = [array.copy() for array in self._types]
        self._may_meet = _may_meet(m)
        self._reach = 2 * _radii(m)
        self._places = engine().MjData(m)
        self._listed: Array | None = None
        """Positions at which parts were listed last; None while all are tested."""
        self._steps = 0
        """Since then."""
        self._list(np.empty((0, 2), np.int64))

    def step(self, data: MjData) -> None:
        """One step, with the contacts of near parts."""
        if self._listed is None:
            outdated = self._steps >= PAUSE
        else:
            outdated = not self._travel(data.qpos, self._listed) <= SKIN / 2
        if outdated:
            self._look(data.qpos)
        self._steps += 1
        engine().mj_step(self.model, data)

    def _look(self, qpos: Array) -> None:
        """List the parts that are near at some positions, unless lists do not serve long."""
        short_lived = self._listed is not None and self._steps < SHORT_LIVED
        pairs = None if short_lived or not np.isfinite(qpos).all() else self._near(qpos)
        if pairs is not None and len(pairs) > self.model.npair:
            pairs = None
        for array, whole in zip(self._types, self._all, strict=True):
            array[:] = whole if pairs is None else 0
        self._list(np.empty((0, 2), np.int64) if pairs is None else pairs)
        self._listed = None if pairs is None else qpos.copy()
        self._steps = 0

    def _list(self, pairs: NDArray[np.int64]) -> None:
        """Make pairs (k, 2) of geoms those of the model. What is left of its room is the ground with itself, which
        MuJoCo does not test."""
        m = self.model
        a, b = pairs.T
        first = m.npair - len(pairs)
        m.pair_geom1[:first] = m.pair_geom2[:first] = GROUND_GEOM
        m.pair_signature[:first] = 0
        bodies = m.geom_bodyid[pairs].astype(np.int64)
        signatures = (bodies[:, 0] << 16) + bodies[:, 1]
        order = np.lexsort((b, a, signatures))
        a, b = a[order], b[order]
        m.pair_geom1[first:], m.pair_geom2[first:] = a, b
        m.pair_signature[first:] = signatures[order]
        m.pair_margin[:] = self._margin
        m.pair_friction[first:] = np.maximum(m.geom_friction[a], m.geom_friction[b])[:, [0, 0, 1, 2, 2]]

    def _near(self, qpos: Array) -> NDArray[np.int64]:
        """Pairs (k, 2) of geoms nearer than the skin."""
        mujoco, m, places = engine(), self.model, self._places
        places.qpos[:] = qpos
        mujoco.mj_kinematics(m, places)
        R = places.geom_xmat.reshape(-1, 3, 3)
        centers = places.geom_xpos + np.einsum("gij,gj->gi", R, m.geom_aabb[:, :3])
        halves = np.einsum("gij,gj->gi", np.abs(R), m.geom_aabb[:, 3:])
        low, high = centers - halves, centers + halves
        low[GROUND_GEOM], high[GROUND_GEOM] = -np.inf, [np.inf, np.inf, 0.0]
        limit = self._margin + SKIN
        near = self._may_meet.copy()
        for axis in range(3):
            near &= low[:, None, axis] - high[None, :, axis] < limit
            near &= low[None, :, axis] - high[:, None, axis] < limit
        pairs = np.argwhere(near)
        exact = [
            a == GROUND_GEOM or mujoco.mj_geomDistance(m, places, int(a), int(b), limit, None) < limit for a, b in pairs
        ]
        return pairs[np.array(exact, bool)]

    def _travel(self, qpos: Array, since: Array) -> float:
        """The longest way [m] of any point of a body between two states: the shift and the chord of the turn."""
        squares = np.square(qpos - since).reshape(-1, 7)
        # |q - q'| of unit quaternions is twice the sine of a quarter of the turn: the chord is at most twice that.
        ways = np.sqrt(np.add.reduceat(squares, SHIFT_AND_TURN, axis=1))
        return float(np.maximum.reduce(ways[:, 0] + self._reach * ways[:, 1], initial=0.0))


def _may_meet(m: MjModel) -> NDArray[np.bool_]:
    """Whether two geoms (n, n), the first before the second, are of different bodies of which one moves."""
    body = m.geom_bodyid
    moves = m.body_dofnum[body] > 0
    return np.triu((body[:, None] != body[None]) & (moves[:, None] | moves[None]))


def _radii(m: MjModel) -> Array:
    """Largest distance (k,) [m] of a point of every free body from its origin."""
    boxes = np.abs(m.geom_aabb[:, :3]) + m.geom_aabb[:, 3:]
    far = np.linalg.norm(m.geom_pos, axis=1) + np.linalg.norm(boxes, axis=1)
    return np.array([far[m.geom_bodyid == body].max(initial=0.0) for body in m.jnt_bodyid])
