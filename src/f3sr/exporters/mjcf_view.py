"""The first sight of a MuJoCo file: where the viewer stands, its lights, the photo's camera and the state at rest."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as ET

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, quaternion_from_rotation
from f3sr.exporters.xml_text import numbers
from f3sr.physics.mujoco_model import Body

FOVY = np.radians(45)
"""Angle of view of MuJoCo's free camera."""
DISTANCE = 1.5
"""Distance of MuJoCo's free camera from what it looks at [extents]."""
LEAST_PICTURE, MOST_PICTURE = (640, 480), 16_384
"""Sides of the off-screen picture [px]: MuJoCo's defaults, and the most that graphics cards take."""
SENSOR = 0.036
"""Width of the photo's sensor [m]; MuJoCo wants one, and only its ratio to the focal length shows."""
LAMP = np.array([0.36, 0.0, -1.0])
"""Where the lamp's light goes: along one axis of MuJoCo's shadow map. Its depths are moved by 1.5 texels of the steeper
slope. Along both axes, neighbours differed by more, and specks covered the ground."""
REST = "rest"
"""The keyframe of the package's state."""
PHOTO = "photo"
"""The camera of the photo."""


def add_view(root: ET.Element, bounds: Array, forward: Array, picture: tuple[int, int] = LEAST_PICTURE) -> None:
    """What the viewer shows first: the box ``bounds`` (2, 3) [m], all of it, looking along ``forward`` (3,).

    ``picture`` is the size [px] that off-screen renderers may have.
    """
    extent = _extent(bounds)
    ET.SubElement(root, "statistic", center=numbers(bounds.mean(0)), extent=numbers(extent))
    visual = ET.SubElement(root, "visual")
    width, height = (min(max(a, b), MOST_PICTURE) for a, b in zip(picture, LEAST_PICTURE, strict=True))
    x, y, z = forward / np.linalg.norm(forward)
    ET.SubElement(
        visual,
        "global",
        azimuth=numbers(float(np.degrees(np.arctan2(y, x)))),
        elevation=numbers(float(np.degrees(np.arcsin(z)))),
        offwidth=str(width),
        offheight=str(height),
    )
    # Half of the light from the viewer, half from the lamp above: no side is black, and shadows still show.
    ET.SubElement(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.35 0.35 0.35", specular="0 0 0")


def add_sky(asset: ET.Element) -> None:
    """A light background, before which dark objects show."""
    ET.SubElement(
        asset,
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1="0.9 0.93 0.96",
        rgb2="0.6 0.67 0.75",
        width="32",
        height="32",
    )


def add_lamp(world: ET.Element, bounds: Array) -> None:
    """A lamp above the box ``bounds`` (2, 3) [m], for shadows; MuJoCo draws those around where it stands."""
    ET.SubElement(
        world,
        "light",
        name="lamp",
        directional="true",
        pos=numbers(bounds.mean(0) - _extent(bounds) * LAMP),
        dir=numbers(LAMP),
        diffuse="0.5 0.5 0.5",
        specular="0.1 0.1 0.1",
    )


def _extent(bounds: Array) -> float:
    """What MuJoCo's free camera has to be told to see a box (2, 3) [m] whole."""
    return float(np.linalg.norm(bounds[1] - bounds[0]) / 2 / np.sin(FOVY / 2) / DISTANCE)


def add_camera(world: ET.Element, camera: Camera) -> None:
    """The photo's camera, its principal point included; MuJoCo has no skew.

    MuJoCo's window reaches from ``-(w/2 - px)`` to ``w/2 + px`` pixels right of its axis, and as far downwards.
    """
    R, K = camera.T_world_camera[:3, :3], camera.K
    ET.SubElement(
        world,
        "camera",
        name=PHOTO,
        pos=numbers(camera.center),
        xyaxes=numbers([*R[:, 0], *-R[:, 1]]),
        resolution=f"{camera.width} {camera.height}",
        sensorsize=numbers([SENSOR, SENSOR * camera.height / camera.width]),
        focalpixel=numbers([K[0, 0], K[1, 1]]),
        principalpixel=numbers([camera.width / 2 - K[0, 2], camera.height / 2 - K[1, 2]]),
    )


def add_keyframe(root: ET.Element, bodies: Sequence[Body]) -> None:
    """The bodies where they are, as a state to return to."""
    places = [
        [*body.T_world_body[:3, 3], *quaternion_from_rotation(body.T_world_body[:3, :3])]
        for body in bodies
        if not body.fixed
    ]
    if places:
        ET.SubElement(ET.SubElement(root, "keyframe"), "key", name=REST, qpos=numbers(np.concatenate(places)))
