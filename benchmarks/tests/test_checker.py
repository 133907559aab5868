"""Laws of the goal suite's checker, on films made by hand where each check passes and fails, and of its data files."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import checker
import gaps
import numpy as np
import paths
import pytest
import seen
from scipy.spatial.transform import Rotation

GOALS = Path(__file__).parents[1] / "goals"
DATA = Path(__file__).parents[3] / "shared" / "data"
EXAMPLE = Path(__file__).parents[2] / "src" / "f3sr" / "example" / "tabletop"

A, B, WALL = 1, 2, 3
"""A cube of 10 cm at x = 0, an open tray of 30 cm at x = .5, a box of 20 cm at x = -.5, all on the table."""
ORIGIN = np.array([0.3, -0.2, 0])
"""Where the films' zero is in the world: nothing happens to be at its origin."""
COM = np.array([0.01, -0.02, 0.005])
"""Where centres of mass, about which all is said here, are in the frames of the bodies."""
TIME = np.arange(61) / 30
Path_ = Callable[[float], tuple[Any, Any]]
"""Where a body's centre is at a time, and its rotation vector [deg]."""


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
    return corners * size + at


def placed(at: Any, turned: Any = (0, 0, 0)) -> np.ndarray:
    """The pose of a body whose centre is there."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.radians(np.asarray(turned, float))).as_matrix()
    T[:3, 3] = ORIGIN + at - T[:3, :3] @ COM
    return T


TRAY = [box((0.3, 0.3, 0.01)), *(box((0.01, 0.3, 0.06), (s * 0.145, 0, 0.035)) for s in (-1, 1))]
TRAY += [box((0.3, 0.01, 0.06), (0, s * 0.145, 0.035)) for s in (-1, 1)]
PLACES = {A: (0, 0, 0.05), B: (0.5, 0, 0.005), WALL: (-0.5, 0, 0.1)}
PARTS = {A: [box((0.1, 0.1, 0.1))], B: TRAY, WALL: [box((0.1, 0.2, 0.2))]}
DOWN = np.array([[1, 0, 0], [0, -0.5, np.sqrt(0.75)], [0, -np.sqrt(0.75), -0.5]])
"""The camera looks along +y and down by 30 deg; its right is +x."""


def filmed(contacts: tuple[tuple[float, int, int, float], ...] = (), **moving: Path_) -> Any:
    """A film in which bodies a, b and wall stand still but where a path is given."""
    T = {}
    for id, name in ((A, "a"), (B, "b"), (WALL, "wall")):
        path = moving.get(name, lambda t, id=id: (PLACES[id], (0, 0, 0)))
        T[id] = np.array([placed(*path(t)) for t in TIME])
    bodies = {
        id: seen.Body(id=id, label="", parts=[p + COM for p in PARTS[id]], com=COM, T=placed(PLACES[id]))
        for id in (A, B, WALL)
    }
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = DOWN, ORIGIN + np.array([0, -1.5, 0.9])
    K = np.array([[800.0, 0, 512], [0, 800, 384], [0, 0, 1]])
    view = {"K": K, "T_world_camera": camera, "size": (1024, 768)}
    return seen.Film(bodies=bodies, **view, time=TIME, T=T, contacts=list(contacts))


def slid(x: float, y: float = 0, z: float = 0.05, speed: float = 0.5) -> Path_:
    """In a straight line from the origin to a point, then still."""
    way = np.array([x, y, z]) - PLACES[A]
    length = max(float(np.linalg.norm(way)), 1e-9)
    return lambda t: (PLACES[A] + way * min(1, speed * t / length), (0, 0, 0))


def tipped(degrees: float, axis: tuple[float, float, float] = (0, 1, 0)) -> Path_:
    return lambda t: (PLACES[A], np.array(axis) * min(degrees, 120 * t))


def fallen(at: tuple[float, float], low: float, *, height: float = 0.3) -> Path_:
    """From a height over a point down to a resting height."""
    return lambda t: ((*at, max(low, height - 4.9 * t * t)), (0, 0, 0))


def thrown(vx: float, vz: float, until: float = 9.0) -> Path_:
    """A parabola from the origin; it stops dead at the table or at a time."""

    def at(t: float) -> tuple[Any, Any]:
        s = min(t, until, 2 * vz / 9.81)
        return (vx * s, 0, 0.05 + vz * s - 4.905 * s * s), (0, 0, 0)

    return at


def bounced(t: float) -> tuple[Any, Any]:
    """Up, down, up again by less, on to the right."""
    fall = abs(np.sin(4 * t)) * (0.2 if t < np.pi / 4 else 0.05)
    return (0.3 * t, 0, 0.05 + fall), (0, 0, 0)


def verdict(film: Any, **check: Any) -> Any:
    return checker.check(film, check, {})


# --- each check passes and fails -------------------------------------------------------------------------------------

LEFT_10 = {"is": "moves", "id": A, "direction": "left", "at_least": 0.07, "at_most": 0.14}
INTO_WALL = {"is": "touches", "a": A, "b": WALL}
CASES: list[tuple[Mapping[str, Any], Path_, Path_]] = [
    (LEFT_10, slid(-0.1), slid(0.1)),
    (LEFT_10, slid(-0.13, 0.02), slid(-0.2)),
    (LEFT_10, slid(-0.08), slid(-0.05)),
    (LEFT_10, slid(-0.1, 0.04), slid(-0.1, 0.09)),
    ({**LEFT_10, "direction": "away"}, slid(0, 0.1), slid(0, -0.1)),
    ({**LEFT_10, "direction": "towards"}, slid(0, -0.1), slid(0, 0.1)),
    ({"is": "moves", "id": A, "towards": B, "at_least": 0.05}, slid(0.1), slid(-0.1)),
    ({"is": "stays", "id": A, "at_most": 0.02}, slid(0.01), slid(0.03)),
    ({"is": "falls", "id": A, "at_least": 0.1}, fallen((0, 0), 0.05), fallen((0, 0), 0.25)),
    ({"is": "rises", "id": A, "at_least": 0.1}, thrown(0, 2.0), thrown(0, 1.0)),
    ({"is": "returns", "id": A, "within": 0.1}, thrown(0.1, 2.0), thrown(1.0, 2.0)),
    ({"is": "returns", "id": A, "within": 0.1}, thrown(0.1, 1.5), slid(0.05)),
    ({"is": "rests", "id": A}, slid(0.3), slid(3.0)),
    ({"is": "topples", "id": A}, tipped(90), tipped(40)),
    ({"is": "topples", "id": A, "direction": "right"}, tipped(90), tipped(90, (0, -1, 0))),
    ({"is": "topples", "id": A, "direction": "away"}, tipped(90, (-1, 0, 0)), tipped(90, (1, 0, 0))),
    ({"is": "topples", "id": A, "towards": WALL}, tipped(90, (0, -1, 0)), tipped(90)),
    ({"is": "upright", "id": A}, tipped(20), tipped(90)),
    ({"is": "rolls", "id": A, "degrees": 90}, lambda t: ((0.1 * t, 0, 0.05), (0, 100 * t, 0)), slid(0.3)),
    (
        {"is": "rolls", "id": A, "degrees": 90},
        lambda t: ((0, 0.1 * t, 0.05), (-100 * t, 0, 0)),
        lambda t: ((0, 0.1 * t, 0.05), (100 * t, 0, 0)),
    ),
    ({"is": "bounces", "id": A}, bounced, fallen((0, 0), 0.05)),
    (INTO_WALL, slid(-0.4), slid(-0.36)),
    ({"is": "touches", "a": A, "b": B}, slid(0.3), slid(0.3, 0.3)),
    ({"is": "touches", "a": A, "b": -1}, fallen((0, 0), 0.05), fallen((0, 0), 0.15)),
    ({"is": "lands_on", "a": A, "b": B}, fallen((0.5, 0), 0.06), slid(0.3)),
    ({"is": "ends_on", "a": A, "b": B}, fallen((0.5, 0), 0.06), fallen((0.3, 0), 0.05)),
    ({"is": "ends_in", "a": A, "b": B}, fallen((0.52, 0), 0.06), fallen((0.52, 0), 0.125)),
    ({"is": "ends_off", "a": A, "b": B}, slid(0.1), fallen((0.5, 0), 0.06)),
    ({"is": "passes_over", "a": A, "b": B}, thrown(1.3, 3.5), thrown(0.9, 2.0)),
    ({"is": "flies", "id": A}, thrown(0.3, 1.5), slid(0.3)),
]


@pytest.mark.parametrize(("check", "good", "bad"), CASES, ids=[c[0]["is"] for c in CASES])
def test_a_check_passes_and_fails(check: Mapping[str, Any], good: Path_, bad: Path_) -> None:
    passes, fails = verdict(filmed(a=good), **check), verdict(filmed(a=bad), **check)
    assert passes.met, passes.line
    assert not fails.met, fails.line


def hovering(at: tuple[float, float, float], *, since: float = 0.1) -> Path_:
    """At the origin at first, then there."""
    return lambda t: (at if t >= since else PLACES[A], (0, 0, 0))


def there_and_back(t: float) -> tuple[Any, Any]:
    return (0.15 * np.sin(np.pi * t / 2), 0, 0.05), (0, 0, 0)


HELD_UP: dict[str, Path_] = {
    "a": lambda t: ((0.5, 0, 0.26), (0, 0, 0)),
    "b": lambda t: ((0.5, 0, 0.205), (0, 0, 0)),
}
"""The cube in the tray, both 20 cm above the table."""


@pytest.mark.parametrize(
    ("check", "paths", "met"),
    [
        ({"is": "ends_on", "a": A, "b": B}, HELD_UP, True),
        ({"is": "ends_on", "a": B, "b": A}, HELD_UP, False),  # it carries the other
        ({"is": "ends_on", "a": A, "b": B}, {"a": hovering((0.5, 0, 0.08))}, False),  # it does not touch
        ({"is": "ends_on", "a": A, "b": B}, {"a": hovering((0.69, 0, 0.12))}, False),  # its middle is beyond the rim
        ({"is": "ends_on", "a": A, "b": B}, {"a": hovering((0.5, 0, 0.05))}, False),  # it stands on the ground
        ({"is": "ends_in", "a": A, "b": B}, {"a": hovering((0.5, 0, 0.105))}, True),  # low enough, its middle is not
        ({"is": "ends_in", "a": A, "b": B}, {"a": hovering((0.66, 0, 0.105))}, False),
        ({"is": "ends_in", "a": A, "b": B}, {"a": hovering((0.5, 0, 0.05))}, False),
        ({"is": "ends_off", "a": A, "b": B}, {"a": hovering((0.5, 0, 0.2))}, True),  # above it, far from it
        ({"is": "ends_off", "a": A, "b": B}, {"a": hovering((0.7, 0, 0.05))}, True),  # beside it, touching it
        ({"is": "lands_on", "a": A, "b": B}, {"a": fallen((0.69, 0), 0.12)}, False),  # on its rim, the middle beyond
        ({"is": "lands_on", "a": A, "b": WALL}, {"a": fallen((-0.5, 0), 0.25, height=0.5)}, True),
        (
            {"is": "lands_on", "a": A, "b": B},
            {
                "a": lambda t: ((0.5, 0, 0.08 + 0.1 * t), (0, 0, 0)),
                "b": lambda t: ((0.5, 0, 0.005 + 0.2 * t), (0, 0, 0)),
            },
            False,  # it rises, the tray catches up
        ),
        ({"is": "passes_over", "a": A, "b": B}, {"a": thrown(0.9, 2.5, until=0.45)}, False),  # it stays over this side
        ({"is": "passes_over", "a": A, "b": WALL}, {"a": thrown(-1.3, 4.0)}, True),
        (
            {"is": "passes_over", "a": A, "b": B},  # by way of its floor
            {"a": lambda t: ((1.5 * t, 0, 0.06 + 1.2 * abs(t - 1 / 3)), (0, 0, 0))},
            False,
        ),
        ({"is": "moves", "id": A, "at_least": 0.1, "at_most": 0.2}, {"a": there_and_back}, False),
        ({"is": "moves", "id": A, "at_least": 0.1, "when": "ever"}, {"a": there_and_back}, True),
        ({"is": "bounces", "id": A}, {"a": thrown(0.3, 2.0)}, False),
        (
            {"is": "bounces", "id": A},
            {"a": lambda t: ((0, 0, 0.1 - 0.05 * min(t, 1) + 0.002 * (t > 1)), (0, 0, 0))},
            False,
        ),
        ({"is": "bounces", "id": A}, {"a": lambda t: ((0, 0, 0.1 + 0.004 * np.sin(9 * t)), (0, 0, 0))}, False),
        ({"is": "topples", "id": A}, {"a": lambda t: (PLACES[A], (0, 180 * t, 0))}, False),  # over, and up again
    ],
)
def test_what_only_looks_like_it_is_told_apart(check: Mapping[str, Any], paths: dict[str, Path_], met: bool) -> None:
    found = verdict(filmed(**paths), **check)
    assert found.met == met, found.line


@pytest.mark.parametrize(
    ("check", "path", "time"),
    [
        ({**LEFT_10, "at_most": 1.0}, slid(-0.5), 2.0),
        ({"is": "moves", "id": A, "direction": "left", "at_least": 0.07}, slid(-0.5), 0.14),
        ({"is": "falls", "id": A, "at_least": 0.1}, fallen((0, 0), 0.05), 0.143),
        ({"is": "rises", "id": A, "at_least": 0.1}, thrown(0, 2.0), 0.059),
        ({"is": "returns", "id": A, "within": 0.1}, thrown(0.1, 2.0), 0.395),
        ({"is": "topples", "id": A}, tipped(90), 0.5),
        ({"is": "rolls", "id": A, "degrees": 90}, lambda t: ((0.1 * t, 0, 0.05), (0, 100 * t, 0)), 0.9),
        ({"is": "bounces", "id": A}, bounced, np.pi / 4),
        ({"is": "touches", "a": A, "b": WALL}, slid(-0.9, speed=9.0), 0.4 / 9),
        ({"is": "lands_on", "a": A, "b": B}, fallen((0.5, 0), 0.06), 0.2213),
        ({"is": "ends_off", "a": A, "b": B}, lambda t: ((0.5 + 0.3 * t, 0, 0.3), (0, 0, 0)), 0.5),
        ({"is": "passes_over", "a": A, "b": B}, thrown(1.3, 3.5), 0.357),
        ({"is": "flies", "id": A}, thrown(0.3, 1.5), 1 / 30),
    ],
)
def test_the_event_is_when_it_happens(check: Mapping[str, Any], path: Path_, time: float) -> None:
    found = verdict(filmed(a=path), **check)
    assert found.met and found.time == pytest.approx(time, abs=1 / 30), found.line


def test_a_flight_of_one_sample_before_the_touch_counts() -> None:
    film = filmed(a=thrown(-8, 1.0, until=0.05))
    hit = verdict(film, **INTO_WALL)
    assert hit.met and hit.time == pytest.approx(0.05, abs=0.02)
    assert checker.check(film, {"is": "flies", "id": A}, {"touches": hit}).met


def test_what_is_measured_is_told() -> None:
    over = verdict(filmed(a=thrown(1.3, 3.5)), **{"is": "passes_over", "a": A, "b": B})
    assert over.measured.startswith(("553 mm", "554 mm")) and "428 mm beyond" in over.measured
    inside = verdict(filmed(a=fallen((0.52, 0), 0.06)), **{"is": "ends_in", "a": A, "b": B})
    assert inside.measured == "middle 10 mm inside its hull, lowest point 60 mm under its rim"


def test_what_is_after_a_touch_is_counted_from_it() -> None:
    """The box moves by 30 mm of itself, is hit at .8 s, and moves 30 mm more."""
    wall = lambda t: ((-0.5 - 0.03 * min(t, 0.5) / 0.5 - 0.03 * max(0, min(1, t - 0.9)), 0, 0.1), (0, 0, 0))  # noqa: E731
    film = filmed(a=slid(-0.43, speed=0.5376), wall=wall)
    hit = verdict(film, **INTO_WALL)
    assert hit.met and hit.time == pytest.approx(0.8, abs=0.04)
    moved = {"is": "moves", "id": WALL, "at_least": 0.02, "after": "touches"}
    assert checker.check(film, moved, {"touches": hit}).time > 1.4
    assert not checker.check(film, {**moved, "at_least": 0.04}, {"touches": hit}).met
    assert verdict(film, **{"is": "moves", "id": WALL, "at_least": 0.04}).met


def test_a_flight_is_before_the_touch() -> None:
    """It slides into the box and is thrown back from there."""
    film = filmed(
        a=lambda t: ((-0.5 * t if t < 0.8 else t - 1.2, 0, 0.05 if t < 0.8 else 0.05 + 0.2 * (t - 0.8)), (0, 0, 0))
    )
    hit = verdict(film, **INTO_WALL)
    assert hit.met and verdict(film, **{"is": "flies", "id": A}).met
    assert not checker.check(film, {"is": "flies", "id": A}, {"touches": hit}).met


def test_every_check_has_a_case() -> None:
    assert {c[0]["is"] for c in CASES} == set(checker.CHECKS)


# --- touching between samples ----------------------------------------------------------------------------------------


def turned_back(x: float, speed: float, hit: float) -> Path_:
    """Towards the wall, as far as x at the time of the hit, and back."""
    return lambda t: ((x + speed * abs(t - hit), 0, 0.05), (0, 0, 0))


@pytest.mark.parametrize("speed", [1.0, 3.0, 6.0])
def test_a_hit_between_samples_is_one_where_paths_meet_and_a_contact_was_recorded(speed: float) -> None:
    hit, away = 0.4123, -0.4 + speed / 10  # a time between two samples; three samples' way before the wall
    row = ((hit, A, WALL, 1.0),)
    hits = verdict(filmed(row, a=turned_back(-0.4, speed, hit)), **INTO_WALL)
    assert hits.met and hits.time == pytest.approx(hit, abs=1 / 30)
    assert not verdict(filmed(a=turned_back(-0.4, speed, hit)), **INTO_WALL).met, "nothing says that it did not turn"
    assert not verdict(filmed(row, a=turned_back(away, speed, hit)), **INTO_WALL).met, "recorded, but it was far"


@pytest.mark.parametrize("speed", [1.0, 3.0, 6.0])
def test_unhit_paths_tell_when_they_met(speed: float) -> None:
    """Within an interval; a contact at another time says nothing of this one."""
    hit = 0.4123
    then, later = (filmed(((t, A, WALL, 1.0),), a=turned_back(-0.4, speed, hit)) for t in (hit, 1.9))
    time, gap = paths.touch(then, A, WALL)
    assert time == pytest.approx(hit, abs=1 / 30) and gap <= paths.TOUCH
    assert paths.touch(later, A, WALL)[0] is None
    assert paths.touch(filmed(a=turned_back(-0.4, speed, hit)), A, WALL)[0] is None


def test_a_path_goes_on_in_its_parabola_and_turns_on_until_something_hits_it() -> None:
    flight = lambda t: ((0.5 * t, -t, 0.05 + 4 * t - 4.905 * t * t), (40 * t, 0, 0))  # noqa: E731
    film = filmed(a=flight)
    for i, j, h, s, t in ((9, 10, 8, 0.4, 10.4), (12, 11, 13, 0.3, 10.7)):
        assert paths.gone_on(film, A, i, j, h, s) == pytest.approx(placed(*flight(t / 30)), abs=1e-9)
    struck = filmed(a=turned_back(-0.4, 1.0, 0.31))
    assert paths.gone_on(struck, A, 9, 10, 8, 0.5) is None, "it was hit between 9 and 10"
    assert paths.gone_on(film, A, 0, 1, -1, 0.5) is None and paths.gone_on(film, A, 60, 59, 61, 0.5) is None


def test_a_hit_right_at_the_start_is_believed_where_it_is_within_reach() -> None:
    row = ((0.012, A, WALL, 1.0),)
    near = verdict(filmed(row, a=lambda t: ((-0.4 + 2 * abs(t - 0.012), 0, 0.05), (0, 0, 0))), **INTO_WALL)
    assert near.met and near.time <= 1 / 30
    far = verdict(filmed(row, a=lambda t: ((-0.1 + 2 * abs(t - 0.012), 0, 0.05), (0, 0, 0))), **INTO_WALL)
    assert not far.met


def test_what_a_third_body_stopped_touches_only_that() -> None:
    """A cube falls onto the tray's floor: on its unhit path it would have reached the ground too."""
    film = filmed(((0.22, A, B, 1.0),), a=fallen((0.5, 0), 0.06))
    assert verdict(film, **{"is": "touches", "a": A, "b": B}).met
    assert not verdict(film, **{"is": "touches", "a": A, "b": -1}).met


def test_what_flies_past_or_stops_short_does_not_touch() -> None:
    def braked(t: float) -> tuple[Any, Any]:
        s = 1 - min(t, 0.4) / 0.4  # friction, 5 m/s2, brings it to rest 4 mm before the wall
        return (-0.396 * (1 - s * s), 0, 0.05), (0, 0, 0)

    past = verdict(filmed(a=lambda t: ((-2 * t, 0.16, 0.05), (0, 0, 0))), **INTO_WALL)
    over = verdict(filmed(a=lambda t: ((-2 * t, 0, 0.05 + 3 * t - 4.905 * t * t), (0, 0, 0))), **INTO_WALL)
    assert [verdict(filmed(a=braked), **INTO_WALL).met, past.met, over.met] == [False, False, False]


def test_what_touches_at_the_start_must_part_first() -> None:
    still = verdict(filmed(), **{"is": "touches", "a": A, "b": -1})
    hopped = verdict(filmed(a=thrown(0, 1.5)), **{"is": "touches", "a": A, "b": -1})
    assert not still.met and hopped.met and hopped.time == pytest.approx(3 / 9.81, abs=1 / 30)


def test_gaps_of_hulls_are_those_of_boxes_and_balls() -> None:
    rng = np.random.default_rng(6)
    for _ in range(20):
        centre = rng.uniform(0.2, 0.6, 3)
        assert gaps.hull_gap(box((0.1, 0.1, 0.1)), box((0.1, 0.1, 0.1), tuple(centre))) == pytest.approx(
            np.linalg.norm(np.maximum(0, centre - 0.1)), abs=1e-6
        )
    ball = rng.normal(size=(400, 3))
    ball /= 10 * np.linalg.norm(ball, axis=1)[:, None]
    assert gaps.hull_gap(ball, ball + np.array([0.25, 0, 0])) == pytest.approx(0.05, abs=4e-3)
    assert gaps.hull_gap(ball, ball + np.array([0.15, 0, 0])) == 0


# --- what every film must hold ---------------------------------------------------------------------------------------

TOPPLE: dict[str, Any] = {"active": A, "checks": [{"is": "topples", "id": A}]}


def judged(goal: Mapping[str, Any], film: Any) -> dict[str, bool]:
    return {f.check: f.met for f in checker.judge_film(goal, film)}


def test_a_good_film_meets_all_that_is_checked() -> None:
    assert all(judged(TOPPLE, filmed(a=tipped(90))).values()) is False, "it turns about its middle, into the ground"
    rolled = lambda t: ((0, 0, 0.0722), (0, min(90, 120 * t), 0))  # noqa: E731
    lifted = {**TOPPLE, "lifted": True, "lift": [0.02, 0.03]}
    assert all(judged(lifted, filmed(a=rolled)).values())


def test_another_that_moves_first_is_found() -> None:
    early = filmed(
        a=lambda t: (PLACES[A], (0, max(0, 90 * (t - 1)), 0)), b=lambda t: ((0.5, 0.2 * t, 0.005), (0, 0, 0))
    )
    late = filmed(a=tipped(90), b=lambda t: ((0.5, 0.2 * max(0, t - 1), 0.005), (0, 0, 0)))
    assert not judged(TOPPLE, early)["goes first"] and judged(TOPPLE, late)["goes first"]
    assert not judged(TOPPLE, filmed())["goes first"], "the active one never moves"


def test_only_a_lifted_active_one_may_start_elsewhere() -> None:
    drop = {"active": A, "checks": [{"is": "falls", "id": A, "at_least": 0.1}]}
    high = filmed(a=fallen((0.5, 0), 0.06))
    assert judged({**drop, "lifted": True}, high)["starts as the scene"]
    assert not judged(drop, high)["starts as the scene"]
    assert not judged({**drop, "lifted": True, "lift": [0.3, 0.4]}, high)["starts as the scene"]
    inside = filmed(a=fallen((0.5, 0), 0.02, height=0.051))
    assert not judged({**drop, "lifted": True}, inside)["starts as the scene"], "it starts in the tray's floor"
    assert not judged({**drop, "lifted": True}, filmed(wall=lambda t: ((-0.5, 0, 0.2), (0, 0, 0))))[
        "starts as the scene"
    ]


def test_half_of_it_must_be_in_the_picture_at_the_event() -> None:
    goal = {"active": A, "checks": [{"is": "moves", "id": A, "at_least": 1.9}]}
    assert judged(goal, filmed(a=slid(0, 2, speed=2)))["in frame"]
    assert not judged(goal, filmed(a=slid(2, 0, speed=2)))["in frame"]
    assert not judged(goal, filmed(a=slid(0, -2, speed=2)))["in frame"], "behind the camera"


def test_what_sinks_is_found() -> None:
    dip = lambda t: ((0, 0, 0.04 if 0.4 < t < 0.5 else 0.05), (0, 0, 0))  # noqa: E731
    assert judged(TOPPLE, filmed(a=dip))["stays above"], "as deep as a hit on soft contacts"
    assert not judged(TOPPLE, filmed(a=slid(0, 0, 0.04)))["stays above"]


def test_after_and_before_bind_checks_together() -> None:
    pushed = lambda t: ((-0.5 - max(0, 0.3 * (t - 1)), 0, 0.1), (0, 0, 0))  # noqa: E731
    goal = {"active": A, "checks": [INTO_WALL, {"is": "moves", "id": WALL, "at_least": 0.1, "after": "touches"}]}
    assert judged(goal, filmed(a=slid(-0.4), wall=pushed))["moves"]
    assert not judged(goal, filmed(a=slid(-0.3), wall=pushed))["moves"], "never touched"
    bounce = {"active": A, "checks": [INTO_WALL, {"is": "bounces", "id": A, "before": "touches"}]}
    assert not judged(bounce, filmed(a=slid(-0.4)))["bounces"]


# --- files -----------------------------------------------------------------------------------------------------------


def written(folder: Path, film: Any, *, spoil: Callable[[dict[str, Any]], None] = lambda arrays: None) -> Path:
    """A package and a rollout as the product writes them."""
    objects = []
    for id, body in film.bodies.items():
        names = [f"collision/{id:02d}/{k:02d}.obj" for k in range(len(body.parts))]
        for name, part in zip(names, body.parts, strict=True):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            corners = "\n".join("v {} {} {}".format(*v) for v in part)
            (folder / name).write_text(f"{corners}\nf 1 2 3\n")
        place = {"T_world_object": body.T.tolist(), "center_of_mass": COM.tolist(), "collision": names}
        objects.append({"id": id, "label": "thing", **place})
    camera = {"width": 1024, "height": 768, "K": film.K.tolist(), "T_world_camera": film.T_world_camera.tolist()}
    (folder / "scene.json").write_text(json.dumps({"camera": camera, "objects": objects}))
    rows = np.array([(0.1, -1, A, 2.0)], [("time", "f8"), ("a", "i8"), ("b", "i8"), ("force", "f8")])
    T = np.stack(list(film.T.values()), axis=1)
    arrays = {"time": film.time, "ids": np.array(list(film.T)), "T_world_object": T, "contacts": rows}
    spoil(arrays)
    np.savez(folder / "rollout.npz", **arrays)
    return folder / "rollout.npz"


def test_files_give_the_same_verdict(tmp_path: Path) -> None:
    goal = {"active": A, "checks": [LEFT_10]}
    file = written(tmp_path, filmed(a=slid(-0.1)))
    found = checker.judge(goal, tmp_path, file)
    assert all(f.met for f in found), [f.line for f in found]
    assert len(seen.read(tmp_path, file).bodies[B].points) == 40


@pytest.mark.parametrize(
    "spoil",
    [
        lambda a: a.update(time=a["time"][::-1]),
        lambda a: a.update(ids=a["ids"][::-1]),
        lambda a: a["T_world_object"].__setitem__((3, 0, 0, 3), np.nan),
        lambda a: a["T_world_object"].__setitem__((3, 0, 0, 0), 1.1),
        lambda a: a.pop("contacts"),
        lambda a: a.update(time=a["time"] + 0.1),
        lambda a: a.update(time=a["time"][:-1]),
        lambda a: a.update(time=a["time"][:1], T_world_object=a["T_world_object"][:1]),
    ],
)
def test_a_rollout_that_is_not_whole_is_missed(tmp_path: Path, spoil: Callable[[dict[str, Any]], None]) -> None:
    file = written(tmp_path, filmed(a=slid(-0.1)), spoil=spoil)
    found = checker.judge({"active": A, "checks": [LEFT_10]}, tmp_path, file)
    assert [f.met for f in found] == [False]


# --- the suite's data ------------------------------------------------------------------------------------------------


def goals(name: str) -> list[dict[str, Any]]:
    return tomllib.loads((GOALS / name).read_text())["goal"]


SUITE, PARAPHRASES, REFUSALS = goals("suite.toml"), goals("paraphrases.toml"), goals("refusals.toml")


def ids_of(scene: str) -> set[int]:
    folder = next((f for f in (DATA / "scenes" / scene, DATA / "real" / scene) if f.is_dir()), None)
    folder = EXAMPLE if scene == "tabletop" else folder
    if folder is None:
        pytest.skip(f"no data for {scene} in {DATA}")
    return {int(mask.stem.split("_")[0]) for mask in (folder / "masks").glob("*.png")}


def test_the_suite_covers_every_scene_and_sort_of_goal() -> None:
    assert len(SUITE) >= 44
    assert len({g["scene"] for g in SUITE}) == 13
    kinds = {"topple", "move", "contact", "roll", "return", "drop", "throw", "bounce", "tip and roll", "hit"}
    assert {g["kind"] for g in SUITE} == kinds


def test_no_goal_is_there_twice() -> None:
    assert len({g["name"] for g in SUITE}) == len(SUITE)
    assert len({(g["scene"], g["words"].lower()) for g in SUITE}) == len(SUITE)


def test_every_goal_has_a_checklist_of_known_checks_and_a_witness_with_a_number() -> None:
    for g in SUITE:
        assert g["checks"] and all(c["is"] in checker.CHECKS for c in g["checks"]), g["name"]
        assert any(ch.isdigit() for ch in g["witness"]), g["name"]
        assert set(g) <= {"name", "scene", "words", "kind", "active", "target", "lifted", "lift", "checks", "witness"}


def test_every_check_can_be_measured_on_any_film_of_its_scene() -> None:
    """No check has a word that nothing reads: what a check needs is there, and what is there is read."""
    known = {"is", "id", "a", "b", "direction", "towards", "at_least", "at_most", "angle", "degrees", "within"}
    for check in (c for g in SUITE for c in g["checks"]):
        assert set(check) <= known | {"after", "before", "when"}, check
        of_film = {k: {"id": A, "a": A, "b": B, "towards": B}.get(k, v) for k, v in check.items()}
        assert isinstance(verdict(filmed(a=slid(0.1)), **of_film).met, bool), check


def test_ids_are_in_the_scenes() -> None:
    for g in SUITE:
        used = {c[k] for c in g["checks"] for k in ("id", "a", "b", "towards") if k in c} - {-1}
        assert used | {g["active"], g.get("target", g["active"])} <= ids_of(g["scene"]), g["name"]
    for g in PARAPHRASES:
        assert {g["active"], g.get("target", g["active"])} <= ids_of(g["scene"])
    assert all(ids_of(g["scene"]) for g in REFUSALS)


def test_there_are_thirty_of_each() -> None:
    words = [w for g in PARAPHRASES for w in g["wordings"]]
    assert len(words) == len(set(words)) == len(REFUSALS) == 30
    assert max(len(g["words"] * g.get("times", 1)) for g in REFUSALS) >= 10_000
    assert all(g["mentions"] for g in REFUSALS)


def test_words_name_nothing_internal() -> None:
    inner = ("id ", "object_", "kind", "impulse", "velocity", "push_into", "lift_and", "_", "m/s")
    for words in (*(g["words"] for g in SUITE), *(w for g in PARAPHRASES for w in g["wordings"])):
        assert not any(word in words.lower() for word in inner), words
