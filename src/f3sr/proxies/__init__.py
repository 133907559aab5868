"""Convex collision proxies of a mesh that cover it: no point of the visual surface lies outside their union.

A mesh that is nearly its own hull gets one part. Others are cut by planes, exactly through their triangles. This ends
when the hulls of the pieces have a small stand-off from the reachable surface everywhere. Then neighbours are joined
where that costs nothing. Finally every hull is simplified outward, to a polytope of few of its own facet planes. A
process with limits on its time does this. All lengths inside are shares of the mesh's size (the diagonal of its
bounding box), and axes are the mesh's own. So the result does not depend on the unit, axes or order of its file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from f3sr.core.mesh import ConvexPart, MassProperties, Mesh
from f3sr.core.transforms import Array, transform
from f3sr.errors import InputError
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.fit import Excess
from f3sr.proxies.joins import Join
from f3sr.proxies.parts import FittedParts, as_given, nearly_convex, one_hull
from f3sr.proxies.store import key_of, packed, unpacked
from f3sr.proxies.surface import Faces
from f3sr.proxies.unit_frame import in_unit_frame
from f3sr.proxies.worker import ProxyWorker
from f3sr.report import Decision
from f3sr.runtime.cache_folder import within
from f3sr.runtime.daemon_thread import begun
from f3sr.runtime.machine import usable_cores
from f3sr.runtime.result_store import Arrays, Store

__all__ = ["Excess", "Join", "Proxy", "ProxyConfig", "check", "decompose", "decompose_all", "decomposing", "split"]

INFLATION_LIMIT = 1.4
"""Ratio of the volume of the parts to that of the mesh above which a decision names the object."""

Method = Literal["hull", "cuts", "hull-fallback", "given"]
STICKS_OUT = 1e-6
"""How far a mesh may stick out of given pieces [size]: rounding."""


@dataclass(frozen=True, kw_only=True)
class Proxy:
    """The convex parts of one mesh, in its frame and unit, and how well they fit."""

    parts: tuple[ConvexPart, ...]
    method: Method
    decisions: tuple[Decision, ...] = ()
    inflation: float | None = None
    """Volume of the union over the volume of the mesh; None when the mesh is no solid."""
    outside: float
    """Largest distance of a visual vertex outside all parts [size]."""
    excess: Excess
    """How far they stand off the mesh, where something can touch it [size]; the place is in the mesh's frame."""
    solid: MassProperties
    """Of the union of the parts."""
    joins: tuple[Join, ...] = ()
    """How parts may be joined further, where nothing touches."""
    cut_short: bool = False
    """An attempt was killed by its limit, so another run may do better; such a result is never cached."""


def decompose(
    mesh: Mesh,
    config: ProxyConfig | None = None,
    *,
    cache_dir: Path | None = None,
    name: str = "mesh",
    about: int | None = None,
) -> Proxy:
    """Convex parts of one mesh; ``name`` appears in errors, ``about`` (an object id) in decisions.

    Results are kept by the hash of their input in ``cache_dir``, by default ``proxies`` in f3sr's cache.
    Raises InputError when there are no faces or a coordinate is not finite, before anything is started.
    """
    check(mesh, name)
    with ProxyWorker(config or ProxyConfig()) as worker:
        return _decomposed(mesh, worker, cache_dir, about)


@contextmanager
def decomposing(meshes: Sequence[Mesh], config: ProxyConfig) -> Generator[Callable[[], list[Proxy]]]:
    """``decompose_all`` beside the block, which ends it; the call waits for its result and raises what it raised."""
    cancelled = threading.Event()
    try:
        yield begun(decompose_all, meshes, config, cancelled=cancelled).result
    finally:
        cancelled.set()


def decompose_all(
    meshes: Sequence[Mesh],
    config: ProxyConfig | None = None,
    *,
    cache_dir: Path | None = None,
    ids: Sequence[int] | None = None,
    cancelled: threading.Event | None = None,
) -> list[Proxy]:
    """Convex parts of many meshes, by one worker per processor, large ones first; ``ids`` name them in decisions.

    Another thread may set ``cancelled``: workers are killed and CancelledError raised.
    """
    cancelled = cancelled or threading.Event()
    ids = range(len(meshes)) if ids is None else ids
    for mesh, id in zip(meshes, ids, strict=True):
        check(mesh, f"mesh of object {id}")
    waiting = iter(sorted(range(len(meshes)), key=lambda k: -len(meshes[k].faces)))
    found: dict[int, Proxy] = {}

    def serve() -> None:
        with ProxyWorker(config or ProxyConfig(), cancelled) as worker:
            for k in waiting:
                found[k] = _decomposed(meshes[k], worker, cache_dir, ids[k])

    with ThreadPoolExecutor(cores := usable_cores()) as pool:
        try:
            for served in [pool.submit(serve) for _ in range(cores)]:
                served.result()
        except BaseException:  # a failure or Ctrl-C: leaving the pool waits for its threads, and they for workers
            cancelled.set()
            raise
    return [found[k] for k in range(len(meshes))]


def split(mesh: Mesh, config: ProxyConfig | None = None) -> int:
    """How many parts a worker of its own finds; RuntimeError with the reason where it finds none."""
    vertices, faces, _ = in_unit_frame(mesh)
    with ProxyWorker(config or ProxyConfig()) as worker:
        outcome = worker.split(vertices, faces)
    if not outcome.fitted:
        raise RuntimeError(outcome.reason)
    return len(outcome.fitted.parts)


def check(mesh: Mesh, name: str) -> None:
    """Refuse what has no surface."""
    accepted = "a mesh with faces, finite vertices and an extent"
    if not len(mesh.faces) or not len(mesh.vertices):
        raise InputError(name, found=f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces", accepted=accepted)
    if not np.isfinite(mesh.vertices).all():
        bad = int((~np.isfinite(mesh.vertices).all(1)).sum())
        raise InputError(name, found=f"{bad} vertices that are not finite", accepted=accepted)
    if mesh.diagonal == 0:
        raise InputError(name, found="all vertices at one point", accepted=accepted)


def _decomposed(mesh: Mesh, worker: ProxyWorker, cache_dir: Path | None, about: int | None) -> Proxy:
    """The parts of a mesh in its frame and unit, from the cache or made anew."""
    vertices, faces, T_mesh_unit = in_unit_frame(mesh)
    if mesh.pieces and (proxy := _given(mesh, vertices, faces, T_mesh_unit)).outside <= STICKS_OUT:
        return _in_frame(proxy, T_mesh_unit, about)
    store, key = Store(cache_dir or within("proxies"), share=0.1), key_of(vertices, faces, worker.config)
    if found := store.load(key):
        proxy = _restored(*found)
    else:
        proxy = _decompose_unit(vertices, faces, worker)
        if not proxy.cut_short:
            store.save(key, *_stored(proxy))
    return _in_frame(proxy, T_mesh_unit, about)


def _given(mesh: Mesh, vertices: Array, faces: Faces, T_mesh_unit: Array) -> Proxy:
    """The pieces that a mesh's maker knows, normalised."""
    T_unit_mesh = np.linalg.inv(T_mesh_unit).astype(float)
    parts = [ConvexPart.hull_of(transform(T_unit_mesh, piece.vertices)) for piece in mesh.pieces]
    told = Decision(choice=f"{len(parts)} convex pieces as given", reason="what made the mesh knows them")
    return _proxy(as_given(parts, vertices, faces), "given", (told,))


def _in_frame(proxy: Proxy, T_mesh_unit: Array, about: int | None) -> Proxy:
    """A normalised proxy in the mesh's frame and unit."""
    x, y, z = map(float, transform(T_mesh_unit, np.array([proxy.excess.at]))[0])
    return replace(
        proxy,
        parts=tuple(part.moved(T_mesh_unit) for part in proxy.parts),
        excess=replace(proxy.excess, at=(x, y, z)),
        solid=_in_mesh(proxy.solid, T_mesh_unit),
        decisions=tuple(replace(d, about=about) for d in proxy.decisions),
    )


def _in_mesh(solid: MassProperties, T_mesh_unit: Array) -> MassProperties:
    """The solid under a scale, a turn and a shift."""
    k = float(np.linalg.norm(T_mesh_unit[0, :3]))
    R, center = T_mesh_unit[:3, :3] / k, transform(T_mesh_unit, solid.center[None])[0]
    return MassProperties(volume=k**3 * solid.volume, center=center, inertia=k**5 * R @ solid.inertia @ R.T)


def _decompose_unit(vertices: Array, faces: Faces, worker: ProxyWorker) -> Proxy:
    """One hull where that is enough, else what the worker finds, else one hull again, which a decision tells."""
    config = worker.config
    if reason := nearly_convex(vertices, faces, config):
        decisions = (Decision(choice="one hull", reason=reason),)
        return _proxy(one_hull(vertices, faces, config), "hull", decisions)
    outcome = worker.split(vertices, faces)
    if outcome.fitted:
        return _proxy(outcome.fitted, "cuts", ())
    failed = Decision(choice="one hull", reason=f"the decomposition was {outcome.reason}", fallback=True)
    proxy = _proxy(one_hull(vertices, faces, config), "hull-fallback", (failed,))
    return replace(proxy, cut_short=outcome.cut_short)


def _proxy(fitted: FittedParts, method: Method, decisions: tuple[Decision, ...]) -> Proxy:
    if fitted.inflation is not None and fitted.inflation > INFLATION_LIMIT:
        reason = f"{fitted.inflation:.2f} of the volume of the mesh, {INFLATION_LIMIT:g} is wanted"
        decisions = (*decisions, Decision(choice="parts larger than the mesh are kept", reason=reason))
    return Proxy(
        parts=fitted.parts,
        method=method,
        decisions=decisions,
        inflation=fitted.inflation,
        outside=fitted.outside,
        excess=fitted.excess,
        solid=fitted.solid,
        joins=fitted.joins,
    )


# The cache


def _stored(proxy: Proxy) -> tuple[dict[str, Any], Arrays]:
    sheet = {"method": proxy.method, "decisions": [asdict(d) for d in proxy.decisions]}
    fitted = FittedParts(
        parts=proxy.parts,
        inflation=proxy.inflation,
        outside=proxy.outside,
        excess=proxy.excess,
        solid=proxy.solid,
        joins=proxy.joins,
    )
    return sheet, packed(fitted)


def _restored(sheet: dict[str, Any], arrays: Arrays) -> Proxy:
    fitted = unpacked(arrays)
    return Proxy(
        parts=fitted.parts,
        method=sheet["method"],
        decisions=tuple(Decision(**d) for d in sheet["decisions"]),
        inflation=fitted.inflation,
        outside=fitted.outside,
        excess=fitted.excess,
        solid=fitted.solid,
        joins=fitted.joins,
    )
