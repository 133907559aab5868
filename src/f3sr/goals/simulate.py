"""simulate: a plan played out as physics, the same motion every time.

The package's proxies, masses and inertias with what the plan's semantics change, one MuJoCo model for all of it.
Nothing is damped or driven: offsets and velocities hold at the start, impulses come at their times, as a force and
torque on the body's centre of mass for one time step, and all else is contact and gravity. The arithmetic is simple
enough to be written again to the bit (``benchmarks/goals/replay.py``): contacts magnify the last digit to millimetres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from f3sr import physics
from f3sr.export.scene_json import Vector3
from f3sr.frames import Array, pose, rotation_from_quaternion, rotation_from_vector
from f3sr.goals.plan import Impulse, InitialConditions, Plan, Semantics, Velocity
from f3sr.goals.rollout import CONTACT, Rollout
from f3sr.physics import PhysicsConfig, body_name, engine
from f3sr.scene import GROUND, Scene, SceneObject

Watch = Callable[[float, Any], bool]
"""Told the time and MuJoCo's data at every sample; True ends the rollout there."""


def simulate(scene: Scene, plan: Plan, *, until: Watch | None = None) -> Rollout:
    """The rollout of a plan: samples at 0 and after every ``steps_per_sample`` steps, ``duration`` long.

    Two calls give the same numbers. Raises ValueError where the plan names objects that the scene lacks or lets an
    impulse act on what is fixed, and FloatingPointError where the state stops being finite.
    """
    objects = as_planned(scene, plan.semantics, plan.initial)
    run = _Run.of(objects, plan)
    return run.rollout(plan, until)


def as_planned(scene: Scene, semantics: Sequence[Semantics], initial: InitialConditions) -> tuple[SceneObject, ...]:
    """The scene's objects made of what the plan says, where it says."""
    known = {o.id for o in scene}
    if unknown := ({s.id for s in semantics} | initial.controlled) - known:
        raise ValueError(f"objects {sorted(unknown)} in the plan; the scene has {sorted(known)}")
    made = {s.id: _made_of(scene[s.id], s) for s in semantics}
    objects = {o.id: made.get(o.id, o) for o in scene}
    if fixed := [id for id in initial.controlled if objects[id].mobility == "fixed"]:
        raise ValueError(f"object {fixed[0]} set off; it is fixed")
    for offset in initial.offsets:
        o = objects[offset.id]
        T = _turned(o, offset.rotation) if any(offset.rotation) else o.T_world_object.copy()
        T[:3, 3] += offset.translation
        objects[offset.id] = replace(o, T_world_object=T)
    return tuple(objects[id] for id in sorted(objects))


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
    center = T[:3, :3] @ physics.body_of(o).center + T[:3, 3]
    return pose(R, center - R @ center) @ T


@dataclass(eq=False)
class _Run:
    """MuJoCo's model and data of one rollout."""

    model: Any
    data: Any
    ids: list[int]

    @classmethod
    def of(cls, objects: Sequence[SceneObject], plan: Plan) -> _Run:
        mujoco = engine()
        config = PhysicsConfig(timestep=plan.simulation.timestep)
        model = physics.build_spec(objects, config).compile()
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # a reset would hide a blow-up
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return cls(model, data, [o.id for o in objects])

    def rollout(self, plan: Plan, until: Watch | None) -> Rollout:
        mujoco, simulation = engine(), plan.simulation
        steps = round(simulation.duration / simulation.timestep)
        pending = sorted(plan.initial.impulses, key=lambda i: (i.time, i.id))
        for velocity in plan.initial.velocities:
            self._set_off(velocity)
        times, poses, contacts = [0.0], [self._poses()], list[tuple[float, int, int, float]]()
        peaks = dict[tuple[int, int], tuple[float, float]]()
        with physics.silent():
            for step in range(steps):
                while pending and pending[0].time <= step * simulation.timestep:
                    self._push(pending.pop(0))
                mujoco.mj_step(self.model, self.data)
                self.data.xfrc_applied[:] = 0
                self._feel(step * simulation.timestep, peaks)
                if (step + 1) % simulation.steps_per_sample:
                    continue
                times.append((step + 1) * simulation.timestep)
                poses.append(self._poses())
                contacts += sorted((time, *pair, force) for pair, (force, time) in peaks.items())
                peaks.clear()
                if not np.isfinite(poses[-1]).all():
                    raise FloatingPointError(f"the simulation blew up after {times[-1]:.3f} s")
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

    def _push(self, impulse: Impulse) -> None:
        wrench = np.array([*impulse.linear, *impulse.angular])
        self.data.xfrc_applied[self._body(impulse.id)] += wrench / self.model.opt.timestep

    def _body(self, id: int) -> int:
        return self.ids.index(id) + 1

    def _poses(self) -> Array:
        """(N, 4, 4), of what is free from its joint: ``xpos`` is one step old after ``mj_step``."""
        poses = np.tile(np.eye(4), (len(self.ids), 1, 1))
        for k in range(len(self.ids)):
            b, at = k + 1, int(self.model.body_jntadr[k + 1])
            q = None if at < 0 else self.data.qpos[int(self.model.jnt_qposadr[at]) :][:7]
            quaternion, origin = (self.data.xquat[b], self.data.xpos[b]) if q is None else (q[3:], q[:3])
            poses[k, :3, :3], poses[k, :3, 3] = rotation_from_quaternion(quaternion), origin
        return poses

    def _feel(self, time: float, peaks: dict[tuple[int, int], tuple[float, float]]) -> None:
        """Note the largest normal force of every pair that touches, and when."""
        if not self.data.ncon:
            return
        names = np.array([GROUND, *self.ids])
        bodies = names[self.model.geom_bodyid[self.data.contact.geom]]
        rows = self.data.contact.efc_address
        felt = dict[tuple[int, int], float]()
        for (i, j), row in zip(bodies.tolist(), rows.tolist(), strict=True):
            if row >= 0 and (force := float(self.data.efc_force[row])) > 0:
                pair = (min(i, j), max(i, j))
                felt[pair] = felt.get(pair, 0.0) + force
        for pair, force in felt.items():
            if force > peaks.get(pair, (0.0, 0.0))[0]:
                peaks[pair] = (force, time)
