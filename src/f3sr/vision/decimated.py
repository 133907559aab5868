"""Meshes light enough to be drawn hundreds of times, for searches that compare nothing but silhouettes."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.scene import SceneObject

_KNOWN: WeakKeyDictionary[Mesh, dict[int, Mesh]] = WeakKeyDictionary()


def outlined(o: SceneObject, max_faces: int) -> SceneObject:
    """The object with a mesh of at most about ``max_faces``."""
    light = outline_mesh(o.mesh, max_faces)
    return o if light is o.mesh else replace(o, mesh=light)


def outline_mesh(mesh: Mesh, max_faces: int) -> Mesh:
    """A mesh of at most about ``max_faces``; made once per mesh, as long as somebody holds that."""
    if len(mesh.faces) <= max_faces:
        return mesh
    known = _KNOWN.setdefault(mesh, {})
    if max_faces not in known:
        known[max_faces] = _simplified(mesh, max_faces)
    return known[max_faces]


def _simplified(mesh: Mesh, max_faces: int) -> Mesh:
    import fast_simplification

    vertices, faces = mesh.welded
    light = fast_simplification.simplify(vertices, faces, target_count=max_faces)
    return Mesh(vertices=np.asarray(light[0], float), faces=np.asarray(light[1], np.int32))
