"""Conditions on made rollouts whose answer is known: met or missed, by how much, when, and in which order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from f3sr.core.transforms import Array, pose, rotation_about
from f3sr.goals.conditions import Judged, judge
from f3sr.goals.plan import (
    AtRest,
    Bounced,
    Condition,
    Contact,
    Displaced,
    Height,
    Impulse,
    InitialConditions,
    Inside,
    Limits,
    Off,
    On,
    Over,
    Phase,
    Returned,
    Rolled,
    SimulationPlan,
    TaskSpec,
    Toppled,
    Upright,
)
from f3sr.goals.rollout import CONTACT, Rollout
from f3sr.goals.verify import to_json, verify_phase
from f3sr.scene import GROUND, Scene
from scenes import box, scene_of

TIME = np.arange(31) / 30


def still(scene: Scene, id: int) -> Array:
    return np.tile(scene[id].T_world_object, (len(TIME), 1, 1))


def rollout_of(
    scene: Scene,
    poses: Mapping[int, Array] | None = None,
    touches: Sequence[tuple[float, int, int, float]] = (),
) -> Rollout:
    """Objects that stay where they are but for some poses (T, 4, 4)."""
    T = np.stack([(poses or {}).get(o.id, still(scene, o.id)) for o in scene], axis=1)
    ids = np.array([o.id for o in scene])
    return Rollout(time=TIME, ids=ids, T_world_object=T, contacts=np.array(list(touches), CONTACT))


def along(scene: Scene, id: int, way: Array) -> Array:
    """Poses of an object shifted by a way (T, 3)."""
    T = still(scene, id)
    T[:, :3, 3] += way
    return T


def one(condition: Condition, rollout: Rollout, scene: Scene) -> Judged:
    return judge([condition], rollout, scene)[0]


@pytest.fixture
def scene() -> Scene:
    return scene_of(box(0, at=(0, 0, 0.05)), box(1, at=(0.5, 0, 0.05)))


def sideways(speed: float) -> Array:
    return TIME[:, None] * np.array([speed, 0, 0])


def test_displaced_by_how_much_and_when(scene: Scene) -> None:
    rollout = rollout_of(scene, {0: along(scene, 0, sideways(0.3))})
    met = one(Displaced(a=0, at_least=0.1), rollout, scene)
    assert met.met and met.margin == pytest.approx(0.2) and met.time == pytest.approx(1 / 3)
    missed = one(Displaced(a=0, at_least=0.5), rollout, scene)
    assert not missed.met and missed.margin == pytest.approx(-0.2) and missed.time == pytest.approx(1.0)
    across = one(Displaced(a=0, at_least=0.1, direction=(0, 2, 0)), rollout, scene)
    assert across.margin == pytest.approx(-0.1), "a direction's length does not matter"
    assert one(Displaced(a=1, at_least=0.1), rollout, scene).margin == pytest.approx(-0.1)


def test_a_contact_is_an_event_and_a_miss_a_distance(scene: Scene) -> None:
    near = rollout_of(scene, {0: along(scene, 0, sideways(0.3))})
    missed = one(Contact(a=0, b=1), near, scene)
    assert missed.margin == pytest.approx(-0.1, abs=1e-3) and missed.time == pytest.approx(1.0)
    assert "misses" in missed.said and "100 mm" in missed.said
    touched = rollout_of(scene, touches=[(0.4, 0, 1, 3.0), (0.5, 0, 1, 9.0)])
    for condition in (Contact(a=0, b=1), Contact(a=1, b=0)):
        met = one(condition, touched, scene)
        assert met.met and met.time == pytest.approx(0.4)
    flying = rollout_of(scene, {0: along(scene, 0, np.full((31, 3), [0, 0, 0.2]))})
    assert one(Contact(a=0, b=GROUND), flying, scene).margin == pytest.approx(-0.2, abs=1e-6)


def test_a_first_contact_comes_after_what_it_is_to_come_after(scene: Scene) -> None:
    def second(*touches: tuple[float, int, int, float]) -> Judged:
        conditions = (Contact(a=0, b=GROUND), Contact(a=0, b=1, after=0, first=True))
        return judge(conditions, rollout_of(scene, touches=touches), scene)[1]

    floor, again = (0.5, GROUND, 0, 1.0), (0.7, 0, 1, 1.0)
    assert second(floor, again).met and second(floor, again).time == pytest.approx(0.7)
    early = second((0.2, 0, 1, 1.0), floor, again)
    assert not early.met and early.margin == pytest.approx(-0.3) and early.unit == "s" and "0.30 s early" in early.said
    assert second((0.0, 0, 1, 1.0), floor, again).met, "what touches at the start has not come there"
    assert not second(floor).met


def test_order_and_deadlines(scene: Scene) -> None:
    rollout = rollout_of(scene, {1: along(scene, 1, sideways(0.3))}, [(0.2, 0, 1, 1.0), (0.8, 0, 1, 1.0)])
    conditions = (Displaced(a=1, at_least=0.15), Contact(a=0, b=1, after=0))
    moved, touched = judge(conditions, rollout, scene)
    assert moved.time == pytest.approx(0.5) and touched.time == pytest.approx(0.8), "the touch before does not count"
    late = one(Displaced(a=1, at_least=0.15, within=0.3), rollout, scene)
    assert not late.met and late.margin == pytest.approx(-0.2) and late.unit == "s" and "late" in late.said
    nothing, then = judge((Displaced(a=0, at_least=1.0), Contact(a=0, b=1, after=0)), rollout, scene)
    assert not nothing.met and not then.met and then.said.startswith("condition 1, which it comes after,")
    with pytest.raises(ValueError, match="an earlier one"):
        TaskSpec(kind="slide", active=0, conditions=(Contact(a=0, b=1, after=0),), interpretation="")


def test_toppled_is_what_stays_so(scene: Scene) -> None:
    def turned(angles: Array) -> Array:
        T = still(scene, 0)
        T[:, :3, :3] = [rotation_about([1, 0, 0], a) @ R for a, R in zip(angles, T[:, :3, :3], strict=True)]
        return T

    over = rollout_of(scene, {0: turned(np.radians(90) * TIME)})
    met = one(Toppled(a=0), over, scene)
    assert met.met and met.margin == pytest.approx(np.radians(30)) and met.time == pytest.approx(2 / 3, abs=0.04)
    rocked = rollout_of(scene, {0: turned(np.radians(80) * np.sin(np.pi * TIME))})
    assert one(Toppled(a=0), rocked, scene).margin == pytest.approx(-np.radians(60), abs=1e-6)
    spun = still(scene, 0)
    spun[:, :3, :3] = [rotation_about([0, 0, 1], 3 * t) for t in TIME]
    assert one(Toppled(a=0), rollout_of(scene, {0: spun}), scene).margin == pytest.approx(-np.radians(60))


def test_displaced_aside_or_too_far_is_missed(scene: Scene) -> None:
    askew = rollout_of(scene, {0: along(scene, 0, TIME[:, None] * np.array([0.3, 0.6, 0]))})
    assert one(Displaced(a=0, at_least=0.1, direction=(1, 0, 0)), askew, scene).margin == pytest.approx(-0.1)
    straight = rollout_of(scene, {0: along(scene, 0, sideways(0.3))})
    assert one(Displaced(a=0, at_least=0.1, at_most=0.35), straight, scene).margin == pytest.approx(0.05)
    assert one(Displaced(a=0, at_least=0.1, at_most=0.2), straight, scene).margin == pytest.approx(-0.1)


def test_upright_is_of_the_end(scene: Scene) -> None:
    T = still(scene, 0)
    T[:, :3, :3] = [rotation_about([1, 0, 0], a) for a in np.radians(20) * TIME]
    assert one(Upright(a=0), rollout_of(scene, {0: T}), scene).margin == pytest.approx(np.radians(10))


def test_rolled_is_turning_across_the_way(scene: Scene) -> None:
    """A wheel of 5 cm that goes .3 m to +x turns by 6 rad about +y; sliding and spinning about z is not rolling."""
    T = along(scene, 0, sideways(0.3))
    T[:, :3, :3] = [rotation_about([0, 1, 0], 6 * t) for t in TIME]
    assert one(Rolled(a=0, at_least=5), rollout_of(scene, {0: T}), scene).margin == pytest.approx(1.0, abs=1e-6)
    T[:, :3, :3] = [rotation_about([0, 0, 1], 6 * t) for t in TIME]
    assert one(Rolled(a=0, at_least=5), rollout_of(scene, {0: T}), scene).margin == pytest.approx(-5, abs=1e-6)


def test_what_fell_over_rolls_about_its_own_axis(scene: Scene) -> None:
    """In .5 s it falls towards +x; what was up then lies along +x and it turns about that by 1 rad, or not at all."""
    fallen, rolling = Toppled(a=0), Rolled(a=0, at_least=0.75, after=0, upended=True)
    for sign, turned in ((1, 1.0), (-1, 1.0), (0, 0.0)):
        T = along(scene, 0, sideways(0.3))
        for k, t in enumerate(TIME):
            over, own = min(t / 0.5, 1.0) * np.pi / 2, sign * max(0.0, 2 * (t - 0.5))
            T[k, :3, :3] = rotation_about([0, 1, 0], over) @ rotation_about([0, 0, 1], own)
        lies, rolled = judge((fallen, rolling), rollout_of(scene, {0: T}), scene)
        assert lies.met and rolled.margin == pytest.approx(turned - 0.75, abs=1e-6)
        assert one(Rolled(a=0, at_least=0.75), rollout_of(scene, {0: T}), scene).met, "falling turns it too"


def test_rocking_to_and_fro_is_not_rolling(scene: Scene) -> None:
    """Three times .1 m there and back, turning as it goes: what is turned back does not count."""
    x = 0.1 * np.abs(np.sin(3 * np.pi * TIME))
    T = along(scene, 0, x[:, None] * [1.0, 0, 0])
    T[:, :3, :3] = [rotation_about([0, 1, 0], float(far) / 0.05) for far in x]
    found = one(Rolled(a=0, at_least=3), rollout_of(scene, {0: T}), scene)
    assert not found.met and found.margin == pytest.approx(2 - 3, abs=0.05)


def test_what_ends_elsewhere_was_not_moved_that_way(scene: Scene) -> None:
    """6 cm to the right on the way, at the end 5 cm to the right and 9.5 cm aside."""
    way = np.column_stack([np.interp(TIME, [0, 0.5, 1], [0, 0.06, 0.05]), 0.095 * (TIME > 0.6), 0 * TIME])
    condition = Displaced(a=0, at_least=0.05, at_most=0.2, direction=(1.0, 0.0, 0.0))
    found = one(condition, rollout_of(scene, {0: along(scene, 0, way)}), scene)
    assert not found.met and "aside" in found.said and found.margin == pytest.approx(0.05 - 0.095, abs=1e-9)


def test_what_is_flung_away_breaks_a_rule(scene: Scene) -> None:
    limits = Limits(speed=3.0, impulse=10.0, force=100.0, lift=1.0)
    task = TaskSpec(kind="slide", active=0, conditions=(Displaced(a=0, at_least=0.1),), interpretation="a test")
    simulation = SimulationPlan(duration=1.0, limits=limits)
    phase = Phase(task=task, semantics=(), initial=InitialConditions(), simulation=simulation)
    fast = rollout_of(scene, {1: along(scene, 1, sideways(9))})
    assert any("flung" in rule for rule in verify_phase(scene, phase, fast).broken)
    assert not any(
        "flung" in r for r in verify_phase(scene, phase, rollout_of(scene, {1: along(scene, 1, sideways(2))})).broken
    )


def test_bounced_rises_again_after_the_touch(scene: Scene) -> None:
    z = np.where(TIME < 0.5, 0.4 * (1 - 2 * TIME), 0.2 * (TIME - 0.5))
    rollout = rollout_of(scene, {0: along(scene, 0, z[:, None] * [0, 0, 1])}, [(0.5, GROUND, 0, 9.0)])
    met = one(Bounced(a=0, b=GROUND, at_least=0.05), rollout, scene)
    assert met.margin == pytest.approx(0.05, abs=1e-6)
    assert not one(Bounced(a=0, b=1, at_least=0.05), rollout, scene).met, "that was never touched"


@pytest.mark.parametrize(("height", "met"), [(0.2, True), (0.05, False)])
def test_over_is_above_the_top(scene: Scene, height: float, met: bool) -> None:
    way = np.column_stack([TIME, 0 * TIME, np.full(31, height)])
    found = one(Over(a=0, b=1), rollout_of(scene, {0: along(scene, 0, way)}), scene)
    assert found.met == met and found.margin == pytest.approx(height - 0.1, abs=1e-6)
    beside = rollout_of(scene, {0: along(scene, 0, np.add(way, (0, 0.25, 0)))})
    assert one(Over(a=0, b=1), beside, scene).margin == pytest.approx(-0.2, abs=1e-3)


def test_off_is_beside_what_it_was_on() -> None:
    scene = scene_of(box(0, at=(0, 0, 0.05)), box(1, at=(0, 0, 0.15)))
    assert one(Off(a=1, b=0), rollout_of(scene), scene).margin == pytest.approx(-0.05)
    gone = rollout_of(scene, {1: along(scene, 1, sideways(0.2))})
    assert one(Off(a=1, b=0), gone, scene).margin == pytest.approx(0.15)


def test_it_may_come_back_and_leave_again(scene: Scene) -> None:
    way = rollout_of(scene, {0: along(scene, 0, np.abs(np.sin(3 * np.pi * TIME / 2))[:, None] * [0.3, 0, 0])})
    assert not one(Returned(a=0, to_within=0.05), way, scene).met
    assert one(Returned(a=0, to_within=0.05, stays=False), way, scene).margin == pytest.approx(0.05, abs=0.02)


def test_height_rest_and_return(scene: Scene) -> None:
    up = np.sin(np.pi * TIME)[:, None] * [0, 0, 0.4]
    rollout = rollout_of(scene, {0: along(scene, 0, up)})
    assert one(Height(a=0, at_least=0.3), rollout, scene).margin == pytest.approx(0.1)
    assert one(Returned(a=0, to_within=0.05), rollout, scene).margin == pytest.approx(0.05, abs=1e-6)
    assert not one(Returned(a=1, to_within=0.05), rollout, scene).met, "what never leaves does not return"
    assert not one(AtRest(a=0), rollout, scene).met and one(AtRest(a=1), rollout, scene).met


def test_on_and_inside() -> None:
    cup = box(0, size=(0.3, 0.3, 0.2), at=(0, 0, 0.1))
    stone = box(1, size=(0.1, 0.1, 0.1), at=(0.5, 0, 0.05))
    scene = scene_of(cup, stone)

    def ends(at: tuple[float, float, float], *touches: tuple[float, int, int, float]) -> Rollout:
        return rollout_of(scene, {1: np.tile(pose(t=at), (len(TIME), 1, 1))}, touches)

    on = ends((0, 0, 0.25), (0.95, 0, 1, 5.0))
    assert one(On(a=1, b=0), on, scene).margin == pytest.approx(0.15) and not one(Inside(a=1, b=0), on, scene).met
    assert not one(On(a=1, b=0), ends((0, 0, 0.25), (0.3, 0, 1, 5.0)), scene).met, "it touched long before the end"
    looks_over = ends((0, 0, 0.2), (0.95, 0, 1, 5.0))
    assert one(Inside(a=1, b=0), looks_over, scene).margin == pytest.approx(0.025)
    assert one(On(a=1, b=GROUND), ends((0.5, 0, 0.05), (0.9, -1, 1, 2.0)), scene).met


def plan_of(*conditions: Condition, target: int | None = None, active: int = 0, **initial: object) -> Phase:
    return Phase(
        task=TaskSpec(kind="slide", active=active, target=target, conditions=conditions, interpretation=""),
        semantics=(),
        initial=InitialConditions.model_validate(initial),
        simulation=SimulationPlan(duration=1.0),
    )


def test_the_verdict_names_broken_rules(scene: Scene) -> None:
    rollout = rollout_of(scene, {0: along(scene, 0, sideways(0.3))}, [(0.2, 0, 1, 1.0)])
    fine = verify_phase(scene, plan_of(Displaced(a=0, at_least=0.1), impulses=[Impulse(id=0, time=0.0)]), rollout)
    assert fine.met and fine.margin == pytest.approx(2.0) and b'"met": true' in to_json(fine)
    late = plan_of(Displaced(a=0, at_least=0.1), target=1, impulses=[Impulse(id=0, time=0.5)])
    assert not verify_phase(scene, late, rollout).met
    assert [rule.split(" by ")[0] for rule in verify_phase(scene, late, rollout).broken] == [
        "an impulse comes 0.30 s after the active object touched its target",
        "object 0 moves",
    ]
    other = verify_phase(scene, plan_of(Displaced(a=0, at_least=0.1), impulses=[Impulse(id=1, time=0.0)]), rollout)
    assert "object 1 is set off" in other.broken[0]
    elsewhere = rollout_of(scene, {1: along(scene, 1, np.full((31, 3), 0.01))})
    assert "does not start where" in verify_phase(scene, plan_of(Displaced(a=0, at_least=0.1)), elsewhere).broken[0]
