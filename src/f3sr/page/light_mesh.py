"""A lighter mesh that looks the same: fewer triangles, every corner with a texture coordinate of its own chart."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.mesh import Mesh

Indices = NDArray[np.int64]


def lightened(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with about ``faces`` triangles; unchanged when it has no more.

    Quadric edge collapses act on the welded surface, so no seam opens. Every remaining triangle is one of the old
    ones with its corners moved. A moved corner takes the texture coordinate and colour of the nearest old vertex that
    was merged into it and belongs to the triangle's own chart: never one from across a seam.
    """
    if len(mesh.faces) <= faces:
        return mesh
    points, cluster = _collapsed(mesh, faces)
    corners = cluster[mesh.faces]
    kept = (corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2]) & (corners[:, 2] != corners[:, 0])
    assert mesh.face_material is not None
    chart = _charts(mesh)
    group, chosen = _nearest_of_chart(mesh, points, cluster, chart)
    used, new_faces = np.unique(group[mesh.faces[kept]], return_inverse=True)
    source = chosen[used]
    return Mesh(
        vertices=points[cluster[source]],
        faces=new_faces.reshape(-1, 3).astype(np.int32),
        uv=None if mesh.uv is None else mesh.uv[source],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[source],
        materials=mesh.materials,
        face_material=mesh.face_material[kept],
    )


def _collapsed(mesh: Mesh, faces: int) -> tuple[NDArray[np.float64], Indices]:
    """Places (k, 3) of the remaining vertices, and for every old vertex (n,) which of them it became."""
    import fast_simplification

    places, weld = np.unique(mesh.vertices, axis=0, return_inverse=True)
    weld = weld.reshape(-1)
    triangles = weld[mesh.faces]
    a, b, c = triangles.T
    triangles = np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)], np.int32)
    middle, size = places.mean(0), max(float(np.ptp(places, axis=0).max()), 1e-300)
    unit = np.ascontiguousarray((places - middle) / size, np.float32)
    simplify: Any = fast_simplification.simplify  # its annotations forget what it returns
    _, _, collapses = simplify(unit, triangles, target_count=faces, return_collapses=True)
    points, _, became = fast_simplification.replay_simplification(unit, triangles, collapses)
    return np.asarray(points, float) * size + middle, np.asarray(became, np.int64)[weld]


def _charts(mesh: Mesh) -> Indices:
    """Label (n,) of the connected piece of surface, as its texture is cut, that a vertex belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(mesh.vertices)
    ends = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]])
    links = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    return connected_components(links, directed=False)[1].astype(np.int64)


def _nearest_of_chart(
    mesh: Mesh, points: NDArray[np.float64], cluster: Indices, chart: Indices
) -> tuple[Indices, Indices]:
    """Old vertices that became one place in one chart form a group: its number per old vertex (n,), and per group the
    old vertex nearest to that place (g,)."""
    distance = np.linalg.norm(mesh.vertices - points[cluster], axis=1)
    order = np.lexsort((distance, chart, cluster))
    c, k = cluster[order], chart[order]
    first = np.r_[True, (c[1:] != c[:-1]) | (k[1:] != k[:-1])]
    group = np.empty(len(order), np.int64)
    group[order] = np.cumsum(first) - 1
    return group, order[first]
