"""The fit of relative inverse depths to a plane: planted scale and shift, outliers, grounds that tell nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from f3sr.errors import InputError
from f3sr.metrology.affine_depth import fit_affine_depth


def plane(n: int = 2000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depths [1/m] of a ground from .8 to 3 m, and the strip that each pixel lies in."""
    rng = np.random.default_rng(seed)
    inverse = rng.uniform(1 / 3, 1 / 0.8, n)
    return inverse, (16 * (inverse - 1 / 3) / (1 / 0.8 - 1 / 3)).astype(int)


@given(scale=st.floats(1e-4, 1e4), shift=st.floats(-5, 5))
def test_planted_scale_and_shift_come_back(scale: float, shift: float):
    inverse, groups = plane()
    fit = fit_affine_depth((inverse - shift) / scale, inverse, groups, "x")
    assert fit.scale == pytest.approx(scale, rel=1e-6) and fit.shift == pytest.approx(shift, abs=1e-6)
    assert fit.inliers == 1 and fit.residual < 1e-8 and fit.pixels == len(inverse)
    assert fit.error((1.0 - shift) / scale) < 1e-6


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45])
def test_pixels_that_are_not_of_the_ground_change_nothing(share: float):
    inverse, groups = plane()
    values = (inverse - 0.2) / 0.01
    wall = np.random.default_rng(1).random(len(values)) < share
    values[wall] = np.random.default_rng(2).uniform(0, 300, wall.sum())
    fit = fit_affine_depth(values, inverse, groups, "x")
    assert fit.scale == pytest.approx(0.01, rel=1e-3) and fit.shift == pytest.approx(0.2, abs=1e-3)
    assert fit.inliers == pytest.approx(1 - share, abs=0.03)


def test_the_doubt_is_about_the_error():
    """Noise of the network, alike within a strip: one jackknife error holds what the fit is really off."""
    off = []
    for seed in range(60):
        inverse, groups = plane(seed=seed)
        noise = np.random.default_rng(seed).normal(0, 0.02, 17)[groups]
        fit = fit_affine_depth((inverse + noise - 0.1) / 0.01, inverse, groups, "x")
        value = (0.9 - 0.1) / 0.01
        off.append((1 / fit.inverse(np.array(value)) / (1 / 0.9) - 1) / fit.error(value))
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 2


def test_farther_from_the_ground_is_more_in_doubt():
    inverse, groups = plane()
    noisy = (inverse + np.random.default_rng(0).normal(0, 0.02, len(inverse)) - 0.1) / 0.01
    fit = fit_affine_depth(noisy, inverse, groups, "x")
    assert fit.error(80.0) < fit.error(8.0) < fit.error(0.0) and fit.error(-100.0) == float("inf")


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda d, q: (d[:20], q[:20]), "20 pixels of the ground"),
        (lambda d, q: (np.where(np.arange(len(d)) < 30, d, np.nan), q), "30 pixels of the ground"),
        (lambda d, q: (d, 1 + 0.001 * q), "inverse depths differ by 0.1 %"),
        (lambda d, q: (np.full_like(d, 3.0), q), "one value for all of the ground"),
        (lambda d, q: (-d, q), "grow with the ground's distance"),
        (lambda d, q: (np.random.default_rng(9).random(len(d)), q), r"values that leave \d+ % of the deviations"),
    ],
)
def test_a_ground_that_tells_no_scale_is_one_error(change, found: str):  # type: ignore[no-untyped-def]
    inverse, groups = plane()
    values, known = change((inverse - 0.2) / 0.01, inverse)
    with pytest.raises(InputError, match=f"{found}.*to give relative depths a scale and a shift"):
        fit_affine_depth(values, known, groups[: len(values)], "depth-anything")


def test_the_same_pixels_give_the_same_fit_in_any_unit():
    inverse, groups = plane()
    noisy = (inverse + np.random.default_rng(0).normal(0, 0.02, len(inverse)) - 0.1) / 0.01
    a, b = fit_affine_depth(noisy, inverse, groups, "x"), fit_affine_depth(noisy, 10 * inverse, groups, "x")
    assert b.scale == pytest.approx(10 * a.scale) and b.shift == pytest.approx(10 * a.shift)
    assert b.residual == pytest.approx(a.residual)
