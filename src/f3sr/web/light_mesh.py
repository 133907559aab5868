"""A lighter mesh that looks the same: fewer triangles, with texture coordinates that never cross a seam."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import Mesh

Indices = NDArray[np.int64]


def lightened(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with about ``faces`` triangles; unchanged when it has no more.

    Quadric edge collapses act on the welded surface, so no seam opens. Every remaining triangle is one of the old
    ones with its corners moved. A moved corner takes texture coordinate and colour from the nearest merged vertex on
    the triangle's own side of any seam.
    """
    if len(mesh.faces) <= faces:
        return mesh
    points, cluster = _collapsed(mesh, faces)
    corners = cluster[mesh.faces]
    kept = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    assert mesh.face_material is not None
    group, chosen = _nearest_of_side(mesh, points, cluster)
    used, new_faces = np.unique(group[mesh.faces[kept]], return_inverse=True)
    source = chosen[used]
    return Mesh(
        vertices=points[cluster[source]],
        faces=new_faces.reshape(-1, 3).astype(np.int32),
        uv=None if mesh.uv is None else mesh.uv[source] + _uv_shift(mesh, source, points[cluster[source]]),
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[source],
        materials=mesh.materials,
        face_material=mesh.face_material[kept],
    )


def _collapsed(mesh: Mesh, faces: int) -> tuple[NDArray[np.float64], Indices]:
    """Places (k, 3) of the remaining vertices, and for every old vertex (n,) which of them it became."""
    import fast_simplification

    places, triangles = mesh.welded
    middle, size = places.mean(0), max(float(np.ptp(places, axis=0).max()), 1e-300)
    unit = np.ascontiguousarray((places - middle) / size, np.float32)
    simplify: Any = fast_simplification.simplify  # its annotations forget what it returns
    _, _, collapses = simplify(unit, triangles, target_count=faces, return_collapses=True)
    points, _, became = fast_simplification.replay_simplification(unit, triangles, collapses)
    return np.asarray(points, float) * size + middle, np.asarray(became, np.int64)[mesh.weld[1]]


def _nearest_of_side(mesh: Mesh, points: NDArray[np.float64], cluster: Indices) -> tuple[Indices, Indices]:
    """Old vertices that became one place, and hang together there without crossing a seam, form a group: its number
    per old vertex (n,), and per group the old vertex nearest to that place (g,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(mesh.vertices)
    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    ends = ends[cluster[ends[:, 0]] == cluster[ends[:, 1]]]
    links = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    group = connected_components(links, directed=False)[1].astype(np.int64)
    distance = np.linalg.norm(mesh.vertices - points[cluster], axis=1)
    order = np.lexsort((distance, group))
    first = np.r_[True, group[order][1:] != group[order][:-1]]
    return group, order[first]


def _uv_shift(mesh: Mesh, source: Indices, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """How texture coordinates change (g, 2) on the way from old vertices to new places (g, 3), to first order: by the
    gradient of the triangles around the vertex, each weighted by its area."""
    assert mesh.uv is not None
    a, b, c = mesh.faces.T
    e1, e2 = mesh.vertices[b] - mesh.vertices[a], mesh.vertices[c] - mesh.vertices[a]
    normal = np.cross(e1, e2)
    area = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    g1, g2 = np.cross(e2, normal) / area[:, None], np.cross(normal, e1) / area[:, None]
    d1, d2 = mesh.uv[b] - mesh.uv[a], mesh.uv[c] - mesh.uv[a]
    shift = np.empty((len(source), 2))
    n, corners, way = len(mesh.vertices), mesh.faces.ravel(), places - mesh.vertices[source]
    weight = np.maximum(np.bincount(corners, np.repeat(area, 3), n), 1e-300)
    for k in range(2):
        gradient = d1[:, [k]] * g1 + d2[:, [k]] * g2
        mean = [np.bincount(corners, np.repeat(gradient[:, i], 3), n) / weight for i in range(3)]
        shift[:, k] = sum(mean[i][source] * way[:, i] for i in range(3))
    return shift
