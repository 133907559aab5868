"""Axes of normals: every convention is found by points, and by the photo; what nothing tells is not guessed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from f3sr.core.transforms import Array, rotation_about
from f3sr.neural.pixel_rays import rays
from f3sr.vision.normal_axes import (
    AxisSigns,
    angle_to_points,
    axis_signs,
    normals_of_points,
    signs_by_outlines,
    signs_by_points,
)

W, H, F = 96, 72, 80.0
K = np.array([[F, 0, W / 2], [0, F, H / 2], [0, 0, 1]])
UP = rotation_about([1, 0, 0], np.radians(35)) @ [0, -1, 0]
AXES = tuple(map("".join, itertools.product("rl", "du", "fb")))
BALL, RADIUS = np.array([0.05, 0.1, 1.0]), 0.25


def seen() -> tuple[Array, Array, NDArray[np.bool_]]:
    """Points and normals (H, W, 3) of a ball over a ground .8 m below the camera, and the ball's mask (H, W)."""
    r = rays(K, W, H)
    with np.errstate(divide="ignore"):
        t = -0.8 / (r @ UP)
    ground = t > 0
    a, b, c = (r * r).sum(2), r @ BALL, BALL @ BALL - RADIUS**2
    root = b * b - a * c
    ball = root > 0
    near = (b - np.sqrt(np.maximum(root, 0))) / a
    points = r * np.where(ball, near, np.where(ground, t, 5.0))[..., None]
    normals = np.where(ball[..., None], (points - BALL) / RADIUS, np.where(ground[..., None], UP, [0, 0, -1.0]))
    return points, normals, ball


@pytest.mark.parametrize("axes", AXES)
def test_every_convention_is_found_by_points_and_by_the_photo(axes: str):
    points, normals, ball = seen()
    scrambled = axis_signs(axes)
    assert scrambled is not None and scrambled.letters == axes
    values = (normals * scrambled.signs)[::2, ::2]  # another resolution
    valid = np.ones((H, W), bool)
    by_points = signs_by_points(values, points, valid)
    assert by_points.letters == signs_by_outlines(values, [ball], ~ball).letters == axes
    assert angle_to_points(values * by_points.signs, points, valid) < np.radians(2)
    assert axes[1:] == "df" or angle_to_points(values, points, valid) > np.radians(35)


def test_what_nothing_tells_is_a_question_mark():
    """A ground alone extends along two axes, and has no sides."""
    points, _, ball = seen()
    normals = np.broadcast_to(UP, (H, W, 3))
    assert signs_by_outlines(normals, [], ~ball).letters == "?df"
    assert signs_by_outlines(np.zeros((H, W, 3)), [ball], ~ball).letters == "???"
    noise = np.random.default_rng(0).standard_normal((H, W, 3))
    noise /= np.linalg.norm(noise, axis=2, keepdims=True)
    assert "?" in signs_by_points(noise, points, np.ones((H, W), bool)).letters
    told = AxisSigns(signs=np.array([0.0, 1, -1])).or_else(AxisSigns(signs=np.array([-1.0, -1, 1])))
    assert told.letters == "ldb"


@pytest.mark.parametrize("axes", ["", "rd", "rdfb", "ddf", "frd", "RDF", "xyz"])
def test_other_letters_are_no_axes(axes: str):
    assert axis_signs(axes) is None


def test_normals_of_points_are_exact_on_planes_and_none_where_depth_jumps():
    points, normals, ball = seen()
    own, found = normals_of_points(points, np.ones((H, W), bool))
    inside = np.zeros_like(ball)
    inside[2:-2, 2:-2] = ~ball[2:-2, 2:-2] & (np.abs(normals[2:-2, 2:-2] - UP).max(2) < 1e-9)
    flat = found & inside
    for moved in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        flat &= np.roll(inside, moved, (0, 1))
    assert flat.sum() > 1000 and np.abs(own[flat] - UP).max() < 1e-9
    step = points.copy()
    step[:, W // 2 :] *= 1.5
    _, found = normals_of_points(step, np.ones((H, W), bool))
    assert not found[:, W // 2 - 1 : W // 2 + 1].any()
    nothing, found = normals_of_points(points[:2, :2], np.ones((2, 2), bool))
    assert not found.any() and not nothing.any()
    assert np.isnan(angle_to_points(normals, points, np.zeros((H, W), bool)))
