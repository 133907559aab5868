"""A mesh in a frame of its own: the same one in whatever axes, order and unit the mesh is stored.

Cuts are chosen by comparisons. Rounding, the order of triangles or other axes decide close ones otherwise, and parts
then differ in number. So a mesh is split in axes that only its own points tell.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from f3sr.core.mesh import Mesh, places
from f3sr.core.transforms import Array, pose
from f3sr.proxies.surface import Faces

GRID = 2.0**-26
"""Normalised vertices are rounded to this step, so that the asset's unit and place change no byte."""


def _turns() -> Array:
    signed = (np.diag(s)[list(order)] for order, s in product(permutations(range(3)), product((1.0, -1.0), repeat=3)))
    return np.array([A for A in signed if np.linalg.det(A) > 0])


TURNS = _turns()
"""(24, 3, 3): the turns that map axes onto axes."""


def in_unit_frame(mesh: Mesh) -> tuple[Array, Faces, Array]:
    """Welded vertices about their box's centre, in units of its diagonal, faces, and the map back (4, 4).

    The longest side of the box lies along x, the shortest along z. Of the turns that are left, the one is taken with
    the first list of sorted vertices, then of faces. Where several give the same lists, the mesh is its own image."""
    low, high = mesh.bounds
    size = float(np.linalg.norm(np.sort(high - low)))  # sorted: a sum of squares depends on their order
    rounded = np.round((mesh.vertices - (low + high) / 2) / size / GRID) * GRID
    welded = Mesh(vertices=rounded, faces=mesh.faces).welded
    sides = TURNS @ np.ptp(welded[0], axis=0)
    found = [(*_listed(*welded, A), A) for A in TURNS[(np.diff(np.abs(sides)) <= 0).all(1)]]
    vertices, faces, turn = found[0]
    for other in found[1:]:
        if _precedes(other[0], vertices) or (np.array_equal(other[0], vertices) and _precedes(other[1], faces)):
            vertices, faces, turn = other
    return vertices, faces, pose(size * turn.T, (low + high) / 2)


def _listed(vertices: Array, faces: Faces, A: Array) -> tuple[Array, Faces]:
    """A turned mesh: vertices sorted, faces from their first vertex on, sorted."""
    vertices, place = places(vertices @ A.T + 0.0)  # no -0
    faces = place[faces]
    faces = np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(3)) % 3, axis=1)
    return vertices, np.ascontiguousarray(faces[np.lexsort(faces.T[::-1])])


def _precedes(one: Array | Faces, other: Array | Faces) -> bool:
    """Whether one array comes before another of its shape: by the first number in which they differ."""
    differ = np.flatnonzero(one != other)
    return bool(len(differ) and one.flat[differ[0]] < other.flat[differ[0]])
