"""A scripted policy: grasp an object from above, lift it, hold it, and set it down somewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, quaternion_from_rotation, rotation_about, transform
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
LEVELS = 5
"""Heights that are looked at, from the lowest that the floor allows to the top."""
OVER = 0.12
"""Height of the hand over the object before and after [m]."""
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

    Parts are cut at the height of the pads: there the object is at most ``FITS`` of the opening wide, and the band that
    each open finger goes down is free of other objects and of the object's own upper parts."""
    o = scene[id]
    own, others = _corners(o), [c for other in scene if other.id != id for c in _corners(other)]
    center = transform(o.T_world_object, body_of(o).center[None])[0]
    half = config.pad[2] / 2
    low, high = max(float(min(c[:, 2].min() for c in own)), 0.0), float(max(c[:, 2].max() for c in own))
    deepest = max(low, CLEARANCE / 2) + half
    heights = np.linspace(deepest, max(deepest, high - half / 3), LEVELS).tolist()
    found = [
        (abs(h - center[2]) + float(np.linalg.norm(g.place[:2] - center[:2])) + 0.2 * g.width, g)
        for h in heights
        for yaw in np.pi * np.arange(YAWS) / YAWS
        if (g := _fitting(own, others, center, float(h), float(yaw), config)) is not None
    ]
    return min(found, key=lambda pair: pair[0])[1] if found else None


def _fitting(
    own: list[Array], others: list[Array], center: Array, height: float, yaw: float, config: GripperConfig
) -> Grasp | None:
    x = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    y = np.array([np.sin(yaw), -np.cos(yaw), 0.0])  # the hand points down: its y is turned over
    bottom = height - config.pad[2] / 2
    slab = _bands(own, center, x, y, bottom, config.pad[0] / 2)
    if not len(slab):
        return None
    left, right = float(slab.min()), float(slab.max())
    width = right - left
    if not 0 < width <= FITS * config.opening:
        return None
    middle = (left + right) / 2
    place = np.array([*center[:2], height]) + middle * y
    outer = config.opening / 2 + config.pad[1] + CLEARANCE
    for side in (-1, 1):
        finger = sorted((side * width / 2, side * outer))
        for corners in others:
            if _reaches(corners, place, x, y, bottom, config.pad[0] / 2 + CLEARANCE, finger):
                return None
    return Grasp(place=place, yaw=yaw, width=width)


def _bands(parts: list[Array], center: Array, x: Array, y: Array, bottom: float, reach: float) -> Array:
    """Ends along ``y`` of what parts have above ``bottom`` within ``reach`` of the middle along ``x``."""
    found = list[float]()
    for corners in parts:
        clipped = _clipped(corners, np.array([0, 0, -1.0]), -bottom)
        for sign in (-1, 1):
            clipped = _clipped(clipped, sign * x, reach + sign * float(x @ center))
        if len(clipped):
            along = (clipped - center) @ y
            found += [float(along.min()), float(along.max())]
    return np.array(found)


def _reaches(corners: Array, place: Array, x: Array, y: Array, bottom: float, reach: float, band: list[float]) -> bool:
    """Whether a convex part is in the band that a finger goes down."""
    clipped = _clipped(corners, np.array([0, 0, -1.0]), -bottom)
    for sign in (-1, 1):
        clipped = _clipped(clipped, sign * x, reach + sign * float(x @ place))
    for sign, end in ((1, band[1]), (-1, -band[0])):
        clipped = _clipped(clipped, sign * y, end + sign * float(y @ place))
    return len(clipped) > 0


def _clipped(corners: Array, normal: Array, offset: float) -> Array:
    """Corners (n, 3) of a convex body cut by ``normal . x <= offset``: those inside, and where pairs cross it."""
    if not len(corners):
        return corners
    over = corners @ normal - offset
    inside, outside = corners[over <= 0], corners[over > 0]
    if not len(outside) or not len(inside):
        return inside
    a, b = over[over <= 0], over[over > 0]
    share = a[:, None] / (a[:, None] - b[None])
    crossing = inside[:, None] + share[..., None] * (outside[None] - inside[:, None])
    return np.concatenate([inside, crossing.reshape(-1, 3)])


def _corners(o: SceneObject) -> list[Array]:
    parts: tuple[ConvexPart, ...] = body_of(o).parts
    return [transform(o.T_world_object, part.vertices) for part in parts]


def pick(
    scene: Scene, id: int, config: GripperConfig, *, rate: int, lift: float = 0.1, hold: float = 1.0
) -> Iterator[Array]:
    """Actions (8,) of an environment with ``control="pose"``, ``rate`` a second: over the object, down, close, up by
    ``lift`` [m], and hold for ``hold`` [s]. Raises InputError where no grasp fits."""
    grasp = grasp_of(scene, id, config)
    if grasp is None:
        raise InputError("grasp", found=f"no place on object {id} for the gripper", accepted="a narrower, freer object")
    top = max(float(c[:, 2].max()) for o in scene for c in _corners(o)) + config.pad[2] / 2
    over = np.array([*grasp.place[:2], max(grasp.place[2] + OVER, top + OVER / 4)])
    raised = grasp.place + lift * UP
    closed = max(0.0, grasp.width - 0.02)

    def at(place: Array, opening: float, seconds: float) -> Iterator[Array]:
        action = np.array([*place, *grasp.quaternion, opening])
        yield from (action for _ in range(max(1, round(seconds * rate))))

    yield from at(over, config.opening, 2.5)
    yield from at(grasp.place, config.opening, float(over[2] - grasp.place[2]) / config.speed + SETTLE)
    yield from at(grasp.place, closed, (config.opening - closed) / config.closing + SQUEEZE)
    yield from at(raised, closed, lift / config.speed + hold)
