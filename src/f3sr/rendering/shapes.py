"""All triangles of a scene in one set of arrays, with smooth normals, and simplified ones that cast shadows."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Mesh, is_closed, signed_volume
from f3sr.core.srgb import linear
from f3sr.core.transforms import Array
from f3sr.rendering.shadow_maps import Caster
from f3sr.rendering.surface_kernels import Shapes
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer


def shapes_of(objects: Sequence[SceneObject], *, crease: float) -> Shapes:
    """The triangles of some objects, one after the other, unscaled in their own frames.

    An edge between faces that turn by more than ``crease`` [rad] stays sharp."""
    meshes = [o.mesh for o in objects]
    # Rows of one object become rows of all by adding where the object's own begin; zip drops the total at the end.
    vertex, slot = starts_of([len(m.vertices) for m in meshes]), starts_of([len(m.materials) for m in meshes])
    return Shapes(
        faces=_joined([m.faces + k for m, k in zip(meshes, vertex, strict=False)], np.int32, 3),
        object=_joined([np.full(len(m.faces), k) for k, m in enumerate(meshes)], np.int32),
        slot=_joined([np.asarray(m.face_material) + k for m, k in zip(meshes, slot, strict=False)], np.int32),
        normals=_joined([corner_normals(m, crease) for m in meshes], np.float32, 3, 3),
        flat=_joined([_flat_normals(m) for m in meshes], np.float32, 3),
        uv=_joined([np.zeros((len(m.vertices), 2)) if m.uv is None else m.uv for m in meshes], np.float32, 2),
        colors=_joined([_vertex_colors(m) for m in meshes], np.float32, 3),
    )


def _joined(arrays: Sequence[NDArray[Any]], dtype: Any, *shape: int) -> NDArray[Any]:
    """Some arrays of rows of a ``shape``, one after the other, as kernels take them."""
    return rasterizer.fixed(np.concatenate([np.empty((0, *shape), dtype), *arrays]), dtype)


def _flat_normals(mesh: Mesh) -> Array:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]


def _vertex_colors(mesh: Mesh) -> Array:
    if mesh.vertex_colors is None:
        return np.ones((len(mesh.vertices), 3))
    return linear(mesh.vertex_colors / 255)


def casters_of(objects: Sequence[SceneObject], *faces: int) -> tuple[tuple[Caster, ...], ...]:
    """For each number of ``faces``, largest first: every object, in its scaled frame, with at most about so many
    faces."""
    made = [_casters(o, faces) for o in objects]
    return tuple(tuple(casters[k] for casters in made) for k in range(len(faces)))


def faces_outward(vertices: Array, faces: NDArray[np.int32]) -> bool:
    """Whether a surface is closed and turned outward, so that what faces away is always hidden by what does not."""
    return is_closed(faces) and signed_volume(vertices, faces) > 0


def _casters(o: SceneObject, faces: Sequence[int]) -> list[Caster]:
    """An object with fewer and fewer triangles (Garland and Heckbert, "Surface simplification using quadric error
    metrics", 1997).

    It acts on the welded surface. No result is outside it: there it would shade the surface that it replaces."""
    import fast_simplification

    vertices, triangles = o.mesh.welded
    within, made = _Within(vertices, triangles), list[Caster]()
    for count in faces:
        # Goals fall: each starts from the last result, which has done a part of the collapses.
        if len(triangles) > count:
            simplified: Any = fast_simplification.simplify(vertices, triangles, target_count=count)
            vertices = within.moved(np.asarray(simplified[0], np.float64))
            triangles = np.asarray(simplified[1], np.int32)
        made.append(Caster(o.scale * vertices, triangles, faces_outward(vertices, triangles)))
    return made


class _Within:
    """Moves points that stand out of a surface back to it, against the normal of its nearest vertex."""

    def __init__(self, vertices: Array, faces: NDArray[np.int32]) -> None:
        self._vertices, self._faces = vertices, faces

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self._vertices)

    @cached_property
    def _sums(self) -> Array:
        """(n, 3) along the normals of the vertices, weighted by the areas of the faces around [m2]."""
        corners = self._vertices[self._faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        rows, count = self._faces.ravel(), len(self._vertices)
        # bincount scatters: every face's cross product is added to its three vertices.
        sums = [np.bincount(rows, np.repeat(across[:, c], 3), count) for c in range(3)]
        return np.asarray(np.stack(sums, axis=1), np.float64)

    def moved(self, points: Array) -> Array:
        """Points (k, 3) [m], those above the tangent plane of their nearest vertex moved down onto it."""
        nearest = np.asarray(self._tree.query(points)[1])
        normals = self._sums[nearest] / np.maximum(np.linalg.norm(self._sums[nearest], axis=1), 1e-30)[:, None]
        # Height over the tangent plane; only what stands out moves.
        out = ((points - self._vertices[nearest]) * normals).sum(1)
        return points - np.maximum(out, 0)[:, None] * normals


def starts_of(counts: Sequence[int]) -> NDArray[np.int64]:
    """Where each of some lists begins when they are joined, and where the last ends: (len(counts) + 1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
