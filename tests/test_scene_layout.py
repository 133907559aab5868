"""Where things are: free ways, tops, pools, what rolls; aims that close in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact.compounds import collide
from f3sr.contact.polytopes import Polytope
from f3sr.goals.cavity import cavity_of
from f3sr.goals.scene_layout import SceneLayout, way_between
from f3sr.launches.launch_context import Aim
from f3sr.scene import GROUND
from goal_scene import BALL, BLOCK, CAN, CARTON, CRATE, LID, goal_scene


@pytest.fixture(scope="module")
def layout() -> SceneLayout:
    return SceneLayout(goal_scene())


def test_the_way_between_squares_is_exact() -> None:
    square = np.array([(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    first, last = way_between(square, np.add(square, (5, 0.5)), np.array([1.0, 0]))
    assert (first, last) == (pytest.approx(3), pytest.approx(7))
    first, last = way_between(square, np.add(square, (5, 3)), np.array([1.0, 0]))
    assert not first < last


def test_what_is_met_first_along_a_way(layout: SceneLayout) -> None:
    assert layout.meets(CARTON, np.array([1.0, 0, 0]))[:1] == []
    toward = layout.center(CAN) - layout.center(CARTON)
    met = layout.meets(CARTON, toward * [1, 1, 0] / np.linalg.norm(toward[:2]))
    assert met[0][1] == CAN and 0.3 < met[0][0] < 0.5
    assert all(id != BLOCK for _, id in layout.meets(LID, np.array([-1.0, 0, 0]))), (
        "what it stands on is not in its way"
    )


def test_tops_look_through_what_is_told(layout: SceneLayout) -> None:
    height, whose = layout.top(0.2, -0.2)
    assert whose == LID and height == pytest.approx(0.09, abs=1e-3)
    assert layout.top(0.2, -0.2, without=LID)[1] == BLOCK and layout.top(0.6, 0.6) == (0.0, GROUND)


def test_what_is_lowered_stops_at_the_first_contact(layout: SceneLayout) -> None:
    """Wherever it is lowered: free of everything there, and in the object that is named just below."""
    rng = np.random.default_rng(5)
    parts = {o.id: [Polytope.of(p).moved(o.T_world_object) for p in o.solids] for o in layout.scene}
    found = set[int]()
    for id in (BALL, CARTON, CRATE):
        for shift in rng.uniform(-0.3, 0.3, (40, 2)):
            z, whose = layout.landing(id, shift)
            lowered = [p.shifted([*shift, z - layout.span(id)[0, 2]]) for p in parts[id]]
            deeper = [p.shifted([0, 0, -1e-5]) for p in lowered]
            assert not any(collide(lowered, parts[o]) for o in parts if o != id)
            assert z == 0 if whose == GROUND else collide(deeper, parts[whose])
            found.add(whose)
    assert found == {GROUND, *range(6)}


def test_a_crate_holds_water_and_a_block_does_not(layout: SceneLayout) -> None:
    pool = layout.pool(CRATE)
    assert pool is not None and np.allclose(pool.center, [0, 0.25], atol=0.01)
    assert pool.level == pytest.approx(0.1, abs=2e-3) and pool.depth == pytest.approx(0.09, abs=2e-3)
    assert pool.radius == pytest.approx(0.14 / np.sqrt(np.pi), rel=0.15)
    assert layout.pool(BLOCK) is None and layout.pool(BALL) is None
    leaking = replace(layout.scene[CRATE], parts=layout.scene[CRATE].parts[:4])
    assert cavity_of(leaking) is None, "a wall is missing"


def test_what_rolls(layout: SceneLayout) -> None:
    assert layout.is_ball(BALL) and not layout.is_ball(CAN) and not layout.is_ball(BLOCK)
    assert not layout.rolls(CAN, np.array([1.0, 0, 0])), "it stands"


def test_an_aim_closes_in_on_its_goal() -> None:
    """A throw that goes twice as far as it is aimed, and a push that jumps from too little to far too much."""
    for moved in (lambda far: 2 * far, lambda far: 0.6 * far if far < 0.31 else 3.0):
        aim = Aim(0.2)
        found = [moved(aim.far)]
        for _ in range(12):
            aim.ended(found[-1])
            found.append(moved(aim.far))
        assert min(abs(f - 0.2) for f in found) < 0.03
