"""Resting facets of solids whose equilibria are known, and the least turn onto one."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.contact.stable_facets import resting_turn, stable_normals
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import rotation_about
from scenes import box_mesh

BOX = ConvexPart.hull_of(box_mesh((0.1, 0.2, 0.3)).vertices)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.05, 0.05, 0.2]
LEANING = ConvexPart.hull_of(CORNERS + CORNERS[:, 2:] * [1.0, 0, 0])
"""A prism that leans by 45 degrees: its middle is beyond its base."""


def directions(normals: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(n) for n in np.round(normals, 6) + 0.0}


def test_a_box_rests_on_all_six_sides() -> None:
    assert directions(stable_normals(BOX, np.array([0.01, 0.02, 0.03]))) == {
        tuple(float(v) for v in s * axis + 0.0) for axis in np.eye(3) for s in (-1, 1)
    }


def test_what_leans_too_far_does_not_rest_on_its_base() -> None:
    found = directions(stable_normals(LEANING, np.zeros(3)))
    assert found and not any(abs(n[2]) == 1 for n in found)
    assert (0.0, 0.0, -1.0) in directions(stable_normals(LEANING, np.array([-0.2, 0, -0.2 + 0.01])))


@pytest.mark.parametrize(("degrees", "turn"), [(0, 0), (10, -10), (44, -44), (46, 44), (80, 10)])
def test_a_tilted_box_turns_onto_the_nearer_side(degrees: float, turn: float) -> None:
    R = rotation_about([1, 0, 0], np.radians(degrees))
    found = resting_turn(BOX, np.zeros(3), R, max_tilt=np.radians(45))
    assert found is not None and np.allclose(found, rotation_about([1, 0, 0], np.radians(turn)), atol=1e-9)


def test_beyond_the_largest_tilt_there_is_none() -> None:
    R = rotation_about([1, 0, 0], np.radians(10))
    assert resting_turn(BOX, np.zeros(3), R, max_tilt=np.radians(9.9)) is None
    assert resting_turn(BOX, np.zeros(3), R, max_tilt=np.radians(10.1)) is not None
    assert resting_turn(BOX, np.array([9.0, 9, 9]), R, max_tilt=np.pi) is None, "its centre is over no side"
