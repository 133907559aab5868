"""Passive physics until a scene rests, and undamped from then on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr.core.transforms import Array, rotation_from_quaternion
from f3sr.physics.mujoco_model import (
    DEFAULT_PHYSICS,
    MjData,
    MjModel,
    PhysicsConfig,
    body_name,
    build_spec,
    contact_loads,
    engine,
    pose_of,
)
from f3sr.physics.near_pairs import NearPairs
from f3sr.physics.outlook import Outlook, Snapshot
from f3sr.physics.release import release_pairs
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import Ground, SceneObject
from f3sr.settings import constants, settings


@constants
class RestConfig:
    """When a body counts as at rest."""

    speed: float = 1e-3
    """Largest mean speed of a centre of mass at rest [m/s]."""
    turning: float = 1e-2
    """Largest mean rate of turn at rest [rad/s]."""
    window: float = 0.2
    """Time over which speeds are averaged [s]: contacts that tremble by micrometres count as still."""
    drift: float = 8e-4
    """Largest travel of a centre of mass in an undamped check [m], four fifths of what the release protocol may show.
    Soft contacts creep on slopes, .1 mm in 5 s in piles and .5 mm in nested bowls, however long they settle."""
    as_measured: bool = True
    """Check again in the model of the release protocol: equal densities spread evenly over the parts, one friction, a
    wider margin. A pose can stand with one centre of mass and tip with the other."""


@settings
class SettleConfig:
    """How a scene comes to rest, and how long to wait for it."""

    damping: Annotated[float, Interval(gt=0, le=50)] = 4.0
    """Damping rate of velocities while settling [1/s]. The checks are undamped."""
    time_limit: Annotated[float, Interval(gt=0, le=600)] = 10.0
    """Most damped simulation, all rounds together [s]."""
    check_time: Annotated[float, Interval(gt=0, le=60)] = 2.0
    """Length of the undamped check after each round [s]."""
    release_time: Annotated[float, Interval(gt=0, le=60)] = 5.0
    """Length of the second undamped check [s], as long as the release protocol: what tips starts slowly."""
    rounds: Annotated[int, Interval(ge=1, le=100)] = 16
    """Most rounds of settling and checking; scenes that creep take eight."""
    rest: RestConfig = RestConfig()


DEFAULT_SETTLING = SettleConfig()
CREEPING = 3
"""Rounds without less drift after which a scene creeps."""
FALLING = 0.9
"""Share of the earlier drift below which the drift still falls."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SettleResult:
    """Where the objects came to rest."""

    T_world_object: Mapping[int, Array]
    """The final pose of every object, fixed ones included; the initial poses when ``exploded``."""
    exploded: bool
    """True when the state stopped being finite."""
    seconds: float
    """Simulated time until rest [s], checks not counted."""
    max_speed: float
    """Largest speed of a centre of mass on the way [m/s]."""
    drifts: Mapping[int, float]
    """Largest travel of every centre of mass, but upward, in the last undamped check [m], foreseen where it creeps;
    infinite when there was none."""
    moving: frozenset[int]
    """Ids of the objects that did not rest in that check: they drifted too far, or still moved at its end."""
    loads: Mapping[tuple[int, int], float]
    """(carried, carrier) ids, the ground GROUND, to the net upward force between them [N]; empty when ``exploded``."""

    @property
    def at_rest(self) -> bool:
        """True when the final poses passed the undamped check."""
        return not self.moving


def settle(
    objects: Sequence[SceneObject],
    config: PhysicsConfig = DEFAULT_PHYSICS,
    *,
    settling: SettleConfig = DEFAULT_SETTLING,
    ground_friction: float = Ground.friction,
) -> SettleResult:
    """Simulate until the objects rest without damping (docs: physics).

    Damped simulation up to rest, then an undamped release of the final positions. If something moves, the next round
    starts where the release ended. A state that is not finite is reported as ``exploded``, not raised.
    """
    mujoco = engine()
    near = _without_reset(NearPairs(build_spec(objects, config, ground_friction=ground_friction), config))
    run, model = _Settling(near, settling), near.model
    data = mujoco.MjData(model)
    drifts, moving, history = np.full(len(objects), np.inf), np.full(len(objects), True), list[float]()
    for _ in range(settling.rounds):
        run.until_rest(data)
        run.exploded = run.exploded or not np.isfinite(data.qpos).all()
        if run.exploded:
            break
        checks = [_Check.as_simulated(near, data, settling)]
        if settling.rest.as_measured:
            checks.append(_Check.as_measured(objects, model, data, settling))
        drifts, moving, failed = run.released(checks)
        data = _fresh(model, failed.positions) if failed else data
        history.append(float(drifts.max()))
        if failed is None or run.exploded or run.seconds >= settling.time_limit or _creeps(history):
            break
    return SettleResult(
        T_world_object={o.id: o.T_world_object if run.exploded else pose_of(model, data, o) for o in objects},
        exploded=run.exploded,
        seconds=run.seconds,
        max_speed=run.max_speed,
        drifts={o.id: float(d) for o, d in zip(objects, drifts, strict=True)},
        moving=frozenset(o.id for o, moves in zip(objects, moving, strict=True) if moves or run.exploded),
        loads={} if run.exploded else contact_loads(model, data, [o.id for o in objects]),
    )


def _fresh(model: MjModel, qpos: Array) -> MjData:
    """Positions with nothing remembered: no velocity, no warm start."""
    new = engine().MjData(model)
    new.qpos[:] = qpos
    return new


def _without_reset(near: NearPairs) -> NearPairs:
    near.model.opt.disableflags |= int(engine().mjtDisableBit.mjDSBL_AUTORESET)  # a reset would hide a blow-up
    return near


def _creeps(history: Sequence[float]) -> bool:
    """Whether the largest drifts of rounds [m] do not fall any more: what creeps would creep in every further round."""
    recent, before = history[-CREEPING:], history[:-CREEPING]
    return bool(before) and min(recent) > FALLING * min(before)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Check:
    """An undamped run from where all objects are."""

    near: NearPairs
    data: MjData
    """At its start, then at its end."""
    seconds: float
    bodies: NDArray[np.int64]
    """(n,) the body of every object, the first after the world being 0."""
    joints: NDArray[np.int64] | None = None
    """(m,) the free joints of what can move, in the order of the objects; None where they are in it already."""
    start: Array | None = None
    """(m, 7) the positions and quaternions to which those of ``joints`` are relative."""

    @classmethod
    def as_simulated(cls, near: NearPairs, data: MjData, settling: SettleConfig) -> _Check:
        bodies = np.arange(near.model.nbody - 1)
        return cls(near=near, data=_fresh(near.model, data.qpos), seconds=settling.check_time, bodies=bodies)

    @classmethod
    def as_measured(
        cls, objects: Sequence[SceneObject], model: MjModel, data: MjData, settling: SettleConfig
    ) -> _Check:
        """In the model of the release protocol, with objects where ``data`` of their own ``model`` has them."""
        here = [replace(o, T_world_object=pose_of(model, data, o)) for o in objects]
        near = _without_reset(release_pairs(here))
        names = [body_name(o.id) for o in objects]
        return cls(
            near=near,
            data=engine().MjData(near.model),
            seconds=settling.release_time,
            bodies=np.array([near.model.body(name).id - 1 for name in names]),
            start=data.qpos.reshape(-1, 7).copy(),
            joints=np.array(
                [near.model.joint(n).id for o, n in zip(objects, names, strict=True) if o.mobility != "fixed"], np.int64
            ),
        )

    @property
    def positions(self) -> Array:
        """Those of the objects' own model."""
        if self.start is None or self.joints is None:
            return self.data.qpos
        moves = self.data.qpos.reshape(-1, 7)[self.joints]
        return np.concatenate([_moved(q, by) for q, by in zip(self.start, moves, strict=True)] or [np.empty(0)])


def _moved(q: Array, by: Array) -> Array:
    """A position and quaternion (7,) moved by another such in the world."""
    turned = np.empty(4)
    engine().mju_mulQuat(turned, by[3:], q[3:])
    return np.r_[rotation_from_quaternion(by[3:]) @ q[:3] + by[:3], turned]


@dataclass(eq=False)
class _Settling:
    """The run of ``settle``: steps data and keeps count of time and speed."""

    near: NearPairs
    config: SettleConfig
    seconds: float = 0.0
    max_speed: float = 0.0
    exploded: bool = False
    unwanted: bool = False
    """Set by another thread to end an undamped check."""

    def until_rest(self, data: MjData) -> None:
        """Damped steps until the mean speeds of a window of ``rest.window`` are low, or the time is up."""
        damping = 1 - self.config.damping * self._model.opt.timestep
        while self.seconds < self.config.time_limit and not self.exploded:
            before = Snapshot.of(data)
            for _ in range(self._window):
                self._step(data, damping)
            self.seconds += self.config.rest.window
            if not self._moving(before, Snapshot.of(data)).any():
                return

    def released(self, checks: Sequence[_Check]) -> tuple[Array, NDArray[np.bool_], _Check | None]:
        """Undamped checks, all at the same time: MuJoCo releases the GIL. The largest travel of every centre of mass
        (n,) [m] up to the first check that fails, which objects (n,) do not rest in it, and that check; None where all
        rest."""
        runs = [_Settling(check.near, self.config) for check in checks]
        going_on = [begun(run.undamped, c.data, c.seconds) for run, c in zip(runs, checks, strict=True)]
        drifts, moving = np.zeros(self._model.nbody - 1), np.full(self._model.nbody - 1, False)
        for run, check, result in zip(runs, checks, going_on, strict=True):
            travels, restless = result.result()
            drifts, moving = np.maximum(drifts, travels[check.bodies]), restless[check.bodies]
            self.max_speed, self.exploded = max(self.max_speed, run.max_speed), self.exploded or run.exploded
            if moving.any():
                for other in runs:
                    other.unwanted = True
                return drifts, moving, check
        return drifts, moving, None

    def undamped(self, data: MjData, seconds: float) -> tuple[Array, NDArray[np.bool_]]:
        """Undamped steps: the largest travel of every centre of mass (n,) [m], and which bodies (n,) do not rest.

        They end early when no body would drift too far even if its travel went on growing as it does. They also end
        when a body creeps: then the travels are those foreseen for all of the time."""
        engine().mj_forward(self._model, data)
        seen = [Snapshot.of(data)]
        squares, drifts = np.zeros(self._model.nbody), np.zeros(self._model.nbody - 1)
        limit = self.config.rest.drift
        windows = max(1, round(seconds / self.config.rest.window))
        while len(seen) <= windows and not self.unwanted:
            for _ in range(self._window):
                self._step(data, 1.0)
                way = data.xipos - seen[0].centers
                way[:, 2] = np.minimum(way[:, 2], 0)  # what is pushed up by a wider margin does not fall
                squares = np.maximum(squares, np.add.reduce(way * way, axis=1))
            drifts = np.sqrt(squares[1:])
            seen.append(Snapshot.of(data))
            if self.exploded or drifts.max() > 20 * limit:
                return drifts, (drifts > limit) | self.exploded
            outlook = Outlook.of(seen, drifts, limit, left=windows - len(seen) + 1)
            if outlook and outlook.rests:
                break
            if outlook and outlook.creeps:
                return outlook.foreseen, outlook.foreseen > limit
        return drifts, self._moving(*seen[-2:]) | (drifts > limit)

    @property
    def _model(self) -> MjModel:
        return self.near.model

    @property
    def _window(self) -> int:
        """Steps in ``rest.window``."""
        return max(1, round(self.config.rest.window / self._model.opt.timestep))

    def _step(self, data: MjData, damping: float) -> None:
        """One step, noting the largest speed; ``cvel`` is (angular, linear) at each free body's centre of mass."""
        self.near.step(data)
        if damping != 1:
            data.qvel *= damping
        linear = data.cvel[:, 3:]
        speed = math.sqrt(np.maximum.reduce(np.add.reduce(linear * linear, axis=1)))
        self.max_speed = max(self.max_speed, speed)
        self.exploded = self.exploded or not math.isfinite(speed)

    def _moving(self, before: Snapshot, after: Snapshot) -> NDArray[np.bool_]:
        """Which bodies (n,) have mean speeds over the limits between two snapshots, one window apart."""
        linear = np.linalg.norm(after.centers - before.centers, axis=1)[1:] / self.config.rest.window
        turns = np.einsum("nij,nij->n", after.turns, before.turns)[1:]
        angular = np.arccos(np.clip((turns - 1) / 2, -1, 1)) / self.config.rest.window
        self.exploded = self.exploded or not np.isfinite(linear + angular).all()
        return ~((linear < self.config.rest.speed) & (angular < self.config.rest.turning))
