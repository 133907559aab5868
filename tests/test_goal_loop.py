"""Goals from words to verdict on a made scene: every kind is met, replays are the same, rules and limits hold."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, pose, transform
from f3sr.errors import InputError, OutputError
from f3sr.goals.checks import PlanError, faults_of
from f3sr.goals.language_protocol import Launch, Planned, Tried
from f3sr.goals.launch_limits import limits_of
from f3sr.goals.plan import (
    Contact,
    Displaced,
    Impulse,
    InitialConditions,
    Offset,
    Plan,
    Semantics,
    SimulationPlan,
    TaskSpec,
    Velocity,
    to_json,
)
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import to_npz
from f3sr.goals.scene_layout import SceneLayout
from f3sr.goals.sequence import simulate
from f3sr.goals.simulate import simulate_phase
from f3sr.goals.verify import VerdictDocument, verify
from f3sr.goals.verify import to_json as verdict_json
from f3sr.language.capabilities import menu
from f3sr.language.planner import planned
from f3sr.language.reasoner import at_rest, declared, semantics_of
from f3sr.launches.flights import dropping
from f3sr.launches.launch_context import LaunchContext
from f3sr.physics.mujoco_model import body_of
from f3sr.physics.restitution import LEAST
from f3sr.play import rollout_folder
from f3sr.play.goal_loop import Played, replay_plan, simulate_goal
from f3sr.play.rule_based_language import Rules
from f3sr.play.trials import LINGERS, ROLLOUTS, SHORTEST, Still, Trials, phase_of
from f3sr.runtime import atomic_folder
from f3sr.scene import GROUND, Scene, Support
from f3sr.scene_package.package import Package
from f3sr.scene_package.scene_json import dump_json
from goal_scene import BALL, BLOCK, CAN, CARTON, CRATE, GAP, LID, goal_package, goal_scene, thing
from plans import changed
from scenes import box

DOCS = Path(__file__).parents[1] / "docs"
SCHEMAS = {
    name: {"$schema": "https://json-schema.org/draft/2020-12/schema", **model.model_json_schema()}
    for name, model in {"task": TaskSpec, "plan": Plan, "verdict": VerdictDocument}.items()
}
MET = {
    "knock over the cereal box": "topple",
    "knock over the soup can to the left": "topple",
    "push the cereal box 10 cm to the left": "slide",
    "push the sponge off the block": "slide",
    "push the can into the block": "push_into",
    "push the ball into the can so that the can moves": "push_into",
    "roll the ball 15 cm to the left": "roll",
    "roll the ball into the cereal box": "roll",
    "drop the sponge on the cereal box": "drop",
    "lift the can and drop it into the crate": "lift_and_drop",
    "throw the can into the crate": "throw",
    "throw the ball over the block": "throw",
    "throw the ball at the cereal box": "throw",
    "throw the sponge off the block": "throw",
    "bounce the ball into the cereal box": "bounce",
    "bounce the can into the cereal box": "bounce",
    "tip the can over and let it roll": "topple",
    "push the can until it falls over": "topple",
    "throw the can 20 cm up and let it fall back": "launch_and_return",
}
REFUSED = {
    "push the banana": "unknown",
    "push the thing to the left": "ambiguous",
    "": "empty",
    "push the can 500 m to the left": "amount",
    "topple the tennis ball": "impossible",
    "drop the block on the cereal box": "impossible",
    "push the can off the block": "impossible",
    "drop the sponge off the block": "impossible",
    "roll the ball over the block": "impossible",
    "delete the can": "other",
    "push the can to the left and to the right": "contradiction",
    "push the can over the table": "",
}


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("goals") / "package")


@cache
def _known(folder: Path, goal: str) -> Played | Refusal:
    from f3sr.scene_package.package import read_package

    return simulate_goal(read_package(folder), goal)


def played(package: Package, goal: str) -> Played:
    found = _known(package.folder, goal)
    assert isinstance(found, Played), found
    return found


def way(found: Played, id: int, scene: Scene) -> Array:
    T = found.rollout.poses(id)
    return T[:, :3, :3] @ body_of(scene[id]).center + T[:, :3, 3]


@pytest.mark.slow
@pytest.mark.parametrize(("goal", "kind"), MET.items())
def test_every_kind_is_met(package: Package, goal: str, kind: str) -> None:
    found = played(package, goal)
    assert found.plan.phases[0].task.kind == kind and found.verdict.met, found.verdict.said
    assert 1 <= found.plan.rollouts <= ROLLOUTS and not list(faults_of(found.plan.phases[0], package.scene))
    assert found.plan.phases[0].initial.controlled == {found.plan.phases[0].task.active}
    assert found.rollout.time[-1] == pytest.approx(found.plan.phases[0].simulation.duration)


@pytest.mark.parametrize("goal", [*MET][2:9:3])
def test_a_replay_is_the_same_to_the_byte(package: Package, goal: str) -> None:
    found = played(package, goal)
    again = replay_plan(package, found.plan)
    assert to_npz(again.rollout) == to_npz(found.rollout)
    assert verdict_json(again.verdict) == verdict_json(found.verdict)


def test_the_same_goal_gives_the_same_plan(package: Package) -> None:
    goal = "knock over the cereal box"
    again = simulate_goal(package, goal)
    assert isinstance(again, Played) and to_json(again.plan) == to_json(played(package, goal).plan)


def test_a_slide_goes_as_far_as_asked_and_stands(package: Package) -> None:
    moved = way(played(package, "push the cereal box 10 cm to the left"), CARTON, package.scene)
    off = moved[-1] - moved[0]
    assert 0.1 <= -off[0] <= 0.15 and abs(off[1]) < 0.02 and abs(off[2]) < 2e-3


def test_a_push_ends_before_the_target_is_touched(package: Package) -> None:
    found = played(package, "push the can into the block")
    touched = float(found.rollout.touches(CAN, BLOCK)["time"][0])
    initial = found.plan.phases[0].initial
    assert initial.impulses and all(i.time + i.duration < touched for i in initial.impulses)
    assert not initial.velocities and not found.verdict.broken


def test_what_is_thrown_in_ends_inside(package: Package) -> None:
    end = way(played(package, "throw the can into the crate"), CAN, package.scene)[-1]
    assert np.abs(end - [0, 0.25, 0.05])[:2].max() < 0.07 and end[2] < 0.1


def test_what_is_thrown_off_is_off(package: Package) -> None:
    end = way(played(package, "throw the sponge off the block"), LID, package.scene)[-1]
    assert np.abs(end - [0.2, -0.2, 0])[:2].max() > 0.06 and end[2] < 0.06


def test_what_is_thrown_up_comes_back(package: Package) -> None:
    moved = way(played(package, "throw the can 20 cm up and let it fall back"), CAN, package.scene)
    assert 0.2 <= np.ptp(moved[:, 2]) < 0.3 and np.linalg.norm(moved[-1] - moved[0]) < 0.07


def test_what_rolls_turns_as_it_goes(package: Package) -> None:
    found = played(package, "roll the ball 15 cm to the left")
    moved = way(found, BALL, package.scene)
    assert moved[:, 0].min() < moved[0, 0] - 0.14
    rolled = next(c for c in found.verdict.conditions if c.condition.type == "rolled")
    assert rolled.met and rolled.margin > 0


def test_a_bounce_touches_the_ground_before_its_target(package: Package) -> None:
    found = played(package, "bounce the ball into the cereal box")
    ground = [t for t in found.rollout.touches(BALL, GROUND)["time"] if t > 0.1]
    assert ground[0] < found.rollout.touches(BALL, CARTON)["time"][0]
    assert next(s for s in found.plan.phases[0].semantics if s.id == BALL).restitution == pytest.approx(0.74)


def test_on_a_table_a_bounce_touches_the_table_before_its_target(tmp_path: Path) -> None:
    """What carries both is the floor: things on a table do not fall off it first. What holds one of them is none."""
    scene, high, table = goal_scene(), 0.4, 6
    slab = thing(table, "table", box(0, size=(0.9, 0.9, high)).mesh, (0.0, 0.0, high / 2))
    lifted = (replace(o, T_world_object=pose(t=[0.0, 0.0, high + GAP]) @ o.T_world_object) for o in scene)
    on_it = (
        replace(o, supports=(Support(id=table),), supported_by=table) if o.supported_by == GROUND else o for o in lifted
    )
    scene = replace(scene, objects=(*on_it, slab))
    assert [SceneLayout(scene).floor_of(a, b) for a, b in ((BALL, CARTON), (LID, BALL), (BALL, table))] == [
        *(table, table, GROUND)
    ]
    package = goal_package(tmp_path / "package", scene)
    found = played(package, "bounce the ball into the cereal box")
    bounced = next(c for c in found.verdict.conditions if c.condition.type == "bounced")
    assert found.verdict.met and bounced.condition.b == table
    below = [t for t in found.rollout.touches(BALL, table)["time"] if t > 0.1]
    assert below[0] < found.rollout.touches(BALL, CARTON)["time"][0]
    assert not len(found.rollout.touches(BALL, GROUND))


def test_what_does_not_bounce_comes_down_before_its_target_and_slides_on(tmp_path: Path) -> None:
    soft = thing(LID, "backpack", box(0, size=(0.06, 0.05, 0.03)).mesh, (0.1, 0.0, 0.015))
    package = goal_package(tmp_path / "package", goal_scene().with_objects(soft))
    found = played(package, "bounce the backpack into the cereal box")
    assert next(s for s in found.plan.phases[0].semantics if s.id == LID).restitution < LEAST
    below = [t for t in found.rollout.touches(LID, GROUND)["time"] if t > 0.1]
    assert found.verdict.met and below[0] < found.rollout.touches(LID, CARTON)["time"][0]


def test_what_lies_in_something_is_thrown_from_where_it_lies(tmp_path: Path) -> None:
    """The scene starts as it is: the ball hops up and is thrown from the top of that."""
    scene = goal_scene()
    ball = replace(scene[BALL], T_world_object=pose(t=[0.0, 0.25, 0.01 + 0.032 + 2 * GAP]))
    ball = replace(ball, supports=(Support(id=CRATE),), supported_by=CRATE)
    package = goal_package(tmp_path / "package", scene.with_objects(ball))
    found = played(package, "throw the ball at the cereal box")
    assert found.verdict.met and not found.plan.phases[0].initial.offsets
    assert np.allclose(found.rollout.poses(BALL)[0], package.scene[BALL].T_world_object, atol=1e-6)
    rise, off = found.plan.phases[0].initial.impulses
    assert rise.linear[2] > 0 and rise.linear[:2] == (0.0, 0.0) and off.time > rise.time == 0.0


def test_what_lies_in_something_is_pushed_out_over_the_rim(tmp_path: Path) -> None:
    scene = goal_scene()
    ball = replace(scene[BALL], T_world_object=pose(t=[0.0, 0.25, 0.01 + 0.032 + 2 * GAP]))
    ball = replace(ball, supports=(Support(id=CRATE),), supported_by=CRATE)
    package = goal_package(tmp_path / "package", scene.with_objects(ball))
    found = played(package, "push the ball out of the crate")
    assert found.verdict.met, found.verdict.said


@pytest.mark.parametrize("speed", [1.0, 2.0, 4.0])
def test_what_is_struck_is_not_lifted_by_that(tmp_path: Path, speed: float) -> None:
    """A speed from one step to the next lifts it: the engine's cone of friction is convex."""
    package = goal_package(tmp_path / "package", replace(goal_scene(), objects=(goal_scene()[BLOCK],)))
    task = played(package, "push the block 5 cm to the left").plan.phases[0].task
    setting = LaunchContext(task, SceneLayout(package.scene), limits_of(package.scene))
    rise = {}
    for launch in (
        setting.struck(setting.direction, speed, 0.5, seconds=0.1),
        setting.thrown(speed * setting.direction, seconds=0.1),
    ):
        phase = phase_of(task, [at_rest(o) for o in package.scene], launch)
        simulation = SimulationPlan(steps_per_sample=2, duration=0.025)
        rollout = simulate_phase(package.scene, phase.model_copy(update={"simulation": simulation}))
        T = rollout.poses(BLOCK)
        low = (T[:, :3, :3] @ package.scene[BLOCK].mesh.vertices.T)[:, 2].min(1) + T[:, 2, 3]
        rise[bool(launch.initial.impulses)] = float(low.max() - low[0])
        reached = (T[-1, :3, 3] - T[-2, :3, 3]) @ setting.direction / (rollout.time[-1] - rollout.time[-2])
        assert reached == pytest.approx(speed, rel=0.2), "it is off at that speed"
    assert rise[True] < rise[False] / 3


def test_what_lies_on_ice_is_pushed_all_the_same(tmp_path: Path) -> None:
    scene = replace(goal_scene(), objects=(replace(goal_scene()[BLOCK], friction=0.0),))
    package = goal_package(tmp_path / "package", replace(scene, ground=replace(scene.ground, friction=0.0)))
    found = played(package, "push the block 5 cm to the left")
    moved = way(found, BLOCK, package.scene)[:, 0]
    assert moved[-1] - moved[0] < -0.05


def test_turning_has_a_limit(package: Package) -> None:
    phase, scene = played(package, "roll the ball to the left").plan.phases[0], package.scene
    most = 2 * limits_of(scene).speed / 0.032
    for spin, blow, ok in ((0.9 * most, False, True), (1.2 * most, False, False), (1.2 * most, True, False)):
        turning = (0.0, 0.0, spin)
        inertia = body_of(scene[BALL]).inertia[2, 2] * phase.semantics[BALL].mass / body_of(scene[BALL]).mass
        initial = (
            InitialConditions(impulses=(Impulse(id=BALL, time=0.0, angular=(0.0, 0.0, spin * inertia)),))
            if blow
            else InitialConditions(velocities=(Velocity(id=BALL, angular=turning),))
        )
        faults = list(faults_of(phase.model_copy(update={"initial": initial}), scene))
        assert (not faults) == ok and all("turn" in f for f in faults), (spin, faults)


def test_a_way_too_far_is_no_advice(package: Package) -> None:
    """``nearest`` is for what falls short."""
    found = played(package, "push the cereal box 10 cm to the left")
    short, far = (
        tuple(replace(c, margin=-0.03, reached=reached) for c in found.verdict.conditions) for reached in (0.07, 0.14)
    )
    assert "0.07 m" in replace(found, verdict=replace(found.verdict, conditions=short)).nearest
    assert not replace(found, verdict=replace(found.verdict, conditions=far)).nearest


def test_what_is_taken_along_is_named(package: Package) -> None:
    assert played(package, "push the block 5 cm to the right").plan.phases[0].task.passives == (LID,)


def test_others_that_still_move_are_waited_for() -> None:
    """What the goal is about lies still: the rollout goes on for what rolls, for a while."""

    class Data:
        qvel = np.zeros(12)

    ends = {}
    for name, rolls in (("still", 0.0), ("a while", 0.6), ("forever", 9.0)):
        watch, data = Still(0.0, [0], fastest=np.inf), Data()
        times = np.arange(1, 300) / 30
        for time in times:
            data.qvel[6] = 0.2 * (time < 1.5 + rolls)
            if watch(float(time), data):
                ends[name] = float(time)
                break
    assert ends["still"] < ends["a while"] < ends["forever"] <= SHORTEST + LINGERS + 2 / 30


def test_only_what_is_dropped_may_start_elsewhere(package: Package) -> None:
    found = played(package, "throw the ball at the cereal box")
    offset = Offset(id=BALL, translation=(0.0, 0.0, 0.1))
    plan = changed(found.plan, initial=InitialConditions(offsets=(offset,)))
    broken = verify(package.scene, plan, simulate(package.scene, plan)).broken
    assert any("starts elsewhere" in rule for rule in broken)


def test_a_height_that_is_said_is_fallen(package: Package) -> None:
    found = played(package, "let the soup can fall from 20 cm up")
    moved = way(found, CAN, package.scene)
    assert found.verdict.met and moved[0, 2] - moved[:, 2].min() == pytest.approx(0.2, abs=0.01)


def test_drops_on_the_ground_try_several_places() -> None:
    setting = LaunchContext(
        _task(kind="drop", active=BALL, target=GROUND), SceneLayout(goal_scene()), limits_of(goal_scene())
    )
    search = dropping(setting)
    found = {tuple(next(search)[0].initial.offsets[0].translation[:2]) for _ in range(8)}
    assert len(found) >= 5


def test_what_is_dropped_starts_clear_of_what_stands_there(tmp_path: Path) -> None:
    """A thin post beside the middle of the block, over which the ball would be let go."""
    post = replace(
        goal_scene()[LID],
        mesh=box(0, size=(0.008, 0.008, 0.2)).mesh,
        T_world_object=pose(t=np.array([0.208, -0.196, 0.16 + GAP])),
        label="post",
    )
    post = replace(post, parts=(post.mesh.hull,))
    package = goal_package(tmp_path / "p", goal_scene().with_objects(post))
    assert played(package, "drop the ball on the block").verdict.met


@pytest.mark.parametrize("far", [0.6, 1.9])
def test_long_pushes_are_played_or_refused(package: Package, far: float) -> None:
    """Into whatever stands there: the push ends with the rollout, and nothing is flung away."""
    found = simulate_goal(package, f"push the soup can {far} m to the left")
    if isinstance(found, Played):
        assert all(
            i.time + i.duration < found.plan.phases[0].simulation.duration + 1e-6
            for i in found.plan.phases[0].initial.impulses
        )
        assert not any("flung" in rule for rule in found.verdict.broken)
    else:
        assert found.reason in ("impossible", "amount")


def test_a_ball_bounces_off_what_it_is_rolled_at(package: Package) -> None:
    """Without restitution it stayed at the can, or climbed it by its spin."""
    found = played(package, "roll the ball into the soup can")
    ball = way(found, BALL, package.scene)
    start, end = ball[0], ball[-1]
    can = way(found, CAN, package.scene)[0]
    nearest = np.linalg.norm((ball - can)[:, :2], axis=1).min()
    assert found.verdict.met and np.linalg.norm((end - can)[:2]) > nearest + 0.03
    assert ball[:, 2].max() - start[2] < 0.005
    (velocity,) = found.plan.phases[0].initial.velocities
    assert np.linalg.norm(velocity.linear) <= 1.6


def test_what_is_bumped_moves(package: Package) -> None:
    found = played(package, "bump the ball into the soup can")
    moved = way(found, CAN, package.scene)
    assert found.verdict.met and np.linalg.norm(moved - moved[0], axis=1).max() > 0.005


@pytest.mark.parametrize(("goal", "reason"), REFUSED.items())
def test_what_cannot_be_done_is_refused(package: Package, goal: str, reason: str) -> None:
    found = simulate_goal(package, goal)
    assert isinstance(found, Refusal) and (not reason or found.reason == reason), found
    assert "accepted" in found.message or found.candidates


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    wide = replace(goal_scene()[CAN], mesh=box(0, size=(0.2, 0.2, 0.05)).mesh, label="tray")
    wide = replace(wide, parts=(wide.mesh.hull,))
    found = simulate_goal(goal_package(tmp_path / "p", goal_scene().with_objects(wide)), "drop the tray into the crate")
    assert isinstance(found, Refusal) and found.reason == "impossible" and "does not fit" in found.message


@pytest.mark.parametrize("side", [-1, 1])
def test_without_a_direction_things_stay_on_the_support_that_the_photo_shows(package: Package, side: int) -> None:
    camera = package.scene.camera
    h, w = camera.height, camera.width
    pixels = np.stack(np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5), -1).reshape(-1, 2)
    rays = np.column_stack([pixels, np.ones(h * w)]) @ np.linalg.inv(camera.K).T @ camera.T_world_camera[:3, :3].T
    x = camera.center[0] - camera.center[2] / rays[:, 2] * rays[:, 0]
    layout = SceneLayout(package.scene)
    edge = layout.center(CARTON)[0] + side * 0.08
    mask = ((side * x < side * edge) & (rays[:, 2] < 0)).reshape(h, w)
    layout = SceneLayout(replace(package.scene, ground_mask=mask))
    over, back = np.array([side * 1.0, 0, 0]), np.array([-side * 1.0, 0, 0])
    assert layout.room(CARTON, over, 0.3) < 0.1 and layout.room(CARTON, back, 0.3) > 0.1
    assert SceneLayout(package.scene).room(CARTON, over, 0.3) > 0.1
    assert layout.on_support(LID, 5 * over), "what stands on an object is not on the support"


@pytest.mark.slow
@pytest.mark.parametrize(("mass", "possible"), [(55, True), (90, False)])
def test_what_is_too_heavy_to_push_is_refused_and_all_else_is_played(
    tmp_path: Path, mass: float, possible: bool
) -> None:
    crate = goal_scene()[CARTON]
    chest = box(0, size=(0.8, 0.5, 0.5)).mesh
    heavy = replace(
        crate,
        mesh=chest,
        parts=(chest.hull,),
        label="chest",
        T_world_object=pose(t=np.array([-1.2, 0, 0.25 + GAP])),
        density=mass / 0.2,
        friction=0.6,
    )
    package = goal_package(tmp_path / "p", goal_scene().with_objects(heavy))
    assert ("push" in {e.id: e for e in menu(package.scene)}[CARTON].verbs) is possible
    for goal in ("push the chest 40 cm to the left", "push the chest into the soup can"):
        found = simulate_goal(package, goal)
        if possible:
            assert isinstance(found, Played)
        else:
            assert isinstance(found, Refusal) and found.reason == "impossible" and f"{mass} kg" in found.message


@pytest.mark.parametrize("goal", ["push the tank", "throw the tank", "knock over the tank", "drop the tank"])
def test_what_no_plan_has_a_way_for_is_refused(goal: str) -> None:
    tank = replace(box(0, size=(30, 30, 90), label="tank"), T_world_object=pose(t=(0, 0, 45)))
    scene = replace(goal_scene(), objects=(replace(tank, parts=(tank.mesh.hull,)),))
    found = planned(goal, scene)
    assert isinstance(found, Refusal) and found.message == "the tank is 99 m large; accepted: at most 14 m"
    assert menu(scene)[0].verbs == ()


def test_what_is_closed_can_only_be_touched(package: Package) -> None:
    found = simulate_goal(package, "throw the cereal box into the can")
    assert isinstance(found, Played) and any("nothing can lie" in a for a in found.plan.phases[0].task.assumptions)


def test_what_is_not_met_is_said_with_the_best_that_was_found(package: Package) -> None:
    found = simulate_goal(package, "hit the block with the sponge so that the block falls over")
    assert isinstance(found, Played) and not found.verdict.met
    assert found.plan.rollouts <= ROLLOUTS and found.verdict.margin < 0 and "wooden block" in found.verdict.said


def test_assumptions_are_said_and_only_then(package: Package) -> None:
    assert any("direction" in a for a in played(package, "knock over the cereal box").plan.phases[0].task.assumptions)
    assert not played(package, "push the cereal box 10 cm to the left").plan.phases[0].task.assumptions


def test_of_ways_to_fall_one_is_taken_that_the_photo_shows(tmp_path: Path) -> None:
    """Beside the border, before a wall: the first way ends with half of the carton outside."""
    scene = goal_scene()
    wall = box(1, size=(0.05, 0.3, 0.25), label="wall")
    wall = replace(wall, T_world_object=pose(t=(0.26, 0, 0.125)), parts=(ConvexPart.hull_of(wall.mesh.vertices),))
    carton = replace(scene[CARTON], T_world_object=pose(t=(0.38, 0, 0.1)))
    beside = goal_package(tmp_path / "package", replace(scene, objects=(carton, replace(wall, mobility="fixed"))))
    layout, found = SceneLayout(beside.scene), played(beside, "knock over the cereal box")
    fallen = found.rollout.poses(CARTON)[-1] @ np.linalg.inv(carton.T_world_object)
    seen = layout.in_view(CARTON, transform(fallen, layout.corners(CARTON)))
    assert found.verdict.met and seen >= layout.in_view(CARTON, layout.corners(CARTON)) > 0.7


def test_what_lies_is_not_offered_to_be_knocked_over() -> None:
    scene = goal_scene()
    for side, size, offered in (("can", (0.066, 0.1, 0.066), False), ("box on edge", (0.3, 0.06, 0.2), True)):
        thing = box(CARTON, size=size, label=side)
        parts = (ConvexPart.hull_of(thing.mesh.vertices),)
        (entry,) = menu(
            replace(scene, objects=(replace(thing, T_world_object=pose(t=(0, 0, size[2] / 2)), parts=parts),))
        )
        assert ("knock over" in entry.verbs) is offered, side


def test_the_menu_names_every_object_and_what_it_can_do(package: Package) -> None:
    entries = {e.id: e for e in menu(package.scene)}
    assert entries[CRATE].holds_things and not entries[BLOCK].holds_things and not entries[CAN].holds_things
    assert "roll" in entries[BALL].verbs and "knock over" not in entries[BALL].verbs
    assert "roll" not in entries[CARTON].verbs and "knock over" in entries[CARTON].verbs
    assert "drop" not in entries[BLOCK].verbs and "push off" in entries[LID].verbs
    for e in entries.values():
        found = simulate_goal(package, f"eat the {e.name}")
        assert isinstance(found, Refusal)


# --- what things are ----------------------------------------------------------------------------------------------


def test_goals_have_the_materials_of_the_package() -> None:
    scene = goal_scene()
    made = semantics_of(_task(kind="throw", active=BALL), scene)
    assert made[BALL] == declared(scene[BALL]) and made[BALL].restitution == 0.74
    assert all(s.restitution == 0 for s in made if s.id != BALL), "only what flies bounces"
    for s, o in zip(made, scene, strict=True):
        assert (s.density, s.friction, s.material, s.source) == (o.density, o.friction, o.material, o.material_source)


def test_what_would_not_rest_keeps_what_the_package_says(package: Package) -> None:
    semantics = semantics_of(_task(active=BALL), package.scene)
    trials = Trials(package.scene)
    assert trials.steady(semantics) == semantics
    told = tuple(s.model_copy(update={"source": "words"}) for s in semantics)
    tilted = replace(package.scene[LID], T_world_object=package.scene[LID].T_world_object + _up(0.05))
    falling = Trials(package.scene.with_objects(tilted))
    made = {s.id: s.source for s in falling.steady(told)}
    assert made[LID] == made[BLOCK] == "label" and made[CARTON] == "words"


def _up(z: float) -> Array:
    T = np.zeros((4, 4))
    T[2, 3] = z
    return T


def _task(**changed: Any) -> TaskSpec:
    values: dict[str, Any] = {
        "kind": "slide",
        "active": CAN,
        "conditions": (Displaced(a=changed.get("active", CAN), at_least=0.05),),
        "interpretation": "a test",
    }
    return TaskSpec.model_validate(values | changed)


# --- the language Protocol ----------------------------------------------------------------------------------------


class Other(Rules):
    """Rules but for some answers."""

    def __init__(self, **answers: Any) -> None:
        super().__init__()
        self.answers = answers

    def plan(self, goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
        answer = self.answers.get("plan", [_task()])
        return answer if isinstance(answer, Refusal) else Planned(readings=answer)

    def reason(self, task: TaskSpec, scene: Scene) -> Sequence[Semantics]:
        change = self.answers.get("reason", lambda made: made)
        return change(list(super().reason(task, scene)))

    def build(
        self, task: TaskSpec, semantics: Sequence[Semantics], scene: Scene, tried: Sequence[Tried]
    ) -> Sequence[Launch] | Refusal:
        return self.answers.get("build", [])


def launch(seconds: float = 1.0, **initial: Any) -> list[Launch]:
    return [Launch(initial=InitialConditions(**initial), simulation=SimulationPlan(duration=seconds))]


HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "no task": ({"plan": []}, "no task"),
    "unknown active": ({"plan": [_task(active=77)]}, r"objects \[77\]"),
    "unknown in a condition": ({"plan": [_task(conditions=(Contact(a=CAN, b=99),))]}, r"objects \[99\]"),
    "no direction": ({"plan": [_task(direction=(0.0, 0.0, 0.0))]}, "no length"),
    "semantics short": ({"reason": lambda made: made[:-1]}, "in this order"),
    "semantics of others": ({"reason": lambda made: [m.model_copy(update={"id": 50}) for m in made]}, "in this order"),
    "weight": ({"reason": lambda made: [m.model_copy(update={"mass": 9.0}) for m in made]}, "by its volume"),
    "nailed": (
        {"reason": lambda made: [m.model_copy(update={"mobility": "fixed"}) for m in made]},
        "as the package has it",
    ),
    "drives another": ({"build": launch(velocities=(Velocity(id=BALL, linear=(1, 0, 0)),))}, "only the active"),
    "too fast": ({"build": launch(velocities=(Velocity(id=CAN, linear=(900, 0, 0)),))}, "at most"),
    "elsewhere": ({"build": launch(offsets=({"id": CAN, "translation": (0, 0, 0.1)},))}, "before it starts"),
    "too long": ({"build": launch(30.0, velocities=(Velocity(id=CAN),))}, "30 s"),
    "late": ({"build": launch(impulses=({"id": CAN, "time": 3.0, "linear": (0.1, 0, 0)},))}, "after the rollout"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_language_is_checked(package: Package, name: str) -> None:
    answers, message = HOSTILE[name]
    with pytest.raises(PlanError, match=message):
        simulate_goal(package, "push the can", language=Other(**answers))


def test_numbers_that_are_none_are_refused_when_they_are_made() -> None:
    for values in ({"linear": (float("nan"), 0, 0)}, {"linear": (float("inf"), 0, 0)}):
        with pytest.raises(ValueError, match="finite"):
            Velocity(id=CAN, **values)
    with pytest.raises(ValueError, match="finite"):
        _task(conditions=(Displaced(a=CAN, at_least=float("nan")),))


def test_a_language_may_refuse_and_give_up(package: Package) -> None:
    refusal = Refusal(reason="other", message="not today")
    assert simulate_goal(package, "x", language=Other(plan=refusal)) is refusal
    assert simulate_goal(package, "x", language=Other(build=refusal)) is refusal
    nothing = simulate_goal(package, "x", language=Other())
    assert isinstance(nothing, Refusal) and nothing.reason == "impossible"


def test_a_start_inside_something_is_no_start(package: Package) -> None:
    into = package.scene[CRATE].T_world_object[:3, 3] - package.scene[CAN].T_world_object[:3, 3]
    offsets = ({"id": CAN, "translation": tuple(into)},)
    task = _task(kind="drop")
    found = simulate_goal(package, "x", language=Other(plan=[task], build=launch(offsets=offsets)))
    assert isinstance(found, Refusal) and "inside something" in found.message


# --- files --------------------------------------------------------------------------------------------------------


def _sha(package: Package) -> str:
    return hashlib.sha256((package.folder / "scene.json").read_bytes()).hexdigest()


def test_a_plan_belongs_to_one_scene(package: Package) -> None:
    plan = played(package, "knock over the cereal box").plan
    assert plan.scene == _sha(package)
    with pytest.raises(PlanError, match="another scene"):
        replay_plan(package, plan.model_copy(update={"scene": "0" * 64}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:-40], "line"),
        (lambda text: text.replace(b'"duration": ', b'"duration": NaN, "x": ', 1), "NaN"),
        (lambda text: text.replace(b'"timestep": ', b'"timestep": 1e9, "x": ', 1), "simulation"),
        (lambda text: text.replace(b'"schema_version": 2', b'"schema_version": 9'), "schema_version"),
        (lambda text: text.replace(b'"schema_version": 2', b'"schema_version": true'), "schema_version"),
        (lambda text: b"[" * 100_000, "nested"),
        (lambda text: b" " * 10_000_001, "bytes"),
        (lambda text: b"\xff\xfe", "UTF-8"),
        (lambda text: b"null", "the document"),
        (lambda text: re.sub(rb'"mass": [0-9.e-]+', b'"mass": 1e30', text, count=1), "mass"),
        (lambda text: re.sub(rb'"linear": \[\s*[0-9.e-]+', b'"linear": [1e300', text, count=1), "linear"),
    ],
)
def test_hostile_plans_are_told_in_one_line(package: Package, tmp_path: Path, change: Any, message: str) -> None:
    file = tmp_path / "plan.json"
    file.write_bytes(change(to_json(played(package, "knock over the cereal box").plan)))
    with pytest.raises(InputError, match=message) as error:
        rollout_folder.read_plan(file)
    assert str(error.value).isprintable()


def test_files_match_their_schemas(package: Package) -> None:
    import jsonschema

    found = played(package, "push the can into the block")
    jsonschema.validate(json.loads(to_json(found.plan)), SCHEMAS["plan"])
    jsonschema.validate(json.loads(verdict_json(found.verdict)), SCHEMAS["verdict"])
    jsonschema.validate(json.loads(to_json(found.plan))["phases"][0]["task"], SCHEMAS["task"])


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_published(name: str) -> None:
    assert json.loads((DOCS / f"{name}.schema.json").read_text()) == SCHEMAS[name], (
        "run: python tests/test_goal_loop.py"
    )


def test_a_write_that_fails_leaves_nothing(package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, out = played(package, "knock over the cereal box"), tmp_path / "out"

    def full(*_: object) -> bytes:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(rollout_folder.verify, "to_json", full)
        with pytest.raises(OutputError, match="no space"):
            rollout_folder.write_played(found, out)
    assert not list(tmp_path.iterdir())
    rollout_folder.write_played(found, out)
    before = (out / "rollout.npz").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(rollout_folder.verify, "to_json", full)
        with pytest.raises(OutputError):
            rollout_folder.write_played(found, out, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["out"] and (out / "rollout.npz").read_bytes() == before
    assert sorted(p.name for p in out.iterdir()) == ["plan.json", "rollout.npz", "verdict.json"]


def test_processes_that_write_at_once_get_numbers_of_their_own(package: Package, tmp_path: Path) -> None:
    found = played(package, "knock over the cereal box")
    folder = goal_package(tmp_path / "package").folder
    with ThreadPoolExecutor(4) as pool:
        places = list(pool.map(lambda _: rollout_folder.write_next(found, folder), range(8)))
    assert sorted(int(p.name) for p in places) == list(range(1, 9))
    assert {p.name for p in (folder / "rollouts").iterdir()} == {str(k) for k in range(1, 9)}


def test_what_a_killed_process_left_is_cleared_and_what_another_holds_is_not(package: Package, tmp_path: Path) -> None:
    found = played(package, "knock over the cereal box")
    folder = goal_package(tmp_path / "package").folder
    left, foreign = folder / "rollouts" / ".1.building", folder / "rollouts" / ".2.building"
    for building in (left, foreign):
        (building / "new").mkdir(parents=True)
    (left / atomic_folder.MARKER).touch()
    with atomic_folder.claimed(folder / "rollouts" / "3", lambda _: None) as held:
        assert rollout_folder.write_next(found, folder).name == "4"
        held.write("x", b"")
        held.replace()
    assert sorted(p.name for p in (folder / "rollouts").iterdir()) == [".2.building", "3", "4"]


def test_limits_grow_with_the_scene_up_to_a_person() -> None:
    scene = goal_scene()
    assert limits_of(scene).speed < 12 and limits_of(scene).lift == pytest.approx(4 * scene.diagonal)


if __name__ == "__main__":
    for schema, made in SCHEMAS.items():
        (DOCS / f"{schema}.schema.json").write_bytes(dump_json(made))
