"""The commands for goals: what they print and write, exit codes, places that may not be written, signals."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import forked
from f3sr.cli import main
from f3sr.goals.plan import Velocity
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.play.telling import launch_told
from f3sr.scene_package.package import Package
from goal_scene import goal_package

TOPPLE = "knock over the cereal box"


def run(arguments: list[str]) -> int:
    """The command without films, which tests of their own are about."""
    return main.main([*arguments, "--no-film"] if arguments[0] == "simulate" else arguments)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("goals") / "package")


@pytest.fixture(scope="module")
def toppled(package: Package) -> str:
    """The plan.json of a goal that is met."""
    found = simulate_goal(package, TOPPLE)
    assert isinstance(found, Played)
    return found.plan.model_dump_json()


def test_a_goal_is_told_written_and_replayed(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, again = tmp_path / "out", tmp_path / "again"
    assert run(["simulate", str(package.folder), TOPPLE, "-o", str(out)]) == 0
    told = capsys.readouterr().out
    assert all(word in told for word in ("meaning:", "assumed:", "launch:", "met:", "rollout,", str(out)))
    for plan in (out / "plan.json", out):
        assert run(["simulate", str(package.folder), "--plan", str(plan), "-o", str(again / plan.name)]) == 0
        for name in ("plan.json", "rollout.npz", "verdict.json"):
            assert (out / name).read_bytes() == (again / plan.name / name).read_bytes()


def test_refusals_write_nothing_and_help(package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(["simulate", str(package.folder), "push the banana", "-o", str(out)]) == 3
    told = capsys.readouterr()
    assert told.err.startswith("f3sr: refused") and "cereal box" in told.err and told.err.count("\n") == 1
    assert not out.exists() and not list(tmp_path.iterdir())


def test_several_goals_go_to_numbered_folders(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    goals = ["hit the block with the sponge so that the block falls over", "push the banana", TOPPLE]
    assert run(["simulate", str(package.folder), *goals, "-o", str(tmp_path / "out"), "--json"]) == 3
    told = json.loads(capsys.readouterr().out)["goals"]
    assert [t["state"] for t in told] == ["missed", "refused", "met"] and told[1]["candidates"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["1", "3"]


def test_without_a_place_the_package_gets_the_next_rollout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = goal_package(tmp_path / "package").folder
    for number in ("1", "2"):
        assert run(["simulate", str(folder), TOPPLE]) == 0
        assert (folder / "rollouts" / number / "verdict.json").exists()
    assert run(["evaluate", str(folder), "--json"]) == 0, "it is a package as before"


def test_what_is_not_met_is_written_and_told_by_the_exit_code(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    goal = "hit the block with the sponge so that the block falls over"
    assert run(["simulate", str(package.folder), goal, "-o", str(tmp_path / "out")]) == 4
    assert "not met" in capsys.readouterr().err
    assert json.loads((tmp_path / "out" / "verdict.json").read_text())["met"] is False


def test_the_menu(package: Package, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["goals", str(package.folder)]) == 0
    assert "knock over" in capsys.readouterr().out
    assert run(["goals", str(package.folder), "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["objects"]) == 6


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["{package}"], 2, "no goal"),
        (["{package}", TOPPLE, "--plan", "{tmp}/plan.json"], 2, "both"),
        (["{package}", "--plan", "{tmp}/none.json"], 2, "no such file"),
        (
            ["{package}", TOPPLE, "--no-film", "--slow", "0.1"],
            2,
            "--slow: found 0.1; accepted: a factor of 0.125 to 100",
        ),
        (["{package}", TOPPLE, "--slow", "inf"], 2, "--slow: found inf; accepted"),
        (["{tmp}", TOPPLE], 2, "scene.json"),
        (["{tmp}/none", TOPPLE], 2, "none: found nothing there"),
        (["{package}", TOPPLE, "-o", "{package}"], 1, "the package"),
        (["{package}", TOPPLE, "-o", "{package}/meshes"], 1, "inside the package"),
        (["{package}", TOPPLE, "-o", "{package}/.."], 1, "holds the package"),
        (["{package}", TOPPLE, "-o", "{tmp}/full"], 1, "nothing replaced"),
        (["{package}", TOPPLE, "-o", "{tmp}/full/stranger"], 1, "is a file"),
        (["{package}", "x" * 10_000, "-o", "{tmp}/new"], 3, "accepted"),
        (["{package}", "push the \x1b[31mcan", "-o", "{tmp}/new"], 3, "accepted"),
    ],
)
def test_wrong_calls_end_with_one_line(
    package: Package,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "stranger").touch()
    before = sorted(package.folder.rglob("*"))
    call = [a.format(package=package.folder, tmp=tmp_path) for a in arguments]
    assert run(["simulate", *call]) == code
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and error[:-1].isprintable()
    assert sorted(package.folder.rglob("*")) == before and not (tmp_path / "new").exists()


def test_a_rollout_is_replaced_only_when_asked(package: Package, tmp_path: Path) -> None:
    call = ["simulate", str(package.folder), TOPPLE, "-o", str(tmp_path / "out")]
    assert run(call) == 0 and run(call) == 1 and run([*call, "--overwrite"]) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_several_goals_do_not_mix_with_one(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["simulate", str(package.folder), TOPPLE, "-o", str(tmp_path / "out")]
    assert run(call) == 0
    assert run([*call[:3], TOPPLE, *call[3:], "--overwrite"]) == 1
    assert "subfolders" in capsys.readouterr().err and not (tmp_path / "out" / "1").exists()


def test_a_refusal_is_said_once_and_a_replay_counts_one(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["simulate", str(package.folder), "push the banana", "-o", str(tmp_path / "out")]) == 3
    assert not capsys.readouterr().out
    assert run(["simulate", str(package.folder), "push the can into the block", "-o", str(tmp_path / "out")]) == 0
    plan = str(tmp_path / "out/plan.json")
    assert run(["simulate", str(package.folder), "--plan", plan, "-o", str(tmp_path / "two")]) == 0
    assert "met, 1 rollout, " in capsys.readouterr().out


def test_a_plan_of_another_package_is_bad_input(
    package: Package, toppled: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.json").write_text(toppled)
    other = shutil.copytree(package.folder, tmp_path / "other")
    (other / "scene.json").write_text((other / "scene.json").read_text() + " ")
    assert run(["simulate", str(other), "--plan", str(tmp_path / "plan.json"), "-o", str(tmp_path / "two")]) == 2
    assert "another scene" in capsys.readouterr().err and not (tmp_path / "two").exists()


def in_steps(duration: float, timestep: float, **more: int) -> Callable[[dict[str, Any]], None]:
    return lambda plan: plan["phases"][0]["simulation"].update(duration=duration, timestep=timestep, **more)


def made_of(**values: float) -> Callable[[dict[str, Any]], None]:
    return lambda plan: plan["phases"][0]["semantics"][0].update(values)


def aimed(x: float) -> Callable[[dict[str, Any]], None]:
    return lambda plan: plan["phases"][0]["task"].update(direction=[x, 0, 0])


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (in_steps(10, 1e-5), "phases.0.simulation.timestep"),
        (in_steps(10, 1e-300), "phases.0.simulation.timestep"),
        (in_steps(10, 1e-4, steps_per_sample=1000), "100,000 steps; accepted: at most 40,000"),
        (in_steps(10, 1 / 960, steps_per_sample=1), "9601 samples; accepted: 3 to 1001"),
        (in_steps(1e-300, 1 / 960), "1 samples"),
        (in_steps(1e300, 1 / 960), "phases.0.simulation.duration"),
        (aimed(1e308), "phases.0.task.direction.0"),
        (aimed(1e-300), "no length"),
        (
            lambda plan: plan["phases"][0]["task"]["conditions"][0].update(direction=[1e308, 0, 0], type="displaced"),
            "direction",
        ),
        (lambda plan: plan["phases"][0]["task"].update(active=2**63), "phases.0.task.active"),
        (made_of(mass=1e300), "phases.0.semantics.0.mass"),
        (made_of(density=1.0, mass=1.0), "by its volume"),
        (lambda plan: plan["phases"][0]["initial"]["velocities"][0].update(angular=[1e308, 0, 0]), "angular"),
    ],
)
def test_a_plan_beyond_all_bounds_is_one_line(
    package: Package, toppled: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], change, found: str
) -> None:
    plan = json.loads(toppled)
    change(plan)
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    capsys.readouterr()
    call = ["simulate", str(package.folder), "--plan", str(tmp_path / "plan.json"), "-o", str(tmp_path / "again")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert run(call) == 2
    error = capsys.readouterr().err
    assert "plan.json" in error and found in error and error.count("\n") == 1 and not (tmp_path / "again").exists()


@pytest.mark.parametrize(
    ("target", "found"), [("/dev/zero", "a device"), ("..", "a folder"), ("plan.json", "too many")]
)
def test_a_plan_that_is_no_file_is_refused_at_once(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str], target: str, found: str
) -> None:
    (tmp_path / "plan.json").symlink_to(target)
    assert run(["simulate", str(package.folder), "--plan", str(tmp_path / "plan.json")]) == 2
    assert found in capsys.readouterr().err


def test_an_interrupted_call_leaves_nothing_half_written(package: Package, tmp_path: Path) -> None:
    goals = [TOPPLE] * 40
    command = [
        sys.executable,
        "-m",
        "f3sr",
        "simulate",
        str(package.folder),
        *goals,
        "-o",
        str(tmp_path / "out"),
        "--no-film",
    ]
    process = forked.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while process.poll() is None and not (tmp_path / "out" / "2").exists():
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    assert process.wait(20) == 1
    assert process.stderr is not None and b"interrupted" in process.stderr.read()
    for folder in (tmp_path / "out").iterdir():
        assert {p.name for p in folder.iterdir()} == {"plan.json", "rollout.npz", "verdict.json"}, folder


@pytest.mark.parametrize(("kind", "linear", "thrown"), [
    ("push_into", (1.0, 0.0, 2.0), True), ("push_into", (1.0, 0.0, 0.0), False), ("throw_into", (1.0, 0.0, 2.0), False)
])  # fmt: skip
def test_a_push_that_becomes_a_throw_is_told(kind: str, linear: tuple[float, float, float], thrown: bool):
    initial = SimpleNamespace(offsets=(), velocities=(Velocity(id=0, linear=linear),), impulses=())
    phase: Any = SimpleNamespace(task=SimpleNamespace(kind=kind), initial=initial, semantics=())
    assert ("thrown" in launch_told(phase)) is thrown
    assert ("63 degrees up" in launch_told(phase)) is (linear[2] > 0)
