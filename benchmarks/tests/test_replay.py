"""The rollout against its second writing in plain MuJoCo (benchmarks/goals/replay.py), to the bit."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import replay

from f3sr.goals.plan import Impulse, Offset, Velocity, to_json
from f3sr.goals.rollout import to_npz
from f3sr.goals.sequence import simulate
from f3sr.physics.mujoco_model import body_of
from f3sr.scene_package.package import read_package, write_package
from plans import made, plan_of
from scenes import box_stack_scene


@pytest.mark.parametrize("turned", [False, True])
def test_plain_mujoco_plays_the_same(tmp_path: Path, turned: bool) -> None:
    package = write_package(box_stack_scene(3), tmp_path / "package")
    scene = read_package(package).scene
    changed = {"density": 1800.0, "friction": 0.4}
    semantics = tuple(
        made(o, restitution=0.6 if o.id == 2 else 0.0, damping=0.5 if o.id == 1 else 0.0, **changed) for o in scene
    )
    mass = 3 * body_of(scene[2]).mass
    plan = plan_of(
        scene,
        duration=1.5,
        active=2,
        semantics=semantics,
        offsets=[Offset(id=2, translation=(0.01, 0, 0.1), rotation=(0.1, 0.2, 0.3) if turned else (0, 0, 0))],
        velocities=[Velocity(id=2, linear=(0.1, 0, 0), angular=(0, 0, 1.0))],
        impulses=[Impulse(id=2, time=0.3, linear=(-0.5 * mass, 0.1 * mass, 0.5 * mass), angular=(1e-4, 0, 0))],
    ).model_copy(update={"scene": hashlib.sha256((package / "scene.json").read_bytes()).hexdigest()})
    rollout = simulate(scene, plan)
    (tmp_path / "plan.json").write_bytes(to_json(plan))
    (tmp_path / "rollout.npz").write_bytes(to_npz(rollout))
    assert replay.difference(package, tmp_path) == 0.0
    assert len(rollout.contacts) > 20, "it lands, bounces and rests"
