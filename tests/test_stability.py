"""Balance of bodies at rest: cases solved by hand, laws, and seeded stacks let go in the physics engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import eye_array, hstack

import stacks
from bodies import GAP, block, body
from f3sr.contact.contact_patches import Contacts, find_contacts
from f3sr.contact.force_balance import EDGES, FALLS, Balance
from f3sr.contact.linear_programme import LinearProgramme
from f3sr.contact.stability import stability, stands
from f3sr.contact.static_bodies import bodies_of, contacts_of, islands
from f3sr.core.transforms import UP, Array, pose, rotation_about, skew
from f3sr.physics import release
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import GRAVITY, GROUND, Ground, SceneObject

ALONG_AN_EDGE = np.cos(np.pi / EDGES)
"""What the pyramid has of a cone's friction at least."""


def moved(bodies, T):
    return [b.moved(T) for b in bodies]


# Where forces act


@pytest.mark.parametrize("seed", range(4))
def test_how_a_cost_changes_with_where_forces_and_weights_act(seed: int) -> None:
    """Against differences: two bodies, one on the other, whose weights some wrench at a price helps to carry."""
    rng = np.random.default_rng(seed)
    low, up = (
        replace(body(k, block(at=(0, 0, 0.05 + 0.1 * k)), mass=1.0 + k), centers=rng.normal((0, 0, z), 0.02, (2, 3)))
        for k, z in enumerate((0.05, 0.15))
    )
    normals = UP + rng.normal(0, 0.2, (8, 3))
    points = np.column_stack([rng.uniform(-0.05, 0.05, (8, 2)), np.repeat([0.0, 0.1], 4)])
    contacts = Contacts(
        upper=np.repeat([0, 1], 4),
        lower=np.repeat([GROUND, 0], 4),
        points=points,
        normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        follow=rng.uniform(0, 1, (8, 3, 3)),
    )
    way, tilt, center, price = rng.uniform(0.001, 0.01, 8 * EDGES), np.array([0.02, -0.01]), 1, 0.03
    middles = rng.normal(0, 0.1, (2, 3))

    def least(q: Array) -> tuple[float, Array]:
        """The least cost after moves (2, 7) of both bodies, and its rates."""

        def shifts(k: int, at: Array) -> Array:
            return motion(q[k]) @ np.vstack([(at - middles[k]).T, np.ones(len(at))])

        there = [replace(b, centers=b.centers + shifts(k, b.centers).T) for k, b in enumerate((low, up))]
        of_upper = np.vstack([shifts(0, points[:4]).T, shifts(1, points[4:]).T])
        of_lower = np.vstack([np.zeros((4, 3)), shifts(0, points[4:]).T])
        follow = contacts.follow
        moved_by = np.einsum("kij,kj->ki", follow, of_upper) + np.einsum("kij,kj->ki", np.eye(3) - follow, of_lower)
        balance = Balance(there, there, replace(contacts, points=points + moved_by), Ground.friction)
        rows = 6 * len(there)
        cost = np.r_[way, np.full(2 * rows, price)]
        upright, lean = balance.weights(center)
        equal = hstack([balance.wrenches, eye_array(rows), -eye_array(rows)])
        found = LinearProgramme(cost, equal, upright + lean @ tilt).solve()
        assert found
        on_upper = np.einsum("ke,keq,k->kq", found.x[: -2 * rows].reshape(-1, EDGES), balance.edges, balance.units)
        return found.value, balance.arm_rates(on_upper, found.duals, middles, center=center, tilt=tilt)

    step = 1e-6 * np.eye(14).reshape(14, 2, 7)
    differences = [(least(d)[0] - least(-d)[0]) / 2e-6 for d in step]
    assert least(np.zeros((2, 7)))[1].ravel() == pytest.approx(differences, rel=1e-4, abs=1e-6)


def motion(q: Array) -> Array:
    """(3, 4): how points (x, y, z, 1) from a middle move with the small parameters (7,) of a pose."""
    return np.column_stack([skew(q[3:6]) + q[6] * np.eye(3), q[:3]])


# Contacts


def test_a_box_on_a_box_touches_at_the_corners_of_the_common_face() -> None:
    found = find_contacts({0: [block()], 1: [block(at=(0.03, 0.02, 0.15 + GAP))]}, ground=False)
    assert found.pairs == {(1, 0)}
    assert np.allclose(np.sort(found.points[:, :2], axis=0), [[-0.02, -0.03]] * 2 + [[0.05, 0.05]] * 2)
    assert np.allclose(found.points[:, 2], 0.1 + GAP / 2, atol=GAP) and np.allclose(found.normals, UP)


def test_where_a_patch_goes_when_a_body_moves() -> None:
    """Of the corners of an overlap some belong to the upper box, some to the lower, some to an edge of each."""
    lower, upper = block(), block(at=(0.03, 0.02, 0.15 + GAP))
    shift = np.array([1e-3, 2e-3, 0])
    before = find_contacts({0: [lower], 1: [upper]}, ground=False)
    after = find_contacts({0: [lower], 1: [upper.shifted(shift)]}, ground=False)
    told = before.points + before.follow @ shift
    for p in told:
        assert np.linalg.norm((after.points - p)[:, :2], axis=1).min() < 1e-9
    both = find_contacts({0: [lower.shifted(shift)], 1: [upper.shifted(shift)]}, ground=False)
    assert np.allclose(both.points[:, :2], (before.points + shift)[:, :2])


def test_parts_of_one_body_make_one_patch() -> None:
    halves = [block((0.05, 0.1, 0.1), (x, 0, 0.05)) for x in (-0.025, 0.025)]
    found = find_contacts({0: halves, 1: [block((0.08, 0.08, 0.1), (0, 0, 0.15 + GAP))]})
    assert sorted(zip(found.upper.tolist(), found.lower.tolist(), strict=True)) == [(0, GROUND)] * 4 + [(1, 0)] * 4


def test_edges_touch_in_a_point_with_the_normal_across_both() -> None:
    lower = block(R=rotation_about([1, 0, 0], np.pi / 4))
    upper = block(at=(0, 0, 0.05 + 0.1 * np.sqrt(2) + GAP), R=rotation_about([0, 1, 0], np.pi / 4))
    found = find_contacts({0: [lower], 1: [upper]}, ground=False)
    assert found.pairs == {(1, 0)} and np.allclose(found.normals, UP)
    assert np.allclose(found.points, [0, 0, 0.05 * (1 + np.sqrt(2))], atol=1.5e-3)


def test_what_is_farther_than_reach_does_not_touch() -> None:
    assert not len(find_contacts({0: [block(at=(0, 0, 0.051))]}))
    assert not len(find_contacts({0: [block()], 1: [block(at=(0.101, 0, 0.05))]}, ground=False))
    assert not len(find_contacts({0: [block()], 1: [block(at=(0.1005, 0, 0.1505))]}, ground=False))


def test_the_order_of_bodies_does_not_matter() -> None:
    bodies = bodies_of(stacks.stack(25))
    a, b = stability(bodies), stability(bodies[::-1])
    assert a.margin == pytest.approx(b.margin, abs=2e-3) and a.moving == b.moving


# Cases solved by hand


@pytest.mark.parametrize("d", [0.0, 0.02, 0.04])
def test_a_box_over_an_edge_tips_at_its_overhang(d: float) -> None:
    """A box of width w and height h whose middle is d off a support as wide tips at tan = (w / 2 - d) / (h / 2)."""
    bodies = [body(0, block(), fixed=True), body(1, block((0.1, 0.1, 0.3), (d, 0, 0.25 + GAP)), friction=2.0)]
    found = stability(bodies)
    assert found.stands and found.margin == pytest.approx(np.arctan((0.05 - d) / 0.15), abs=2e-3)


def test_a_box_beyond_an_edge_falls_and_says_how_much_tilt_would_hold_it() -> None:
    found = stability([body(0, block()), body(1, block((0.1, 0.1, 0.3), (0.06, 0, 0.25 + GAP)), friction=2.0)])
    assert not found.stands and found.moving == {1}
    assert found.margin == pytest.approx(-np.arctan(0.01 / 0.15), abs=2e-3)


def test_a_low_box_slides_at_its_friction_angle() -> None:
    low = body(0, block((0.3, 0.3, 0.02), (0, 0, 0.01)), friction=0.3)
    margin = stability([low], ground_friction=0.3).margin
    assert np.arctan(0.3 * ALONG_AN_EDGE) - 1e-3 <= margin <= np.arctan(0.3) + 1e-3


@pytest.mark.parametrize(("angle", "friction", "holds"), [(0.25, 0.3, True), (0.35, 0.3, False), (0.35, 0.45, True)])
def test_a_block_on_a_slope(angle: float, friction: float, holds: bool) -> None:
    R = rotation_about([0, 1, 0], angle)
    slope = body(0, block((1, 1, 0.1), (0, 0, 1), R), fixed=True, friction=friction)
    on_it = body(1, block((0.1, 0.1, 0.05), np.array([0, 0, 1]) + R @ [0, 0, 0.075 + GAP], R), friction=friction)
    found = stability([slope, on_it])
    assert found.stands == holds
    assert found.margin == pytest.approx(np.arctan(friction) - angle, abs=0.03)


@pytest.mark.parametrize(("angle", "stands"), [(60, True), (35, False)])
def test_a_leaning_plank_stands_when_it_is_steep(angle: float, stands: bool) -> None:
    """On a floor with friction mu, against a smooth wall: tan(angle) >= 1 / (2 mu) holds it, here 40 degrees."""
    R = rotation_about([0, 1, 0], -np.radians(angle))
    plank = block((1.0, 0.1, 0.001), R=R)
    plank = plank.shifted((-plank.bounds[1, 0] - GAP, 0, GAP - plank.bounds[0, 2]))
    wall = body(0, block((0.1, 1, 3), (0.05, 0, 1.5)), fixed=True, friction=0.0)
    smooth = [wall, body(1, plank, friction=0.0)]
    touching = {frozenset(pair) for pair in contacts_of(smooth).pairs}
    assert {frozenset((1, 0)), frozenset((1, GROUND))} <= touching
    assert stability(smooth, ground_friction=0.6).stands == stands


def test_a_bridge_falls_without_one_of_its_piers() -> None:
    piers = [body(k, block(at=(x, 0, 0.05))) for k, x in ((0, -0.1), (1, 0.1))]
    plank = body(2, block((0.3, 0.1, 0.02), (0, 0, 0.11 + GAP)), mass=0.4)
    assert stability([*piers, plank]).stands and stability([piers[0], plank]).moving == {2}


def test_an_arch_stands_by_friction_alone() -> None:
    """Two planks that lean on each other push outward; without friction on the floor they slide apart."""
    angle = np.radians(70)
    legs = []
    for id, side in ((0, -1), (1, 1)):
        leg = block((0.02, 0.1, 0.4), R=rotation_about([0, 1, 0], -side * (np.pi / 2 - angle)))
        inner = leg.bounds[1, 0] if side < 0 else -leg.bounds[0, 0]
        legs.append(body(id, leg.shifted((side * (inner + GAP / 2), 0, GAP - leg.bounds[0, 2]))))
    assert stability(legs).stands
    assert not stability([replace(leg, friction=0.0) for leg in legs], ground_friction=0.0).stands
    assert stability([legs[0]]).moving == {0}


def test_what_touches_nothing_falls_whatever_the_tilt_and_fixed_things_never_do() -> None:
    found = stability([body(0, block(at=(0, 0, 0.5))), body(1, block(at=(1, 0, 0.5)), fixed=True)])
    assert found.margin == FALLS and found.moving == {0}
    assert stability([body(1, block(at=(1, 0, 0.5)), fixed=True)]).stands


def test_every_centre_of_mass_must_stand() -> None:
    one = body(0, block())
    two = replace(one, centers=[one.centers[0], one.centers[0] + [0.06, 0, 0]])
    assert stability([one]).stands and stability([two]).moving == {0}


def test_a_counterweight_holds_what_would_fall() -> None:
    """A plank half over an edge stands under a block, and neither is said to fall."""
    shelf = body(0, block(at=(0, 0, 0.05)))
    plank = body(1, block((0.2, 0.1, 0.01), (0.06, 0, 0.105 + GAP)))
    weight = body(2, block((0.04, 0.1, 0.1), (-0.02, 0, 0.16 + 2 * GAP)))
    assert stability([shelf, plank]).moving == {1}
    assert stability([shelf, plank, weight]).stands


# Laws


@pytest.mark.parametrize("seed", [3, 6, 12])
def test_a_turn_about_the_vertical_changes_nothing(seed: int) -> None:
    bodies = bodies_of(stacks.stack(seed))
    T = pose(rotation_about(UP, 0.7), [3, -2, 0])
    once, turned = stability(bodies), stability(moved(bodies, T))
    assert turned.margin == pytest.approx(once.margin, abs=0.02)
    assert turned.moving == once.moving


@pytest.mark.parametrize("k", [0.1, 10.0])
def test_a_larger_world_stands_alike(k: float) -> None:
    """Scaled with its gaps and the reach; masses grow alike."""
    bodies = bodies_of(stacks.stack(12))
    T = pose(k * np.eye(3))
    large = [replace(b, parts=b.parts.moved(T), centers=k * b.centers, mass=k**3 * b.mass) for b in bodies]
    found = stability(large, contacts_of(large, reach=k * DEFAULT_MARGIN.reach))
    once = stability(bodies)
    assert found.margin == pytest.approx(once.margin, abs=2e-3)


def test_forces_balance_weights_and_pull_at_nothing() -> None:
    for seed in (6, 12, 26):
        bodies = bodies_of(stacks.stack(seed))
        contacts = contacts_of(bodies)
        forces = np.zeros((len(contacts), 3))
        for group in islands(bodies, contacts):
            balance = Balance(group, bodies, contacts, Ground.friction)
            forces[balance.rows] = GRAVITY * balance.eased(np.zeros(2)).forces
        assert (np.einsum("ki,ki->k", forces, contacts.normals) >= -1e-9).all()
        for b in bodies:
            sign = (contacts.upper == b.id).astype(float) - (contacts.lower == b.id)
            total = sign @ forces
            moment = sign @ np.cross(contacts.points - b.centers[0], forces)
            weight = GRAVITY * b.mass
            assert np.allclose(total, weight * UP, atol=1e-5 * weight)
            assert np.allclose(moment, 0, atol=1e-5 * weight * b.size)


def test_the_margin_is_where_balance_ends() -> None:
    """Gravity tilted in many directions: none moves anything below the margin, one does just above."""
    bodies = bodies_of(stacks.stack(26))
    contacts = contacts_of(bodies)
    margin = stability(bodies, contacts).margin

    def balanced(direction: float, tilt: float) -> bool:
        lean = rotation_about([np.cos(direction), np.sin(direction), 0], tilt)
        turned = Contacts(
            upper=contacts.upper,
            lower=contacts.lower,
            points=contacts.points @ lean.T,
            normals=contacts.normals @ lean.T,
            follow=contacts.follow,
        )
        return stands(moved(bodies, pose(lean)), turned)

    directions = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    assert all(balanced(a, margin - 0.03) for a in directions)
    assert not all(balanced(a, margin + 0.03) for a in directions)


@pytest.mark.parametrize("offset", [0.0, 0.02, 0.045, 0.06])
def test_what_a_tilt_moves_is_told_without_the_margin_itself(offset: float) -> None:
    lower, upper = body(0, block(), fixed=True), body(1, block(at=(offset, 0, 0.15 + GAP)))
    balance = Balance([upper], [lower, upper], contacts_of([lower, upper]), 0.6)
    margin = balance.margin()
    assert [balance.bears(margin + d) for d in (-0.01, -0.003, 0.003, 0.01)] == [True, True, False, False]


# Against the physics engine


@pytest.mark.parametrize("seed", range(10))
def test_stacks_that_stand_stay_and_those_that_do_not_move(seed: int) -> None:
    objects: tuple[SceneObject, ...] = stacks.stack(seed)
    found = stability(bodies_of(objects))
    travel = release.release(objects, seconds=1.5).D_max
    assert travel < 1e-3 if found.stands else travel > 2e-3
