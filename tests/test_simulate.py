"""Rollouts against formulas: free fall, ballistics, sliding, spinning, bouncing; the same numbers every time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import pose, rotation_angle, rotation_from_vector
from f3sr.goals.plan import (
    Impulse,
    Offset,
    SimulationPlan,
    Velocity,
    from_json,
    to_json,
)
from f3sr.goals.rollout import from_npz, to_npz
from f3sr.goals.sequence import simulate
from f3sr.physics.mujoco_model import body_of
from f3sr.physics.restitution import LEAST, damping_ratio_of, restitution_of, solref
from f3sr.scene import GROUND, SceneObject
from plans import centers, changed, made, plan_of
from scenes import ball_mesh, box, box_stack_scene, scene_of

G = 9.81


def ball(id: int, radius: float, at: tuple[float, float, float]) -> SceneObject:
    mesh = ball_mesh(radius)
    o = box(id, size=(2 * radius,) * 3, at=at, label="ball")
    return replace(o, mesh=mesh, parts=(mesh.hull,))


def test_a_thrown_body_follows_its_parabola_and_keeps_its_spin() -> None:
    o = box(0, size=(0.1, 0.06, 0.03), at=(0, 0, 1.0), R=rotation_from_vector(np.array([0.3, -0.2, 0.5])))
    v, spin = np.array([1.0, -0.5, 2.0]), np.array([0.0, 0.0, 0.0])
    scene = scene_of(o)
    rollout = simulate(scene, plan_of(scene, velocities=[Velocity(id=0, linear=tuple(v), angular=tuple(spin))]))
    t = rollout.time[:, None]
    expected = centers(rollout, o)[0] + v * t + [0, 0, -G / 2] * t**2
    step = 1 / 960
    assert np.abs(centers(rollout, o) - expected).max() < G * step * rollout.time[-1], "Euler's own error, no more"
    assert rotation_angle(rollout.poses(0)[-1, :3, :3] @ rollout.poses(0)[0, :3, :3].T) < 1e-6
    assert not len(rollout.contacts)


def test_samples_come_at_film_rate_and_the_first_is_the_scene() -> None:
    scene = box_stack_scene(3)
    rollout = simulate(scene, plan_of(scene, duration=1.0))
    assert np.allclose(np.diff(rollout.time), 1 / 30) and rollout.time[0] == 0 and len(rollout.time) == 31
    for o in scene:
        assert np.allclose(rollout.poses(o.id)[0], o.T_world_object, atol=1e-12)
        assert np.abs(centers(rollout, o) - centers(rollout, o)[0]).max() < 1e-3, "what nobody sets off stays"


def test_twice_the_same_numbers_and_back_from_files(tmp_path: Path) -> None:
    scene = box_stack_scene(3)
    plan = plan_of(scene, active=2, impulses=[Impulse(id=2, time=0.1, linear=(0.2, 0.05, 0.1), angular=(0.001, 0, 0))])
    data = to_npz(simulate(scene, plan))
    assert data == to_npz(simulate(scene, from_json(to_json(plan))))
    (tmp_path / "rollout.npz").write_bytes(data)
    assert to_npz(from_npz(tmp_path / "rollout.npz")) == data


def test_an_impulse_gives_its_momentum_at_its_time() -> None:
    o = box(0, size=(0.1, 0.2, 0.05), at=(0, 0, 1.0), R=rotation_from_vector(np.array([0.4, 0.1, -0.3])))
    scene, body = scene_of(o), body_of(o)
    J, L = np.array([0.3, 0.1, 0.2]), np.array([2e-4, -1e-4, 3e-4])
    plan = plan_of(scene, duration=0.3, impulses=[Impulse(id=0, time=0.1, linear=tuple(J), angular=tuple(L))])
    plan = changed(plan, simulation=SimulationPlan(duration=0.3, steps_per_sample=1))
    rollout = simulate(scene, plan)
    way, dt = centers(rollout, o), float(rollout.time[1])
    at = round(0.1 / dt)
    assert np.allclose(way[at, :2], way[0, :2], atol=1e-9), "nothing before its time"
    gained = (way[at + 1] - way[at]) / dt - (way[at] - way[at - 1]) / dt + [0, 0, G * dt]
    assert np.allclose(gained * body.mass, J, atol=1e-6)
    R = rollout.poses(0)[:, :3, :3]
    turn = R[at + 1] @ R[at].T
    omega = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2 / dt
    inertia = R[at] @ body.inertia @ R[at].T
    assert np.allclose(inertia @ omega, L, rtol=0.02, atol=1e-6)


def test_a_box_slides_as_far_as_friction_says() -> None:
    o = box(0, size=(0.2, 0.2, 0.05), at=(0, 0, 0.0252))
    scene = scene_of(o)
    v = 1.2
    rollout = simulate(scene, plan_of(scene, duration=1.0, velocities=[Velocity(id=0, linear=(v, 0, 0))]))
    slid = centers(rollout, o)[-1, 0] - centers(rollout, o)[0, 0]
    assert slid == pytest.approx(v**2 / (2 * 0.6 * G), rel=0.05)


def test_recorded_forces_are_vector_sums() -> None:
    """A ball in a groove presses on it with its weight, however steep the groove: the sides' forces in part cancel."""
    walls = list[ConvexPart]()
    for side in (-1, 1):
        R = rotation_from_vector(np.array([0, -side * np.pi / 4, 0]))
        walls.append(box(0, size=(0.2, 0.2, 0.02)).parts[0].moved(pose(R, [0, 0, 0.05] + R @ [side * 0.1, 0, -0.01])))
    mesh = Mesh(
        vertices=np.concatenate([w.vertices for w in walls]),
        faces=np.concatenate([walls[0].faces, walls[1].faces + len(walls[0].vertices)]).astype(np.int32),
    )
    groove = replace(box(0), mesh=mesh, parts=tuple(walls), T_world_object=pose(), mobility="fixed")
    round_ = ball(1, 0.04, (0, 0, 0.0502 + 0.04 * np.sqrt(2)))
    scene = scene_of(groove, round_)
    rollout = simulate(scene, plan_of(scene, active=1, duration=1.5))
    assert rollout.touches(0, 1)["force"][-10:] == pytest.approx(body_of(round_).mass * G, rel=0.02)


@pytest.mark.parametrize(("e", "off"), [(0.3, 0.06), (0.6, 0.03), (0.85, 0.01)])
def test_a_ball_bounces_to_its_restitution(e: float, off: float) -> None:
    """In the median of drops: where a step of 6 mm begins in the contact changes a single one by twice as much."""
    found = list[float]()
    for z in np.linspace(0.5, 0.506, 7):
        o = ball(0, 0.04, (0, 0, 0.04 + z))
        scene = scene_of(o)
        plan = plan_of(scene, duration=1.0, semantics=(made(o, restitution=e),))
        simulation = SimulationPlan(duration=1.0, steps_per_sample=4)
        rollout = simulate(scene, changed(plan, simulation=simulation))
        height = centers(rollout, o)[:, 2] - 0.04
        low = int(np.argmin(height[: round(0.5 / rollout.time[1])]))
        found.append(float(np.sqrt(height[low:].max() / height[0])))
    assert np.median(found) == pytest.approx(e, abs=off) and max(abs(f - e) for f in found) < 2 * off
    assert len(rollout.touches(GROUND, 0)) and rollout.touches(0, GROUND)["time"][0] == pytest.approx(
        np.sqrt(2 * 0.5 / G), abs=0.02
    )


def test_restitution_and_damping_are_inverse() -> None:
    for e in np.linspace(LEAST + 0.01, 1, 20):
        assert restitution_of(damping_ratio_of(float(e))) == pytest.approx(e, abs=1e-9)
    assert solref(0.0) is None and solref(LEAST) is None and solref(1.0) == (-40000.0, pytest.approx(0, abs=1e-6))
    with pytest.raises(ValueError, match="at most 1"):
        damping_ratio_of(1.5)


def test_an_offset_lifts_and_turns_about_the_centre_of_mass() -> None:
    o = box(0, size=(0.1, 0.06, 0.03), at=(0.1, 0, 0.0152))
    scene = scene_of(o)
    plan = plan_of(scene, offsets=[Offset(id=0, translation=(0.0, 0.1, 0.5), rotation=(0.0, 0.0, np.pi / 2))])
    rollout = simulate(scene, plan)
    start = centers(rollout, o)[0] - (o.T_world_object[:3, :3] @ body_of(o).center + o.T_world_object[:3, 3])
    assert np.allclose(start, [0, 0.1, 0.5], atol=1e-9)
    turn = rollout.poses(0)[0, :3, :3] @ o.T_world_object[:3, :3].T
    assert rotation_angle(turn) == pytest.approx(np.pi / 2)


def test_heavier_stuff_is_heavier_and_fixed_things_stay() -> None:
    o = box(0, size=(0.1, 0.1, 0.1), at=(0, 0, 3.0))
    shelf = replace(box(1, at=(0.5, 0, 2.0)), mobility="fixed")
    scene = scene_of(o, shelf)
    push = [Impulse(id=0, time=0.0, linear=(1.0, 0, 0))]
    way = [
        centers(simulate(scene, plan_of(scene, semantics=(made(o, density=d), made(shelf)), impulses=push)), o)[-1, 0]
        for d in (600.0, 1200.0)
    ]
    assert way[0] == pytest.approx(2 * way[1], rel=1e-6)
    with pytest.raises(ValueError, match="fixed"):
        simulate(scene, plan_of(scene, impulses=[Impulse(id=1, time=0.0, linear=(1.0, 0, 0))]))
    with pytest.raises(ValueError, match="objects \\[7\\]"):
        simulate(scene, plan_of(scene, impulses=[Impulse(id=7, time=0.0, linear=(1.0, 0, 0))]))


def test_damping_takes_speed_at_its_rate() -> None:
    o = ball(0, 0.05, (0, 0, 5.0))
    scene = scene_of(o)
    plan = plan_of(scene, semantics=(made(o, damping=2.0),), velocities=[Velocity(id=0, linear=(1.0, 0, 0))])
    way = centers(simulate(scene, plan), o)
    assert way[-1, 0] - way[0, 0] == pytest.approx((1 - np.exp(-2.0 * 0.5)) / 2.0, rel=2e-3)
