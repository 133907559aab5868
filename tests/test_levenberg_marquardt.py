"""The search inside a box: sums of objectives, and minima that are known."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.core.levenberg_marquardt import Local, minimise
from f3sr.core.transforms import Array

H = np.array([[2.0, 0.9], [0.9, 1.0]])
MIDDLE = np.array([0.4, -0.3])
ONES = np.ones(2)


def bowl(x: Array) -> Local:
    d = x - MIDDLE
    return Local(value=float(d @ H @ d) / 2, gradient=H @ d, curvature=H)


def test_sums_weights_and_priors_are_those_of_the_functions() -> None:
    """Value, gradient and curvature of 3 (bowl + sum w x^2) against central differences."""
    w, x, h = np.array([0.5, 2.0]), np.array([0.7, 0.2]), 1e-4

    def at(x: Array) -> Local:
        return (bowl(x).plus_squares(w, x) + bowl(x)).weighted(3)

    found = at(x)
    both = [(at(x + e), at(x - e)) for e in h * np.eye(2)]
    assert found.value == pytest.approx(3 * (2 * bowl(x).value + w @ x**2))
    assert found.gradient == pytest.approx([(a.value - b.value) / (2 * h) for a, b in both])
    assert found.curvature == pytest.approx(np.array([(a.gradient - b.gradient) / (2 * h) for a, b in both]))


def test_a_bowl_inside_the_box_is_found() -> None:
    found = minimise(bowl, -ONES, bounds=(-ONES, ONES), tolerance=1e-12)
    assert found.x == pytest.approx(MIDDLE, abs=1e-5) and found.value == pytest.approx(0, abs=1e-9)


def test_on_a_side_of_the_box_the_rest_is_the_best_there() -> None:
    """With x_0 held at .1 the best x_1 is where the second row of H (x - middle) is 0."""
    high = np.array([0.1, 1.0])
    found = minimise(bowl, np.array([-1.0, 1.0]), bounds=(-ONES, high), tolerance=1e-12)
    assert found.x == pytest.approx([0.1, MIDDLE[1] + 0.9 * 0.3], abs=1e-4)


def test_it_never_leaves_the_box_nor_gets_worse() -> None:
    """A valley that bends (Rosenbrock 1960): every point that is asked for is inside."""
    asked: list[Array] = []

    def valley(x: Array) -> Local:
        asked.append(x)
        r = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
        J = np.array([[-20 * x[0], 10.0], [-1, 0]])
        return Local(value=float(r @ r), gradient=2 * J.T @ r, curvature=2 * J.T @ J)

    start, low, high = np.array([-1.2, 1.0]), np.array([-1.5, -0.5]), np.array([1.5, 1.2])
    found = minimise(valley, start, bounds=(low, high), iterations=200, tolerance=0.0)
    assert all((low <= x).all() and (x <= high).all() for x in asked)
    assert found.x == pytest.approx([1, 1], abs=1e-3) and found.value < valley(start).value
