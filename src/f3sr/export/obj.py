"""Wavefront OBJ, for the programs that read no GLB."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array
from f3sr.mesh import ConvexPart


def part_to_obj(part: ConvexPart) -> str:
    """A convex part in its own frame; coordinates survive to 12 digits."""
    return to_obj(part.vertices, part.faces)


def to_obj(vertices: Array, faces: NDArray[np.int32], uv: Array | None = None) -> str:
    """Vertices (n, 3), triangles (m, 3) and, per vertex, texture coordinates (n, 2) with v upwards."""
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in vertices.tolist()]
    corners = (faces + 1).tolist()
    if uv is None:
        lines += [f"f {a} {b} {c}" for a, b, c in corners]
    else:
        lines += [f"vt {s:.9g} {t:.9g}" for s, t in uv.tolist()]
        lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in corners]
    return "\n".join(lines) + "\n"
