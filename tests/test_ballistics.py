"""Closed forms of setting things off against flights in small steps and against physics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from f3sr.core.transforms import Array
from f3sr.goals.plan import Velocity
from f3sr.goals.sequence import simulate
from f3sr.launches import ballistics
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import GRAVITY, SceneObject
from plans import centers, plan_of
from scenes import box, scene_of

STARTS = [(np.array([0.1, 0.2, 0.05]), np.array([0.7, -0.3, z])) for z in (0.0, 0.05, 0.4)]


def flown(start: Array, velocity: Array, seconds: float) -> Array:
    return start + velocity * seconds - np.array([0, 0, GRAVITY / 2]) * seconds**2


@pytest.mark.parametrize(("start", "target"), STARTS)
def test_a_throw_arrives_over_its_apex(start: Array, target: Array) -> None:
    velocity, seconds = ballistics.throw(start, target, 0.6)
    assert np.allclose(flown(start, velocity, seconds), target)
    assert flown(start, velocity, velocity[2] / GRAVITY)[2] == pytest.approx(0.6)
    with pytest.raises(ValueError, match="an apex above"):
        ballistics.throw(start, target, float(min(start[2], target[2])))


@pytest.mark.parametrize(("start", "target"), STARTS)
@pytest.mark.parametrize("restitution", [0.4, 0.8])
def test_a_bounce_arrives_after_one_bounce(start: Array, target: Array, restitution: float) -> None:
    velocity, seconds = ballistics.bounce(start, target, 0.03, restitution, 0.5)
    up, g = velocity[2], GRAVITY
    first = (up + math.sqrt(up**2 + 2 * g * (start[2] - 0.03))) / g
    landed = flown(start, velocity, first)
    assert landed[2] == pytest.approx(0.03)
    off = np.append(velocity[:2], -restitution * (up - g * first))
    assert np.allclose(flown(landed, off, seconds - first), target)
    assert 0.03 + off[2] ** 2 / 2 / g == pytest.approx(0.5)


def test_what_falls_from_high_bounces_higher() -> None:
    velocity, _ = ballistics.bounce(np.array([0, 0, 2.0]), np.array([0.3, 0, 0.1]), 0.0, 0.8, 0.3)
    assert velocity[2] == 0 and velocity[0] > 0


def toppling(o: SceneObject, surplus: float) -> float:
    """How far a box leans in the end [rad], set off to topple towards +x."""
    body, R = body_of(o), o.T_world_object[:3, :3]
    corners = np.concatenate([p.vertices for p in o.colliders_world])
    center = R @ body.center + o.T_world_object[:3, 3]
    twist = ballistics.topple(
        corners, center, R @ body.inertia @ R.T, body.mass, np.array([1.0, 0, 0]), surplus=surplus
    )
    assert twist is not None
    scene = scene_of(o)
    velocity = Velocity(id=o.id, linear=tuple(twist.linear.tolist()), angular=tuple(twist.angular.tolist()))
    rollout = simulate(scene, plan_of(scene, duration=2.0, velocities=[velocity]))
    R = rollout.poses(o.id)[:, :3, :3]
    assert centers(rollout, o)[-1, 0] > -0.05
    return float(np.arccos(np.clip((R[-1] @ R[0].T)[2, 2], -1, 1)))


@pytest.mark.parametrize("size", [(0.1, 0.1, 0.25), (0.06, 0.12, 0.12)])
def test_just_enough_topples_and_less_does_not(size: tuple[float, float, float]) -> None:
    o = box(0, size=size, at=(0, 0, size[2] / 2 + DEFAULT_MARGIN.clearance))
    assert toppling(o, 1.5) == pytest.approx(np.pi / 2, abs=0.05)
    assert toppling(o, 0.6) < 0.05


def test_what_hangs_over_falls_by_itself() -> None:
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)])
    over = ballistics.topple(corners, np.array([0.2, 0.05, 0.05]), np.eye(3), 1.0, np.array([1.0, 0, 0]), surplus=1.5)
    assert over is None
