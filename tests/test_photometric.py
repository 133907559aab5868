"""The flow of a surface in the image against its projection a moment later."""

from __future__ import annotations

import numpy as np

from f3sr.core.transforms import rotation_from_vector
from f3sr.vision import photometric

K = np.array([[300.0, 4.0, 150], [0, 320, 110], [0, 0, 1]])


def projected(points: np.ndarray) -> np.ndarray:
    p = points @ K.T
    return p[:, :2] / p[:, 2:]


def test_the_flow_is_the_projection_s_derivative() -> None:
    """Points all over a wide image, that shift, come nearer and turn."""
    rng = np.random.default_rng(0)
    pixels, depth = rng.integers(0, [220, 300], (50, 2)), rng.uniform(0.5, 2, 50)
    rays = np.column_stack([pixels[:, 1] + 0.5, pixels[:, 0] + 0.5, np.ones(50)]) @ np.linalg.inv(K).T
    points, h = rays * depth[:, None], 1e-6
    turn, shift = np.array([0.3, -0.2, 0.5]), np.array([0.1, 0.2, -0.4])
    skew = (rotation_from_vector(1e-7 * turn) - rotation_from_vector(-1e-7 * turn)) / 2e-7
    velocities = np.stack([np.column_stack([np.zeros((3, 3)), shift]), np.column_stack([skew, np.zeros(3)])])
    found = photometric._flow(pixels, depth, K, velocities)
    for v, flow in zip(velocities, found, strict=True):
        step = h * (points @ v[:, :3].T + v[:, 3])
        expected = (projected(points + step) - projected(points - step)) / (2 * h)
        assert np.allclose(flow.T, expected, atol=1e-3 * np.abs(expected).max())
