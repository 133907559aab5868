"""GLB: the whole scene as one binary glTF, Y up, metres, with smooth normals and the photo's camera.

A node per object has its id and label in the extras. The camera's extras hold the photo's exact one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, box_corners
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.symmetric_camera import symmetric
from f3sr.io.gltf_writer import GlbBuilder, safe_name
from f3sr.scene import Scene

T_YUP_ZUP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From the world (Z up) to glTF's axes (Y up)."""
T_CAMERA_GLTF = np.diag([1.0, -1, -1, 1])
"""From glTF's camera axes (y up, looks along -z) to ours."""
CAMERA = "photo_camera"
"""Name of the camera and its node, as in USD."""
SAME = 1e-3
"""Normals at one vertex that differ by less, about .06 degrees, are one: rounding parts no vertex."""
NEAR = 0.1
"""Distance of the camera's near plane [distance of what is nearest to it]. glTF wants one: no object is cut."""
LEAST_NEAR = 1e-4
"""The same [m], where an object reaches to the camera."""


class Glb:
    """The ``Exporter`` of ``scene.glb``. It holds no physics."""

    name = "glb"

    def files(self, exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
        yield "scene.glb", scene_to_glb(exported.scene)


def scene_to_glb(scene: Scene) -> bytes:
    """The whole scene: a node per object, and one of the photo's camera."""
    glb = GlbBuilder()
    for o in scene:
        name = safe_name(f"object_{o.id:02d}_{o.label}")
        mesh, normals = with_normals(o.mesh.with_vertices(o.scale * o.mesh.vertices))
        index = glb.add_mesh(mesh, name, normals)
        glb.add_node(name, mesh=index, T=T_YUP_ZUP @ o.T_world_object, extras={"id": o.id, "label": o.label})
    corners = [box_corners(o.bounds_world) for o in scene]
    _add_camera(glb, scene.camera, np.concatenate([np.zeros((0, 3)), *corners]))
    return glb.to_bytes()


def with_normals(mesh: Mesh) -> tuple[Mesh, NDArray[np.float32]]:
    """The same faces, and unit normals (n, 3) of their vertices: a vertex is there once for each normal at it.

    Corners of faces without area point upwards in the mesh's frame: glTF wants a normal, and nobody sees it."""
    normals = corner_normals(mesh).reshape(-1, 3)
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0, 0, 1]
    steps = np.rint(normals / SAME).astype(np.int64)
    key = steps @ [1 << 24, 1 << 12, 1]  # |steps| <= 1000: no two share a key
    _, normal = np.unique(key, return_inverse=True)
    pairs = mesh.faces.ravel().astype(np.int64) * (int(normal.max(initial=0)) + 1) + normal
    _, first, corner = np.unique(pairs, return_index=True, return_inverse=True)
    vertex = mesh.faces.ravel()[first]
    split = Mesh(
        vertices=mesh.vertices[vertex],
        faces=corner.reshape(-1, 3).astype(np.int32),
        uv=None if mesh.uv is None else mesh.uv[vertex],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[vertex],
        materials=mesh.materials,
        face_material=mesh.face_material,
    )
    return split, normals[first]


def _add_camera(glb: GlbBuilder, camera: Camera, points: Array) -> None:
    """The photo's camera, whose window glTF puts around its axis; ``points`` (n, 3) [m] are to be seen."""
    fitted = symmetric(camera)
    depth = fitted.camera.to_camera(points)[:, 2]
    nearest = float(depth[depth > 0].min(initial=np.inf))
    near = max(NEAR * nearest, LEAST_NEAR) if np.isfinite(nearest) else NEAR
    made = glb.add_camera(CAMERA, yfov=fitted.yfov, aspect=fitted.aspect, near=near)
    extras: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "T_gltf_camera": (T_YUP_ZUP @ camera.T_world_camera).tolist(),
        "axes": "x right, y down, z forward; pixel (0, 0) is the top left corner",
        "farthest_from_the_photo_px": fitted.farthest,
    }
    T = T_YUP_ZUP @ fitted.camera.T_world_camera @ T_CAMERA_GLTF
    glb.add_node(CAMERA, camera=made, T=T, extras=extras)
