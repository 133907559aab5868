"""What setting something off may take: what a hand can do, and what a scene of some size calls for."""

from __future__ import annotations

import math

import numpy as np

from f3sr.core.transforms import Array
from f3sr.goals.plan import Impulse, InitialConditions, Limits
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import GRAVITY, Scene, SceneObject

HIGHEST = 4.0
"""Diagonals of the scene that a throw rises at most: more is out of any picture."""
HIGHEST_EVER = 1e4
"""The same [m] where a scene is a landscape: no plan holds more."""
FASTEST = 12.0
"""Speed that a hand gives without a run-up [m/s]: an underarm throw of a ball."""
IMPULSE = 60.0
"""Blow of a person [N s]: a thrown medicine ball of 5 kg leaves at 12 m/s."""
FORCE = 400.0
"""Push of a person with both hands [N], for a moment; ISO 11228-2 has 230 to 320 for starting a cart."""

WHIRL = 2.0
"""Times the limit of speeds that turning alone may give a point of an object: the top of what rolls goes at 1."""
SLACK = 1 + 1e-9


def limits_of(scene: Scene) -> Limits:
    """The limits that suit a scene: speeds that its size calls for, at most a person's."""
    highest = HIGHEST * scene.diagonal
    return Limits(
        speed=min(FASTEST, math.sqrt(2 * GRAVITY * highest)),
        impulse=IMPULSE,
        force=FORCE,
        lift=min(HIGHEST_EVER, highest),
    )


def whirl(o: SceneObject, angular: Array) -> float:
    """Speed [m/s] of the fastest point of an object that turns so about its centre of mass (3,) [rad/s]."""
    return float(np.linalg.norm(np.cross(angular, _arms(o)), axis=1).max())


def _arms(o: SceneObject) -> Array:
    """(n, 3) from its centre of mass to the corners of its parts, in the world [m]."""
    body = body_of(o)
    corners = np.concatenate([part.vertices for part in body.parts])
    return (corners - body.center) @ o.T_world_object[:3, :3].T


def beyond(initial: InitialConditions, o: SceneObject, mass: float, limits: Limits) -> str | None:
    """What of the initial conditions of an object that weighs so much [kg] is beyond the limits, in words."""
    for velocity in initial.velocities:
        speed = float(np.linalg.norm(velocity.linear))
        if (fast := whirl(o, np.array(velocity.angular))) > WHIRL * limits.speed * SLACK:
            return f"turning that moves its rim at {fast:.1f} m/s, at most {WHIRL * limits.speed:.1f} here"
        if speed > limits.speed * SLACK:
            return f"a speed of {speed:.1f} m/s, at most {limits.speed:.1f} here"
        if speed * mass > limits.impulse * SLACK:
            return f"a blow of {speed * mass:.0f} N s, at most {limits.impulse:.0f}"
    for impulse in initial.impulses:
        blow = float(np.linalg.norm(impulse.linear))
        if excess := _turning(impulse, o, mass, limits):
            return excess
        if impulse.duration == 0 and blow > limits.impulse * SLACK:
            return f"a blow of {blow:.0f} N s, at most {limits.impulse:.0f}"
        if impulse.duration > 0 and blow / impulse.duration > limits.force * SLACK:
            return f"a push of {blow / impulse.duration:.0f} N, at most {limits.force:.0f}"
    for offset in initial.offsets:
        lift = float(np.linalg.norm(offset.translation))
        if lift > limits.lift * SLACK:
            return f"a lift of {lift:.2f} m, at most {limits.lift:.2f} here"
    return None


def _turning(impulse: Impulse, o: SceneObject, mass: float, limits: Limits) -> str | None:
    """What of an impulse's turning is beyond the limits: of a blow the speed that it gives, of a push its torque."""
    turning, body = np.array(impulse.angular), body_of(o)
    if impulse.duration > 0:
        torque = float(np.linalg.norm(turning)) / impulse.duration
        most = limits.force * float(np.linalg.norm(_arms(o), axis=1).max())
        return f"a torque of {torque:.3g} N m, at most {most:.3g} here" if torque > most * SLACK else None
    R = o.T_world_object[:3, :3]
    inertia = mass / body.mass * (R @ body.inertia @ R.T)
    fast = whirl(o, np.asarray(np.linalg.solve(inertia, turning), float))
    if fast > WHIRL * limits.speed * SLACK:
        return f"a blow that turns its rim at {fast:.1f} m/s, at most {WHIRL * limits.speed:.1f} here"
    return None
