"""Shifts that make bodies stand: one box by hand, laws, and seeded stacks let go before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stacks
from bodies import GAP, block, body
from f3sr.contact import compounds
from f3sr.contact.stability import stability, stands
from f3sr.contact.stabilize import BalanceConfig, balance
from f3sr.contact.static_bodies import StaticBody, bodies_of
from f3sr.core.transforms import UP, pose, rotation_about
from f3sr.physics import release
from f3sr.scene import GROUND


def after(bodies, found):
    return [b.moved(pose(t=found.shifts[b.id])) for b in bodies]


def overhanging(d: float, **more) -> list[StaticBody]:
    """A box whose middle lies d [m] off the middle of a fixed box of .1 m."""
    return [body(0, block(), fixed=True), body(1, block((0.1, 0.1, 0.2), (d, 0, 0.2 + GAP)), **more)]


def test_a_box_beyond_an_edge_comes_back_as_far_as_the_margin_asks() -> None:
    """Its weight, .1 m above the edge, is brought .1 tan(margin) inside it: 8 mm and little more."""
    bodies = overhanging(0.055)
    found = balance(bodies, {0: GROUND, 1: 0}, BalanceConfig(margin=0.03, max_shift=0.5))
    assert found.success and found.after >= 0.029
    inside = 0.1 * np.tan(0.03)
    assert -found.shifts[1][0] == pytest.approx(0.005 + inside, abs=2.5e-3)
    assert not found.shifts[0].any() and abs(found.shifts[1][1]) < 1e-3


def test_what_stands_is_not_moved() -> None:
    found = balance(overhanging(0.03), {0: GROUND, 1: 0})
    assert found.success and found.rounds == 0 and not any(t.any() for t in found.shifts.values())


def test_what_may_not_go_far_enough_is_told() -> None:
    found = balance(overhanging(0.06), {0: GROUND, 1: 0}, max_shifts={1: 0.005})
    assert not found.success and found.unbalanced == {1}
    assert np.linalg.norm(found.shifts[1][:2]) <= 0.005 * 1.09


def test_the_one_that_the_picture_holds_less_moves() -> None:
    """Both free: either the upper box comes back or the lower one goes under it."""
    lower, upper = body(0, block((0.3, 0.1, 0.1))), body(1, block((0.1, 0.1, 0.2), (0.155, 0, 0.2 + GAP)))
    for held, moves in ((1, 0), (0, 1)):
        weights = {held: 1e4 * np.eye(2), moves: np.eye(2)}
        found = balance([lower, upper], {0: GROUND, 1: 0}, weights=weights)
        assert found.success
        assert np.linalg.norm(found.shifts[moves][:2]) > 0.004 > 1e-4 > np.linalg.norm(found.shifts[held][:2])


def test_a_plank_that_lost_a_pier_moves_onto_the_other() -> None:
    pier, plank = body(0, block()), body(1, block((0.2, 0.08, 0.02), (0.06, 0, 0.11 + GAP)))
    found = balance([pier, plank], {0: GROUND, 1: 0})
    assert found.success and found.shifts[1][0] - found.shifts[0][0] == pytest.approx(-0.01, abs=4e-3)


def test_bodies_are_not_pushed_into_their_neighbours() -> None:
    """The way back is blocked on one side by a wall .1 mm away, so it moves along the wall."""
    shelf = body(0, block((0.1, 0.4, 0.1)), fixed=True)
    wall = body(2, block((0.1, 1, 0.4), (-0.0501 + 0.06 - 0.05, 0, 0.4)), fixed=True)
    thing = body(1, block((0.1, 0.1, 0.2), (0.06, 0, 0.2 + GAP)))
    found = balance([shelf, thing, wall], {0: GROUND, 1: 0, 2: GROUND})
    moved = after([shelf, thing, wall], found)
    assert not compounds.collide(moved[1].parts, moved[2].parts)
    assert not found.success and found.unbalanced == {1}


def test_a_body_that_hangs_over_its_support_is_lowered_onto_it() -> None:
    found = balance(overhanging(0.0), {0: GROUND, 1: 0})
    raised = overhanging(0.0)
    raised[1] = raised[1].moved(pose(t=0.01 * UP))
    again = balance(raised, {0: GROUND, 1: 0})
    assert again.success and again.shifts[1][2] == pytest.approx(found.shifts[1][2] - 0.01, abs=1e-6)


def test_a_turn_of_the_world_turns_the_shifts() -> None:
    T = pose(rotation_about(UP, np.pi / 2), [1, 2, 0])
    bodies = overhanging(0.055)
    once = balance(bodies, {0: GROUND, 1: 0})
    again = balance([b.moved(T) for b in bodies], {0: GROUND, 1: 0})
    assert np.allclose(again.shifts[1], T[:3, :3] @ once.shifts[1], atol=1e-3)


def test_a_weight_must_be_positive_definite() -> None:
    with pytest.raises(ValueError, match="positive definite"):
        balance(overhanging(0.055), {0: GROUND, 1: 0}, weights={1: np.diag([1.0, 0.0])})


@pytest.mark.parametrize("seed", [0, 3, 8, 10])
def test_stacks_that_fell_rest_after_their_shifts(seed: int) -> None:
    objects = stacks.stack(seed)
    bodies = bodies_of(objects)
    found = balance(bodies, {o.id: o.supported_by for o in objects})
    assert not stability(bodies).stands and found.success
    assert stands(after(bodies, found))
    shifted = [replace(o, T_world_object=pose(t=found.shifts[o.id]) @ o.T_world_object) for o in objects]
    assert release.release(objects, seconds=1.5).D_max > 0.05
    assert release.release(shifted, seconds=1.5).D_max < 2e-3
