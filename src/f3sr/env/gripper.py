"""A two-finger gripper that follows a mocap body: a hand welded softly to a frame that actions move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from f3sr.core.transforms import Array, quaternion_from_rotation, rotation_about, rotation_from_quaternion
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, contact_options, engine
from f3sr.settings import settings

HAND, TARGET, FINGERS = "gripper", "gripper_target", ("gripper_finger_left", "gripper_finger_right")
APPROACH = rotation_about([1.0, 0, 0], np.pi)
"""Axes of a hand that points down: x along the pads' width, y along which fingers close, z to the finger tips."""
Length = Annotated[float, Interval(gt=0, le=1)]


@settings
class GripperConfig:
    """Sizes and limits; those of a common parallel gripper of 85 mm stroke."""

    opening: Length = 0.085
    """Largest distance between the pads [m]."""
    pad: tuple[Length, Length, Length] = (0.022, 0.008, 0.06)
    """Width, thickness and length of a finger [m]; the hand's frame is in the middle between two pads."""
    palm: tuple[Length, Length, Length] = (0.04, 0.11, 0.03)
    """Sides of the palm, which ends where the fingers begin [m]."""
    mass: Annotated[float, Interval(gt=0, le=20)] = 0.6
    """Of all of it [kg]; its weight is carried."""
    force: Annotated[float, Interval(gt=0, le=500)] = 40.0
    """Largest force of a finger [N]."""
    friction: Annotated[float, Interval(gt=0, le=3)] = 1.0
    """Coefficient of sliding friction of the pads, which are rubber."""
    speed: Annotated[float, Interval(gt=0, le=5)] = 0.5
    """Largest speed of the hand [m/s]."""
    turn: Annotated[float, Interval(gt=0, le=20)] = 2.0
    """Largest rate of rotation of the hand [rad/s]."""
    closing: Annotated[float, Interval(gt=0, le=2)] = 0.15
    """Largest rate at which the pads close or open [m/s]."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """A box of the gripper: the body it belongs to, its half sides and its middle in that body [m]."""

    body: str
    half: tuple[float, float, float]
    middle: tuple[float, float, float]


def blocks(config: GripperConfig) -> tuple[Block, ...]:
    """What it is made of, for physics and pictures alike."""
    width, thickness, length = config.pad
    x, y, z = config.palm
    palm = Block(body=HAND, half=(x / 2, y / 2, z / 2), middle=(0.0, 0.0, -length / 2 - z / 2))
    half = width / 2, thickness / 2, length / 2
    sides = zip(FINGERS, (1, -1), strict=True)
    return palm, *(Block(body=name, half=half, middle=(0.0, s * thickness / 2, 0.0)) for name, s in sides)


def add_gripper(spec: Any, config: GripperConfig, position: Array) -> None:
    """Hang it into a model with its frame at ``position`` (3,) [m], pointing down, open."""
    mujoco = engine()
    world, turn = spec.worldbody, quaternion_from_rotation(APPROACH)
    world.add_body(name=TARGET, pos=position, quat=turn, mocap=True)
    hand = world.add_body(name=HAND, pos=position, quat=turn, gravcomp=1)
    hand.add_freejoint(name=HAND)
    bodies = {HAND: hand}
    for name, side in zip(FINGERS, (1, -1), strict=True):
        finger = bodies[name] = hand.add_body(name=name, gravcomp=1)
        finger.add_joint(
            name=name,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, side, 0],
            range=[0, config.opening / 2],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            damping=DAMPING,
            armature=ARMATURE,
        )
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=STIFFNESS)
        motor.forcelimited, motor.forcerange = True, [-config.force, config.force]
    for k, block in enumerate(blocks(config)):
        bodies[block.body].add_geom(
            name=f"{block.body}_{k}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=block.half,
            pos=block.middle,
            mass=config.mass * (0.8 if block.body == HAND else 0.1),
            friction=(config.friction, 0.01, 0.001),
            **contact_options(DEFAULT_PHYSICS, 0.0),
        )
    spec.add_exclude(bodyname1=FINGERS[0], bodyname2=FINGERS[1])
    weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1=TARGET, name2=HAND)
    weld.solref = WELD
    # Anchor, relative position and quaternion, weight of the turn: the two frames are one.
    weld.data[:11] = [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1]


STIFFNESS, DAMPING, ARMATURE = 8000.0, 60.0, 0.1
"""Of a finger's position servo [N/m, N s/m, kg]: an object of 10 mm or more is held with the full force."""
WELD = (0.01, 1.0)
"""Time constant [s] and damping ratio with which the hand follows its target."""


@dataclass(eq=False)
class Gripper:
    """The gripper of one model: where its target is, and how actions move it."""

    model: Any
    data: Any
    config: GripperConfig
    low: Array
    """(3,) and ``high`` (3,): where its frame may go [m]."""
    high: Array
    opening: float = field(init=False)
    """Commanded distance between the pads [m]."""
    _aim: tuple[Array, Array, float] | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self._target = int(self.model.body_mocapid[self.model.body(TARGET).id])
        self._hand = int(self.model.body(HAND).id)
        self._motors = [int(self.model.actuator(name).id) for name in FINGERS]
        self._joints = [int(self.model.jnt_qposadr[self.model.joint(name).id]) for name in FINGERS]
        self.opening = self.config.opening

    def reset(self) -> None:
        """Open, at rest where the model has it."""
        self.opening, self._aim = self.config.opening, None
        for joint in self._joints:
            self.data.qpos[joint] = self.opening / 2
        self.data.ctrl[self._motors] = self.opening / 2

    @property
    def position(self) -> Array:
        """(3,) of its target [m]."""
        return np.array(self.data.mocap_pos[self._target])

    @property
    def state(self) -> Array:
        """(8,): position [m], quaternion (w, x, y, z) of the hand, and the distance between its pads [m]."""
        pads = float(sum(self.data.qpos[j] for j in self._joints))
        return np.array([*self.data.xpos[self._hand], *self.data.xquat[self._hand], pads])

    def aim(self, position: Array, quaternion: Array, opening: float) -> None:
        """Go to a pose as fast as its limits allow. A quaternion (4,) of no length keeps the axes."""
        quaternion = np.clip(quaternion, -1, 1)
        length = float(np.linalg.norm(quaternion))
        turn = quaternion / length if length > 1e-6 else np.array(self.data.mocap_quat[self._target])
        self._aim = np.clip(position, self.low, self.high), turn, float(np.clip(opening, 0, self.config.opening))

    def move(self, linear: Array, angular: Array, closing: float, dt: float) -> None:
        """Move the target for ``dt`` [s] at speeds in the world [m/s, rad/s]; pads apart at ``closing`` [m/s]."""
        position = np.clip(self.position + dt * linear, self.low, self.high)
        turn = np.array(self.data.mocap_quat[self._target])
        engine().mju_quatIntegrate(turn, _in_axes_of(turn, angular), dt)
        self._put(position, turn, float(np.clip(self.opening + dt * closing, 0, self.config.opening)))

    def follow(self, dt: float) -> None:
        """Move the target for ``dt`` [s] towards what was aimed at."""
        if self._aim is None:
            return
        position, turn, opening = self._aim
        here, now = self.position, np.array(self.data.mocap_quat[self._target])
        off = np.zeros(3)
        engine().mju_subQuat(off, turn, now)
        share = min(1.0, self.config.turn * dt / max(float(np.linalg.norm(off)), 1e-12))
        engine().mju_quatIntegrate(now, off, share)
        step = self.config.closing * dt
        width = self.opening + float(np.clip(opening - self.opening, -step, step))
        self._put(here + _limited(position - here, self.config.speed * dt), now, width)

    def _put(self, position: Array, turn: Array, opening: float) -> None:
        self.data.mocap_pos[self._target], self.data.mocap_quat[self._target] = position, turn
        self.opening = opening
        self.data.ctrl[self._motors] = opening / 2

    def poses(self) -> Mapping[str, Array]:
        """T_world_body (4, 4) of the hand and the fingers."""
        found = dict[str, Array]()
        for name in (HAND, *FINGERS):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = rotation_from_quaternion(self.data.body(name).xquat), self.data.body(name).xpos
            found[name] = T
        return found


def _limited(step: Array, most: float) -> Array:
    return step * min(1.0, most / max(float(np.linalg.norm(step)), 1e-12))


def _in_axes_of(quaternion: Array, vector: Array) -> Array:
    """A vector (3,) of the world in the axes of a quaternion (w, x, y, z)."""
    turned, back = np.zeros(3), np.zeros(4)
    engine().mju_negQuat(back, quaternion)
    engine().mju_rotVecQuat(turned, vector, back)
    return turned
