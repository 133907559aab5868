"""How a producer may have written down where a mesh stands: the choices that conventions are made of, and their names.

A pose of rotation Q, translation t and scale s puts a vertex v of the file at ``x_camera = s F Q A v + F t``. A turns
the file's axes into those that the pose turns, F the producer's camera axes into OpenCV's. Both are signed
permutations, and may mirror: a file or a camera may be left-handed. Q is read from four numbers in one of two orders,
and acts on columns or on rows. So conventions are enumerated from these choices, not listed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations, product
from typing import Literal, get_args

import numpy as np

from f3sr.core.handedness import MIRROR
from f3sr.core.transforms import Array, rotation_from_quaternion
from f3sr.errors import InputError
from f3sr.options import ASSET_FRAMES

Order = Literal["wxyz", "xyzw"]
Vectors = Literal["row", "column"]
LETTERS = "xyz"
SEPARATOR = "/"
"""Between the parts of a convention's name."""


@dataclass(frozen=True)
class SignedAxes:
    """Where three directions point in a file's axes, as "+x-z+y": the second is the file's -z.

    Of a camera they are the picture's right, its down, and forward; of a mesh the x, y and z that its pose turns."""

    name: str

    @cached_property
    def matrix(self) -> Array:
        """The signed permutation (3, 3) from the file's axes to the three directions; its determinant is 1 or -1."""
        rows = np.zeros((3, 3))
        for k, (sign, letter) in enumerate(re.findall(r"([+-])([xyz])", self.name)):
            rows[k, LETTERS.index(letter)] = 1.0 if sign == "+" else -1.0
        return rows

    @property
    def mirrors(self) -> bool:
        """Whether the file's axes are left-handed."""
        return bool(np.linalg.det(self.matrix) < 0)


def _all_axes() -> Iterator[SignedAxes]:
    for order, signs in product(permutations(LETTERS), product("+-", repeat=3)):
        yield SignedAxes("".join(sign + letter for sign, letter in zip(signs, order, strict=True)))


ALL_AXES: tuple[SignedAxes, ...] = tuple(_all_axes())
"""The 24 turns by quarters, and the 24 that mirror too."""
CAMERAS: dict[str, SignedAxes] = {
    "opencv": SignedAxes("+x+y+z"),
    "opengl": SignedAxes("+x-y-z"),
    "pytorch3d": SignedAxes("-x-y+z"),
    "unity": SignedAxes("+x-y+z"),
    "blender": SignedAxes("+x-z+y"),
}
"""Camera axes that have a name. Unity's are left-handed; "blender" is a camera's frame turned from Y-up to Z-up."""
Y_UP = ("opengl", "unity")
"""Cameras of programs whose poses turn Y-up meshes. Those of SAM 3D Objects and Blender turn Z-up ones."""
FILE_AXES = SignedAxes("+x+y+z")
GLTF_FROM_Z_UP = SignedAxes("+x-z+y")
"""The mesh of a glTF file, Y-up, whose pose turns Z-up axes."""


@dataclass(frozen=True)
class PoseConvention:
    """One way to read a pose."""

    order: Order
    vectors: Vectors
    mesh: SignedAxes
    camera: SignedAxes

    @property
    def name(self) -> str:
        """As an option takes it: "wxyz/row/+x-z+y/pytorch3d"."""
        return SEPARATOR.join((self.order, self.vectors, self.mesh.name, camera_name(self.camera)))

    @property
    def own(self) -> Array:
        """The axes (3, 3) in which an object is kept, from those of its file: those that its pose turns, right-handed
        and Z-up. So they are the same whichever program wrote the pose down."""
        handed = (MIRROR if self.camera.mirrors else np.eye(3)) @ self.mesh.matrix
        return GLTF_FROM_Z_UP.matrix @ handed if camera_name(self.camera) in Y_UP else handed


SAM3D = PoseConvention("wxyz", "row", GLTF_FROM_Z_UP, CAMERAS["pytorch3d"])
"""That of SAM 3D Objects, see ``io/sam3d``."""


def camera_name(axes: SignedAxes) -> str:
    """The usual name of camera axes, else their own."""
    return next((name for name, known in CAMERAS.items() if known == axes), axes.name)


def camera_axes(name: str) -> SignedAxes | None:
    """Camera axes by their usual name or their own; None for another text."""
    return CAMERAS.get(name) or next((axes for axes in ALL_AXES if axes.name == name), None)


def parsed(name: str) -> PoseConvention | None:
    """The convention of a name; None for another text."""
    parts = name.split(SEPARATOR)
    if len(parts) != 4 or parts[0] not in get_args(Order) or parts[1] not in get_args(Vectors):
        return None
    mesh = next((axes for axes in ALL_AXES if axes.name == parts[2]), None)
    camera = camera_axes(parts[3])
    if mesh is None or camera is None:
        return None
    return PoseConvention(
        "wxyz" if parts[0] == "wxyz" else "xyzw", "row" if parts[1] == "row" else "column", mesh, camera
    )


def require_asset_frame(where: str, name: str) -> None:
    """Raises InputError for a text that ``--asset-frame`` does not take."""
    if name not in ASSET_FRAMES and camera_axes(name) is None and parsed(name) is None:
        example = f"axes such as {CAMERAS['opengl'].name}, or a convention such as {SAM3D.name}"
        raise InputError(where, found=name, accepted=f"{', '.join(ASSET_FRAMES)}, {example}")


def all_conventions() -> list[PoseConvention]:
    """Every convention with a camera that has a name, the usual choices first.

    A left-handed camera comes with a left-handed mesh only: such a program holds everything so."""
    meshes = sorted(ALL_AXES, key=lambda axes: (axes != GLTF_FROM_Z_UP, axes != FILE_AXES, axes.mirrors))
    cameras = sorted(CAMERAS.values(), key=lambda axes: axes != SAM3D.camera)
    return [
        PoseConvention(order, vectors, mesh, camera)
        for mesh, camera, order, vectors in product(meshes, cameras, get_args(Order), get_args(Vectors))
        if mesh.mirrors or not camera.mirrors
    ]


def rotation_as_read(four: Sequence[float], order: Order, vectors: Vectors) -> Array:
    """The matrix (3, 3) of a quaternion that acts on columns, whatever it was written for.

    Raises ValueError for a quaternion of length 0."""
    wxyz = list(four) if order == "wxyz" else [four[3], *four[:3]]
    R = rotation_from_quaternion(wxyz)
    return R.T if vectors == "row" else R
