"""Where meshes would meet: known solids over each other, and what is not below."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact.vertical_gap import meeting
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose
from f3sr.scene import GROUND, SceneObject
from scenes import ball_mesh, box, box_mesh, dish_mesh

RADIUS, DISH = 0.05, 0.25


def at(id: int, mesh: Mesh, *place: float) -> SceneObject:
    return replace(box(id), mesh=mesh, T_world_object=pose(t=place))


def test_over_the_ground_it_is_the_lowest_vertex():
    found = meeting(at(0, ball_mesh(RADIUS), 0, 0, 0.06), [])
    assert (found.other, found.gap) == (GROUND, pytest.approx(0.01))
    assert found.below[2] == 0 and found.above[2] == pytest.approx(0.01)


@pytest.mark.parametrize("aside", [0.0, 0.01, 0.03])
def test_a_ball_over_a_dish_meets_it_where_their_heights_differ_least(aside: float):
    dish, ball = at(0, dish_mesh(DISH), 0, 0, 0.1), at(1, ball_mesh(RADIUS), aside, 0, 0.17)
    found = meeting(ball, [dish])
    x = np.linspace(aside - 0.04, aside + 0.04, 100_001)
    low = 0.17 - np.sqrt(RADIUS**2 - (x - aside) ** 2)
    high = 0.1 + DISH - np.sqrt(DISH**2 - x**2)
    assert found.other == 0
    assert found.gap == pytest.approx((low - high).min(), abs=2e-4), "32 sides around"
    assert found.above[2] - found.below[2] == pytest.approx(found.gap, abs=1e-6)


def test_what_lies_on_it_or_beside_it_is_not_below():
    lower, upper = at(0, box(0).mesh, 0, 0, 0.052), at(1, box(1).mesh, 0.02, 0, 0.154)
    beside = at(2, box(2).mesh, 0.3, 0, 0.05)
    assert meeting(lower, [upper, beside]).other == GROUND
    found = meeting(upper, [lower, beside])
    assert (found.other, found.gap) == (0, pytest.approx(0.002, abs=1e-5))


def shelf(*heights: float) -> Mesh:
    """Boards of one mesh, .02 m thick, with their tops at these heights [m]."""
    boards = [box_mesh((0.5, 0.4, 0.02)) for _ in heights]
    vertices = [b.vertices + np.array([0, 0, z - 0.01]) for b, z in zip(boards, heights, strict=True)]
    faces = [b.faces + len(b.vertices) * k for k, b in enumerate(boards)]
    return Mesh(vertices=np.concatenate(vertices), faces=np.concatenate(faces).astype(np.int32))


@pytest.mark.parametrize("mesh", [box_mesh(), ball_mesh(RADIUS)], ids=["box", "ball"])
@pytest.mark.parametrize("board", [0.1, 0.4])
def test_a_board_above_does_not_hide_the_one_below(mesh: Mesh, board: float):
    """A shelf's upper boards hid the one on which a box stood: its gap was that to the ground."""
    found = meeting(at(1, mesh, 0.02, 0.01, board + 0.053), [at(0, shelf(0.1, 0.4, 0.7), 0, 0, 0)])
    assert (found.other, found.gap) == (0, pytest.approx(0.003, abs=1e-4))


def test_each_pose_scale_and_object_of_the_same_meshes_has_its_own_meeting():
    mesh, other = box(0).mesh, box(1).mesh
    lower, upper = at(0, mesh, 0, 0, 0.05), at(1, other, 0.02, 0, 0.16)
    assert meeting(upper, [lower]).gap == pytest.approx(0.01, abs=1e-5)
    assert meeting(at(1, other, 0.02, 0, 0.17), [lower]).gap == pytest.approx(0.02, abs=1e-5)
    assert meeting(upper, [at(0, mesh, 0, 0, 0.045)]).gap == pytest.approx(0.015, abs=1e-5)
    assert meeting(upper, [replace(lower, scale=0.9)]).gap == pytest.approx(0.015, abs=1e-5)
    assert meeting(replace(upper, scale=0.9), [lower]).gap == pytest.approx(0.015, abs=1e-5)
    assert meeting(upper, [at(7, mesh, 0, 0, 0.05)]).other == 7
    assert meeting(upper, [lower]).gap == pytest.approx(0.01, abs=1e-5)
