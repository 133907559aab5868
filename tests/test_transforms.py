"""Laws of poses and of the camera."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from f3sr.core.camera import Camera
from f3sr.core.transforms import (
    invert_pose,
    pose,
    quaternion_from_rotation,
    rotation_about,
    rotation_angle,
    rotation_between,
    rotation_from_quaternion,
    rotation_from_vector,
    transform,
)

vectors = arrays(float, 3, elements=st.floats(-3, 3, width=32)).filter(lambda v: np.linalg.norm(v) > 1e-2)


@given(vectors, vectors, vectors)
def test_inverse_pose_undoes_the_pose(omega, t, x):
    T = pose(rotation_from_vector(omega), t)
    assert np.allclose(transform(invert_pose(T), transform(T, x)), x, atol=1e-9)


@given(vectors, vectors)
def test_rotation_between_turns_a_onto_b_and_is_shortest(a, b):
    R = rotation_between(a, b)
    assert np.allclose(R @ a / np.linalg.norm(a), b / np.linalg.norm(b), atol=1e-9)
    angle = np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
    assert rotation_angle(R) == pytest.approx(angle, abs=1e-6)


def test_rotation_between_opposite_directions():
    R = rotation_between([0, 0, 1], [0, 0, -1])
    assert np.allclose(R @ [0, 0, 1], [0, 0, -1]) and np.linalg.det(R) == pytest.approx(1)


@given(vectors)
def test_quaternions_round_trip_as_wxyz(omega):
    R = rotation_from_vector(omega)
    q = quaternion_from_rotation(R)
    assert q[0] >= 0
    assert np.allclose(rotation_from_quaternion(q), R, atol=1e-9)


def test_many_quaternions_give_the_matrices_of_each():
    q = np.random.default_rng(0).normal(size=(5, 4))
    assert np.array_equal(rotation_from_quaternion(q), [rotation_from_quaternion(one) for one in q])


def test_quarter_turn_has_its_textbook_quaternion():
    half = np.sqrt(0.5)
    assert np.allclose(quaternion_from_rotation(rotation_about([0, 0, 1], np.pi / 2)), [half, 0, 0, half])


def camera(**changes) -> Camera:
    K = np.array([[500.0, 0, 310], [0, 520, 250], [0, 0, 1]])
    values = {"width": 640, "height": 480, "K": K, "T_world_camera": np.eye(4)} | changes
    return Camera(**values)


def test_pixel_convention_centre_of_the_first_pixel_is_half():
    x = np.linalg.inv(camera().K) @ [0.5, 0.5, 1]
    uv, z = camera().project(2 * x[None])
    assert np.allclose(uv, 0.5) and z[0] == pytest.approx(2)


def test_resized_camera_sees_the_same_directions():
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 2.0]])
    full, _ = camera().project(points)
    small, _ = camera().resized(320, 120).project(points)
    assert np.allclose(small, full * [0.5, 0.25])


def test_cropped_camera_sees_the_same_pixels_shifted():
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 2.0]])
    full, _ = camera().project(points)
    part, _ = camera().cropped(30, -10, 100, 50).project(points)
    assert np.allclose(part, full - [30, -10])


@given(vectors, vectors)
def test_moving_world_and_camera_together_changes_no_pixel(omega, t):
    T = pose(rotation_from_vector(omega), t)
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 2.0]])
    before, _ = camera().project(points)
    after, _ = camera(T_world_camera=T).project(transform(T, points))
    assert np.allclose(before, after, atol=1e-6)


def test_the_angle_of_nearly_no_rotation_is_as_exact_as_its_matrix() -> None:
    """Matrices of many products are off by 1e-9: an arc cosine made 5e-5 rad of that."""
    assert rotation_angle((1 - 1e-9) * np.eye(3)) == 0
    for angle in (1e-9, 1e-5, 1.0, np.pi - 1e-6, np.pi):
        R = (1 + 1e-9) * rotation_about(np.array([0.6, 0.0, 0.8]), angle)
        assert rotation_angle(R) == pytest.approx(angle, rel=1e-6)
