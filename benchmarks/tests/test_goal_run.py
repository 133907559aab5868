"""The goal suite's runner on a made-up command: rows, what is found wrong with a run, numbers and tables."""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import sys
from pathlib import Path
from typing import Any

import asked
import pytest
import results

from f3sr.goals.plan import Velocity, to_json
from f3sr.goals.rollout import to_npz
from f3sr.goals.sequence import simulate
from f3sr.goals.verify import to_json as verdict_json
from f3sr.goals.verify import verify
from f3sr.scene_package.package import read_package, write_package
from plans import plan_of
from scenes import box_stack_scene

GOALS = Path(__file__).parents[1] / "goals"
spec = importlib.util.spec_from_file_location("goals_run", GOALS / "run.py")
assert spec and spec.loader
run = importlib.util.module_from_spec(spec)
spec.loader.exec_module(run)

FAKE = """
import shutil, sys
from pathlib import Path
made, (_, package, *what, _, out, _, _) = Path(sys.argv[1]), sys.argv[2:]
words = what[-1]
if words == "crash":
    sys.exit(1)
if words in ("refuse", "refuse badly"):
    if words == "refuse badly":
        Path(out + ".log").write_text("left behind")
    print("no 'teapot' here; the scene has a box", file=sys.stderr)
    sys.exit(3)
shutil.copytree(made, out)
if words == "differ":
    (Path(out) / "rollout.npz").write_bytes(b"no rollout")
print('{"search": {"rollouts": 7}}')
sys.exit(4 if words == "missed" else 0)
"""
TOP = 2
GOAL: dict[str, Any] = {
    "name": "slide the top one",
    "scene": "boxes",
    "kind": "move",
    "words": "good",
    "active": TOP,
    "checks": [{"is": "moves", "id": TOP, "at_least": 0.01}],
}


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_package(box_stack_scene(3), tmp_path_factory.mktemp("boxes") / "package")


@pytest.fixture(scope="module")
def command(package: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A command that has one plan, rollout and verdict for all goals: the uppermost box slides a little."""
    made = tmp_path_factory.mktemp("made")
    scene = read_package(package).scene
    plan = plan_of(scene, duration=0.5, active=TOP, velocities=[Velocity(id=TOP, linear=(0.5, 0, 0))])
    plan = plan.model_copy(update={"scene": hashlib.sha256((package / "scene.json").read_bytes()).hexdigest()})
    rollout = simulate(scene, plan)
    (made / "plan.json").write_bytes(to_json(plan))
    (made / "rollout.npz").write_bytes(to_npz(rollout))
    (made / "verdict.json").write_bytes(verdict_json(verify(scene, plan, rollout)))
    fake = made.with_name("fake.py")
    fake.write_text(FAKE)
    return [sys.executable, str(fake), str(made)]


def test_a_good_run_is_judged_replayed_and_run_again(package: Path, command: list[str], tmp_path: Path) -> None:
    row = asked.goal_row(GOAL, package, tmp_path / "out" / "good", command)
    assert row["checker"] and row["valid"] and row["identical"] and row["right_active"], row
    assert row["rollouts"] == 7 and row["replay_mm"] < 1e-3 and row["planned"] == "slide"
    assert not row["verify"] and not row["said"], "its condition is 10 cm: the verdict is a miss, the exit code is not"


def test_what_is_wrong_with_a_run_is_found(package: Path, command: list[str], tmp_path: Path) -> None:
    rows = {w: asked.goal_row({**GOAL, "words": w}, package, tmp_path / "o" / w, command) for w in ("crash", "differ")}
    assert not any(r["valid"] or r["checker"] for r in rows.values())
    assert "exit code 1" in rows["crash"]["missed"][0] and "not readable" in rows["differ"]["missed"][0]
    far = {**GOAL, "checks": [{"is": "moves", "id": TOP, "at_least": 0.5}], "active": 1}
    row = asked.goal_row(far, package, tmp_path / "o" / "far", command)
    assert row["valid"] and not row["checker"] and not row["right_active"]
    assert any("moves" in m for m in row["missed"])
    assert asked.goal_row({**GOAL, "words": "missed"}, package, tmp_path / "o" / "m", command)["said"]


def test_a_plan_of_another_scene_is_not_valid(package: Path, command: list[str], tmp_path: Path) -> None:
    other = shutil.copytree(package, tmp_path / "package")
    (other / "scene.json").write_text((package / "scene.json").read_text() + "\n")
    assert not asked.goal_row(GOAL, other, tmp_path / "out" / "other", command)["valid"]


def test_paraphrases_need_the_object_the_kind_and_the_target(package: Path, command: list[str], tmp_path: Path) -> None:
    goal = {"scene": "boxes", "active": TOP, "kinds": ["slide"]}
    ask = lambda words="good", **other: asked.paraphrase_row(  # noqa: E731
        {**goal, **other}, words, package, tmp_path / "out" / "p", command
    )["right"]
    assert ask()
    assert not any([ask(active=1), ask(kinds=["roll"]), ask(target=1), ask("crash"), ask("refuse")])


def test_a_refusal_helps_and_leaves_nothing(package: Path, command: list[str], tmp_path: Path) -> None:
    goal = {"scene": "boxes", "why": "unknown", "words": "refuse", "mentions": ["TEAPOT", "box|can"]}

    def row(**other: object) -> Any:
        return asked.refusal_row({**goal, **other}, package, tmp_path / "out" / "r", command)

    marks = ("refused", "nothing_written", "helpful")
    assert [row()[m] for m in marks] == [True, True, True]
    assert [row(mentions=["spoon"])[m] for m in marks] == [True, True, False]
    assert [row(words="refuse badly")[m] for m in marks] == [True, False, True]
    assert [row(words="good")[m] for m in marks] == [False, False, False]
    assert not row(words="crash")["refused"]


def test_numbers_baseline_and_tables_hold_every_row(package: Path, command: list[str], tmp_path: Path) -> None:
    goals = [GOAL, {**GOAL, "name": "crashes", "words": "crash"}]
    packages = {"boxes": package}
    refused = {"scene": "boxes", "why": "unknown", "words": "refuse", "mentions": ["teapot"]}
    asks = {
        "suite": goals,
        "paraphrases": [{"scene": "boxes", "active": TOP, "kinds": ["slide"], "wordings": ["good", "refuse"]}],
        "refusals": [refused, {**refused, "words": "good"}, {**refused, "scene": "not there"}],
    }
    rows = {part: run.measured(part, some, packages, tmp_path, command) for part, some in asks.items()}
    numbers = run.numbers_of(rows)
    wanted = {f"{n}_pct": 50.0 for n in ("valid", "checklist", "identical", "paraphrases", "refused")}
    assert {n: numbers[n] for n in wanted} == wanted
    groups = run.baseline.read(run.FILE)
    assert set(groups) == set(run.PARTS)
    for part in run.PARTS:
        assert set(groups[part].measures) <= set(numbers)
        assert run.baseline.compare(groups[part], numbers).problems
    page = results.markdown(numbers, rows)
    assert page.count("\n| good |") == 3 and page.count("\n| crash |") == 1
    assert "exit code 1" in results.summary(numbers, rows)


def test_a_package_is_taken_from_its_folder_and_not_made_without_data(package: Path, tmp_path: Path) -> None:
    shutil.copytree(package, tmp_path / "boxes")
    assert run.package_of("boxes", tmp_path, tmp_path) == tmp_path / "boxes"
    assert run.package_of("others", tmp_path, tmp_path) is None
