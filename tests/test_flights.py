"""Throws into openings: what is hardly narrower comes down with its longest axis upright."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from f3sr.core.transforms import UP, Array, rotation_about, rotation_from_vector
from f3sr.launches import flights
from f3sr.launches.launch_context import LaunchContext

SIZES = np.array([0.06, 0.066, 0.1])


def context(R: Array, radius: float | None = None) -> LaunchContext:
    """Of a box of ``SIZES`` turned by R (3, 3), and a target with an opening of so much radius [m]."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    pool = None if radius is None else SimpleNamespace(radius=radius)
    layout: Any = SimpleNamespace(corners=lambda _: (signs * SIZES) @ R.T, pool=lambda _: pool)
    return cast(LaunchContext, SimpleNamespace(layout=layout, active=0, target=1))


@pytest.mark.parametrize("seed", range(8))
def test_the_spin_turns_the_longest_axis_upright_by_the_shorter_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    R, seconds = rotation_about(axis / np.linalg.norm(axis), rng.uniform(0, np.pi)), rng.uniform(0.2, 1.5)
    turn = seconds * flights._turned_upright(context(R), seconds)
    assert abs((rotation_from_vector(turn) @ R[:, 2]) @ UP) == pytest.approx(1)
    assert np.linalg.norm(turn) <= np.pi / 2 + 1e-9 and turn @ UP == pytest.approx(0, abs=1e-9)


def test_what_stands_upright_is_not_turned() -> None:
    assert flights._turned_upright(context(np.eye(3)), 0.5) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("radius", "tight"), [(None, False), (0.035, True), (0.046, True), (0.048, False), (0.1, False)]
)
def test_an_opening_is_tight_where_the_middle_extent_hardly_passes(radius: float | None, tight: bool) -> None:
    assert flights._is_tight(context(np.eye(3), radius)) == tight
