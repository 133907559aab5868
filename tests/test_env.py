"""Scene packages as Gymnasium environments: determinism, the goal's own verdict, grasps, hostile actions."""

from __future__ import annotations

import copy
import math
import pickle
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed: pip install 'f3sr[gym]'")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import f3sr  # noqa: E402
from f3sr.core.transforms import UP  # noqa: E402
from f3sr.env import ID, resets  # noqa: E402
from f3sr.env.goal_progress import GoalProgress  # noqa: E402
from f3sr.env.gripper import GripperConfig  # noqa: E402
from f3sr.env.resets import Randomization  # noqa: E402
from f3sr.env.scene_env import RATE, SceneEnv  # noqa: E402
from f3sr.env.scripted_grasp import grasp_of, pick  # noqa: E402
from f3sr.errors import InputError  # noqa: E402
from f3sr.goals.plan import Displaced, Height  # noqa: E402
from f3sr.goals.verify import verify  # noqa: E402
from f3sr.physics.mujoco_model import engine  # noqa: E402
from f3sr.scene_package.package import Package, write_package  # noqa: E402
from goal_scene import goal_package  # noqa: E402

GOAL = "put the sponge on the cereal box"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("env") / "package")


def env_of(package: Package, *args: Any, **kwargs: Any) -> SceneEnv:
    return SceneEnv(package, *args, **kwargs)


@pytest.mark.parametrize("options", [{}, {"control": "pose"}, {"gripper": False}, {"reward": "margin"}])
def test_gymnasiums_own_check_finds_nothing(package: Package, options: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "(?s).*symmetric and normalized")  # poses are metres
        folder, goal = str(package.folder), "push the can 10 cm to the left"
        env = gymnasium.make(ID, package=folder, goal=goal, **options)
        check_env(env.unwrapped, skip_render_check=True)


def test_equal_seeds_give_equal_episodes_to_the_bit(package: Package) -> None:
    some = Randomization(mass=0.3, friction=0.3)
    runs = list[bytes]()
    for seed in (3, 3, 4):
        env = env_of(package, "push the can 10 cm to the left", randomization=some)
        env.action_space.seed(seed)
        seen = [env.reset(seed=seed)[0]]
        seen += [env.step(env.action_space.sample())[0] for _ in range(20)]
        runs.append(b"".join(o[name].tobytes() for o in seen for name in sorted(o)))
    assert runs[0] == runs[1] != runs[2]


def test_a_reset_is_the_scene_at_rest_and_forgets_the_episode_before(package: Package) -> None:
    env = env_of(package)
    first, _ = env.reset(seed=0)
    assert np.allclose(env.playable.poses(), [o.T_world_object for o in package.scene], atol=1e-9)
    for _ in range(10):
        env.step(np.array([0.0, 0, -1, 0, 0, 0, 0]))
    again, _ = env.reset(seed=0)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    still = [env.step(np.zeros(7)) for _ in range(2 * RATE)]
    assert not any(reward or ended for _, reward, ended, *_ in still)
    moved = np.linalg.norm(still[-1][0]["poses"][:, :3] - first["poses"][:, :3], axis=1)
    assert moved.max() < 1e-3


def test_random_materials_leave_the_scene_at_rest(package: Package) -> None:
    env = env_of(package, randomization=Randomization(mass=0.4, friction=0.2))
    masses = set[float]()
    for seed in range(8):
        first, _ = env.reset(seed=seed)
        masses.add(float(env.playable.model.body_mass[1]))
        seen = [env.step(np.zeros(7))[0] for _ in range(RATE)][-1]
        assert np.abs(seen["poses"][:, :3] - first["poses"][:, :3]).max() < 1e-3
    assert len(masses) == 8


def test_episodes_judge_as_rollouts_do(package: Package) -> None:
    """The rollout of a played goal, fed to an episode's progress, is met as its verdict says."""
    for goal in ("push the sponge off the block", "knock over the cereal box"):
        played = f3sr.simulate_goal(package, goal)
        assert isinstance(played, f3sr.Played) and played.verdict.met
        env = env_of(package, goal)
        env.reset(seed=0)
        conditions = played.plan.phases[0].task.conditions
        progress = GoalProgress(
            scene=package.scene, conditions=conditions, samples=len(played.rollout.time), model=env.playable.model
        )
        data = env.playable.data
        for time, poses in zip(played.rollout.time, played.rollout.T_world_object, strict=True):
            env.playable.put(poses)
            data.time = time
            progress.add(data, env.playable.states())
        judged = {type(j.condition).__name__: j for j in progress.judged()}
        wanted = {type(j.condition).__name__: j for j in verify(package.scene, played.plan, played.rollout).conditions}
        for name, j in judged.items():
            if name not in ("Contact", "On"):  # brief contacts lie between poses that are put back
                assert j.met == wanted[name].met and abs(j.margin - wanted[name].margin) < 1e-6


def test_an_object_pushed_by_hand_meets_its_goal(package: Package) -> None:
    env = env_of(package, "push the can 10 cm to the left", gripper=False)
    env.reset(seed=0)
    assert env.task is not None and isinstance(env.task.conditions[0], Displaced)
    push = np.zeros(6)
    push[:3] = 0.2 * np.asarray(env.task.conditions[0].direction)
    ended, reward, info = False, 0.0, dict[str, Any]()
    for _ in range(5 * RATE):
        _, reward, ended, _, info = env.step(push)
        if ended:
            break
    assert ended and reward == 1 and info["success"] and all(j.met for j in env.judged())


@pytest.mark.parametrize("goal", ["drop the can", "lift and drop the can"])
def test_what_is_to_be_dropped_has_to_be_lifted_first(package: Package, goal: str) -> None:
    env = env_of(package, goal, gripper=False)
    env.reset(seed=0)
    for _ in range(10):
        _, reward, ended, _, _ = env.step(np.zeros(6))
        assert reward == 0 and not ended
    assert env.task is not None and isinstance(env.task.conditions[0], Height)
    up, still = np.array([0, 0, 0.5, 0, 0, 0]), np.zeros(6)
    ended, most = False, math.ceil(RATE * (env.task.amount or 0) / 0.4)
    for action in [up] * most + [0.3 * -up] * 4 * most + [still] * 3 * RATE:
        _, reward, ended, _, _ = env.step(action)
        if ended:
            break
    assert ended and reward == 1, [j.said for j in env.judged()]


@pytest.mark.slow
def test_a_scripted_grasp_lifts_and_holds_what_fits(package: Package) -> None:
    config = GripperConfig()
    env = env_of(package, control="pose", seconds=30)
    held = 0
    for o in package.scene:
        if o.mobility == "fixed" or grasp_of(package.scene, o.id, config) is None:
            continue
        seen, _ = env.reset(seed=0)
        k = env.playable.ids.index(o.id)
        start = seen["poses"][k, 2]
        for action in pick(env.scene, o.id, config, rate=RATE, lift=0.1):
            seen, *_ = env.step(action)
        assert seen["poses"][k, 2] - start > 0.08, o.label
        held += 1
    assert held >= 3


def test_a_grasp_is_as_wide_as_what_is_between_its_pads(package: Package) -> None:
    """Turned objects have turned grasps: the same width, and the hand points down."""
    for o in package.scene:
        grasp = grasp_of(package.scene, o.id, GripperConfig())
        if grasp is not None:
            assert 0 < grasp.width < 0.085
            hand = np.zeros(9)
            engine().mju_quat2Mat(hand, grasp.quaternion)
            assert np.allclose(hand.reshape(3, 3)[:, 2], -UP, atol=1e-9)


def test_a_grasp_of_what_the_scene_has_not_names_its_objects(package: Package) -> None:
    with pytest.raises(InputError, match="grasp: found object 99; accepted: one of 0, 1"):
        pick(package.scene, 99, GripperConfig(), rate=RATE)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"rate": 0}, "rate: found 0; accepted: 1 to 1000 actions a second"),
        ({"rate": 1e9}, "rate: found 1000000000.0; accepted: 1 to 1000"),
        ({"rate": "20"}, "rate: found '20'"),
        ({"lift": 1e9}, "lift: found 1000000000.0; accepted: 0 to 0.[0-9]+ m: no higher does the hand go"),
        ({"lift": -0.1}, "lift: found -0.1; accepted: 0 to"),
        ({"lift": float("nan")}, "lift: found nan"),
        ({"hold": 1e9}, "hold: found 1000000000.0; accepted: 0 to 600 s"),
    ],
)
def test_a_grasp_that_the_hand_cannot_do_is_refused_at_once(
    package: Package, options: dict[str, Any], said: str
) -> None:
    id = next(o.id for o in package.scene if o.mobility == "dynamic" and grasp_of(package.scene, o.id, GripperConfig()))
    with pytest.raises(InputError, match=said):
        pick(package.scene, id, GripperConfig(), **{"rate": RATE, **options})


def test_pictures_show_the_gripper_and_are_the_photo_without(package: Package) -> None:
    env = env_of(package, observation="both", render_mode="rgb_array")
    seen, _ = env.reset(seed=0)
    assert seen["picture"].shape == env.observation_space["picture"].shape  # type: ignore[index]
    picture = env.render()
    assert picture is not None and np.array_equal(seen["picture"], picture)
    down = np.array([0.0, 0, -1, 0, 0, 0, 0])
    later = [env.step(down)[0]["picture"] for _ in range(RATE)]
    assert (later[-1] != seen["picture"]).any()
    assert env_of(package).render() is None


def test_light_and_camera_differ_from_reset_to_reset(package: Package) -> None:
    env = env_of(package, observation="pictures", randomization=Randomization(light=0.5, camera=0.05))
    pictures = [env.reset(seed=seed)[0]["picture"] for seed in (0, 0, 1)]
    assert np.array_equal(pictures[0], pictures[1]) and (pictures[0] != pictures[2]).any()


KINDS = (["1"] * 7, [1j] * 7, np.full(7, 1j), np.full(7, "1"), [[1], 2], [10**30] * 7, b"1234567")


@pytest.mark.parametrize(
    "action",
    [np.full(7, np.nan), np.full(7, np.inf), np.zeros(6), np.zeros((7, 1)), np.array(["a"] * 7), "up", None, *KINDS],
    ids=str,
)
def test_actions_of_another_kind_are_refused(package: Package, action: Any) -> None:
    env = env_of(package)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"action: found .*; accepted: finite values of shape \(7,\)"):
        env.step(action)


def test_an_episode_has_a_start_and_an_end(package: Package) -> None:
    env = env_of(package, seconds=0.1)
    still = np.zeros(7)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still)
    env.reset(seed=0)
    assert [env.step(still)[3] for _ in range(2)] == [False, True]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still)
    env.reset(seed=0)
    assert not env.step(still)[3]


def test_an_episode_ends_where_its_goal_is_met(package: Package) -> None:
    env = env_of(package, "push the can 10 cm to the left", gripper=False)
    env.reset(seed=0)
    assert env.task is not None and isinstance(env.task.conditions[0], Displaced)
    push = np.array([*0.2 * np.asarray(env.task.conditions[0].direction), 0, 0, 0])
    while not env.step(push)[2]:
        pass
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(push)
    env.reset(seed=0)
    assert not env.step(push)[2]


@pytest.mark.parametrize("options", [3, {"scnee": 0}, {"scene": 0.0}, {"scene": True}], ids=str)
def test_options_of_a_reset_are_checked(package: Package, options: Any) -> None:
    with pytest.raises(InputError, match="options"):
        env_of(package).reset(options=options)


def test_a_copy_is_an_environment_of_its_own(package: Package) -> None:
    env = env_of(package, "push the can 10 cm to the left", control="pose", seconds=1)
    for copied in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        own, other = (each.reset(seed=4)[0]["poses"] for each in (env, copied))
        assert np.array_equal(own, other) and copied.playable is not env.playable
        assert (copied.goal, copied.action_space) == (env.goal, env.action_space)


@pytest.mark.parametrize("scale", [1e3, 1e300])
def test_large_actions_are_limited(package: Package, scale: float) -> None:
    for options in ({}, {"control": "pose"}, {"gripper": False}):
        env = env_of(package, **options)
        env.reset(seed=0)
        action = np.full(env.action_space.shape or (), scale)
        for seen in [env.step(action)[0] for _ in range(5)]:
            assert all(np.isfinite(values).all() for values in seen.values())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"goal": "paint the can"}, "goal"),
        ({"goal": "push the can 10 cm to the left, then roll the ball to the left"}, "phases"),
        ({"seconds": 0}, "seconds"),
        ({"seconds": float("nan")}, "seconds"),
        ({"render_mode": "human"}, "render_mode"),
        ({"control": "pose", "gripper": False}, "control"),
        ({"control": "torque"}, "control: found 'torque'; accepted: 'velocity', 'pose'"),
        ({"observation": "rgb"}, "observation: found 'rgb'; accepted: 'state', 'pictures', 'both'"),
        ({"reward": "dense"}, "reward: found 'dense'; accepted: 'success', 'margin'"),
        ({"goal": 3}, "goal: found 3"),
        ({"gripper": {"opening": 0.1}}, "gripper: found .*GripperConfig"),
        ({"randomization": {"mass": 0.3}}, "randomization: found .*Randomization"),
        ({"seconds": "ten"}, "seconds: found 'ten'"),
        ({"longest": 0}, "longest: found 0; accepted: 16 to 4096"),
        ({"longest": 64.5}, "longest: found 64.5"),
        ({"samples": "/nowhere"}, "no package"),
    ],
)
def test_bad_arguments_get_one_clear_error(package: Package, options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        env_of(package, **options)
    assert "\n" not in str(caught.value)


def test_a_bank_of_samples_starts_episodes_elsewhere(package: Package, tmp_path: Path) -> None:
    """Its scenes are packages of the same objects; those of others are refused."""
    moved = package.scene.with_objects(*(o for o in package.scene))
    write_package(moved, tmp_path / "bank" / "001")
    env = env_of(package, samples=tmp_path / "bank")
    drawn = {env.reset(seed=seed)[1]["scene"] for seed in range(12)}
    assert drawn == {0, 1}
    assert env.reset(options={"scene": 1})[1]["scene"] == 1
    with pytest.raises(InputError, match="scene 7"):
        env.reset(options={"scene": 7})


def test_too_many_samples_are_refused(package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(3):
        (tmp_path / str(k)).mkdir()
        (tmp_path / str(k) / "scene.json").touch()
    monkeypatch.setattr(resets, "MAX_BANK", 2)
    with pytest.raises(InputError, match="3 samples; accepted: at most 2"):
        env_of(package, samples=tmp_path)


def test_the_examples_of_the_page_run(package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every Python block, in a folder that holds a package ``out``; the grasp's own assertion holds."""
    page = Path(__file__).parents[1] / "docs/environments.md"
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2 and any("pick(" in block for block in blocks)
    (tmp_path / "out").symlink_to(package.folder)
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        exec(compile(block, str(page), "exec"), {})


def test_a_package_gives_its_mujoco_model(package: Package) -> None:
    play = f3sr.load(package.folder).mujoco()
    assert play.ids == tuple(o.id for o in package.scene)
    engine().mj_step(play.model, play.data, 500)
    moved = np.abs(play.poses()[:, :3, 3] - [o.T_world_object[:3, 3] for o in package.scene])
    assert moved.max() < 1e-3
    shifted = play.poses()
    shifted[0, :3, 3] += [0, 0, 0.3]
    play.put(shifted)
    assert np.allclose(play.poses(), shifted, atol=1e-12) and not play.velocities().any()
