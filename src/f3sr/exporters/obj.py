"""Wavefront OBJ, for the programs that read no GLB."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array

BLOCK = 20_000
"""Rows that are written at a time."""


def part_to_obj(part: ConvexPart) -> str:
    """A convex part in its own frame, in single precision and exactly: MuJoCo takes meshes in single precision from
    memory and in double from files, and both are to see the same."""
    return to_obj(part.vertices.astype(np.float32).astype(float), part.faces, digits=17)


def to_obj(
    vertices: Array,
    faces: NDArray[np.int32],
    uv: Array | None = None,
    uv_faces: NDArray[np.int32] | None = None,
    *,
    digits: int = 12,
) -> str:
    """Vertices (n, 3), triangles (m, 3) and texture coordinates (k, 2) with v upwards: those of the corners' rows
    (m, 3), or of the vertices."""
    corners = (faces + 1).astype(np.int64)
    number = f"%.{digits}g"
    text = [*_rows(f"v {number} {number} {number}\n", vertices)]
    if uv is None:
        text += _rows("f %d %d %d\n", corners)
    else:
        text += _rows("vt %.9g %.9g\n", uv)
        shown = corners if uv_faces is None else (uv_faces + 1).astype(np.int64)
        text += _rows("f %d/%d %d/%d %d/%d\n", np.stack([corners, shown], 2).reshape(-1, 6))
    return "".join(text)


def _rows(line: str, values: NDArray[Any]) -> Iterator[str]:
    """``values`` (n, k), row by row in a line of k places; many rows in one go, which is twice as fast."""
    for start in range(0, len(values), BLOCK):
        block = values[start : start + BLOCK]
        yield line * len(block) % tuple(block.ravel().tolist())
