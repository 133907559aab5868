"""The visual mesh of a URDF of one rigid link: its file, scale and place in the link's frame (wiki.ros.org/urdf/XML).

The link's frame is Z-up and metric. XML is untrusted: its size is limited, document types and entities are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, rotation_about, transform
from f3sr.errors import InputError
from f3sr.files import limited_file

MAX_URDF_BYTES = 1_000_000
"""Largest URDF: one link takes 2 kB."""
MAX_LENGTH = 1e6
"""Largest number of an origin [m] or a scale."""
ACCEPTED = "a URDF of one link with a visual mesh"
RIGHT_ANGLE = 1e-3
"""Error of a turn by quarters [rad]: they are written with four decimals."""


@dataclass(frozen=True, eq=False, kw_only=True)
class UrdfVisual:
    """``x_link = T_link_mesh (scale * x)`` with ``scale`` (3,) and T (4, 4) rigid [m]."""

    mesh: str
    """The file's path in the URDF's folder."""
    scale: Array
    T_link_mesh: Array

    def in_link(self, mesh: Mesh) -> Mesh:
        """The mesh in the link's frame."""
        return mesh.with_vertices(transform(self.T_link_mesh, mesh.vertices * self.scale))


def read_urdf(file: Path) -> UrdfVisual:
    """The first visual mesh. Raises InputError for no URDF, for one with joints, and for numbers that no link has."""
    data = limited_file.read(file, most=MAX_URDF_BYTES, accepted=ACCEPTED)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(file, found="a document type or an entity", accepted=ACCEPTED)
    try:
        robot = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(file, found=f"no valid XML ({error})", accepted=ACCEPTED) from None
    if robot.tag != "robot" or len(robot.findall("link")) != 1:
        found = f"<{robot.tag}> with {len(robot.findall('link'))} links"
        raise InputError(file, found=found, accepted=ACCEPTED)
    visual = robot.find("./link/visual")
    mesh = None if visual is None else visual.find("./geometry/mesh")
    if visual is None or mesh is None or not mesh.get("filename"):
        raise InputError(file, found="no visual mesh", accepted=ACCEPTED)
    origin = visual.find("./origin")
    xyz = _numbers(file, None if origin is None else origin.get("xyz"), 0.0)
    roll, pitch, yaw = _quarters(_numbers(file, None if origin is None else origin.get("rpy"), 0.0))
    R = rotation_about([0, 0, 1], yaw) @ rotation_about([0, 1, 0], pitch) @ rotation_about([1, 0, 0], roll)
    scale = _numbers(file, mesh.get("scale"), 1.0)
    if (scale == 0).any():
        raise InputError(file, found="a scale of 0", accepted="scales other than 0")
    return UrdfVisual(mesh=str(mesh.get("filename")), scale=scale, T_link_mesh=pose(R, xyz))


def _numbers(file: Path, text: str | None, default: float) -> Array:
    """Three numbers (3,)."""
    if text is None:
        return np.full(3, default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.full(3, np.nan)
    if values.shape != (3,) or not (np.abs(values) <= MAX_LENGTH).all():  # NaN is not
        raise InputError(file, found=f"the numbers {text[:60]!r}", accepted="three finite numbers")
    return values


def _quarters(rpy: Array) -> Array:
    """Angles (3,) [rad], those near quarter turns exact."""
    near = np.round(rpy / (math.pi / 2)) * (math.pi / 2)
    return np.where(np.abs(near - rpy) <= RIGHT_ANGLE, near, rpy)
