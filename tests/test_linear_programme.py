"""Linear programmes: as scipy solves each anew, whatever was solved before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from f3sr.contact.linear_programme import LinearProgramme


@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.integers(1, 9))
def test_solved_again_it_has_the_optimum_of_a_new_programme(seed: int, k: int, n: int):
    """Some right sides have no answer."""
    random = np.random.default_rng(seed)
    rows, high = random.normal(size=(k, n)), random.uniform(0.5, 2, n)
    programme = LinearProgramme(np.zeros(n), rows, np.zeros(k), high=high)
    for _ in range(4):
        cost, equal = random.normal(size=n), rows @ random.uniform(-0.2, 0.8, n)
        found = programme.solve(cost=cost, equal=equal)
        wanted = linprog(cost, A_eq=rows, b_eq=equal, bounds=np.stack([np.zeros(n), high], axis=1), method="highs")
        assert (found is None) == (wanted.status == 2)
        if found:
            assert found.value == pytest.approx(wanted.fun, abs=1e-7) == pytest.approx(cost @ found.x, abs=1e-7)
            assert rows @ found.x == pytest.approx(equal, abs=1e-6)
            assert (found.x >= -1e-9).all() and (found.x <= high + 1e-9).all()


def test_duals_are_rates_of_the_cost():
    programme = LinearProgramme(np.array([1.0, 3.0]), np.array([[1.0, 1.0]]), np.ones(1), high=0.75)
    found = programme.solve()
    assert found and found.x == pytest.approx([0.75, 0.25]) and found.duals == pytest.approx([3.0])
    more = programme.solve(equal=np.array([1.25]))
    assert more and more.value - found.value == pytest.approx(0.25 * 3.0)


def test_rows_that_are_added_bind_it():
    programme = LinearProgramme(np.array([-1.0, -1.0]), np.array([[1.0, -1.0]]), np.zeros(1), high=5.0)
    assert [*programme.solve().x] == pytest.approx([5, 5])  # pyright: ignore[reportOptionalMemberAccess]
    programme.add(np.array([[1.0, 2.0]]), np.array([3.0]))
    found = programme.solve()
    assert found and found.x == pytest.approx([1, 1])


def test_without_an_answer_it_says_so():
    never = LinearProgramme(np.ones(1), np.ones((1, 1)), -np.ones(1))
    assert never.solve() is None
    assert never.solve(equal=np.ones(1)) is not None
    unbounded = LinearProgramme(-np.ones(2), np.array([[1.0, -1.0]]), np.zeros(1))
    assert unbounded.solve() is None


def test_the_solver_prints_nothing(capfd: pytest.CaptureFixture[str]):
    LinearProgramme(np.ones(1), np.ones((1, 1)), np.ones(1)).solve()
    assert capfd.readouterr() == ("", "")
