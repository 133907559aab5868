"""All triangles of a scene in one set of arrays, with smooth normals, and the simpler ones that cast its shadows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr import raster
from f3sr.frames import Array
from f3sr.mesh import Mesh, is_closed, signed_volume
from f3sr.rendering.shadow_maps import Caster
from f3sr.rendering.surface_kernels import Shapes, corner_normals
from f3sr.rendering.textures import linear
from f3sr.scene import SceneObject


def shapes_of(objects: Sequence[SceneObject], *, crease: float) -> Shapes:
    """The triangles of some objects, one after the other; edges of more than ``crease`` [rad] stay sharp."""
    meshes = [o.mesh for o in objects]
    vertex, slot = starts_of([len(m.vertices) for m in meshes]), starts_of([len(m.materials) for m in meshes])
    return Shapes(
        faces=_joined([m.faces + k for m, k in zip(meshes, vertex, strict=False)], np.int32, 3),
        object=_joined([np.full(len(m.faces), k) for k, m in enumerate(meshes)], np.int32),
        slot=_joined([np.asarray(m.face_material) + k for m, k in zip(meshes, slot, strict=False)], np.int32),
        normals=_joined([smooth_normals(m, crease) for m in meshes], np.float32, 3, 3),
        flat=_joined([_flat_normals(m) for m in meshes], np.float32, 3),
        uv=_joined([np.zeros((len(m.vertices), 2)) if m.uv is None else m.uv for m in meshes], np.float32, 2),
        colors=_joined([_vertex_colors(m) for m in meshes], np.float32, 3),
    )


def _joined(arrays: Sequence[NDArray[Any]], dtype: Any, *shape: int) -> NDArray[Any]:
    """Some arrays of rows of a ``shape``, one after the other, as kernels take them."""
    return raster.fixed(np.concatenate([np.empty((0, *shape), dtype), *arrays]), dtype)


def smooth_normals(mesh: Mesh, crease: float) -> NDArray[np.float32]:
    """Unit normals (m, 3, 3) of every face's corners, in the mesh's frame."""
    unique, welded = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = welded.reshape(-1)[mesh.faces]
    order = np.argsort(faces.ravel(), kind="stable")
    first = np.searchsorted(faces.ravel()[order], np.arange(len(unique) + 1))
    out = np.empty((len(faces), 3, 3), np.float32)
    corner_normals(
        raster.fixed(unique, np.float64),
        raster.fixed(faces, np.int32),
        raster.fixed(first, np.int64),
        raster.fixed(order // 3, np.int64),
        float(np.cos(crease)),
        out,
    )
    return out


def _flat_normals(mesh: Mesh) -> Array:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None]


def _vertex_colors(mesh: Mesh) -> Array:
    if mesh.vertex_colors is None:
        return np.ones((len(mesh.vertices), 3))
    return linear(mesh.vertex_colors / 255)


def casters_of(objects: Sequence[SceneObject], faces: int) -> tuple[Caster, ...]:
    """Every object in its frame at its scale, with about ``faces`` triangles or fewer."""
    return tuple(_caster(o.scale, *_simplified(o.mesh, faces)) for o in objects)


def faces_outward(vertices: Array, faces: NDArray[np.int32]) -> bool:
    """Whether a surface is closed and turned outward, so that what faces away is always hidden by what does not."""
    return is_closed(faces) and signed_volume(vertices, faces) > 0


def _caster(scale: float, vertices: Array, faces: NDArray[np.int32]) -> Caster:
    return Caster(scale * vertices, faces, faces_outward(vertices, faces))


def _simplified(mesh: Mesh, faces: int) -> tuple[Array, NDArray[np.int32]]:
    """Garland and Heckbert, "Surface simplification using quadric error metrics" (1997), on the welded surface, and
    nowhere outside of it, where it would shade the very surface that it stands for."""
    vertices, triangles = mesh.welded
    if len(triangles) <= faces:
        return vertices, triangles
    import fast_simplification

    simplified: Any = fast_simplification.simplify(vertices, triangles, target_count=faces)
    return _withdrawn(np.asarray(simplified[0], np.float64), vertices, triangles), np.asarray(simplified[1], np.int32)


def _withdrawn(points: Array, vertices: Array, faces: NDArray[np.int32]) -> Array:
    """``points`` (k, 3) that stand out of a surface moved back to it, against the normal of its nearest vertex."""
    from scipy.spatial import KDTree

    a, b, c = (vertices[faces[:, k]] for k in range(3))
    sums = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(sums, faces[:, k], np.cross(b - a, c - a))
    nearest = np.asarray(KDTree(vertices).query(points)[1])
    normals = sums[nearest] / np.maximum(np.linalg.norm(sums[nearest], axis=1), 1e-30)[:, None]
    out = ((points - vertices[nearest]) * normals).sum(1)
    return points - np.maximum(out, 0)[:, None] * normals


def starts_of(counts: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
