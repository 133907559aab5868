"""The ground plane from points and normals: what each is worth, and the focal length on which both agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from f3sr.core.transforms import Array, rotation_about
from f3sr.vision.ground_plane import (
    LEAN,
    FocalLength,
    GroundNormal,
    agreeing,
    combined,
    fit_plane,
    focal_length,
    normal_of,
    plane_errors,
)

PIXELS = np.stack(np.meshgrid(np.linspace(-0.45, 0.45, 64), np.linspace(-0.1, 0.35, 48)), -1).reshape(-1, 2)
"""Rays (x / z, y / z) of a picture of the ground."""


def ground(pitch: float, roll: float = 0.0) -> Array:
    """The unit normal (3,) of a ground that a camera sees ``pitch`` [rad] below its axis."""
    return rotation_about([0, 0, 1], roll) @ [0.0, -np.cos(pitch), -np.sin(pitch)]


def seen(normal: Array, *, stretch: float = 1.0, noise: Array | float = 0.0) -> Array:
    """Points (n, 3) of the ground 1 m below, at the rays of ``PIXELS``, under a focal length 1 / stretch times the true
    one, their depths times exp(noise)."""
    rays = np.column_stack([PIXELS, np.ones(len(PIXELS))])
    depth = -np.exp(noise) / (rays @ normal)
    return depth[:, None] * rays * [stretch, stretch, 1]


def exactly(normal: Array) -> GroundNormal:
    return GroundNormal(normal=normal, error=1e-4)


@given(pitch=st.floats(0.45, 1.2), roll=st.floats(-0.3, 0.3), stretch=st.floats(0.8, 1.25), strays=st.floats(0, 0.1))
def test_the_focal_length_is_that_on_which_points_and_normals_agree(
    pitch: float, roll: float, stretch: float, strays: float
):
    """Also where depths are mixed at edges."""
    normal = ground(pitch, roll)
    points = seen(normal, stretch=stretch)
    mixed = np.random.default_rng(0).random(len(points)) < strays
    points[mixed] *= np.random.default_rng(1).uniform(0.6, 0.9, mixed.sum())[:, None]
    found = focal_length(points, exactly(normal))
    assert found is not None
    # Points go with stretch across the axis, as under a focal length of 1 / stretch.
    assert found.factor == pytest.approx(stretch, rel=2e-3)


@pytest.mark.parametrize("pitch", [np.pi / 2 - 0.01, 0.01])
def test_a_ground_seen_from_above_or_edge_on_tells_no_focal_length(pitch: float):
    points = np.random.default_rng(0).normal([0, 0, 3], 1, size=(500, 3))
    assert focal_length(points, exactly(ground(pitch))) is None


@pytest.mark.parametrize("rows", [1, 2])
def test_a_line_of_pixels_or_a_few_tell_no_focal_length(rows: int):
    points = seen(ground(0.6))
    assert focal_length(points[: 64 * rows : 2 // rows], exactly(ground(0.6))) is None
    assert focal_length(points[:: len(points) // 50], exactly(ground(0.6))) is None


def wavy(rng: np.random.Generator) -> Array:
    """Noise of logarithms of depths that is smooth over the picture, 2 %."""
    a, b = rng.uniform(0, 2 * np.pi, 2)
    k = rng.uniform(4, 12, 2)
    return 0.02 * np.sqrt(2) * np.sin(k[0] * PIXELS[:, 0] + a) * np.sin(k[1] * PIXELS[:, 1] + b)


def test_the_error_of_the_focal_length_covers_it_and_weighing_halves_the_variance():
    rng = np.random.default_rng(3)
    rows = []
    for _ in range(40):
        normal, stretch = ground(rng.uniform(0.5, 0.9)), np.exp(rng.normal(0, 0.03))
        found = focal_length(seen(normal, stretch=stretch, noise=wavy(rng)), exactly(normal))
        assert found is not None
        factors = np.array([found.factor, found.shrunk(0.03), 1.0])
        rows.append([found.error, *np.log(factors / stretch)])
    error, alone, weighed, given = np.array(rows).T
    assert (np.abs(alone) <= 2 * error).mean() >= 0.9
    assert np.mean(weighed**2) < 0.5 * np.mean(given**2)


def test_a_principal_point_that_is_off_is_within_the_error():
    """It turns all rays alike, which shows in nothing but the focal length, most where the ground is seen flat."""
    for pitch in (0.4, 0.8):
        normal = ground(pitch)
        points = seen(normal)
        points[:, 1] += 0.008 * points[:, 2]
        found = focal_length(points, exactly(normal), center=0.008)
        assert found is not None
        assert 0.5 * found.error < abs(np.log(found.factor)) < 1.5 * found.error


def test_an_exact_focal_length_stays():
    assert FocalLength(factor=1.2, error=0.01).shrunk(0.0) == 1.0
    assert FocalLength(factor=1.2, error=0.03).shrunk(0.03) == pytest.approx(np.sqrt(1.2))


def test_normals_weigh_by_their_inverse_variances():
    a = ground(0.5)
    b = rotation_about([1, 0, 0], 0.02) @ a
    both = combined(GroundNormal(normal=a, error=0.01), GroundNormal(normal=b, error=0.02))
    assert np.arccos(np.clip(both.normal @ a, -1, 1)) == pytest.approx(0.02 / 5, rel=1e-3)
    assert both.error == pytest.approx(0.02 / np.sqrt(5))
    unknown = combined(GroundNormal(normal=a, error=np.inf), GroundNormal(normal=b, error=0.02))
    assert np.allclose(unknown.normal, b) and unknown.error == pytest.approx(0.02)


def test_normals_that_differ_from_place_to_place_are_trusted_by_as_much():
    rng = np.random.default_rng(0)
    points, normal = seen(ground(0.6)), ground(0.6)
    even = normal + 0.02 * rng.normal(size=points.shape)
    leaning = np.where(points[:, :1] > 0, 0.05, -0.05) * [1.0, 0, 0]
    known, doubted = (normal_of(points, n / np.linalg.norm(n, axis=1, keepdims=True)) for n in (even, even + leaning))
    assert np.arccos(known.normal @ normal) < LEAN < known.error < 0.02 < 0.08 < doubted.error


def test_only_agreeing_normals_vote_from_either_side():
    normal = np.array([0.0, -1, 0])
    tilted = rotation_about([1, 0, 0], np.radians(2)) @ normal
    far = rotation_about([1, 0, 0], np.radians(60)) @ normal
    agree, turned, share = agreeing(np.array([tilted] * 4 + [-tilted] * 4 + [far] * 2 + [[np.nan] * 3] * 5), normal)
    assert share == 0.8 and agree.tolist() == [True] * 8 + [False] * 7
    assert np.allclose(turned[agree], tilted)
    assert agreeing(np.zeros((0, 3)), normal)[2] == 0.0


def test_strays_metres_away_tilt_nothing():
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(-1, 1, (5000, 2)), np.zeros(5000)]) + rng.normal(0, 0.003, (5000, 3))
    R = rotation_about([1, 0, 0], 2.2)
    points = plane @ R.T + [0, 0.2, 1.5]
    strays = rng.uniform([-3, -3, 0.5], [3, 3, 9], (2500, 3))
    fitted = fit_plane(np.concatenate([points, strays]), rng, 0.015)
    normal = R @ [0, 0, 1] * np.sign(-(R @ [0, 0, 1])[1])
    assert np.degrees(np.arccos(np.clip(fitted.normal @ normal, -1, 1))) < 0.1
    assert fitted.normal[1] < 0 and fitted.offset == pytest.approx(normal @ [0, 0.2, 1.5], abs=1e-3)


@pytest.mark.parametrize("wave", [0.0, 0.002], ids=["independent", "correlated"])
def test_the_error_of_a_plane_covers_the_truth(wave: float):
    """Independent noise: two standard errors, no more. Noise that neighbours share: no less, although the residual
    over the square root of n would be a tenth of it."""
    rng = np.random.default_rng(4)
    rows = []
    for _ in range(20):
        x, y = rng.uniform(-0.5, 0.5, (2, 4000))
        a, b = rng.uniform(0, 2 * np.pi, 2)
        z = 0.001 * rng.normal(size=len(x)) + wave * np.sin(8 * x + a) * np.sin(8 * y + b)
        true = np.linalg.lstsq(np.column_stack([x, y, np.ones_like(x)]), z)[0]
        rows.append([np.hypot(true[0], true[1]), abs(true[2]), *plane_errors(np.column_stack([x, y, z]))])
    tilt, height, tilt_error, height_error = np.array(rows).T
    assert (tilt <= tilt_error).mean() >= 0.9 and (height <= height_error).mean() >= 0.8
    if not wave:
        assert np.median(tilt_error) < 4 * np.sqrt(np.mean(tilt**2))
        assert np.median(height_error) < 4 * np.sqrt(np.mean(height**2))
