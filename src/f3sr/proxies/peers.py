"""CoACD and V-HACD as they are, for comparison: their parts may leave surface uncovered and bridge cavities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from f3sr.frames import Array
from f3sr.mesh import ConvexPart
from f3sr.proxies import fit
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.parts import Fitted, decimated
from f3sr.proxies.surface import Faces, Nearest, surroundings

COACD: dict[str, Any] = {
    "threshold": 0.05,
    "max_convex_hull": 32,
    "preprocess_mode": "off",
    "resolution": 1000,
    "mcts_nodes": 10,
    "mcts_iterations": 60,
    "mcts_max_depth": 2,
    "seed": 0,
}
"""Settings of CoACD: its default concavity, on a simplified mesh, its search as small as it takes."""
VHACD: dict[str, Any] = {"maxConvexHulls": 32, "resolution": 400_000, "asyncACD": False}
"""Settings of V-HACD: its default resolution."""


def several(vertices: Array, faces: Faces, config: ProxyConfig) -> Fitted:
    """The hulls that the peer of ``config.method`` finds; ValueError when none spans a volume."""
    pieces = _coacd(vertices, faces, config) if config.method == "coacd" else _vhacd(vertices, faces)
    parts = tuple(_with_volume(pieces))
    if not parts:
        raise ValueError(f"{config.method} found no part with a volume")
    around = surroundings(vertices, faces, config)
    return Fitted(
        parts=parts,
        inflation=fit.inflation(parts, vertices, faces),
        outside=fit.largest_outside(parts, vertices[np.unique(faces)]),
        excess=fit.excess(parts, Nearest.on(vertices, faces), around, config.probe),
    )


def _coacd(vertices: Array, faces: Faces, config: ProxyConfig) -> list[Array]:
    import coacd

    coacd.set_log_level("error")
    mesh = coacd.Mesh(*decimated(vertices, faces, config.target_faces))
    return [np.asarray(points, float) for points, _ in coacd.run_coacd(mesh, **COACD)]


def _vhacd(vertices: Array, faces: Faces) -> list[Array]:
    import vhacdx

    pieces = vhacdx.compute_vhacd(vertices, faces.astype(np.uint32), **VHACD)
    return [np.asarray(points, float) for points, _ in pieces]


def _with_volume(pieces: Sequence[Array]) -> list[ConvexPart]:
    found: list[ConvexPart] = []
    for piece in pieces:
        try:
            hull = ConvexPart.hull_of(piece)
        except ValueError:
            continue
        if hull.volume > 1e-9:
            found.append(hull)
    return found
