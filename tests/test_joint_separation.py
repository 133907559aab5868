"""The joint move apart: rows of boxes by hand, laws on seeded heaps, and never longer than one pair after the other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from f3sr.contact import compounds
from f3sr.contact.joint_separation import part
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, pose, rotation_about
from f3sr.physics.contact_margin import DEFAULT_MARGIN

EVEN = np.eye(2)
GAP = DEFAULT_MARGIN.clearance


def block(x=0.0, y=0.0, *, size=(0.1, 0.1, 0.1), z=0.05, turn=0.0) -> Polytope:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    R = rotation_about(UP, turn)
    return Polytope.of(ConvexPart.hull_of(signs * np.array(size))).moved(pose(R, [x, y, z]))


def all_pairs(bodies):
    return list(combinations(bodies, 2))


def at(bodies, found):
    return {id: [p.shifted(np.r_[found.shifts[id], 0]) for p in parts] for id, parts in bodies.items()}


def overlapping(bodies):
    return [(a, b) for a, b in all_pairs(bodies) if compounds.collide(bodies[a], bodies[b])]


def heap(seed: int, count: int, *, crowding: float = 0.5):
    """Blocks, some with two parts, on a floor too small for them."""
    rng = np.random.default_rng(seed)
    reach = 0.1 * crowding * np.sqrt(count)
    bodies = {}
    for id in range(count):
        x, y = rng.uniform(-reach, reach, 2)
        turn = rng.uniform(0, 2 * np.pi)
        parts = [block(turn=turn, size=rng.uniform(0.04, 0.12, 3), z=0.03).shifted((x, y, 0))]
        if id % 3 == 0:
            parts.append(block(0.05, turn=turn + 0.5, size=rng.uniform(0.04, 0.1, 3), z=0.03).shifted((x, y, 0)))
        bodies[id] = parts
    return bodies


def one_pair_after_the_other(bodies, rounds=64):
    """The report's way: half of the shortest move each, until nothing overlaps; None when that does not end."""
    start = bodies
    moved = {id: np.zeros(2) for id in bodies}
    for _ in range(rounds):
        busy = False
        for a, b in all_pairs(bodies):
            t = compounds.smallest_horizontal_move(bodies[a], bodies[b])
            if length := float(np.linalg.norm(t)):
                t = t * (1 + 1e-9 / length)
                moved[a], moved[b] = moved[a] + t / 2, moved[b] - t / 2
                bodies = {id: [p.shifted(np.r_[moved[id], 0]) for p in parts] for id, parts in start.items()}
                busy = True
        if not busy:
            return sum(float(t @ t) for t in moved.values())
    return None


def test_two_boxes_share_the_way() -> None:
    found = part({0: [block()], 1: [block(0.08, 0.01)]}, [(0, 1)], {0: EVEN, 1: EVEN})
    assert np.allclose(found.shifts[0], [-0.01 - GAP / 2, 0]) and np.allclose(found.shifts[1], [0.01 + GAP / 2, 0])
    assert found.optimal and not found.unsolved and found.cost == pytest.approx(2 * (0.01 + GAP / 2) ** 2, rel=1e-4)


def test_the_light_one_moves_more() -> None:
    found = part({0: [block()], 1: [block(0.08)]}, [(0, 1)], {0: EVEN, 1: 4 * EVEN}, clearance=0)
    assert np.allclose(found.shifts[0], [-0.016, 0], atol=1e-6) and np.allclose(found.shifts[1], [0.004, 0], atol=1e-6)


def test_the_way_the_picture_feels_least_is_taken() -> None:
    """Longer along y, but a hundred times cheaper."""
    W = np.diag([100.0, 1.0])
    found = part({0: [block()], 1: [block(0.08)]}, [(0, 1)], {0: W, 1: W}, clearance=0)
    assert np.allclose(np.abs(found.shifts[1] - found.shifts[0]), [0, 0.1], atol=1e-6)


def test_three_in_a_row_push_the_outer_ones_out() -> None:
    bodies = {k: [block(0.08 * k)] for k in range(3)}
    found = part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN), clearance=0)
    assert np.allclose([found.shifts[k][0] for k in range(3)], [-0.02, 0, 0.02], atol=1e-6)
    assert np.allclose([found.shifts[k][1] for k in range(3)], 0, atol=1e-9)


def test_what_may_not_move_stays_and_two_such_are_told() -> None:
    bodies = {k: [block(0.08 * k)] for k in range(3)}
    found = part(bodies, all_pairs(bodies), {2: EVEN})
    assert found.unsolved == ((0, 1),) and np.allclose(found.shifts[2], [0.02 + GAP, 0])
    assert not found.shifts[0].any() and not found.shifts[1].any()


def test_what_is_carried_goes_along_and_counts() -> None:
    """A box on one of two that overlap: moved with it, and it must not be pushed into its neighbour."""
    bodies = {0: [block()], 1: [block(0.08)], 2: [block(0.01, z=0.15 + GAP)], 3: [block(-0.095, z=0.15 + GAP)]}
    pairs = [(0, 1), (2, 3), (1, 3), (0, 3), (1, 2)]
    weights = {0: 2 * EVEN, 1: EVEN}
    found = part(bodies, pairs, weights, carriers={2: 0, 0: -1, 1: -1, 3: None})
    assert np.array_equal(found.shifts[2], found.shifts[0]) and not found.shifts[3].any()
    assert found.shifts[0][0] > -0.005 - 1e-6  # no farther than the gap to the box beside what it carries
    assert (2, 3) not in overlapping(at(bodies, found)) and (0, 1) not in overlapping(at(bodies, found))


def test_what_is_apart_stays_and_near_ones_keep_their_gap() -> None:
    bodies = {0: [block()], 1: [block(0.1 + 1e-4)], 2: [block(1.0)]}
    found = part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN))
    assert found.cost == 0 and found.optimal


def test_out_of_a_corner() -> None:
    """An L of two parts around a box: each part alone would push it into the other."""
    corner = [block(0.0, 0.0, size=(0.3, 0.1, 0.1)), block(-0.1, 0.15, size=(0.1, 0.3, 0.1))]
    bodies = {0: corner, 1: [block(-0.01, 0.06, size=(0.1, 0.1, 0.1))]}
    found = part(bodies, [(0, 1)], {1: EVEN}, clearance=0)
    assert np.allclose(found.shifts[1], [0.01, 0.04], atol=1e-6) and found.optimal


@pytest.mark.parametrize("seed", range(12))
def test_heaps_come_apart_and_no_farther_than_one_pair_after_the_other(seed: int) -> None:
    bodies = heap(seed, 3 + seed % 5)
    assert not overlapping(at(bodies, part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN))))
    found = part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN), clearance=0)
    assert not found.unsolved
    other = one_pair_after_the_other(bodies)
    assert other is None or found.cost <= other * (1 + 1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_no_random_move_is_cheaper_than_the_proven_one(seed: int) -> None:
    bodies = heap(seed, 3, crowding=0.4)
    found = part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN), clearance=0, nodes=20_000)
    assert found.optimal
    rng = np.random.default_rng(seed)
    best = np.concatenate([found.shifts[k] for k in range(3)])
    for _ in range(200):
        x = rng.normal(size=6) if rng.random() < 0.5 else best + 0.3 * np.sqrt(found.cost) * rng.normal(size=6)
        x *= 0.98 * np.sqrt(found.cost) / np.linalg.norm(x)
        there = {k: [p.shifted([x[2 * k], x[2 * k + 1], 0]) for p in parts] for k, parts in bodies.items()}
        assert found.cost == 0 or overlapping(there)


def test_a_turn_of_the_world_turns_the_moves() -> None:
    bodies = heap(1, 4)
    T = pose(rotation_about(UP, 1.1), [1, 2, 0])
    turned = {id: [p.moved(T) for p in parts] for id, parts in bodies.items()}
    W = {id: np.diag([1.0, 3.0]) for id in bodies}
    R = T[:2, :2]
    once = part(bodies, all_pairs(bodies), W, nodes=20_000)
    again = part(turned, all_pairs(bodies), {id: R @ w @ R.T for id, w in W.items()}, nodes=20_000)
    assert once.optimal and again.optimal and again.cost == pytest.approx(once.cost, rel=1e-3)


def test_it_ends_when_the_search_is_cut_short_and_never_claims_more() -> None:
    bodies = heap(7, 10, crowding=0.3)
    found = part(bodies, all_pairs(bodies), dict.fromkeys(bodies, EVEN), nodes=20)
    assert not found.optimal and sorted(found.unsolved) == overlapping(at(bodies, found))
