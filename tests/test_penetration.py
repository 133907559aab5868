"""R_pen: a share of the scene without units, the same for every surface that is the same."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.core.transforms import pose, rotation_about, transform
from f3sr.metrics.penetration import EDGE_LENGTH, Surface, penetration
from scenes import box


def crossed() -> list[Surface]:
    a, b = box(1), box(2, at=(0.06, 0.01, 0.07), R=rotation_about([1, 2, 3], 0.4))
    return [(o.vertices_world, o.mesh.faces) for o in (a, b)]


def moved(surfaces: list[Surface], T: np.ndarray, k: float = 1.0) -> list[Surface]:
    return [(k * transform(T, v), f) for v, f in surfaces]


def test_r_pen_is_crossings_times_the_mean_edge_by_the_diagonal() -> None:
    found = penetration(crossed())
    assert found.crossings > 100 and found.crossings == sum(pair.count for pair in found.pairs)
    assert found.r_pen / found.crossings == pytest.approx(EDGE_LENGTH, rel=0.3), "edges are about 1 % of it"


@pytest.mark.parametrize("k", [1e-2, 1e3])
def test_the_unit_does_not_matter(k: float) -> None:
    once, again = penetration(crossed()), penetration(moved(crossed(), np.eye(4), k))
    assert again.crossings == pytest.approx(once.crossings, rel=0.02)
    assert again.r_pen == pytest.approx(once.r_pen, rel=0.02)


def test_a_surface_inside_another_does_not_cross_it() -> None:
    inside = box(2, size=(0.02, 0.02, 0.02), at=(0, 0, 0.05))
    surfaces = [(o.vertices_world, o.mesh.faces) for o in (box(1), inside)]
    assert (penetration(surfaces).r_pen, penetration(surfaces).crossings) == (0.0, 0)


def test_order_changes_nothing_but_names() -> None:
    a, b = penetration(crossed()), penetration(crossed()[::-1])
    assert (a.crossings, a.r_pen) == (b.crossings, pytest.approx(b.r_pen))
    assert np.allclose(a.pairs[0].bounds, b.pairs[0].bounds)
    lifted = penetration(moved(crossed(), pose(t=[0, 0, 5])))
    assert np.allclose(lifted.pairs[0].bounds - [0, 0, 5], a.pairs[0].bounds, atol=1e-3)
