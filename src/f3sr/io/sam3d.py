"""The pose file of SAM 3D Objects and its conventions, in one place.

The model works in a Z-up local frame inside [-0.5, 0.5]^3. Its GLB export rewrites vertices as (x, z, -y). Poses are
PyTorch3D row vectors, ``p_camera = (s p_local) @ R(q) + t``, in PyTorch3D camera axes (+X left, +Y up, +Z forward),
so in column form the rotation is R(q)^T. Hence ``p_opencv = s F R(q)^T A v_glb + F t``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from f3sr.backends.protocols import ReadPose
from f3sr.core.transforms import Array, pose
from f3sr.io.pose_conventions import CAMERAS, FILE_AXES, GLTF_FROM_Z_UP, Order, Vectors, rotation_as_read

LOCAL_FROM_GLB = GLTF_FROM_Z_UP.matrix
"""A: vertices of the exported GLB back to the model's Z-up frame."""
OPENCV_FROM_PYTORCH3D = CAMERAS["pytorch3d"].matrix
"""F: PyTorch3D camera axes to OpenCV axes."""


UNIT = 0.01
"""How far from 1 the length of a quaternion may be."""
EQUAL = 1e-4
"""Share by which the three scales of a pose may differ."""
PRODUCERS_CAMERAS = {name: CAMERAS[name.lower()] for name in ("PyTorch3D", "OpenCV", "OpenGL")}
"""Axes of cameras in which its poses are passed on."""
LOCALS = {"Z-up": GLTF_FROM_Z_UP, "file's": FILE_AXES}
"""What a pose turns: the model's Z-up axes, or the mesh file's own."""


def readings(rotation: Sequence[float], translation: Sequence[float], scale: Sequence[float]) -> tuple[ReadPose, ...]:
    """What rotation (4,), translation (3,) and scale (3,) may mean for a GLB, SAM 3D Objects' convention first.

    Producers that pass its poses on change the quaternion's order, its direction or the camera's axes.
    Raises ValueError where the quaternion is no rotation or the scale no size."""
    length = math.hypot(*rotation)
    if abs(length - 1) > UNIT:
        raise ValueError(f"a quaternion of length {length:.3g}")
    size = sum(scale) / 3
    if min(scale) <= 0 or max(scale) - min(scale) > EQUAL * max(scale):
        raise ValueError(f"the scale {[float(f'{v:.3g}') for v in scale]}")
    found = list[ReadPose]()
    for (camera, F), (local, A), order, vectors in product(
        PRODUCERS_CAMERAS.items(), LOCALS.items(), get_args(Order), get_args(Vectors)
    ):
        R = rotation_as_read(rotation, order, vectors)
        T = pose(F.matrix @ R @ A.matrix, F.matrix @ np.asarray(translation, float))
        reading = f"quaternion {order}, {vectors} vectors, {local} axes, {camera} camera"
        found.append(ReadPose(reading=reading, T_camera_mesh=T, scale=size))
    return tuple(found)


def _unwrapped(value: Any) -> Any:
    """The model saves (1, n) tensors; accept them as (n,)."""
    return value[0] if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list) else value


def _triple(value: Any) -> Any:
    value = _unwrapped(value)
    value = value[0] if isinstance(value, list) and len(value) == 1 else value
    return [value] * 3 if isinstance(value, int | float) else value


Quaternion = Annotated[list[float], BeforeValidator(_unwrapped), Field(min_length=4, max_length=4)]
Vector = Annotated[list[float], BeforeValidator(_unwrapped), Field(min_length=3, max_length=3)]
Scale = Annotated[list[float], BeforeValidator(_triple), Field(min_length=3, max_length=3)]


class AssetPose(BaseModel):
    """One entry: the mask it belongs to, its mesh file and its pose."""

    model_config = ConfigDict(allow_inf_nan=False, strict=True)
    mask: str
    mesh: str
    rotation: Quaternion
    translation: Vector
    scale: Scale

    @field_validator("mask")
    @classmethod
    def _bare(cls, value: str) -> str:
        if not value or set(value) & set("/\\\0"):
            raise ValueError(f"{value[:60]!r}; accepted: the bare name of a mask file")
        return value

    @field_validator("rotation")
    @classmethod
    def _unit(cls, value: list[float]) -> list[float]:
        if abs(math.hypot(*value) - 1) > UNIT:
            raise ValueError(f"a quaternion of length {math.hypot(*value):.3g}; accepted: wxyz of length 1")
        return value

    @field_validator("scale")
    @classmethod
    def _uniform(cls, value: list[float]) -> list[float]:
        if min(value) <= 0 or max(value) - min(value) > EQUAL * max(value):
            raise ValueError(
                f"{[float(f'{v:.3g}') for v in value]}; accepted: one positive number, or three that are equal"
            )
        return value

    @property
    def uniform_scale(self) -> float:
        """Metres per unit of the local frame."""
        return sum(self.scale) / 3

    @property
    def readings(self) -> tuple[ReadPose, ...]:
        """What the pose may mean for its GLB, the documented convention first."""
        return readings(self.rotation, self.translation, self.scale)

    def camera_pose(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and translation (3,) [m] of the local frame in OpenCV camera axes: F R(q)^T and F t."""
        R = OPENCV_FROM_PYTORCH3D @ rotation_as_read(self.rotation, "wxyz", "row")
        return R, OPENCV_FROM_PYTORCH3D @ np.asarray(self.translation)


class Poses(BaseModel):
    """``assets/poses.json``."""

    model_config = ConfigDict(strict=True)
    convention: str = "sam-3d-objects"
    objects: list[AssetPose] = Field(min_length=1)

    @property
    def declared(self) -> bool:
        """Whether the file names its convention itself."""
        return "convention" in self.model_fields_set

    @field_validator("convention")
    @classmethod
    def _known(cls, value: str) -> str:
        if not value.startswith("sam-3d-objects"):
            raise ValueError(f"convention {value[:60]!r}; accepted: sam-3d-objects")
        return value
