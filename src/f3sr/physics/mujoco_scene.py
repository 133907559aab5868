"""A scene as MuJoCo plays it, for programs that step the engine themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from f3sr.core.transforms import Array, quaternion_from_rotation, rotation_from_quaternion
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, MjData, MjModel, PhysicsConfig, build_spec, compiled, engine
from f3sr.scene import Ground, SceneObject


@dataclass(frozen=True, eq=False, kw_only=True)
class MujocoScene:
    """MuJoCo's model and data of some objects. Body k + 1 is the object ``ids[k]``; bodies that others add follow."""

    model: MjModel
    data: MjData
    ids: tuple[int, ...]
    names: Mapping[int, str]
    """Of the body and the free joint of every object, by id."""

    @classmethod
    def of(
        cls,
        objects: Iterable[SceneObject],
        config: PhysicsConfig = DEFAULT_PHYSICS,
        *,
        ground_friction: float = Ground.friction,
    ) -> Self:
        """At rest where the objects are; with the contact margin with which f3sr settles, so that nothing falls."""
        chosen = tuple(objects)
        return cls.compiled(build_spec(chosen, config, ground_friction=ground_friction), chosen)

    @classmethod
    def compiled(cls, spec: object, objects: tuple[SceneObject, ...]) -> Self:
        """Of a specification whose first bodies are the objects. Raises ValueError if MuJoCo rejects a number."""
        model = compiled(spec)
        data = engine().MjData(model)
        engine().mj_forward(model, data)
        names = {o.id: str(model.body(k + 1).name) for k, o in enumerate(objects)}
        return cls(model=model, data=data, ids=tuple(o.id for o in objects), names=MappingProxyType(names))

    def poses(self) -> Array:
        """T_world_object (N, 4, 4) of the objects [m]."""
        return poses_of(self.model, self.data, len(self.ids))

    def states(self) -> Array:
        """Position [m] and quaternion (w, x, y, z) of the objects (N, 7)."""
        return states_of(self.model, self.data, len(self.ids))

    def velocities(self) -> Array:
        """Of the objects (N, 6): linear of the origin in the world [m/s], angular in the object's axes [rad/s]."""
        found = np.zeros((len(self.ids), 6))
        speeds = self.model.body_dofadr[1 : len(self.ids) + 1]
        free = speeds >= 0
        found[free] = self.data.qvel[speeds[free][:, None] + np.arange(6)]
        return found

    def put(self, T_world_object: ArrayLike) -> None:
        """Place the movable objects at poses (N, 4, 4), without speed."""
        poses = np.asarray(T_world_object, float)
        for k, T in enumerate(poses):
            joint = int(self.model.body_jntadr[k + 1])
            if joint >= 0:
                at, speed = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
                self.data.qpos[at : at + 7] = [*T[:3, 3], *quaternion_from_rotation(T[:3, :3])]
                self.data.qvel[speed : speed + 6] = 0
        engine().mj_forward(self.model, self.data)


def poses_of(model: MjModel, data: MjData, count: int) -> Array:
    """T_world_body (count, 4, 4) of the first bodies [m]."""
    return poses_from(states_of(model, data, count))


def states_of(model: MjModel, data: MjData, count: int) -> Array:
    """(count, 7) position [m] and quaternion (w, x, y, z) of the first bodies, of what is free from its joint: ``xpos``
    is one step old after ``mj_step``."""
    bodies = slice(1, count + 1)
    states = np.concatenate([data.xpos[bodies], data.xquat[bodies]], axis=1)
    joints = model.body_jntadr[bodies]
    free = joints >= 0
    states[free] = data.qpos[model.jnt_qposadr[joints[free]][:, None] + np.arange(7)]
    return states


def poses_from(states: Array) -> Array:
    """Poses (..., 4, 4) of states (..., 7): position and quaternion (w, x, y, z)."""
    flat = states.reshape(-1, 7)
    poses = np.tile(np.eye(4), (len(flat), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotation_from_quaternion(flat[:, 3:]), flat[:, :3]
    return poses.reshape(*states.shape[:-1], 4, 4)
