"""One body coming to lie on what is held still: by hand, laws, and against damped physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stacks
from bodies import GAP, block, body
from f3sr.contact import compounds
from f3sr.contact.static_bodies import bodies_of
from f3sr.contact.tipping import LandingConfig, land
from f3sr.core.transforms import UP, pose, rotation_about, rotation_angle
from f3sr.physics import release, settling

EXACT = np.radians(0.02)


def tilted(axis, degrees, **more):
    return body(0, block(at=(0, 0, 0.3), R=rotation_about(axis, np.radians(degrees)), **more))


@pytest.mark.parametrize(("degrees", "turn"), [(0, 0), (5, 5), (44, 44), (46, 44), (80, 10)])
def test_a_tilted_box_falls_onto_the_nearer_face(degrees: float, turn: float) -> None:
    found = land(tilted([0, 1, 0], degrees), [], LandingConfig(max_turn=1.0, max_drop=10))
    assert found.stands and not found.tipped
    assert found.turn == pytest.approx(np.radians(turn), abs=EXACT)
    placed = tilted([0, 1, 0], degrees).moved(found.T)
    assert placed.parts[0].bounds[:, 2] == pytest.approx([GAP, 0.1 + GAP], abs=2e-5)


def test_a_box_on_a_corner_turns_about_it_then_about_an_edge() -> None:
    found = land(tilted([1, 2, 0], 20), [], LandingConfig(max_turn=1.0, max_drop=10))
    placed = tilted([1, 2, 0], 20).moved(found.T)
    assert found.stands and placed.parts[0].bounds[1, 2] == pytest.approx(0.1 + GAP, abs=2e-5)


def test_a_plank_over_an_edge_leans_from_it_to_the_floor() -> None:
    """.3 m beyond the edge of a box of .1 m its underside reaches the floor: sin(turn) = 1 / 3."""
    shelf = body(1, block(), fixed=True)
    plank = body(0, block((0.4, 0.05, 0.02), (0.15, 0, 0.3)))
    found = land(plank, [shelf], LandingConfig(max_turn=1.0, max_drop=10))
    assert found.stands and found.turn == pytest.approx(np.arcsin(1 / 3), abs=EXACT)
    assert not compounds.collide(plank.moved(found.T).parts, shelf.parts)


def test_what_would_turn_too_far_or_drop_too_low_stays_and_says_so() -> None:
    shelf = body(1, block(), fixed=True)
    plank = body(0, block((0.4, 0.05, 0.02), (0.15, 0, 0.3)))
    for limits in (LandingConfig(max_turn=0.2), LandingConfig(max_turn=1.0, max_drop=0.1)):
        found = land(plank, [shelf], limits)
        assert found.tipped and not found.stands and np.array_equal(found.T, np.eye(4))


def test_what_stands_is_only_lowered() -> None:
    found = land(body(0, block(at=(0.3, 0.1, 0.2))), [], LandingConfig(max_turn=1.0, max_drop=10))
    assert found.stands and np.allclose(found.T, pose(t=(GAP - 0.15) * UP), atol=1e-9)


def test_a_turn_of_the_world_turns_the_landing() -> None:
    T = pose(rotation_about(UP, 0.9), [0.3, -1, 0])
    thing, shelf = tilted([1, 2, 0.4], 25), body(1, block((0.3, 0.3, 0.1)), fixed=True)
    once = land(thing, [shelf], LandingConfig(max_turn=1.0, max_drop=10))
    again = land(thing.moved(T), [shelf.moved(T)], LandingConfig(max_turn=1.0, max_drop=10))
    assert np.allclose(again.T @ T, T @ once.T, atol=1e-4)


@pytest.mark.parametrize("seed", range(7))
def test_it_ends_as_damped_physics_does_and_rests(seed: int) -> None:
    """Bodies a few degrees off their rest, on a slab: the same face down, within what contacts give."""
    rng = np.random.default_rng(seed)
    slab = replace(stacks.thing(1, "slab", pose(t=0.04 * UP)), mobility="fixed")
    kind = str(rng.choice(["box", "can", "angle", "table"]))
    axis = np.r_[rng.normal(size=2), 0.0]
    R = rotation_about(axis, np.radians(rng.uniform(2, 8))) @ rotation_about(UP, float(rng.uniform(0, 6)))
    thing = stacks.thing(0, kind, pose(R, [*rng.uniform(-0.01, 0.01, 2), 0.3]))
    low = min(p.bounds[0, 2] for p in stacks.world_parts(thing))
    thing = replace(thing, T_world_object=pose(t=(0.0805 - low) * UP) @ thing.T_world_object)
    found = land(bodies_of([thing])[0], bodies_of([slab]), LandingConfig(max_turn=0.6, max_drop=10))
    assert found.stands
    ours = found.T @ thing.T_world_object
    theirs = settling.settle([thing, slab]).T_world_object[0]
    assert rotation_angle(ours[:3, :3].T @ theirs[:3, :3]) < np.radians(2.5)
    up = (ours[2, :3], theirs[2, :3])
    assert np.degrees(np.arccos(np.clip(up[0] @ up[1], -1, 1))) < 0.1
    rests = replace(thing, T_world_object=ours)
    assert release.release([rests, slab], seconds=1).D_max < 2e-4


def test_what_would_tip_over_an_edge_is_shifted_over_it_when_that_is_allowed() -> None:
    """Tilted and 5 mm too far out: it is brought in by that and the margin, and lies flat."""
    shelf = body(1, block((0.1, 0.3, 0.1)), fixed=True)
    thing = body(0, block((0.1, 0.1, 0.2), (0.055, 0, 0.3), R=rotation_about([1, 0, 0], 0.03)))
    assert land(thing, [shelf], LandingConfig(max_shift=0.0)).tipped
    found = land(thing, [shelf], LandingConfig(max_shift=0.2))
    assert found.stands and found.shift == pytest.approx(0.005 + 0.1 * 0.03, abs=1e-3)
    assert thing.moved(found.T).parts[0].bounds[0, 2] == pytest.approx(0.1 + GAP, abs=2e-5)


def test_what_leans_on_a_wall_stays() -> None:
    R = rotation_about([0, 1, 0], -np.radians(65))
    plank = block((0.4, 0.1, 0.01), R=R)
    plank = plank.shifted((-plank.bounds[1, 0], 0, -plank.bounds[0, 2]))
    wall = body(1, block((0.1, 1, 3), (0.05, 0, 1.5)), fixed=True)
    found = land(body(0, plank), [wall], LandingConfig(max_turn=1.5))
    assert found.stands and found.turn < EXACT
