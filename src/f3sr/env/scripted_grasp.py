"""A scripted policy: grasp an object from above, lift it, hold it, and set it down somewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import area_vectors
from f3sr.core.transforms import UP, Array, quaternion_from_rotation, rotation_about, transform
from f3sr.env.controllers import AROUND
from f3sr.env.environment_arguments import LONGEST_EPISODE, require_within
from f3sr.env.gripper import APPROACH, GripperConfig
from f3sr.errors import InputError
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import Scene, SceneObject

YAWS = 36
"""Turns of the gripper about the vertical that are looked at, over half a turn."""
FITS = 0.9
"""Share of the gripper's opening that an object's width may have."""
CLEARANCE = 0.008
"""Room beside an open finger that nothing else may be in [m]."""
FLOOR = 0.0015
"""Least distance of finger tips from the floor, and of the palm from the object [m]."""
LEVELS = 5
"""Heights that are looked at, from the lowest that the floor allows to the top."""
OVER = 0.12
"""Height of the hand over the object before and after [m]."""
RATES = (1, 1000)
"""Least and most actions a second."""
SETTLE, SQUEEZE = 0.2, 0.4
"""Pauses before and while the fingers close [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Grasp:
    """Where pads close on an object: the middle between them (3,) [m], and the turn about the vertical [rad]."""

    place: Array
    yaw: float
    width: float
    """Of the object between the pads [m]."""

    @property
    def quaternion(self) -> Array:
        """(4,) (w, x, y, z) of the hand, pointing down."""
        return quaternion_from_rotation(rotation_about([0, 0, 1.0], self.yaw) @ APPROACH)


def grasp_of(scene: Scene, id: int, config: GripperConfig) -> Grasp | None:
    """The grasp nearest to the centre of mass whose fingers touch nothing else on their way; None where none fits.

    At the height of the pads the object is at most ``FITS`` of the opening wide, and the band that each open finger
    goes down is free of other objects. What the pads touch first faces them: they would slide off a slope. Surfaces are
    looked at as points, ``SPACING`` apart. Raises InputError for an unknown id."""
    if id not in (known := [o.id for o in scene]):
        raise InputError("grasp", found=f"object {id}", accepted=f"one of {', '.join(map(str, known))}")
    o = scene[id]
    own, normals = _surface(o)
    others = np.concatenate([np.zeros((0, 3)), *(_surface(other)[0] for other in scene if other.id != id)])
    center = transform(o.T_world_object, body_of(o).center[None])[0]
    near = np.linalg.norm(others[:, :2] - center[:2], axis=1) < config.opening + float(np.ptp(own[:, :2], axis=0).max())
    half = config.pad[2] / 2
    top = float(own[:, 2].max())
    deepest = max(float(own[:, 2].min()) + half + FLOOR, top - half + FLOOR)  # pads above the floor, palm above the top
    heights = np.linspace(deepest, max(deepest, top - half / 3), LEVELS)
    places = ((float(h), float(yaw)) for h in heights for yaw in np.pi * np.arange(YAWS) / YAWS)
    fitting = (_fitting(own, normals, others[near], center, *place, config) for place in places)
    found = [grasp for grasp in fitting if grasp is not None]
    return min(found, key=lambda g: float(np.linalg.norm(g.place - center)) + 0.2 * g.width, default=None)


def _fitting(
    own: Array, normals: Array, others: Array, center: Array, height: float, yaw: float, config: GripperConfig
) -> Grasp | None:
    x = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    y = np.array([np.sin(yaw), -np.cos(yaw), 0.0])  # the hand points down: its y is turned over
    bottom, reach = height - config.pad[2] / 2, config.pad[0] / 2
    inside = _inside(own, center, x, bottom, reach)
    between = (own[inside] - center) @ y
    if not len(between):
        return None
    width, middle = float(np.ptp(between)), float(between.min() + between.max()) / 2
    if not 0 < width <= FITS * config.opening:
        return None
    for sign in (-1, 1):  # weighted by area: normals are as long as their share of the surface
        touched = sign * (between - middle) > width / 2 - TOUCHED
        facing = normals[inside][touched].sum(0)
        if sign * float(facing @ y) < FACING * float(np.linalg.norm(normals[inside][touched], axis=1).sum()):
            return None
    beside = np.abs(_along(others, center, x, y, bottom, reach + CLEARANCE) - middle)
    outer = config.opening / 2 + config.pad[1] + CLEARANCE
    palm = _along(others, center, x, y, height + config.pad[2] / 2, config.palm[0] / 2 + CLEARANCE)
    if (beside < outer).any() or (np.abs(palm - middle) < config.palm[1] / 2 + CLEARANCE).any():
        return None
    return Grasp(place=np.array([*center[:2], height]) + middle * y, yaw=yaw, width=width)


def _inside(points: Array, center: Array, x: Array, bottom: float, reach: float) -> NDArray[np.bool_]:
    """Which points are above ``bottom`` and within ``reach`` of the centre along ``x``."""
    return (points[:, 2] > bottom) & (np.abs((points - center) @ x) < reach)


def _along(points: Array, center: Array, x: Array, y: Array, bottom: float, reach: float) -> Array:
    """Places along ``y``, from the centre, of such points."""
    return ((points - center) @ y)[_inside(points, center, x, bottom, reach)]


def _surface(o: SceneObject) -> tuple[Array, Array]:
    """Points (n, 3) on an object's convex parts in the world [m], and outward normals there, as long as twice the
    surface that each stands for [m2]."""
    from trimesh.remesh import subdivide_to_size

    corners = list[Array]()
    for part in body_of(o).parts:
        vertices, faces = subdivide_to_size(part.vertices, part.faces, SPACING, max_iter=12)[:2]
        corners.append(transform(o.T_world_object, vertices)[faces])
    triangles = np.concatenate(corners)
    return triangles.mean(1), area_vectors(triangles)


TOUCHED, FACING = 0.003, 0.85
"""Depth of what a pad touches first [m], and the least mean cosine between its normals and the pad's: 32 degrees."""
SPACING = 0.005
"""[m]"""


def pick(
    scene: Scene, id: int, config: GripperConfig, *, rate: int, lift: float = 0.1, hold: float = 1.0
) -> Iterator[Array]:
    """Actions (8,) of an environment with ``control="pose"``, ``rate`` a second: over the object, down, close, up by
    ``lift`` [m], and hold for ``hold`` [s]. Raises InputError at once for an unknown id, where no grasp fits, and for
    numbers that the hand or an episode has no room for."""
    require_within("rate", rate, RATES, "actions a second")
    require_within("hold", hold, (0, LONGEST_EPISODE), "s")
    grasp = grasp_of(scene, id, config)
    if grasp is None:
        raise InputError("grasp", found=f"no place on object {id} for the gripper", accepted="a narrower, freer object")
    top = max(float(o.bounds_world[:, 2].max()) for o in scene)
    highest = round(top + AROUND - float(grasp.place[2]), 3)
    require_within("lift", lift, (0, highest), f"m: no higher does the hand go, {AROUND:g} m above all objects")
    return _picking(grasp, top, config, rate, lift, hold)


def _picking(grasp: Grasp, top: float, config: GripperConfig, rate: int, lift: float, hold: float) -> Iterator[Array]:
    """The same for a grasp; ``top`` is the height of the highest object [m]."""
    over = np.array([*grasp.place[:2], max(grasp.place[2] + OVER, top + config.pad[2] / 2 + OVER / 4)])
    raised = grasp.place + lift * UP
    closed = max(0.0, grasp.width - 0.02)

    def at(place: Array, opening: float, seconds: float) -> Iterator[Array]:
        action = np.array([*place, *grasp.quaternion, opening])
        yield from (action for _ in range(max(1, round(seconds * rate))))

    yield from at(over, config.opening, 2.5)
    yield from at(grasp.place, config.opening, float(over[2] - grasp.place[2]) / config.speed + SETTLE)
    yield from at(grasp.place, closed, (config.opening - closed) / config.closing + SQUEEZE)
    yield from at(raised, closed, lift / config.speed + hold)
