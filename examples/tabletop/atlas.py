"""A texture for a mesh without one: charts by facing, packed into a square, colours baked texel by texel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from f3sr.core.transforms import Array

MARGIN = 0.006
"""Gap around each chart, as a share of the texture's side."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Unwrapped:
    """A mesh cut along its chart borders; ``uv`` (n, 2) with the origin at the bottom left."""

    vertices: Array
    faces: NDArray[np.int64]
    uv: Array


def unwrap(mesh: trimesh.Trimesh) -> Unwrapped:
    """Faces that look along the same axis and hang together form a chart, projected along that axis."""
    axis, chart = charts(mesh)
    corner_chart = np.repeat(chart, 3)
    keys = np.stack([corner_chart, mesh.faces.reshape(-1)], -1)
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    vertices = np.asarray(mesh.vertices)[unique[:, 1]]

    chart_axis = np.zeros(chart.max() + 1, int)
    chart_axis[chart] = axis
    own, (x, y, z) = unique[:, 0], vertices.T
    flat = np.stack([np.where(chart_axis[own] == 0, y, x), np.where(chart_axis[own] == 2, y, z)], -1)
    low = np.array([flat[own == c].min(0) for c in range(len(chart_axis))])
    high = np.array([flat[own == c].max(0) for c in range(len(chart_axis))])
    scale, places = pack(high - low)
    uv = (flat - low[own]) * scale + places[own]
    return Unwrapped(vertices=vertices, faces=inverse.reshape(-1, 3), uv=uv)


def charts(mesh: trimesh.Trimesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Projection axis (m,) and chart number (m,) of each face; specks join the neighbour they face most."""
    normals = np.asarray(mesh.face_normals) + np.asarray(mesh.vertex_normals)[mesh.faces].mean(1)
    side = 2 * np.abs(normals).argmax(1)
    side += normals[np.arange(len(side)), side // 2] < 0
    a, b = np.asarray(mesh.face_adjacency).T
    for _ in range(6):
        chart = _components(side, a, b)
        small = np.bincount(chart)[chart] < 12
        for near, far in ((a, b), (b, a)):
            join = small[near] & ~small[far]
            target = side[far[join]]
            toward = normals[near[join], target // 2] * np.where(target % 2, -1, 1)
            side[near[join][toward > 0.05]] = target[toward > 0.05]
    return side // 2, _components(side, a, b)


def _components(side: NDArray[np.int64], a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    same = side[a] == side[b]
    graph = coo_array((np.ones(same.sum()), (a[same], b[same])), shape=(len(side), len(side)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def pack(sizes: Array) -> tuple[float, Array]:
    """The largest scale at which all boxes (k, 2) fit on shelves in the unit square, and their places."""
    order = np.argsort(-sizes[:, 1])
    scale = 2.0 / np.sqrt((sizes[:, 0] * sizes[:, 1]).sum())
    while (places := _shelves(sizes[order] * scale)) is None:
        scale *= 0.97
    return scale, places[np.argsort(order)]


def _shelves(sizes: Array) -> Array | None:
    places, x, y, shelf = np.zeros_like(sizes), MARGIN, MARGIN, 0.0
    for k, (w, h) in enumerate(sizes):
        if x + w + MARGIN > 1:
            x, y, shelf = MARGIN, y + shelf + MARGIN, 0.0
        if x + w + MARGIN > 1 or y + h + MARGIN > 1:
            return None
        places[k] = x, y
        x, shelf = x + w + MARGIN, max(shelf, h)
    return places


def bake(mesh: Unwrapped, paint: Callable[[Array], Array], *, size: int) -> NDArray[np.uint8]:
    """The texture (size, size, 3) of sRGB colours ``paint(points)``; gaps take the nearest colour."""
    scene = EmbreeScene()
    corners = np.column_stack([mesh.uv, np.zeros(len(mesh.uv))])[mesh.faces].reshape(-1, 3).astype(np.float32)
    keep = TriangleMesh(scene, corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    texel = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(texel, texel[::-1])
    origin = np.stack([u.ravel(), v.ravel(), np.ones(size * size)], -1).astype(np.float32)
    down = np.broadcast_to(np.array([0, 0, -1], np.float32), origin.shape).copy()
    hit = scene.run(origin, down, query="INTERSECT", output=1)
    del keep

    on = hit["primID"] >= 0
    a, b, c = (mesh.vertices[mesh.faces[hit["primID"][on]][:, k]] for k in range(3))
    s, t = hit["u"][on, None], hit["v"][on, None]
    colors = np.zeros((size * size, 3))
    colors[on] = paint(a * (1 - s - t) + b * s + c * t)
    _, nearest = distance_transform_edt(~on.reshape(size, size), return_indices=True)
    return np.round(255 * np.clip(colors.reshape(size, size, 3)[tuple(nearest)], 0, 1)).astype(np.uint8)
