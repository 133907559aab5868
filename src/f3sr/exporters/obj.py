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
    *,
    normals: NDArray[np.float32] | None = None,
    digits: int = 12,
) -> str:
    """Vertices (n, 3), triangles (m, 3) and, per vertex, texture coordinates (n, 2) with v upwards.

    ``normals`` (m, 3, 3) are those of the triangles' corners."""
    corner = (faces + 1).astype(np.int64)
    number = f"%.{digits}g"
    text = [*_rows(f"v {number} {number} {number}\n", vertices)]
    columns, form = [corner], "%d"
    if uv is not None:
        text += _rows("vt %.9g %.9g\n", uv)
        columns, form = [*columns, corner], "%d/%d"
    if normals is not None:
        distinct, which = np.unique(normals.reshape(-1, 3), axis=0, return_inverse=True)
        text += _rows("vn %.6g %.6g %.6g\n", distinct)
        columns, form = [*columns, which.reshape(-1, 3) + 1], f"{form}/%d" if uv is not None else "%d//%d"
    text += _rows(f"f {form} {form} {form}\n", np.stack(columns, axis=2).reshape(len(faces), -1))
    return "".join(text)


def _rows(line: str, values: NDArray[Any]) -> Iterator[str]:
    """``values`` (n, k), row by row in a line of k places; many rows in one go, which is twice as fast."""
    for start in range(0, len(values), BLOCK):
        block = values[start : start + BLOCK]
        yield line * len(block) % tuple(block.ravel().tolist())
