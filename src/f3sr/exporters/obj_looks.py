"""Visual meshes as OBJ with MTL and PNG, for formats that name mesh files, and convex parts beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from f3sr.exporters.exported_scene import ExportedObject
from f3sr.exporters.looks import ExportedLook
from f3sr.exporters.obj import part_to_obj, to_obj

MESHES = "meshes"
"""The folder of mesh files, relative to that of the object."""


def visual_path(look: ExportedLook) -> str:
    """Where a look's OBJ lies, relative to the object's folder."""
    return f"{MESHES}/visual_{look.number:02d}.obj"


def hull_path(k: int) -> str:
    """Where a convex part lies, relative to the object's folder."""
    return f"{MESHES}/hull_{k:03d}.obj"


def mesh_files(o: ExportedObject, *, hull_unit: float = 1.0) -> Iterator[tuple[str, bytes]]:
    """All mesh files of an object with their paths, in the object frame: looks in metres, convex parts in units of
    ``hull_unit`` [m]."""
    for look in o.looks:
        path = visual_path(look)
        stem = path.removesuffix(".obj")
        name = stem.rpartition("/")[2]
        body = to_obj(look.vertices, look.faces, look.uv, normals=look.normals)
        yield path, f"mtllib {name}.mtl\nusemtl {name}\n{body}".encode()
        yield f"{stem}.mtl", _mtl(name, look).encode()
        if look.png is not None:
            yield f"{stem}.png", look.png
    for k, part in enumerate(o.colliders):
        yield hull_path(k), part_to_obj(replace(part, vertices=part.vertices / hull_unit)).encode()


def _mtl(name: str, look: ExportedLook) -> str:
    """A dull material of the look's colour and texture."""
    color = " ".join(f"{c:.6g}" for c in np.clip(look.rgb, 0, 1))
    lines = [f"newmtl {name}", f"Ka {color}", f"Kd {color}", "Ks 0 0 0", "d 1", "illum 1"]
    if look.png is not None:
        lines.append(f"map_Kd {name}.png")
    return "\n".join(lines) + "\n"
