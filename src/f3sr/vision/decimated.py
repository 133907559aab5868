"""Meshes light enough to be drawn hundreds of times, for searches that compare nothing but silhouettes."""

from __future__ import annotations

from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.scene import SceneObject

_KNOWN: WeakKeyDictionary[Mesh, dict[int, Mesh]] = WeakKeyDictionary()


def outlined(o: SceneObject, max_faces: int) -> SceneObject:
    """The object with a mesh of at most about ``max_faces``; made once per mesh, as long as somebody holds that."""
    if len(o.mesh.faces) <= max_faces:
        return o
    known = _KNOWN.setdefault(o.mesh, {})
    if max_faces not in known:
        known[max_faces] = _simplified(o.mesh, max_faces)
    return replace(o, mesh=known[max_faces])


def _simplified(mesh: Mesh, max_faces: int) -> Mesh:
    import fast_simplification

    vertices, faces = mesh.welded
    light = fast_simplification.simplify(vertices, faces, target_count=max_faces)
    return Mesh(vertices=np.asarray(light[0], float), faces=np.asarray(light[1], np.int32))
