"""What the numbers of a package, a plan and a rollout may be: one type per quantity, checked where the file is read.

A package holds what stages made of an input: its objects may be larger, smaller and farther than an input's.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from f3sr.core.transforms import Array
from f3sr.scene import GROUND

MAX_ID = 2**31 - 1
"""Largest id: buffers of a picture's ids hold 32 bits."""
MAX_OBJECTS = 500
"""Most objects of a package, as many as an input may have masks."""
MAX_OBJECT_PARTS = 320
"""Most convex parts of an object: a proxy has up to 256 and a footing up to 64."""
MAX_SCENE_PARTS = 10_000
"""Most convex parts of a package: a hundred objects of a hundred parts."""
MAX_SCENE_BYTES = 64_000_000
"""Largest scene.json: relations between all pairs of 500 objects take 50 MB."""
MAX_PART_BYTES = 50_000_000
"""Largest file of a convex part: the hull of a mesh of a million triangles takes less."""
MAX_LABEL = 300
"""Longest label: names of files hold 255 characters."""
FARTHEST = 1e6
"""From the origin that anything may be [m]: beyond it float32 meshes have no millimetres, nor decimetres."""
MIN_OBJECT, MAX_OBJECT = 5e-4, 2e3
"""Sizes of a package's objects [m]: half and twice what an input's may have."""
MAX_SIZES_AWAY = 1e6
"""Largest distance of a package's object from the camera, in its own sizes: ten times what an input's may have."""
MIN_DENSITY, MAX_DENSITY = 1.0, 25_000.0
"""Densities [kg/m3]: from aerogel, or a balloon, to osmium."""
MIN_VOLUME, MAX_VOLUME = 1e-15, 1e10
"""Volumes [m3] that masses and densities give: a grain of 10 micrometres, a cube of two kilometres."""
MIN_MASS, MAX_MASS = MIN_VOLUME * MIN_DENSITY, MAX_VOLUME * MAX_DENSITY
"""Masses [kg]: of the volumes and densities accepted."""
MIN_MOMENT = 1.01e-14
"""Least principal moment of inertia of what can move [kg m2]: MuJoCo takes no inertia below 1e-14."""
MAX_FRICTION = 4.0
"""Largest sliding friction: rubber on rubber has 1.2, gecko tape 4."""
MAX_ROLLING_FRICTION = 0.1
"""Largest rolling friction [m]: a ball in sand has .01."""
MAX_SCALE = 1e5
"""Largest factor between sizes of an object at two stages, and 1 over the least."""
MAX_SIDE = 100_000
"""Longest side of a package's photo [px]."""
MIN_FOCAL_LENGTH, MAX_FOCAL_LENGTH = 0.01, 300.0
"""Focal lengths of a package's camera, in longer image sides: a tenth and ten times what an input's may have."""
MAX_PRINCIPAL = 300.0
"""How far its principal point may lie from the image's corner, and its skew, in longer image sides: likewise."""
ROUNDING = 1e-5
"""By which R R^T may differ from 1, and a unit vector's length from 1."""


def _rigid(T: Matrix4) -> Matrix4:
    matrix = np.array(T)
    R = matrix[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 2 * ROUNDING or np.linalg.det(R) < 0:
        raise ValueError("no rigid transform; accepted: rotation and translation, no scale, no mirror")
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"a last row {list(T[3])}; accepted: 0, 0, 0, 1")
    return T


def _unit(vector: Vector3) -> Vector3:
    if abs(math.hypot(*vector) - 1) > ROUNDING:
        raise ValueError(f"a vector of length {math.hypot(*vector):.3g}; accepted: of length 1")
    return vector


Id = Annotated[int, Field(ge=0, le=MAX_ID, strict=True)]
IdOrGround = Annotated[int, Field(ge=GROUND, le=MAX_ID, strict=True)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Place = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST, allow_inf_nan=False)]
"""A coordinate, or an element of a rigid transform."""
Vector3 = tuple[Place, Place, Place]
UnitVector3 = Annotated[Vector3, AfterValidator(_unit)]
Component = Annotated[float, Field(ge=-2, le=2, allow_inf_nan=False)]
Direction3 = tuple[Component, Component, Component]
"""About a unit vector."""
Row4 = tuple[Place, Place, Place, Place]
Matrix4 = tuple[Row4, Row4, Row4, Row4]
RigidMatrix4 = Annotated[Matrix4, AfterValidator(_rigid)]
Moment = Annotated[float, Field(ge=-MAX_MASS * MAX_OBJECT**2, le=MAX_MASS * MAX_OBJECT**2, allow_inf_nan=False)]
Inertia = tuple[tuple[Moment, Moment, Moment], tuple[Moment, Moment, Moment], tuple[Moment, Moment, Moment]]
Pixels = Annotated[float, Field(ge=-1e8, le=1e8, allow_inf_nan=False)]
Intrinsics = tuple[tuple[Pixels, Pixels, Pixels], tuple[Pixels, Pixels, Pixels], tuple[Number, Number, Number]]
Side = Annotated[int, Field(gt=0, le=MAX_SIDE)]
Scale = Annotated[float, Field(ge=1 / MAX_SCALE, le=MAX_SCALE, allow_inf_nan=False)]
Mass = Annotated[float, Field(ge=MIN_MASS, le=MAX_MASS, allow_inf_nan=False)]
Density = Annotated[float, Field(ge=MIN_DENSITY, le=MAX_DENSITY, allow_inf_nan=False)]
Friction = Annotated[float, Field(ge=0, le=MAX_FRICTION, allow_inf_nan=False)]
RollingFriction = Annotated[float, Field(ge=0, le=MAX_ROLLING_FRICTION, allow_inf_nan=False)]
Damping = Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Label = Annotated[str, Field(max_length=MAX_LABEL)]


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError(f"{text!r:.60}, with characters that are not printable")
    return text


NewLabel = Annotated[Label, AfterValidator(_printable)]
"""Of a user: packages may hold others, as words of a photo's file names."""


def intrinsics_fault(K: Array, width: int, height: int) -> str | None:
    """What is wrong with K (3, 3) in pixels of an image; None where nothing is."""
    longest = max(width, height)
    low, high, far = MIN_FOCAL_LENGTH * longest, MAX_FOCAL_LENGTH * longest, MAX_PRINCIPAL * longest
    if not np.array_equal(K[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
        return f"K = {K.tolist()}; accepted: [[fx, s, cx], [0, fy, cy], [0, 0, 1]]"
    if not (low <= K[0, 0] <= high and low <= K[1, 1] <= high):
        return f"focal lengths {K[0, 0]:.3g} and {K[1, 1]:.3g} px; accepted: {low:.3g} to {high:.3g} px"
    if max(abs(K[0, 1]), abs(K[0, 2]), abs(K[1, 2])) > far:
        return f"K with a principal point or skew beyond {far:.3g} px; accepted: within it"
    return None


def inertia_fault(inertia: Array, mass: float, *, free: bool) -> str | None:
    """What is wrong with the inertia (3, 3) of a mass about its centre; None where some body can have it."""
    if np.abs(inertia - inertia.T).max() > ROUNDING * np.abs(inertia).max():
        return "an inertia that is not symmetric; accepted: one that is"
    a, b, c = np.linalg.eigvalsh(inertia)
    if a <= 0 or a + b < 0.99 * c:
        return f"principal moments {a:.3g}, {b:.3g}, {c:.3g} kg m2; accepted: those that some body can have"
    if free and a < MIN_MOMENT:
        return f"a principal moment of {a:.3g} kg m2; accepted: at least {MIN_MOMENT:.3g} of what can move"
    if c > mass * MAX_OBJECT**2:
        return f"a principal moment of {c:.3g} kg m2 of {mass:.3g} kg; accepted: of at most {MAX_OBJECT:.0f} m"
    return None
