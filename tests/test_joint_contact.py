"""Bodies brought into contact by one joint move: boxes by hand, laws on seeded heaps, and exits that cost least."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from f3sr.contact import compounds
from f3sr.contact.compounds import Compound
from f3sr.contact.joint_contact import INSIDE, bring_together
from f3sr.contact.least_norm import nearly, shortest
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, pose, rotation_about
from f3sr.physics.contact_margin import DEFAULT_MARGIN

GAP = DEFAULT_MARGIN.clearance
EVEN = np.eye(3)


def block(
    at: tuple[float, float, float], size: tuple[float, float, float] = (0.1, 0.1, 0.1), turn: float = 0
) -> Polytope:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    return Polytope.of(ConvexPart.hull_of(signs * np.array(size))).moved(pose(rotation_about(UP, turn), at))


def bodies_of(*parts: Polytope) -> dict[int, Compound]:
    return {id: Compound.of([p]) for id, p in enumerate(parts)}


def ray_metric(ray: tuple[float, float, float], free: float = 0.01) -> Array:
    """Moves along a viewing ray cost a hundredth of others."""
    u = np.array(ray) / np.linalg.norm(ray)
    return EVEN - (1 - free**2) * np.outer(u, u)


def test_a_body_that_hangs_comes_down_where_only_its_height_is_free():
    found = bring_together(bodies_of(block((0, 0, 0.2))), {0: ray_metric((0, 0, 1))}, standing=[0], reach=0.05)
    assert found.shifts[0] == pytest.approx([0, 0, GAP - 0.15], abs=1e-9)
    assert found.overlap == found.hanging == 0


def test_it_slides_along_its_viewing_ray_instead_of_sinking_in_the_picture():
    found = bring_together(bodies_of(block((0, 0, 0.1))), {0: ray_metric((0, 1, -1))}, standing=[0], reach=0.05)
    x, y, z = found.shifts[0]
    assert z == pytest.approx(GAP - 0.05, abs=1e-9) and x == pytest.approx(0, abs=1e-9)
    assert y == pytest.approx(0.05, rel=0.01) and found.cost < 1e-6


def test_a_stack_comes_down_as_one():
    bodies = bodies_of(block((0, 0, 0.06)), block((0.01, 0, 0.18)))
    found = bring_together(bodies, {0: EVEN, 1: EVEN}, standing=[0, 1], above=[(0, 1)], reach=0.1)
    assert found.shifts[0] == pytest.approx([0, 0, GAP - 0.01], abs=1e-9)
    assert found.shifts[1] == pytest.approx([0, 0, 2 * GAP + 0.1 - 0.13], abs=1e-9)


def test_what_overlaps_leaves_by_the_facet_that_costs_least():
    """The shortest way out is up, but the picture feels heights a hundred times as much."""
    bodies = bodies_of(block((0, 0, 0.05)), block((0.08, 0, 0.145)))
    found = bring_together(bodies, {1: EVEN}, reach=0.05)
    assert found.shifts[1] == pytest.approx([0, 0, 0.005 + GAP], abs=1e-9)
    felt = np.diag([1.0, 1.0, 1e4])
    found = bring_together(bodies, {1: felt}, reach=0.05)
    assert found.shifts[1] == pytest.approx([0.02 + GAP, 0, 0], abs=1e-9)


def test_a_content_leaves_the_wall_of_its_crate_and_stays_on_the_floor():
    floor, wall = block((0, 0, 0.01), (0.4, 0.4, 0.02)), block((0.19, 0, 0.1), (0.02, 0.4, 0.2))
    crate, content = Compound.of([floor, wall]), Compound.of([block((0.14, 0, 0.07 + GAP))])
    found = bring_together({0: crate, 1: content}, {1: EVEN}, standing=[1], above=[(0, 1)], reach=0.05)
    assert found.shifts[1] == pytest.approx([-0.01 - GAP, 0, 0], abs=1e-8)


def heap(seed: int) -> dict[int, Compound]:
    """Blocks at random, some of two parts, over and in each other."""
    rng = np.random.default_rng(seed)
    bodies = dict[int, Compound]()
    for id in range(6):
        at, turn = rng.uniform([-0.12, -0.12, 0.03], [0.12, 0.12, 0.15]), rng.uniform(0, 3)
        parts = [block(tuple(at), tuple(rng.uniform(0.05, 0.12, 3)), turn)]
        if id % 2:
            parts.append(block(tuple(at + np.array([0.03, 0, 0])), tuple(rng.uniform(0.04, 0.08, 3)), turn + 0.5))
        bodies[id] = Compound.of(parts)
    return bodies


@pytest.mark.parametrize("seed", range(8))
def test_heaps_end_free_of_each_other_and_each_on_something(seed: int):
    bodies = heap(seed)
    weights = {id: ray_metric((0.2 * id - 0.5, 1, -1), 0.2) for id in bodies}
    found = bring_together(bodies, weights, standing=list(bodies), reach=1.0)
    assert found.overlap <= INSIDE
    moved = {id: b.moved(pose(t=found.shifts[id])) for id, b in bodies.items()}
    assert not any(compounds.collide(moved[a], moved[b]) for a, b in combinations(moved, 2))
    assert all(b.lowest >= GAP - INSIDE for b in moved.values())
    if found.hanging:
        return
    sides = [2 * GAP * np.array([np.cos(a), np.sin(a), 0]) for a in np.linspace(0, 2 * np.pi, 16)]
    for id, body in moved.items():  # a corner may stand on an edge by no more than the clearance
        others = Compound.of(p for k, b in moved.items() if k != id for p in b)
        below = [compounds.free_travel(body.moved(pose(t=s)), others, -UP) for s in (np.zeros(3), *sides)]
        assert min(*below, body.lowest) < 8 * GAP


@pytest.mark.parametrize("seed", range(8))
def test_most_heaps_stand_and_cost_no_more_than_lifting_everything_apart(seed: int):
    bodies = heap(seed)
    found = bring_together(bodies, dict.fromkeys(bodies, EVEN), reach=1.0)
    top = lifted = 0.0
    for body in bodies.values():  # one above the other, as they come
        rise = max(0.0, top + GAP - body.lowest)
        top, lifted = body.bounds[1, 2] + rise, lifted + rise**2
    assert found.overlap <= INSIDE and found.cost <= lifted


def test_what_is_wanted_elsewhere_ends_there_if_it_can():
    found = bring_together(bodies_of(block((0, 0, 0.2))), {0: EVEN}, wanted={0: np.array([0.3, 0, 0.1])}, reach=0.05)
    assert found.shifts[0] == pytest.approx([0.3, 0, 0.1]) and found.cost < 1e-18


def test_nothing_that_moves_and_what_cannot_be_satisfied_end_without_an_error():
    assert bring_together(bodies_of(block((0, 0, 0.05))), {}, reach=0.05).shifts == {}
    walls = [block((x, 0, 0.05)) for x in (0, -0.08, 0.08)]
    room = bodies_of(*walls, block((0, 0, 0.05), (1, 1, 1)))
    found = bring_together(room, {0: EVEN}, standing=[0], reach=0.2)
    assert np.isfinite(found.shifts[0]).all()


def test_the_shortest_vector_and_the_one_that_nearly_satisfies():
    assert shortest(np.array([[1.0, 0, 2], [0, 1, -1]])) == pytest.approx([2, 0])
    against = np.array([[1.0, 1], [-1, 1]])
    assert shortest(against) is None
    assert nearly(against, 1e6) == pytest.approx([0], abs=1e-9)
    assert nearly(np.array([[1.0, 1]]), 1.0) == pytest.approx([0.5])
