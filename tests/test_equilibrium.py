"""The equilibrium nearest to given poses: by hand, and heaps that were disturbed from one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bodies import block, body
from f3sr.contact.compounds import Compound, collide
from f3sr.contact.equilibrium import BodyMove, Equilibrium, FootedBody, nearest_equilibrium
from f3sr.contact.least_norm import nearly, shortest
from f3sr.contact.near_contacts import NearContacts, footing_contacts, near_contacts
from f3sr.contact.polytopes import Polytope
from f3sr.contact.stability import stands
from f3sr.contact.static_bodies import StaticBody
from f3sr.core.mesh import ConvexPart
from f3sr.core.pose_uncertainty import parameters, similarity
from f3sr.core.transforms import Array, pose, rotation_about
from f3sr.physics.contact_margin import DEFAULT_MARGIN

GAP, REACH = DEFAULT_MARGIN.clearance, DEFAULT_MARGIN.reach
EVEN = np.diag([1e6, 1e6, 1e6, 1e4, 1e4, 1e4, 1e6])
"""Shifts of 1 mm, turns of .01 rad and scales of .001 are one standard deviation."""


def vectors(longest: float) -> st.SearchStrategy[Array]:
    return st.tuples(*[st.floats(-longest, longest)] * 3).map(np.array)


def balanced(bodies: Sequence[StaticBody], precisions: Mapping[int, Array]) -> tuple[list[StaticBody], Equilibrium]:
    found = nearest_equilibrium(bodies, precisions)
    return [moved(b, found) for b in bodies], found


def moved(b: StaticBody, found: Equilibrium) -> StaticBody:
    if b.id not in found.moves:
        return b
    return after_move(b, found.moves[b.id])


def after_move(b: StaticBody, move: BodyMove) -> StaticBody:
    return b.moved(pose(move.scale * move.T[:3, :3], move.T[:3, 3]))


def middle(b: StaticBody) -> Array:
    return b.parts.bounds.mean(0)


def test_what_hangs_comes_down_and_what_is_sunk_comes_up():
    for height in (0.07, 0.047):
        after, found = balanced([body(0, block(at=(0, 0, height)))], {0: EVEN})
        assert after[0].parts.lowest == pytest.approx(GAP, abs=2e-5) and found.work < 1e-4


def test_what_hangs_too_high_stays():
    after, found = balanced([body(0, block(at=(0, 0, 1)))], {0: EVEN})
    assert middle(after[0]) == pytest.approx([0, 0, 1], abs=0.06) and found.work > 0.02


def test_of_a_stack_that_hangs_too_high_something_else_has_to_carry_the_lowest():
    stack = [body(id, block(at=(0, 0, 1 + (0.1 + GAP) * k))) for k, id in enumerate((4, 2, 7))]
    precisions = dict.fromkeys((4, 2, 7), EVEN)
    assert nearest_equilibrium(stack, precisions, may_hold=(4, 2, 7)).unheld == 4
    assert nearest_equilibrium(stack, precisions, may_hold=(2, 7)).unheld == 2
    found = nearest_equilibrium([replace(stack[0], fixed=True), *stack[1:]], precisions, may_hold=(2, 7))
    assert found.unheld is None and found.work < 1e-5
    assert all(np.abs(moved(b, found).parts.bounds - b.parts.bounds).max() < 1e-3 for b in stack)


def test_what_something_else_carries_still_leaves_what_it_overlaps():
    held, other = body(0, block(at=(0.094, 0, 0.3))), body(1, block(at=(0, 0, 0.3)))
    bodies = [replace(held, fixed=True), other]
    found = nearest_equilibrium(bodies, {0: EVEN}, may_hold=(0,))
    after = [moved(b, found) for b in bodies]
    assert found.unheld is None
    assert after[0].parts.bounds[0, 0] >= 0.05 + GAP - 2e-5 and middle(after[0])[2] == pytest.approx(0.3, abs=1e-3)


def test_a_box_that_is_tilted_by_an_error_lies_down_flat():
    tilted = block(at=(0, 0, 0)).moved(pose(rotation_about([1, 0, 0], 0.03), [0, 0, 0.0517]))
    after, _ = balanced([body(0, tilted)], {0: EVEN})
    assert stands(after, reach=REACH)
    assert np.ptp(after[0].parts.arrays.vertices[:, 2]) == pytest.approx(0.1, abs=2e-4)


def wedge(b: StaticBody) -> Polytope:
    """What is between the four lowest corners of a box and the height of its lowest."""
    corners = b.parts.arrays.vertices
    corners = corners[np.argsort(corners[:, 2])[:4]]
    level = np.column_stack([corners[:, :2], np.full(4, corners[:, 2].min())])
    return Polytope.of(ConvexPart.hull_of(np.concatenate([corners + np.array([0, 0, 1e-4]), level])))


@pytest.mark.parametrize("height", [0.056, 0.049])
def test_on_a_footing_a_tilted_box_comes_down_and_keeps_its_turn(height: float):
    """It hangs or is sunk, and its turn is known to .001 rad. Without a footing it turns to its face."""
    known = EVEN + np.diag([0, 0, 0, 1e6, 1e6, 1e6, 0])
    tilted = body(0, block(at=(0, 0, 0)).moved(pose(rotation_about([1, 0, 0], 0.03), [0, 0, height])))

    def footed(moves: Mapping[int, BodyMove], overlapping: bool) -> dict[int, FootedBody]:
        there = after_move(tilted, moves[0])
        return {0: FootedBody(body=there, footing=Compound.of([wedge(there)]))}

    def turn(found: Equilibrium) -> float:
        return float(np.linalg.norm(parameters(found.moves[0].T, found.moves[0].scale, middle(tilted))[3:6]))

    found = nearest_equilibrium([tilted], {0: known}, footings=footed)
    after = moved(tilted, found)
    assert after.parts.lowest == pytest.approx(GAP, abs=5e-5) and found.work < 1e-4
    assert turn(found) < 2e-3 and turn(nearest_equilibrium([tilted], {0: known})) > 0.01
    at = found.footed_at[0]
    stood = footed({0: at}, False)[0].footing
    assert stood and stood.moved(found.moves[0].T @ np.linalg.inv(at.T)).lowest == pytest.approx(GAP, abs=1e-4)


def test_footings_are_asked_for_again_once_bodies_overlap_no_more_even_if_none_moved():
    """What may be inside other bodies while these overlap may not be so at the end."""
    box, flags = body(0, block(at=(0, 0, 0.05 + GAP))), list[bool]()

    def footed(moves: Mapping[int, BodyMove], overlapping: bool) -> dict[int, FootedBody]:
        flags.append(overlapping)
        return {0: FootedBody(body=after_move(box, moves[0]), footing=None)}

    found = nearest_equilibrium([box], {0: EVEN}, footings=footed)
    assert found.cost < 1e-2 and flags == [True, False]


def test_a_footing_that_is_refused_leaves_the_search_as_without():
    tilted = body(0, block(at=(0, 0, 0)).moved(pose(rotation_about([1, 0, 0], 0.03), [0, 0, 0.0517])))

    def bare(moves: Mapping[int, BodyMove], overlapping: bool) -> dict[int, FootedBody]:
        there = after_move(tilted, moves[0])
        return {0: FootedBody(body=there, footing=None)}

    one, other = (nearest_equilibrium([tilted], {0: EVEN}, footings=f) for f in (bare, None))
    assert moved(tilted, one).parts.arrays.vertices == pytest.approx(
        moved(tilted, other).parts.arrays.vertices, abs=2e-4
    )


def test_the_gap_of_a_footing_closes_by_the_nearest_contact_of_its_body():
    low = body(9, block((0.3, 0.3, 0.1), at=(0, 0, 0.05)), fixed=True)
    tilted = body(0, block(at=(0, 0, 0)).moved(pose(rotation_about([1, 0, 0], 0.03), [0, 0, 0.153])))
    parts = {b.id: b.parts for b in (low, tilted)}
    own = near_contacts(parts, [0])
    near, closing = footing_contacts(own, {0: Compound.of([wedge(tilted)])}, parts)
    more = closing[len(own.gaps) :]
    assert len(more) >= 4 and set(closing[: len(own.gaps)]) == set(range(len(own.gaps)))
    assert np.allclose(own.gaps[more], own.gaps.min())
    assert near.gaps[len(own.gaps) :] == pytest.approx(own.gaps.min(), abs=1e-5)


@pytest.mark.parametrize("deep", [0.001, 0.0, -0.001])
def test_the_least_gap_to_a_part_that_is_thinner_than_the_room_for_patches_is_found(deep: float):
    """A floor of 2 mm, and a bottom that bulges by 1 mm: moved by the room of a small turn, the floor is past it."""
    floor = Compound.of([block((0.3, 0.3, 0.002), at=(0, 0, 0.499))])
    corners = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.501, 0.6)])
    bulge = np.concatenate([corners, [[0.02, 0.01, 0.5]]]) - [0, 0, deep]
    bodies = {0: floor, 1: Compound.of([Polytope.of(ConvexPart.hull_of(bulge))])}
    assert near_contacts(bodies, [1]).gaps.min() == pytest.approx(-deep, abs=1e-6)


def test_a_footing_carries_from_below_only():
    """Beside a wall it has contacts with the ground alone."""
    wall = body(9, block((0.1, 0.3, 0.3), at=(0.1 + GAP, 0, 0.15)), fixed=True)
    box = body(0, block(at=(0, 0, 0.06)))
    parts = {b.id: b.parts for b in (wall, box)}
    own = near_contacts(parts, [0])
    near, closing = footing_contacts(own, {0: Compound.of([block((0.1, 0.1, 0.01), at=(0, 0, 0.006))])}, parts)
    more = near.contacts.of(np.arange(len(own.gaps), len(near.gaps)))
    assert more.pairs == {(0, -1)} and {9} <= set(near.contacts.upper) | set(near.contacts.lower)
    assert (near.contacts.lower[closing[len(own.gaps) :]] == -1).all()


def test_the_support_that_is_known_worst_moves():
    """A plank bridges two posts of which one is 3 mm too low."""
    high, low = (
        body(k, block((0.05, 0.05, height), at=(x, 0, height / 2 + GAP)))
        for k, x, height in ((0, -0.15, 0.1), (1, 0.15, 0.097))
    )
    plank = body(2, block((0.4, 0.05, 0.02), at=(0, 0, 0.11 + 2 * GAP)))
    tall = EVEN.copy()
    tall[6, 6] = 1e3  # its size is known to 3 %
    after, found = balanced([high, low, plank], {0: EVEN, 1: tall, 2: EVEN})
    assert stands(after, reach=REACH)
    assert found.moves[1].scale > 1.01 and found.cost < 3


def test_what_rests_hardly_moves_and_what_is_fixed_not_at_all():
    low, up = body(0, block(at=(0, 0, 0.05 + GAP))), body(1, block(at=(0.02, 0, 0.15 + 2 * GAP)))
    _, found = balanced([low, up], {0: EVEN, 1: EVEN})
    assert found.cost < 1e-2
    sunk = up.moved(pose(t=[0, 0, -0.002]))
    after, found = balanced([low, sunk], {1: EVEN})
    assert set(found.moves) == {1} and after[1].parts.lowest == pytest.approx(0.1 + 2 * GAP, abs=5e-5)


@pytest.mark.parametrize("height", [0.001, -0.004])
def test_what_is_sunk_through_a_thin_floor_comes_back_inside_where_the_search_begins_apart(height: float):
    """A cube in a tray fixed on the ground. Its middle is under that of the tray's floor, so the nearest way out
    is down, where the ground leaves no room. Overlap that ends little by little leads nowhere there."""
    floor = block((0.3, 0.3, 0.006), at=(0, 0, 0.003))
    walls = [block((0.01, 0.3, 0.06), at=(x, 0, 0.036)) for x in (-0.145, 0.145)]
    tray = body(9, floor, *walls, fixed=True)
    cube = body(0, block((0.03, 0.03, 0.03), at=(0.02, 0, height)))
    found = nearest_equilibrium([tray, cube], {0: EVEN}, apart=True)
    after = moved(cube, found)
    assert after.parts.lowest == pytest.approx(0.006 + GAP, abs=5e-5) and found.work < 1e-4
    assert found.moves[0].scale == pytest.approx(1, abs=0.01)
    other = nearest_equilibrium([tray, cube], {0: EVEN})
    assert other.cost > 10 * found.cost or collide(moved(cube, other).parts, tray.parts, 1e-4)


def test_the_search_stays_at_the_equilibrium_that_it_starts_from():
    """A box may stand in either of two hollows; the farther one is kept where it is the start."""
    ridges = [body(9 + k, block((0.02, 0.2, 0.02), at=(x, 0, 0.01)), fixed=True) for k, x in enumerate((-0.2, 0, 0.2))]
    box = body(0, block((0.1, 0.1, 0.1), at=(-0.1, 0, 0.05 + GAP)))
    there = BodyMove(T=pose(rotation_about([0, 0, 1], 0.02), [0.2, 0.01, 0]), scale=1.01)
    after = moved(box, found := nearest_equilibrium([box, *ridges], {0: EVEN}, start={0: there}))
    assert stands([after, *ridges], reach=REACH) and middle(after)[0] > 0.03
    here = nearest_equilibrium([box, *ridges], {0: EVEN})
    assert here.cost < 0.1 < found.cost


@given(shift=vectors(1.0), turn=vectors(1.7), size=st.floats(-1, 1), middle=vectors(2.0))
def test_parameters_of_a_similarity(shift: Array, turn: Array, size: float, middle: Array):
    q = np.concatenate([shift, turn, [size]])
    assert parameters(*similarity(q, middle), middle) == pytest.approx(q, abs=1e-9)


def test_a_box_beyond_the_edge_of_its_support_moves_back_over_it():
    table = body(9, block((0.3, 0.3, 0.1), at=(0, 0, 0.05)), fixed=True)
    box = body(0, block(at=(0.152, 0, 0.15 + GAP)))
    found = nearest_equilibrium([table, box], {0: EVEN}, descends=True)
    after = moved(box, found)
    assert found.work < 1e-5 and found.cost < 10 and stands([table, after], reach=REACH)
    assert middle(after) == pytest.approx([0.1495, 0, 0.15 + GAP], abs=7e-4)


def test_a_plank_that_lies_beside_the_middle_of_two_rails_moves_over_them():
    rails = [body(9 - k, block((0.02, 0.02, 0.1), at=(0.2 * k, 0, 0.05)), fixed=True) for k in range(2)]
    plank = body(0, block((0.3, 0.06, 0.02), at=(0.1, 0.014, 0.11 + GAP)))
    found = nearest_equilibrium([*rails, plank], {0: EVEN}, descends=True)
    assert found.work < 1e-5 and middle(moved(plank, found))[1] < 0.011
    assert nearest_equilibrium([*rails, plank], {0: EVEN}).work > 1e-4, "gaps alone tell of no way"


@pytest.mark.parametrize("seed", range(6))
def test_a_disturbed_heap_comes_to_an_equilibrium_about_as_near_as_the_one_that_it_came_from(seed: int):
    """Two boxes side by side carry a third that leans on a wall."""
    rng = np.random.default_rng(seed)
    sigmas = np.array([0.002] * 3 + [0.01] * 3 + [0.005])
    wall = body(9, block((0.02, 0.3, 0.3), at=(0.15 + GAP, 0, 0.15)), fixed=True)
    heap = [
        body(0, block((0.1, 0.1, 0.1), at=(-0.06, 0, 0.05 + GAP))),
        body(1, block((0.1, 0.1, 0.1), at=(0.06, 0, 0.05 + GAP))),
        body(2, block((0.12, 0.08, 0.06), at=(0.01, 0, 0.13 + 2 * GAP))),
    ]
    errors = {b.id: sigmas * rng.standard_normal(7) for b in heap}
    wrong: list[StaticBody] = [wall]
    for b in heap:
        T, scale = similarity(errors[b.id], middle(b))
        wrong.append(b.moved(pose(scale * T[:3, :3], T[:3, 3])))
    after, found = balanced(wrong, {b.id: np.diag(sigmas**-2) for b in heap})
    came = sum(float(((e / sigmas) ** 2).sum()) for e in errors.values())
    assert found.cost < came
    assert stands(after, reach=REACH)
    assert not any(collide(a.parts, b.parts, 1e-5) for a, b in combinations(after, 2))


@pytest.mark.parametrize("gap", [0.004, 0.0, -0.003])
def test_gaps_are_distances_between_the_faces_negative_where_they_overlap(gap: float):
    # The upper box juts out: corners of contact lie where its underside crosses the other's edges.
    low, up = block(at=(0, 0, 0.05)), block((0.1, 0.1, 0.1), at=(0.04, 0.03, 0.15 + gap))
    near = near_contacts({0: body(0, low).parts, 1: body(1, up).parts}, [1])
    on = near.contacts
    assert set(zip(on.upper.tolist(), on.lower.tolist(), strict=True)) == {(0, 1)}
    assert near.gaps == pytest.approx(gap, abs=1e-9)
    assert on.points[:, :2].min(0) == pytest.approx([-0.01, -0.02]) and on.points[:, :2].max(0) == pytest.approx(0.05)


def test_gaps_change_by_a_move_as_their_normals_say():
    low = block(at=(0, 0, 0.05))
    up = block(at=(0, 0, 0)).moved(pose(rotation_about([1, 2, 3], 0.7), [-0.05, 0, 0]))
    up = up.moved(pose(t=[0, 0, 0.103 - up.vertices[:, 2].min()]))

    def nearest(shift: Array) -> NearContacts:
        return near_contacts({0: body(0, low).parts, 1: body(1, up.moved(pose(t=shift))).parts}, [1])

    before = nearest(np.zeros(3))
    k = int(np.argmin(before.gaps))
    shift = np.array([1e-3, -2e-3, 1e-3])
    change = float(nearest(shift).gaps.min()) - float(before.gaps[k])
    sign = 1 if before.contacts.upper[k] == 1 else -1
    assert change == pytest.approx(sign * float(before.contacts.normals[k] @ shift), abs=1e-9)


def test_the_vector_that_nearly_satisfies():
    against = np.array([[1.0, 1], [-1, 1]])
    assert shortest(against) is None
    assert nearly(against, 1e6) == pytest.approx([0], abs=1e-9)
    assert nearly(np.array([[1.0, 1]]), 1.0) == pytest.approx([0.5])


@pytest.mark.parametrize("seed", range(10))
def test_at_a_high_price_it_is_the_shortest(seed: int):
    rng = np.random.default_rng(seed)
    inside = rng.standard_normal(4)
    G = rng.standard_normal((30, 4))
    rows = np.column_stack([G, G @ inside - rng.uniform(0, 1, 30)])
    assert nearly(rows, 1e12) == pytest.approx(shortest(rows), abs=1e-6)


@pytest.mark.parametrize(("degrees", "needed"), [(20.0, {}), (28.0, {0: 0.6}), (35.0, {0: 0.6}), (60.0, {})])
def test_what_slides_with_the_friction_that_is_guessed_needs_more(degrees: float, needed: dict[int, float]):
    """A box on a slope, with a friction of .5, gets that of the release protocol. Nothing holds it on the steepest."""
    T = pose(rotation_about([0, 1, 0], np.radians(degrees)))
    slope = body(1, block(at=(0, 0, -0.05), size=(1, 1, 0.1)).moved(T), fixed=True, friction=0.5)
    box = body(0, block(at=(0, 0, 0.05 + GAP)).moved(T), friction=0.5)
    up = pose(t=[0, 0, 1])  # the ground is far
    bodies = [b.moved(up) for b in (box, slope)]
    assert nearest_equilibrium(bodies, {0: EVEN}, guessed=[0]).friction == needed
    assert nearest_equilibrium(bodies, {0: EVEN}).friction == {}


@pytest.mark.parametrize(("degrees", "holds"), [(29.0, True), (33.0, False)])
def test_no_force_relies_on_more_friction_than_the_release_protocol_has(degrees: float, holds: bool):
    """A rubber box on rubber would stay in an engine of its own friction, and slide in the check that all must pass."""
    T = pose(rotation_about([0, 1, 0], np.radians(degrees)), [0, 0, 1])  # the ground is far
    slope = body(1, block(at=(0, 0, -0.05), size=(1, 1, 0.1)).moved(T), fixed=True, friction=0.9)
    box = body(0, block(at=(0, 0, 0.05 + GAP)).moved(T), friction=0.9)
    assert (nearest_equilibrium([box, slope], {0: EVEN}).work < 1e-5) == holds
