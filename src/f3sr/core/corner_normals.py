"""Smooth normals of triangle meshes, one a corner: a mean, in which faces beyond a sharp edge do not count."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import cross

CREASE = 0.7
"""Least angle between triangles at which their common edge is seen [rad]. It is 40 degrees: sides of a 12-sided
cylinder (30 degrees) look round, those of an octagon (45 degrees) flat."""
FAN = 256
"""Corners that meet at a vertex, at most, for it to be smooth. More are the tip of a cone or the middle of a flat fan:
a mean over all pairs of them would say nothing and take long."""
PAIRS = 500_000
"""Pairs of a corner and a face around it that are in memory at a time."""


def corner_normals(mesh: Mesh, crease: float = CREASE) -> NDArray[np.float32]:
    """Unit normals (m, 3, 3) of all faces' corners, in the mesh's frame; edges beyond ``crease`` [rad] stay sharp.

    Each is the mean, by area, of the faces around the corner's vertex that turn away from its own by less. Texture
    seams do not matter. Those of faces without area may be 0."""
    places, place = mesh.weld
    corner = place[mesh.faces].ravel()
    a, b, c = places[corner].reshape(-1, 3, 3).swapaxes(0, 1)
    flat = cross(b - a, c - a)  # as long as twice the area: plain sums are means by area
    length = np.linalg.norm(flat, axis=1)
    sums = np.empty((len(corner), 3))
    for corners, k, face in _pairs(corner, len(places)):
        own = k // 3
        dot = np.einsum("ij,ij->i", flat.take(own, 0), flat.take(face, 0))
        near = (face != own) & (dot > np.cos(crease) * length.take(own) * length.take(face))
        first = corners[0]
        into, added = np.concatenate([corners, k[near]]) - first, np.concatenate([corners // 3, face[near]])
        for axis in range(3):
            sums[corners, axis] = np.bincount(into, flat[:, axis].take(added), len(corners))
    norm = np.maximum(np.linalg.norm(sums, axis=1), 1e-30)
    return (sums / norm[:, None]).reshape(-1, 3, 3).astype(np.float32)


def _pairs(
    corner: NDArray[np.int32], vertices: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """Corners in their order, a block at a time, and as rows of pairs a corner and a face around its vertex.

    ``corner`` has the vertex of every corner; corner k is of face k // 3."""
    order = np.argsort(corner, kind="stable")
    count = np.bincount(corner, minlength=vertices)
    begin = np.cumsum(count) - count
    count = np.where(count > FAN, 0, count)[corner]
    block = np.cumsum(count) // PAIRS
    for corners in np.split(np.arange(len(corner)), np.flatnonzero(np.diff(block)) + 1):
        n = count[corners]
        k = np.repeat(corners, n)
        nth = np.arange(len(k)) - np.repeat(np.cumsum(n) - n, n)
        yield corners, k, order[begin[corner[k]] + nth] // 3
