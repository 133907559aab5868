"""Goals of several phases: each starts where all rests after the one before; verdict, files and film hold them."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from f3sr.film import PLAYER, make_film
from f3sr.goals.plan import MOST_PHASES, Plan, from_json, to_json
from f3sr.goals.refusal import Refusal
from f3sr.goals.rollout import Rollout, from_npz, joined, to_npz
from f3sr.goals.sequence import played_phases, scene_after, simulate
from f3sr.goals.verify import verify
from f3sr.play import rollout_folder
from f3sr.play.goal_loop import Played, replay_plan, simulate_goal
from f3sr.scene import GROUND
from f3sr.scene_package.package import Package
from film_scene import given, unlit
from goal_scene import BALL, BLOCK, CAN, LID, goal_package
from plans import plan_of
from scenes import box, box_stack_scene, scene_of

TWO = "knock over the soup can, then push the wooden block 5 cm to the left"
BACK = "push the wooden block 5 cm to the left, then back to the right by 5 cm"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("sequence") / "package")


@cache
def played(package: Package, goal: str) -> Played:
    found = simulate_goal(package, goal)
    assert isinstance(found, Played), found
    return found


def test_every_phase_is_launched_and_met(package: Package) -> None:
    found = played(package, TWO)
    assert [p.task.active for p in found.plan.phases] == [CAN, BLOCK]
    assert found.verdict.met and not found.stopped and {c.phase for c in found.verdict.conditions} == {0, 1}
    start = float(found.rollout.time[found.rollout.starts[1]])
    assert all((c.time or start) >= start for c in found.verdict.conditions if c.phase == 1)


def test_a_phase_starts_where_the_one_before_rests(package: Package) -> None:
    first, second = played(package, TWO).rollout.phases
    assert np.allclose(first.T_world_object[-1], second.T_world_object[0], atol=1e-12)
    last = first.T_world_object[first.time >= first.time[-1] - 0.2][:, :, :3, 3]
    assert np.ptp(last, axis=0).max() < 0.02 * 0.2
    _, later = played_phases(package.scene, played(package, TWO).plan, played(package, TWO).rollout)
    assert all(np.array_equal(o.T_world_object, T) for o, T in zip(later.scene, first.T_world_object[-1], strict=True))


def test_there_and_back_ends_where_it_began(package: Package) -> None:
    way = played(package, BACK).rollout.poses(BLOCK)[:, :3, 3]
    middle = way[played(package, BACK).rollout.starts[1]]
    assert np.linalg.norm(middle - way[0]) > 0.045 and np.linalg.norm(way[-1] - way[0]) < 0.03
    assert not played(package, BACK).verdict.side_effects


def test_replay_and_files_keep_every_byte(package: Package, tmp_path: Path) -> None:
    found = played(package, TWO)
    assert to_npz(replay_plan(package, found.plan).rollout) == to_npz(found.rollout)
    assert to_npz(simulate(package.scene, from_json(to_json(found.plan)))) == to_npz(found.rollout)
    folder = rollout_folder.write_played(found, tmp_path / "out")
    read = rollout_folder.read_played(folder, package.folder)
    assert read.plan == found.plan and to_npz(read.rollout) == to_npz(found.rollout)
    assert verify(package.scene, read.plan, read.rollout).said == found.verdict.said


def test_the_film_shows_both_phases(package: Package) -> None:
    g = given(TWO)
    rollout = g.played.rollout
    files = make_film(g.scene, g.played.plan, rollout, g.played.verdict, unlit(g.scene))
    page = files[PLAYER].decode()
    data = json.loads(page.split('<script type="application/json" id="player-data">')[1].split("</script>")[0])
    assert data["frames"] == len(rollout.time) - 1, "the sample at which the second phase starts is shown once"
    assert data["view"]["strips"] == [0, int(rollout.starts[1]) - 1]
    assert "Phase 1" in page and "Phase 2" in page and "phase 2, wooden block is pushed" in page


def test_what_is_lifted_in_a_later_phase_is_carried_there(package: Package) -> None:
    g = given("knock over the soup can, then drop the ball on the ground")
    before, after = g.played.rollout.phases
    jump = np.linalg.norm(after.poses(BALL)[0, :3, 3] - before.poses(BALL)[-1, :3, 3])
    drawn = list[np.ndarray]()
    draw = unlit(g.scene)

    def noted(poses: np.ndarray) -> np.ndarray:
        drawn.append(poses[[o.id for o in g.scene].index(BALL), :3, 3])
        return draw(poses)

    make_film(g.scene, g.played.plan, g.played.rollout, g.played.verdict, noted)
    steps = np.linalg.norm(np.diff(drawn, axis=0), axis=1)
    assert jump > 0.05 and steps.max() < 0.5 * jump, "no cut: it is on its way for some frames"


def test_a_missed_phase_is_the_last_one(package: Package) -> None:
    found = simulate_goal(package, "throw the wooden block over the soup can, then push the soup can 4 m to the left")
    assert isinstance(found, Refusal) or (not found.verdict.met and found.stopped is (len(found.plan.phases) < 2))


def test_a_refusal_says_its_phase(package: Package) -> None:
    found = simulate_goal(package, "knock over the soup can, then push the unicorn to the left")
    assert isinstance(found, Refusal) and found.reason == "unknown"
    found = simulate_goal(package, "push the wooden block 5 cm to the left, then topple the ball")
    assert isinstance(found, Refusal) and found.message.startswith("phase 2: ") and "round" in found.message


def test_more_than_four_phases_are_refused(package: Package) -> None:
    goal = ", then ".join(["push the wooden block 5 cm to the left"] * (MOST_PHASES + 1))
    found = simulate_goal(package, goal)
    assert isinstance(found, Refusal) and f"at most {MOST_PHASES}" in found.message


def test_what_carries_what_is_found_again() -> None:
    scene = box_stack_scene(3)
    phase = plan_of(scene).phases[0]
    ids = np.array([o.id for o in scene])
    still = np.stack([o.T_world_object for o in scene])
    moved = still.copy()
    low = scene[2].bounds_world[0, 2]
    moved[2, :3, 3] += [0.5, 0.0, 1e-5 - low]

    def after(T: np.ndarray) -> list[int | None]:
        times, contacts = np.array([0.0, 1.0]), joined_contacts()
        rollout = Rollout(time=times, ids=ids, T_world_object=np.stack([still, T]), contacts=contacts)
        return [o.supported_by for o in scene_after(scene, phase, rollout)]

    assert after(still) == [GROUND, 0, 1]
    assert after(moved) == [GROUND, 0, GROUND]


def joined_contacts() -> np.ndarray:
    from f3sr.goals.rollout import CONTACT

    return np.zeros(0, CONTACT)


def test_loads_are_shared_by_what_carries() -> None:
    """A plank on two blocks: half of it each; beside its middle the lever's law."""
    blocks = [box(k, size=(0.06, 0.07, 0.06), at=(x, 0, 0.03)) for k, x in enumerate((-0.1, 0.1))]
    scene = scene_of(*blocks, box(2, size=(0.3, 0.05, 0.015), at=(0.02, 0, 0.0675)))
    plan = plan_of(scene, duration=0.5, active=2)
    found = scene_after(scene, plan.phases[0], simulate(scene, plan))[2]
    shares = {s.id: s.share for s in found.supports}
    assert set(shares) == {0, 1} and shares[1] > shares[0] and found.supported_by == 1
    assert sum(shares.values()) == pytest.approx(1)


def test_rollouts_are_joined_and_parted_again(tmp_path: Path) -> None:
    scene = box_stack_scene(3)
    one = simulate(scene, plan_of(scene, duration=0.3))
    both = joined([one, one])
    assert both.starts.tolist() == [0, len(one.time)] and both.time[len(one.time)] == one.time[-1]
    for part in both.phases:
        assert np.allclose(part.time, one.time, atol=1e-12) and len(part.contacts) == len(one.contacts)
    (tmp_path / "r.npz").write_bytes(to_npz(both))
    assert to_npz(from_npz(tmp_path / "r.npz")) == to_npz(both)
    assert joined([one]) is one


def test_a_plan_of_version_1_is_one_phase() -> None:
    plan = plan_of(box_stack_scene(3))
    new = json.loads(to_json(plan))
    old = {k: v for k, v in new.items() if k != "phases"} | new["phases"][0] | {"schema_version": 1}
    assert from_json(json.dumps(old).encode()) == plan
    for version in (True, 1.0, 3, "1"):
        with pytest.raises(ValueError):
            from_json(json.dumps(old | {"schema_version": version}).encode())


def test_densities_stay_from_phase_to_phase() -> None:
    plan = plan_of(box_stack_scene(3))
    (phase,) = plan.phases
    heavier = tuple(s.model_copy(update={"density": 2 * s.density}) for s in phase.semantics)
    other = phase.model_copy(update={"semantics": heavier})
    with pytest.raises(ValueError, match="densities"):
        Plan.model_validate({**plan.model_dump(), "phases": (phase.model_dump(), other.model_dump())})


# --- side effects -------------------------------------------------------------------------------------------------


def test_what_else_falls_is_told(package: Package) -> None:
    """The lid lies on the block: pushed from under it, the lid falls off; told, though the goal may be met."""
    scene, plan = package.scene, played(package, TWO).plan
    rollout = played(package, TWO).rollout
    T = rollout.T_world_object.copy()
    row = rollout.row(LID)
    T[-10:, row, :3, 3] += [0.0, 0.0, -0.2]
    T[-10:, row, :3, 3] += [5.0, 0.0, 0.0]
    contacts = rollout.contacts[(rollout.contacts["a"] != LID) & (rollout.contacts["b"] != LID)]
    moved = replace(rollout, T_world_object=T, contacts=contacts)
    effects = verify(scene, plan, moved).side_effects
    assert any("falls off" in said for said in effects) and any("leaves the photo" in said for said in effects)
    assert all(said.startswith("phase 2: ") for said in effects)


def test_what_is_asked_for_is_no_side_effect(package: Package) -> None:
    assert not played(
        package, "knock over the soup can, then push the wooden block 5 cm to the left"
    ).verdict.side_effects
