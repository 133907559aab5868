"""Words of direction, as somebody at the camera means them, and the vectors of the world that they are.

``forward``, ``away`` and ``to the back`` lead away from the camera; ``backward``, ``towards me`` and ``to the front``
lead to it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Literal

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array

Direction = Literal["left", "right", "away", "towards", "up", "down"]

SIDES: dict[str, Direction] = {
    "left": "left",
    "right": "right",
    "back": "away",
    "rear": "away",
    "background": "away",
    "front": "towards",
    "foreground": "towards",
}
"""Said with ``to the``, or bare after an object: ``to the back left``, ``push it right``."""
HEADINGS: dict[str, Direction] = {
    "leftwards": "left",
    "leftward": "left",
    "rightwards": "right",
    "rightward": "right",
    "forward": "away",
    "forwards": "away",
    "ahead": "away",
    "away": "away",
    "backward": "towards",
    "backwards": "towards",
    "closer": "towards",
    "nearer": "towards",
    "up": "up",
    "upwards": "up",
    "upward": "up",
    "skywards": "up",
    "vertically": "up",
    "downwards": "down",
}
"""Directions by themselves."""
OPPOSITE: dict[Direction, Direction] = {
    "left": "right",
    "right": "left",
    "away": "towards",
    "towards": "away",
    "up": "down",
    "down": "up",
}
VIEWER = {"me", "us", "camera", "viewer", "myself", "observer", "photographer"}
STEEP = 0.2
"""Horizontal part of the viewing direction below which the camera looks down and the photo's up is away."""


def contradict(directions: Collection[Direction]) -> bool:
    """Whether two of the directions are opposite."""
    return any(OPPOSITE[d] in directions for d in directions)


def world_vector(directions: Sequence[Direction], camera: Camera) -> Array:
    """The unit vector (3,) of the world of some directions together, seen from a camera. Left is against the camera's
    x axis and away along its z axis, both laid on the ground. ValueError where they cancel out."""
    total = np.sum([_vector(d, camera) for d in directions], axis=0) if directions else np.zeros(3)
    length = float(np.linalg.norm(total))
    if length < 1e-6:
        raise ValueError(f"directions {list(directions)} lead nowhere; accepted: some that are not opposite")
    return total / length


def _vector(direction: Direction, camera: Camera) -> Array:
    if direction in ("up", "down"):
        return UP if direction == "up" else -UP
    if direction in ("left", "towards"):
        return -_vector(OPPOSITE[direction], camera)
    x, y, z = camera.T_world_camera[:3, :3].T
    axis = x if direction == "right" else z if np.hypot(z[0], z[1]) > STEEP else -y
    flat = np.array([axis[0], axis[1], 0.0])
    return flat / max(float(np.linalg.norm(flat)), 1e-12)
