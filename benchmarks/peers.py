"""CoACD and V-HACD as they are, for comparison: their parts may leave surface uncovered and bridge cavities.

They run in this process and without a limit on time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from f3sr.core.mesh import ConvexPart, Mesh, mass_properties, union
from f3sr.core.transforms import Array
from f3sr.proxies import Excess, ProxyConfig, fit
from f3sr.proxies.parts import FittedParts, decimated, nearly_convex, one_hull
from f3sr.proxies.surface import PROBE, Faces, NearestTriangles, surroundings
from f3sr.proxies.unit_frame import GRID
from f3sr.scene import Scene
from f3sr.stages.decompose import Decomposed, ProxyFit

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
SMALLEST = 1e-9
"""Volume of a part [size^3] below which it spans none."""


@dataclass(frozen=True, kw_only=True)
class PeerProxy:
    """What ``f3sr.proxies.Proxy`` says of the product's parts, of a peer's."""

    parts: tuple[ConvexPart, ...]
    method: str
    """``hull`` where one is enough, ``hull-fallback`` where the peer found no part with a volume."""
    inflation: float | None
    outside: float
    excess: Excess
    """Its place is in shares of the mesh's size about its middle."""


def decompose(mesh: Mesh, method: str, config: ProxyConfig | None = None) -> PeerProxy:
    """Parts of one mesh by ``coacd`` or ``vhacd``; one hull where the product takes one, too."""
    config = config or ProxyConfig()
    middle, size = mesh.bounds.mean(0), mesh.diagonal
    rounded = np.round((mesh.vertices - middle) / size / GRID) * GRID + 0.0
    vertices, faces = Mesh(vertices=rounded, faces=mesh.faces).welded
    if nearly_convex(vertices, faces, config):
        method, fitted = "hull", one_hull(vertices, faces, config)
    elif parts := _with_volume(PEERS[method](vertices, faces, config)):
        fitted = _fitted(parts, vertices, faces)
    else:
        method, fitted = "hull-fallback", one_hull(vertices, faces, config)
    T_mesh_unit = np.diag([size, size, size, 1.0])
    T_mesh_unit[:3, 3] = middle
    return PeerProxy(
        parts=tuple(p.moved(T_mesh_unit) for p in fitted.parts),
        method=method,
        inflation=fitted.inflation,
        outside=fitted.outside,
        excess=fitted.excess,
    )


def stage(method: str) -> Callable[[Scene, ProxyConfig], tuple[Scene, Decomposed]]:
    """Stands in for the stage ``decompose``."""

    def decomposed(scene: Scene, config: ProxyConfig) -> tuple[Scene, Decomposed]:
        found = {o.id: decompose(o.mesh, method, config) for o in scene}
        fits = {
            id: ProxyFit(parts=len(p.parts), inflation=p.inflation, excess=p.excess, outside=p.outside)
            for id, p in found.items()
        }
        scene = scene.with_objects(*(replace(o, parts=found[o.id].parts) for o in scene))
        return scene, Decomposed(fits=fits)

    return decomposed


def _fitted(parts: Sequence[ConvexPart], vertices: Array, faces: Faces) -> FittedParts:
    around, solid = surroundings(vertices, faces), mass_properties(*union(parts))
    return FittedParts(
        parts=tuple(parts),
        solid=solid,
        inflation=fit.inflation(solid, vertices, faces),
        outside=fit.largest_outside(parts, vertices[np.unique(faces)]),
        excess=fit.excess(parts, NearestTriangles.on(vertices, faces), around, PROBE),
    )


def _coacd(vertices: Array, faces: Faces, config: ProxyConfig) -> list[Array]:
    import coacd

    coacd.set_log_level("error")
    mesh = coacd.Mesh(*decimated(vertices, faces, config.cuts.target_faces))
    return [np.asarray(points, float) for points, _ in coacd.run_coacd(mesh, **COACD)]


def _vhacd(vertices: Array, faces: Faces, _: ProxyConfig) -> list[Array]:
    import vhacdx

    pieces = vhacdx.compute_vhacd(vertices, faces.astype(np.uint32), **VHACD)
    return [np.asarray(points, float) for points, _ in pieces]


PEERS: Mapping[str, Callable[[Array, Faces, ProxyConfig], list[Array]]] = {"coacd": _coacd, "vhacd": _vhacd}


def _with_volume(pieces: Sequence[Array]) -> list[ConvexPart]:
    found: list[ConvexPart] = []
    for piece in pieces:
        try:
            hull = ConvexPart.hull_of(piece)
        except ValueError:
            continue
        if hull.volume > SMALLEST:
            found.append(hull)
    return found
