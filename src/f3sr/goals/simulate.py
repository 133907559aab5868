"""simulate_phase: a phase of a plan played as physics, deterministic to the last bit (docs: physics).

One MuJoCo model holds the package's proxies, masses and inertias with the changes of the plan's semantics. Offsets and
velocities act at the start. Impulses act at their times, as a force and torque on the body's centre of mass. Everything
else is contact and gravity. Nothing is driven, nor damped unless the semantics say so. The arithmetic is simple enough
to be repeated to the bit (``benchmarks/goals/replay.py``): contacts amplify the last digit to millimetres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from f3sr.core.transforms import Array, rotation_from_vector, turn_about
from f3sr.files.bounds import Vector3
from f3sr.goals.plan import Impulse, InitialConditions, Offset, Phase, Semantics, SimulationPlan, Velocity
from f3sr.goals.rollout import CONTACT, Rollout
from f3sr.physics import mujoco_model
from f3sr.physics.contact_margin import ContactMargin
from f3sr.physics.mujoco_model import PhysicsConfig, body_name, engine
from f3sr.physics.mujoco_scene import poses_of
from f3sr.scene import GROUND, Scene, SceneObject

TOUCH = 1e-9
"""Force [N] of a pair whose forces cancel: it touches."""

Watch = Callable[[float, Any], bool]
"""Called with the time [s] and MuJoCo's data at every sample; True ends the rollout there."""


def simulate_phase(scene: Scene, phase: Phase, *, until: Watch | None = None, model: Any = None) -> Rollout:
    """The rollout of a phase in a scene at rest: samples at 0 and after every ``steps_per_sample`` steps, ``duration``
    [s] long.

    Two calls give the same numbers. ``until`` may end it early. ``model`` reuses a result of ``model_of``. Raises
    ValueError if the phase names unknown objects or launches a fixed one. Raises FloatingPointError if the state stops
    being finite.
    """
    _require_playable(scene, phase.semantics, phase.initial)
    if model is None:
        model = model_of(scene, phase.semantics, phase.simulation)
    return _Run.of(model, [o.id for o in scene], phase.initial.offsets).rollout(phase, until)


def model_of(scene: Scene, semantics: Sequence[Semantics], simulation: SimulationPlan) -> Any:
    """MuJoCo's model of a scene with a plan's materials; it serves any number of rollouts, also at once."""
    objects = as_planned(scene, semantics, InitialConditions())
    model = mujoco_model.compiled(
        mujoco_model.build_spec(
            objects,
            PhysicsConfig(timestep=simulation.timestep, contact=ContactMargin(body=simulation.margin)),
            ground_friction=scene.ground.friction,
            bounces=True,
        )
    )
    model.opt.disableflags |= int(engine().mjtDisableBit.mjDSBL_AUTORESET)  # a reset would hide a blow-up
    return model


def start_state(model: Any, ids: Sequence[int], offsets: Sequence[Offset]) -> Any:
    """MuJoCo's data at the start of a rollout: the objects at rest but for the offsets."""
    at_rest, data = engine().MjData(model), engine().MjData(model)
    if offsets:
        engine().mj_forward(model, at_rest)
    for offset in offsets:
        _displace(model, at_rest, offset, list(ids).index(offset.id) + 1)
    data.qpos[:] = at_rest.qpos  # nothing else: solvers start from what was
    engine().mj_forward(model, data)
    return data


def as_planned(scene: Scene, semantics: Sequence[Semantics], initial: InitialConditions) -> tuple[SceneObject, ...]:
    """The scene's objects, by id, with the plan's materials and offsets. Raises ValueError as ``simulate`` does."""
    _require_playable(scene, semantics, initial)
    made = {s.id: _made_of(scene[s.id], s) for s in semantics}
    objects = {o.id: made.get(o.id, o) for o in scene}
    for offset in initial.offsets:
        o = objects[offset.id]
        T = _turned(o, offset.rotation) if any(offset.rotation) else o.T_world_object.copy()
        T[:3, 3] += offset.translation
        objects[offset.id] = replace(o, T_world_object=T)
    return tuple(objects[id] for id in sorted(objects))


def _require_playable(scene: Scene, semantics: Sequence[Semantics], initial: InitialConditions) -> None:
    known = {o.id for o in scene}
    if unknown := ({s.id for s in semantics} | initial.controlled) - known:
        raise ValueError(f"objects {sorted(unknown)} in the plan; the scene has {sorted(known)}")
    mobility = {o.id: o.mobility for o in scene} | {s.id: s.mobility for s in semantics}
    if fixed := [id for id in initial.controlled if mobility[id] == "fixed"]:
        raise ValueError(f"object {fixed[0]} set off; it is fixed")


def _made_of(o: SceneObject, s: Semantics) -> SceneObject:
    return replace(
        o,
        material=s.material,
        density=s.density,
        friction=s.friction,
        rolling_friction=s.rolling_friction,
        restitution=s.restitution,
        mobility=s.mobility,
    )


def _turned(o: SceneObject, rotation: Vector3) -> Array:
    """The pose (4, 4) of an object turned about its centre of mass by a rotation vector."""
    T, R = o.T_world_object, rotation_from_vector(np.array(rotation))
    center = T[:3, :3] @ mujoco_model.body_of(o).center + T[:3, 3]
    return turn_about(center, R) @ T


def _displace(model: Any, data: Any, offset: Offset, body: int) -> None:
    """Turn a body about its centre of mass and shift it."""
    at = int(model.jnt_qposadr[model.body_jntadr[body]])
    if angle := float(np.linalg.norm(offset.rotation)):
        turn, turned, arm = np.zeros(4), np.zeros(4), np.zeros(3)
        engine().mju_axisAngle2Quat(turn, np.array(offset.rotation) / angle, angle)
        engine().mju_mulQuat(turned, turn, data.xquat[body])
        engine().mju_rotVecQuat(arm, data.xpos[body] - data.xipos[body], turn)
        data.qpos[at : at + 7] = [*(data.xipos[body] + arm), *turned]
    data.qpos[at : at + 3] += offset.translation


@dataclass(eq=False)
class _Run:
    """MuJoCo's model and data of one rollout."""

    model: Any
    data: Any
    ids: list[int]

    @classmethod
    def of(cls, model: Any, ids: list[int], offsets: Sequence[Offset]) -> _Run:
        return cls(model, start_state(model, ids, offsets), ids)

    def rollout(self, phase: Phase, until: Watch | None) -> Rollout:
        mujoco, simulation = engine(), phase.simulation
        steps = round(simulation.duration / simulation.timestep)
        for velocity in phase.initial.velocities:
            self._set_off(velocity)
        pushes = [_Push.of(i, self._body(i.id), simulation.timestep) for i in phase.initial.impulses]
        pushes.sort(key=lambda p: p.first)
        kept = self._kept(phase)
        times, poses = [0.0], [poses_of(self.model, self.data, len(self.ids))]
        contacts = list[tuple[float, int, int, float]]()
        peaks = _Peaks(self.model, self.ids)
        for step in range(steps):
            for push in pushes:
                if push.first <= step < push.last:
                    self.data.xfrc_applied[push.body] += push.wrench
            mujoco.mj_step(self.model, self.data)
            self.data.xfrc_applied[:] = 0
            self.data.qvel *= kept
            peaks.feel(self.data, step * simulation.timestep)
            if (step + 1) % simulation.steps_per_sample:
                continue
            times.append((step + 1) * simulation.timestep)
            if not np.isfinite(self.data.qpos).all():
                raise FloatingPointError(f"the simulation blew up after {times[-1]:.3f} s")
            poses.append(poses_of(self.model, self.data, len(self.ids)))
            contacts += peaks.taken()
            if until is not None and until(times[-1], self.data):
                break
        return Rollout(
            time=np.array(times),
            ids=np.array(self.ids, np.int64),
            T_world_object=np.array(poses),
            contacts=np.array(contacts, CONTACT),
        )

    def _set_off(self, velocity: Velocity) -> None:
        """A free joint's speeds are those of the body's origin in the world and of turning in the body's axes."""
        b, at = self._body(velocity.id), int(self.model.joint(body_name(velocity.id)).dofadr[0])
        arm = self.data.xpos[b] - self.data.xipos[b]
        self.data.qvel[at : at + 3] = velocity.linear + np.cross(velocity.angular, arm)
        self.data.qvel[at + 3 : at + 6] = self.data.xmat[b].reshape(3, 3).T @ velocity.angular

    def _kept(self, phase: Phase) -> Array:
        """The share of every free joint's speeds that a step of damping leaves."""
        kept = np.ones(self.model.nv)
        for s in phase.semantics:
            b = self._body(s.id)
            at = int(self.model.body_dofadr[b])
            kept[at : at + int(self.model.body_dofnum[b])] = 1 - s.damping * phase.simulation.timestep
        return kept

    def _body(self, id: int) -> int:
        return self.ids.index(id) + 1


@dataclass(frozen=True, eq=False, kw_only=True)
class _Push:
    """An impulse as a force and torque (6,) on a body from one step until before another."""

    body: int
    first: int
    last: int
    wrench: Array

    @classmethod
    def of(cls, impulse: Impulse, body: int, timestep: float) -> _Push:
        """From the first step at or after its time, over as many steps as its duration has, at least one."""
        first = math.ceil(impulse.time / timestep - 1e-9)
        steps = max(1, round(impulse.duration / timestep))
        wrench = np.array([*impulse.linear, *impulse.angular]) / (steps * timestep)
        return cls(body=body, first=first, last=first + steps, wrench=wrench)


class _Peaks:
    """The largest normal force of every pair that touches, and when, since they were last taken: of two, the vector sum
    over their contacts, for what is wedged in feels forces against each other."""

    def __init__(self, model: Any, ids: Sequence[int]) -> None:
        self.body_of_geom, self.names = np.asarray(model.geom_bodyid), [GROUND, *ids]
        self.times, self.felt = list[float](), list[tuple[Array, Array, Array]]()

    def feel(self, data: Any, time: float) -> None:
        """Keep geoms (c, 2), normals (c, 3) and normal forces (c,) [N] of a step's contacts, for ``taken``."""
        rows = data.contact.efc_address
        active = rows >= 0
        self.times.append(time)
        self.felt.append((data.contact.geom[active], data.contact.frame[active, :3], data.efc_force[rows[active]]))

    def taken(self) -> list[tuple[float, int, int, float]]:
        """Rows of CONTACT by time."""
        geoms, normals, pressing = (np.concatenate(parts) for parts in zip(*self.felt, strict=True))
        step = np.repeat(np.arange(len(self.times)), [len(force) for _, _, force in self.felt])
        bodies, n = self.body_of_geom[geoms], len(self.names)
        pairs, pair = np.unique(np.minimum(*bodies.T) * n + np.maximum(*bodies.T), return_inverse=True)
        force = np.maximum(pressing, 0) * np.where(bodies[:, 0] <= bodies[:, 1], 1.0, -1.0)
        shape = len(self.times), len(pairs)
        at = step * shape[1] + pair
        sums = [np.bincount(at, f, math.prod(shape)) for f in (force[:, None] * normals).T]
        felt = np.linalg.norm(sums, axis=0)
        felt[at[force != 0]] = np.maximum(felt[at[force != 0]], TOUCH)
        felt = felt.reshape(shape)
        first = felt.argmax(0)
        rows = [
            (self.times[first[k]], self.names[pairs[k] // n], self.names[pairs[k] % n], float(felt[first[k], k]))
            for k in np.flatnonzero(felt.any(0))
        ]
        self.times.clear()
        self.felt.clear()
        return sorted(rows)
