"""The pose file of SAM 3D Objects and its conventions, in one place.

The model works in a Z-up local frame inside [-0.5, 0.5]^3. Its GLB export rewrites vertices as (x, z, -y). Poses are
PyTorch3D row vectors, ``p_camera = (s p_local) @ R(q) + t``, in PyTorch3D camera axes (+X left, +Y up, +Z forward),
so in column form the rotation is R(q)^T. Hence ``p_opencv = s F R(q)^T A v_glb + F t``.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator

from f3sr.backends.protocols import GivenPose
from f3sr.core.transforms import Array
from f3sr.io.pose_conventions import CAMERAS, GLTF_FROM_Z_UP, rotation_as_read

LOCAL_FROM_GLB = GLTF_FROM_Z_UP.matrix
"""A: vertices of the exported GLB back to the model's Z-up frame."""
OPENCV_FROM_PYTORCH3D = CAMERAS["pytorch3d"].matrix
"""F: PyTorch3D camera axes to OpenCV axes."""
UNIT = 0.01
"""How far from 1 the length of a quaternion may be."""
EQUAL = 1e-4
"""Share by which the three scales of a pose may differ."""


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
    def given(self) -> GivenPose:
        """The pose alone."""
        (w, x, y, z), (right, down, forward) = self.rotation, self.translation
        return GivenPose(rotation=(w, x, y, z), translation=(right, down, forward), scale=self.uniform_scale)

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
