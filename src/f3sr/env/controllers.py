"""What actions move: the gripper, or one object without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.env.gripper import Gripper, GripperConfig, add_gripper
from f3sr.errors import InputError
from f3sr.physics.mujoco_model import MjSpec
from f3sr.physics.mujoco_scene import MujocoScene
from f3sr.scene import GRAVITY, Scene

ABOVE = 0.15
"""Height of a waiting gripper over everything [m]."""
AROUND = 0.3
"""How far beyond the objects it may go, aside and up [m]."""


POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
VELOCITIES = ("vx", "vy", "vz", "wx", "wy", "wz")
"""Names of the numbers of a pose and of a velocity, linear before angular."""


class Controller(Protocol):
    """Turns actions into physics."""

    @property
    def space(self) -> spaces.Box: ...

    @property
    def action_names(self) -> tuple[str, ...]:
        """What every number of an action is."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """What every number of ``state`` is."""
        ...

    @property
    def state(self) -> Array:
        """What an observation tells of it (k,)."""
        ...

    def reset(self) -> None:
        """As at the start of an episode."""
        ...

    def command(self, action: NDArray[np.float64]) -> None:
        """What to do from now on."""
        ...

    def act(self, dt: float) -> None:
        """Prepare the next ``dt`` [s]."""
        ...

    def poses(self) -> Mapping[str, Array]:
        """T_world_body (4, 4) of its own bodies, for pictures."""
        ...


@dataclass(eq=False)
class GripperControl:
    """A gripper by velocities (7,) in [-1, 1]: linear, angular, opening; or by poses (8,): position [m], quaternion (w,
    x, y, z), distance between the pads [m]."""

    gripper: Gripper
    by_pose: bool
    _action: NDArray[np.float64]

    @classmethod
    def hang(cls, spec: MjSpec, scene: Scene, config: GripperConfig) -> None:
        """Add it to a model, above the scene."""
        low, high = _extent(scene)
        add_gripper(spec, config, np.array([*(low + high)[:2] / 2, high[2] + ABOVE]))

    @classmethod
    def of(cls, playable: MujocoScene, scene: Scene, config: GripperConfig, *, poses: bool) -> Self:
        low, high = _extent(scene)
        floor = config.pad[2] / 2
        gripper = Gripper(
            model=playable.model,
            data=playable.data,
            config=config,
            low=np.array([*(low[:2] - AROUND), floor]),
            high=high + AROUND,
        )
        return cls(gripper, poses, np.zeros(8 if poses else 7))

    @property
    def space(self) -> spaces.Box:
        if not self.by_pose:
            return spaces.Box(-1.0, 1.0, (7,), np.float64)
        g = self.gripper
        low, high = [*g.low, *-np.ones(4), 0.0], [*g.high, *np.ones(4), g.config.opening]
        return spaces.Box(np.array(low), np.array(high), dtype=np.float64)

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.state_names if self.by_pose else (*VELOCITIES, "opening_rate")

    @property
    def state_names(self) -> tuple[str, ...]:
        return (*POSE, "opening")

    @property
    def state(self) -> Array:
        return self.gripper.state

    def reset(self) -> None:
        self.gripper.reset()
        self._action = np.zeros_like(self._action)

    def command(self, action: NDArray[np.float64]) -> None:
        self._action = action
        if self.by_pose:
            self.gripper.aim(action[:3], action[3:7], float(action[7]))

    def act(self, dt: float) -> None:
        if self.by_pose:
            self.gripper.follow(dt)
            return
        action, config = np.clip(self._action, -1, 1), self.gripper.config
        self.gripper.move(config.speed * action[:3], config.turn * action[3:6], config.closing * float(action[6]), dt)

    def poses(self) -> Mapping[str, Array]:
        return self.gripper.poses()


@dataclass(eq=False)
class ObjectControl:
    """One movable object by velocities (6,) in [-1, 1], linear and angular: a servo pulls at its centre of mass with at
    most ``STRONG`` times its weight."""

    playable: MujocoScene
    body: int
    _action: NDArray[np.float64]

    @classmethod
    def of(cls, playable: MujocoScene, scene: Scene, active: int | None) -> Self:
        """The object of the goal, else the first that can move. Raises InputError where none can."""
        movable = [o.id for o in scene if o.mobility == "dynamic"]
        if not movable:
            raise InputError("package", found="no object that can move", accepted="one at least, or a gripper")
        id = movable[0] if active is None else active
        if id not in movable:
            raise InputError("goal", found=f"object {id}, which is fixed", accepted=f"one of {movable}")
        return cls(playable, playable.ids.index(id) + 1, np.zeros(6))

    @property
    def space(self) -> spaces.Box:
        return spaces.Box(-1.0, 1.0, (6,), np.float64)

    @property
    def action_names(self) -> tuple[str, ...]:
        return VELOCITIES

    @property
    def state_names(self) -> tuple[str, ...]:
        return ()

    @property
    def state(self) -> Array:
        return np.zeros(0)

    def reset(self) -> None:
        self._action = np.zeros(6)

    def command(self, action: NDArray[np.float64]) -> None:
        self._action = np.clip(action, -1, 1)

    def act(self, dt: float) -> None:
        model, data = self.playable.model, self.playable.data
        mass, inertia = float(model.body_mass[self.body]), np.asarray(model.body_inertia[self.body])
        data.xfrc_applied[self.body] = 0
        if not self._action.any():
            return
        # cvel is about the centre of the whole tree: of a free body its own centre of mass.
        turning, moving = data.cvel[self.body, :3], data.cvel[self.body, 3:]
        force = mass * (SPEED * self._action[:3] - moving) / SERVO
        force += [0, 0, mass * GRAVITY * (self._action[2] > 0)]
        torque = inertia.mean() * (TURN * self._action[3:] - turning) / SERVO
        data.xfrc_applied[self.body, :3] = _at_most(force, STRONG * mass * GRAVITY)
        data.xfrc_applied[self.body, 3:] = torque

    def poses(self) -> Mapping[str, Array]:
        return {}


SPEED, TURN = 1.0, 6.0
"""Velocities of an action of 1 [m/s, rad/s]."""
SERVO = 0.01
"""Time constant of the servo [s]: friction takes as much from its speed as it takes in this time."""
STRONG = 5.0
"""Largest force of the servo [weights of the object]."""


def _at_most(vector: Array, length: float) -> Array:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-12))


def _extent(scene: Scene) -> tuple[Array, Array]:
    """Least and largest corners (3,) of everything [m]."""
    corners: Any = [o.bounds_world for o in scene] or [np.zeros((2, 3))]
    whole = np.concatenate(corners)
    return whole.min(0), whole.max(0)
