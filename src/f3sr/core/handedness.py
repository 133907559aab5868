"""Meshes of left-handed files: mirrored, so that a rotation alone puts them where they stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from f3sr.core.mesh import Mesh, signed_volume
from f3sr.core.transforms import Array

MIRROR = np.diag([-1.0, 1, 1])
"""Which axis a mirror turns does not matter: the rotations that follow differ."""


def mirrored(mesh: Mesh) -> Mesh:
    """The mesh with its first axis turned round, its triangles facing outward whatever they did in the file."""
    return outward(mesh.with_vertices(mesh.vertices @ MIRROR))


def outward(mesh: Mesh) -> Mesh:
    """The mesh with its triangles the other way round where they enclose a negative volume."""
    if signed_volume(mesh.vertices, mesh.faces) >= 0:
        return mesh
    return replace(mesh, faces=mesh.faces[:, ::-1])


def in_axes(mesh: Mesh, A: Array) -> Mesh:
    """The mesh in other axes, by an orthogonal ``A`` (3, 3) that may mirror."""
    turned = mesh.with_vertices(mesh.vertices @ A.T)
    return outward(turned) if np.linalg.det(A) < 0 else turned


def rotation_of(R: Array) -> Array:
    """The rotation (3, 3) that puts the ``mirrored`` mesh where an improper ``R`` (3, 3) puts the mesh; a proper one
    stays."""
    return R @ MIRROR if np.linalg.det(R) < 0 else R
