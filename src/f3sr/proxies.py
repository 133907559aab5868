"""Convex collision proxies of a mesh that cover it: no point of the visual surface lies outside their union.

A mesh that is nearly its own hull gets one part. Others are split by CoACD, else by V-HACD, each in a
subprocess that may be killed: CoACD aborts on some inputs and hangs on others. Every visual triangle is then
assigned to the part that covers it best, and that part grows to the hull of both; at last every hull is
simplified outward, to a polytope of few of its own facet planes. All lengths inside are shares of the mesh's
size (the diagonal of its bounding box), so the result does not depend on the asset's unit.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Annotated, Any, Literal

import numpy as np
from annotated_types import Interval
from numpy.typing import NDArray

from f3sr import interrupts
from f3sr.cache import Arrays, Store
from f3sr.errors import InputError
from f3sr.frames import Array
from f3sr.kernels import cache_root
from f3sr.mesh import ConvexPart, Mesh, is_closed, signed_volume, union
from f3sr.report import Decision
from f3sr.settings import settings

PROXY_VERSION = 2
"""Part of the cache key; raise it when the same input and config give other parts."""
GRID = 2.0**-26
"""Normalised vertices are rounded to this step, so that the asset's unit and place change no byte."""

SAME_FLAT = np.radians(2.0)
"""Facets turned by less than this [rad] belong to one flat: the noise of generated meshes."""

LOOK_UP_S = 0.2
"""How often a thread that waits for a worker looks whether all has been called off [s]."""
PR_SET_PDEATHSIG = 1
"""From Linux' sys/prctl.h."""

SCATTERED_VOXELS = 30_000
"""V-HACD's voxels for meshes without a body: 20,000 triangles take it 8 s so, more than a minute with 400,000."""
FEW_FACES = 300
"""Triangles up to which it is looked whether they pierce each other, all against all."""
CRUMPLED = 0.3
"""Share of pierced triangles from which on such a mesh has no inside to cut up: twelve of them took CoACD 38 s."""
NO_SURFACE = 0.5
"""Share of triangle edges without exactly one neighbour from which on triangles form no surface; real assets have 0,
open shells as many as their rims."""

Faces = NDArray[np.int32]
Split = Literal["coacd", "vhacd"]
Method = Literal["hull", Split, "hull-fallback"]


@settings
class ProxyConfig:
    """How meshes become convex parts. Lengths are shares of the mesh's size, times per object and attempt."""

    hull_volume_ratio: Annotated[float, Interval(gt=0, le=1)] = 0.93
    """One hull if the closed mesh fills this share of it: splitting would add little."""
    hull_surface_distance: Annotated[float, Interval(gt=0, lt=0.5)] = 0.02
    """... and no visual point lies deeper below the hull [size]: keeps dents and handles."""
    threshold: Annotated[float, Interval(ge=0.01, le=1)] = 0.08
    """CoACD's concavity at which a part is convex enough; at .05 the cap on parts decides the
    result and the time triples."""
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 16
    """Most parts of CoACD: the cost of contact grows with the square."""
    shell_fill: Annotated[float, Interval(ge=0, le=1)] = 0.5
    """A mesh that fills less of its hull than this is a shell: a bowl, a mug, a pan. What lies in
    it would float on parts that bridge its curved wall, so shells get finer parts."""
    shell_threshold: Annotated[float, Interval(ge=0.01, le=1)] = 0.05
    """``threshold`` for shells."""
    shell_parts: Annotated[int, Interval(ge=1, le=256)] = 32
    """``max_parts`` for shells: with 16 a bowl's floor lies 3% of its size too high, with 32 1.8%."""
    target_faces: Annotated[int, Interval(ge=100, le=100_000)] = 2000
    """Triangles CoACD sees after decimation: as good as 16,000, since parts grow to cover."""
    resolution: Annotated[int, Interval(ge=1000, le=10000)] = 1000
    """CoACD's surface samples for its concavity."""
    mcts_nodes: Annotated[int, Interval(ge=10, le=40)] = 10
    """CoACD's cutting planes per axis and node of its tree search."""
    mcts_iterations: Annotated[int, Interval(ge=60, le=2000)] = 60
    """CoACD's tree search iterations."""
    mcts_depth: Annotated[int, Interval(ge=2, le=7)] = 2
    """How many cuts CoACD looks ahead: 3 takes half as long again and gains nothing measurable."""
    max_pieces: Annotated[float, Interval(ge=1, le=10_000)] = 20.0
    """Loose pieces, those of equal area counting as one each and crumbs hardly at all, from which on CoACD is not
    tried: 25 boxes stuck into each other take it 80 s, 400 loose triangles 100 s."""
    vhacd_parts: Annotated[int, Interval(ge=1, le=256)] = 32
    """Most parts of the fallback V-HACD: it needs more of them for the same quality."""
    vhacd_voxels: Annotated[int, Interval(ge=10_000, le=100_000_000)] = 400_000
    """V-HACD's voxels: the 7 s of CPU it takes, whatever the mesh."""
    cpu_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 120.0
    """Processor time [s] after which an attempt is killed; most meshes need 5, a hollow
    toy brick 65. Work cut short is lost and not cached, so the limit is generous."""
    wall_limit_s: Annotated[float, Interval(gt=0, le=36_000)] = 600.0
    """Time [s] after which an attempt is killed even if the machine was busy."""
    cover: bool = True
    """Grow the parts until they cover the visual mesh; off only for comparison."""
    longest_edge: Annotated[float, Interval(gt=0, le=1)] = 0.05
    """Longer visual edges are split before triangles are assigned [size]: slivers must bridge no cavity."""
    thickness: Annotated[float, Interval(ge=0, le=0.1)] = 0.002
    """How far a simplified hull may stand out from the exact one [size]; makes a can about 27-sided."""
    max_hull_faces: Annotated[int, Interval(ge=8, le=1000)] = 36
    """Most facets of a simplified hull: up to 68 corners. This outranks ``thickness``."""
    flat_share: Annotated[float, Interval(gt=0, lt=1)] = 0.02
    """Facets that face one way and hold this share of a hull's area are kept as one plane: what an
    object stands on stays flat."""
    sheet: Annotated[float, Interval(gt=0, le=0.1)] = 0.004
    """Thickness given to a mesh that spans no volume [size]."""


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
    cut_short: bool = False
    """An attempt was killed by its limit, so another run may do better; such a result is never cached."""


def decompose(
    mesh: Mesh,
    config: ProxyConfig | None = None,
    *,
    cache_dir: Path | None = None,
    name: str = "mesh",
    about: int | None = None,
    cancelled: threading.Event | None = None,
) -> Proxy:
    """Convex parts of one mesh; ``name`` is told in errors, ``about`` (an object id) in decisions.

    Results are kept by the hash of their input in ``cache_dir``, by default ``proxies`` in f3sr's cache.
    Another thread may set ``cancelled``: the worker is killed and CancelledError raised.
    Raises InputError when there are no faces or a coordinate is not finite, before anything is started.
    """
    config = config or ProxyConfig()
    check(mesh, name)
    vertices, faces, T_mesh_unit = _normalised(mesh)
    store, key = Store(cache_dir or cache_root() / "proxies", share=0.1), _key(vertices, faces, config)
    if found := store.load(key):
        proxy = _restored(*found)
    else:
        proxy = _decompose_unit(vertices, faces, config, cancelled)
        if not proxy.cut_short:
            store.save(key, *_stored(proxy))
    return replace(
        proxy,
        parts=tuple(part.moved(T_mesh_unit) for part in proxy.parts),
        decisions=tuple(replace(d, about=about) for d in proxy.decisions),
    )


def decompose_all(
    meshes: Sequence[Mesh],
    config: ProxyConfig | None = None,
    *,
    cache_dir: Path | None = None,
    ids: Sequence[int] | None = None,
) -> list[Proxy]:
    """Convex parts of many meshes, one subprocess per processor at a time; ``ids`` name them in decisions."""
    ids = range(len(meshes)) if ids is None else ids
    for mesh, id in zip(meshes, ids, strict=True):
        check(mesh, f"mesh of object {id}")

    def one(mesh: Mesh, id: int) -> Proxy:
        return decompose(mesh, config, cache_dir=cache_dir, about=id, cancelled=cancelled)

    cancelled = threading.Event()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            return list(pool.map(one, meshes, ids))
        except BaseException:  # a failure or Ctrl-C: leaving the pool waits for its threads, and they for workers
            cancelled.set()
            raise


def split(mesh: Mesh, method: Split, config: ProxyConfig | None = None) -> int:
    """How many parts one method alone finds; RuntimeError with the reason where it finds none."""
    vertices, faces, _ = _normalised(mesh)
    outcome = _run_worker(method, vertices, faces, config or ProxyConfig())
    if not outcome.parts:
        raise RuntimeError(outcome.reason)
    return len(outcome.parts)


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


def _normalised(mesh: Mesh) -> tuple[Array, Faces, Array]:
    """Welded vertices about their box's centre, in units of its diagonal; faces; and the map back (4, 4)."""
    center, size = mesh.bounds.mean(0), mesh.diagonal
    rounded = np.round((mesh.vertices - center) / size / GRID) * GRID + 0.0
    vertices, faces = Mesh(vertices=rounded, faces=mesh.faces).welded
    T = np.diag([size, size, size, 1.0])
    T[:3, 3] = center
    return vertices, faces, T


def _decompose_unit(
    vertices: Array, faces: Faces, config: ProxyConfig, cancelled: threading.Event | None = None
) -> Proxy:
    """Try the methods in turn until one gives parts; every one that fails is told in a decision."""
    decisions: list[Decision] = []
    cut_short = False
    if reason := _is_nearly_convex(vertices, faces, config):
        method, parts = "hull", _hull_parts(vertices, faces, config)
        decisions.append(Decision(choice="one hull", reason=reason))
    else:
        attempts: tuple[Split, ...] = ("coacd", "vhacd")
        if reason := _is_no_body(vertices, faces, config):
            attempts = ("vhacd",)
            config = replace(config, vhacd_voxels=min(config.vhacd_voxels, SCATTERED_VOXELS))
            decisions.append(Decision(choice="split by V-HACD, coarsely, not by CoACD", reason=reason, fallback=True))
        for attempt in attempts:
            outcome = _run_worker(attempt, vertices, faces, config, cancelled)
            if outcome.parts:
                method, parts = attempt, outcome.parts
                break
            cut_short = cut_short or outcome.cut_short
            decisions.append(Decision(choice=f"{attempt} gave no parts", reason=outcome.reason, fallback=True))
        else:
            method, parts = "hull-fallback", _hull_parts(vertices, faces, config)
            decisions.append(Decision(choice="one hull", reason="every decomposition failed", fallback=True))
    return Proxy(
        parts=parts,
        method=method,
        decisions=tuple(decisions),
        inflation=_inflation(parts, vertices, faces),
        outside=float(np.maximum(_outside(parts, vertices).min(1), 0).max()),
        cut_short=cut_short,
    )


# One hull


def _is_nearly_convex(vertices: Array, faces: Faces, config: ProxyConfig) -> str | None:
    """Why one hull is enough, or None. An open mesh has no volume and is judged by its surface alone."""
    try:
        hull = ConvexPart.hull_of(vertices)
    except ValueError:
        return "the mesh spans no volume"
    used = vertices[np.unique(faces)]
    some = used[:: max(1, len(used) // 2000)]
    depth = -min(float(_outside([hull], chunk).min()) for chunk in np.array_split(some, 1 + len(some) // 100))
    if depth > config.hull_surface_distance:
        return None
    reason = f"surface within {depth:.1%} of its size below the hull"
    if is_closed(faces) and (volume := signed_volume(vertices, faces)) > 0:
        ratio = volume / hull.volume
        return f"fills {ratio:.1%} of its hull, {reason}" if ratio >= config.hull_volume_ratio else None
    return reason


def _is_no_body(vertices: Array, faces: Faces, config: ProxyConfig) -> str | None:
    """Why a search for cuts would get lost in the mesh, or None: known beforehand and by counting, not by a limit on
    time, so that every run decides alike."""
    pieces = _effective_pieces(vertices, faces)
    if pieces > config.max_pieces:
        return f"as scattered as {pieces:.0f} loose pieces"
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, sides = np.unique(edges, axis=0, return_counts=True)
    apart = 1 - 2 * float((sides == 2).sum()) / len(edges)
    if apart > NO_SURFACE:
        return f"{apart:.0%} of the triangles' edges are not shared by two triangles"
    if len(faces) <= FEW_FACES and (crossed := _crossed_share(vertices, faces)) > CRUMPLED:
        return f"{crossed:.0%} of the few triangles are pierced by others"
    return None


def _crossed_share(vertices: Array, faces: Faces) -> float:
    """The share of triangles that an edge of another one, no corner in common, strictly pierces (all pairs)."""
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    p, q = (vertices[edges[:, k]][:, None] for k in (0, 1))
    a, b, c = (vertices[faces[:, k]][None] for k in range(3))

    def side(x: Array, y: Array, z: Array, w: Array) -> Array:
        """Sign of the volume of tetrahedra (e, m)."""
        return np.sign(np.einsum("...i,...i->...", np.cross(y - x, z - x), w - x))

    through = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)]
    pierced = (side(a, b, c, p) * side(a, b, c, q) < 0) & (through[0] == through[1]) & (through[1] == through[2])
    apart = ~(edges[:, None, :, None] == faces[None, :, None, :]).any((2, 3))
    return float((pierced & apart & (through[0] != 0)).any(0).mean())


def _effective_pieces(vertices: Array, faces: Faces) -> float:
    """1 / the sum of squared shares of the area that connected pieces hold: n for n equal ones."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    links = coo_array((np.ones(len(a), bool), (a, b)), shape=(len(vertices), len(vertices)))
    piece = connected_components(links, directed=False)[1][faces[:, 0]]
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    held = np.bincount(piece, area) / area.sum()
    return 1 / float((held**2).sum())


def _hull_parts(vertices: Array, faces: Faces, config: ProxyConfig) -> tuple[ConvexPart, ...]:
    points = vertices[np.unique(faces)]
    try:
        return (simplified_outward(points, config),)
    except ValueError:  # a sheet: give it a thickness along its normal
        normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
        offset = config.sheet / 2 * normal
        return (ConvexPart.hull_of(np.concatenate([points - offset, points + offset])),)


# Covering the visual mesh


def covering(pieces: Sequence[Array], vertices: Array, faces: Faces, config: ProxyConfig) -> list[Array]:
    """Grow convex pieces, given by their points (k, 3), until every triangle lies in one of them.

    Each triangle goes to the piece it sticks out of least (its farthest vertex counts, the first of equals
    wins), and that piece becomes the hull of itself and its triangles.
    """
    from trimesh.remesh import subdivide_to_size

    split = subdivide_to_size(vertices, faces, max_edge=config.longest_edge, max_iter=20)
    points, triangles = split[0], split[1]
    outside = np.maximum(_outside([ConvexPart.hull_of(p) for p in pieces], points), 0)
    sticks_out = outside[triangles].max(1)
    owner = sticks_out.argmin(1)
    uncovered = sticks_out.min(1) > 0
    return [
        np.concatenate([piece, points[np.unique(triangles[uncovered & (owner == k)])]])
        for k, piece in enumerate(pieces)
    ]


def _outside(parts: Sequence[ConvexPart], points: Array) -> Array:
    """Largest signed distance (n, parts) of points beyond a facet plane of each part; negative inside."""
    return np.stack([_beyond(points, *_planes(part)) for part in parts], axis=1)


def _beyond(points: Array, normals: Array, offsets: Array) -> Array:
    blocks = np.array_split(points, max(1, points.shape[0] * len(offsets) // 4_000_000))
    return np.concatenate([(block @ normals.T - offsets).max(1) for block in blocks])


def _planes(part: ConvexPart) -> tuple[Array, Array]:
    """Outward unit normals (m, 3) and offsets (m,) of a part's triangles."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    real = area > 1e-14
    normals = cross[real] / area[real, None]
    return normals, np.einsum("ij,ij->i", normals, a[real])


def _inflation(parts: Sequence[ConvexPart], vertices: Array, faces: Faces) -> float | None:
    if not is_closed(faces) or (volume := signed_volume(vertices, faces)) <= 0:
        return None
    return signed_volume(*union(parts)) / volume


# Simpler hulls that contain the exact one


def simplified_outward(points: Array, config: ProxyConfig, around: ConvexPart | None = None) -> ConvexPart:
    """A polytope of few facets around points (n, 3), in normalised units; it contains all of them.

    Its planes are the hull's flats, then, one by one, the hull plane that cuts off most of the corner that
    stands out farthest, until all stand out by less than ``thickness``. Where the points reach a flat of
    ``around``, the hull of the whole mesh, that plane is taken: all parts of an object end in one base.
    Raises ValueError when the points span no volume.
    """
    hull = ConvexPart.hull_of(points)
    normals, offsets = _planes(hull)
    kept_normals, kept_offsets = _first_planes(hull, around, config)
    for _ in range(config.max_hull_faces - len(kept_offsets)):
        corners = _corners(kept_normals, kept_offsets, hull)
        excess = corners @ normals.T - offsets
        worst = int(excess.argmax())
        if excess.flat[worst] <= config.thickness:
            break
        plane = worst % len(offsets)
        kept_normals = np.vstack([kept_normals, normals[plane]])
        kept_offsets = np.append(kept_offsets, offsets[plane])
    return ConvexPart.hull_of(_merged(_corners(kept_normals, kept_offsets, hull)))


def _first_planes(hull: ConvexPart, around: ConvexPart | None, config: ProxyConfig) -> tuple[Array, Array]:
    """The flats of the whole mesh that a part reaches, then its own ones that face elsewhere."""
    own = _flats(hull, config.flat_share)
    own_offsets = (hull.vertices @ own.T).max(0)
    if around is None:
        return own, own_offsets
    shared = _flats(around, config.flat_share)
    shared_offsets = (around.vertices @ shared.T).max(0)
    reached = shared_offsets - (hull.vertices @ shared.T).max(0) <= config.thickness
    shared, shared_offsets = shared[reached], shared_offsets[reached]
    elsewhere = (own @ shared.T).max(1, initial=-1) < np.cos(SAME_FLAT)
    return np.vstack([shared, own[elsewhere]]), np.append(shared_offsets, own_offsets[elsewhere])


def _flats(hull: ConvexPart, share: float) -> Array:
    """Mean normals (k, 3) of facets that face nearly the same way and hold ``share`` of the hull's area."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(area, np.finfo(float).tiny)[:, None]
    left, flats = area.copy(), list[Array]()
    seeds = np.flatnonzero(_area_around(normals, area) >= share * area.sum())
    for seed in seeds[np.argsort(-area[seeds], kind="stable")]:
        near = (normals @ normals[seed] > np.cos(SAME_FLAT)) & (left > 0)
        if left[seed] > 0 and left[near].sum() >= share * area.sum():
            mean = cross[near].sum(0)
            flats.append(mean / np.linalg.norm(mean))
            left[near] = 0
    return np.array(flats).reshape(-1, 3)


def _area_around(normals: Array, area: Array) -> Array:
    """An upper bound (n,) of the area that faces the way of each facet: what lies in its cell of a grid over the
    normals, as wide as SAME_FLAT, and in the cells around it. Spares round bodies a quadratic search."""
    from scipy.spatial import KDTree

    cell = 2.001 * np.sin(SAME_FLAT / 2)
    cells, inverse = np.unique(np.floor(normals / cell), axis=0, return_inverse=True)
    held = np.bincount(inverse.ravel(), area)
    around = KDTree(cells).query_ball_point(cells, 1.5, p=np.inf)
    return np.array([held[near].sum() for near in around])[inverse.ravel()]


def _corners(normals: Array, offsets: Array, hull: ConvexPart) -> Array:
    """Corners (n, 3) of ``normals . x <= offsets``, within a box far around the hull."""
    from scipy.spatial import HalfspaceIntersection

    low, high = hull.vertices.min(0), hull.vertices.max(0)
    margin = (high - low).max()
    box = np.concatenate([np.eye(3), -np.eye(3)])
    box_offsets = np.concatenate([high + margin, margin - low])
    halfspaces = np.column_stack([np.vstack([normals, box]), -np.append(offsets, box_offsets)])
    return np.asarray(HalfspaceIntersection(halfspaces, hull.vertices.mean(0)).intersections)


def _merged(points: Array, tolerance: float = 1e-9) -> Array:
    """Points with all but the first of those within ``tolerance`` left out."""
    from scipy.spatial import KDTree

    pairs = KDTree(points).query_pairs(tolerance, output_type="ndarray")
    return np.delete(points, np.unique(pairs[:, 1]), axis=0)


# The worker: everything that may abort or hang


@dataclass(frozen=True, kw_only=True)
class _Outcome:
    parts: tuple[ConvexPart, ...] = ()
    reason: str = ""
    cut_short: bool = False


def _run_worker(
    method: str, vertices: Array, faces: Faces, config: ProxyConfig, cancelled: threading.Event | None = None
) -> _Outcome:
    """Split a normalised mesh in a subprocess of our own, killed at its processor or wall limit."""
    with tempfile.TemporaryFile() as mesh, tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as errors:
        np.savez(mesh, vertices=vertices, faces=faces)
        mesh.seek(0)
        with interrupts.undone(lambda: _start(method, config, mesh, answer, errors), subprocess.Popen.kill) as process:
            try:
                _wait(process, config.wall_limit_s, cancelled)
            except subprocess.TimeoutExpired:
                return _Outcome(reason=f"killed after {config.wall_limit_s:g} s", cut_short=True)
            finally:
                process.kill()
                process.wait()
        if process.returncode == 0:
            answer.seek(0)
            with np.load(answer, allow_pickle=False) as data:
                return _Outcome(parts=_unpack(data))
        errors.seek(0)
        return _explain(process.returncode, errors.read().decode(errors="replace"), config)


def _start(method: str, config: ProxyConfig, *streams: IO[bytes]) -> subprocess.Popen[bytes]:
    """A worker in a process group of its own, as it is ours to end it when the user presses Ctrl-C. Its streams are
    files without a name: there is nothing to tidy up after ``kill -9``."""
    # One thread each: the objects are what runs in parallel, and sums keep their order.
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-m", "f3sr.proxies", method, _json(config), str(os.getpid())]
    stdin, stdout, stderr = streams
    return subprocess.Popen(command, env=environment, process_group=0, stdin=stdin, stdout=stdout, stderr=stderr)


def _wait(process: subprocess.Popen[bytes], limit_s: float, cancelled: threading.Event | None) -> None:
    """Until a worker ends; TimeoutExpired at the limit, CancelledError when all is called off."""
    deadline = time.monotonic() + limit_s
    while True:
        try:
            process.wait(timeout=max(0.0, min(LOOK_UP_S, deadline - time.monotonic())))
            return
        except subprocess.TimeoutExpired:
            if cancelled is not None and cancelled.is_set():
                raise CancelledError from None
            if time.monotonic() >= deadline:
                raise


def _explain(code: int, errors: str, config: ProxyConfig) -> _Outcome:
    import signal

    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return _Outcome(reason=f"killed after {config.cpu_limit_s:g} s of processor time", cut_short=True)
    if code < 0:
        return _Outcome(reason=f"crashed with {signal.Signals(-code).name}")
    last = (errors.strip().splitlines() or ["no message"])[-1]
    return _Outcome(reason=f"failed: {last[:200]}")


def _worker(method: str, config_json: str, parent: str) -> None:
    """The subprocess: read a normalised mesh, split it, cover it, simplify its parts, write them."""
    import resource

    _die_with(int(parent))
    config = ProxyConfig(**json.loads(config_json))
    seconds = max(1, round(config.cpu_limit_s))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as data:
        vertices, faces = data["vertices"], data["faces"]
    answer = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for the words of the libraries
    pieces = _with_volume(_SPLITTERS[method](vertices, faces, config))
    if not pieces:
        raise ValueError(f"{method} found no part with a volume")
    if config.cover:
        pieces = covering(pieces, vertices, faces, config)
    whole = ConvexPart.hull_of(vertices)
    parts = _without_hidden([simplified_outward(p, config, whole) for p in pieces])
    with os.fdopen(answer, "wb") as stream:
        archive = io.BytesIO()
        np.savez(archive, allow_pickle=False, **_pack(parts))
        stream.write(archive.getvalue())


def _die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent is gone, be it by ``kill -9``. Elsewhere than on Linux the limit
    on processor time does."""
    import ctypes
    import signal

    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        raise SystemExit("the parent is gone")


def _with_volume(pieces: Sequence[Array]) -> list[Array]:
    """The hull corners of pieces (k, 3), leaving out those that span no volume."""
    solid: list[Array] = []
    for piece in pieces:
        try:
            hull = ConvexPart.hull_of(piece)
        except ValueError:
            continue
        if hull.volume > 1e-9:
            solid.append(hull.vertices)
    return solid


def _without_hidden(parts: list[ConvexPart]) -> list[ConvexPart]:
    """Parts that do not lie inside another one, the first of equals kept."""
    kept: list[ConvexPart] = []
    for part in sorted(parts, key=lambda p: -p.volume):
        if not kept or not (_outside(kept, part.vertices).max(0) <= 1e-9).any():
            kept.append(part)
    return kept


def _split_coacd(vertices: Array, faces: Faces, config: ProxyConfig) -> list[Array]:
    import coacd

    coacd.set_log_level("error")
    # An open surface has no volume, but its signed sum still tells a wall with two sides from a body.
    is_shell = signed_volume(vertices, faces) < config.shell_fill * ConvexPart.hull_of(vertices).volume
    vertices, faces = _decimated(vertices, faces, config.target_faces)
    pieces = coacd.run_coacd(
        coacd.Mesh(vertices, faces),
        threshold=config.shell_threshold if is_shell else config.threshold,
        max_convex_hull=config.shell_parts if is_shell else config.max_parts,
        preprocess_mode="off",
        resolution=config.resolution,
        mcts_nodes=config.mcts_nodes,
        mcts_iterations=config.mcts_iterations,
        mcts_max_depth=config.mcts_depth,
        seed=0,
    )
    return [np.asarray(points, float) for points, _ in pieces]


def _split_vhacd(vertices: Array, faces: Faces, config: ProxyConfig) -> list[Array]:
    import vhacdx

    pieces = vhacdx.compute_vhacd(
        vertices,
        faces.astype(np.uint32),
        maxConvexHulls=config.vhacd_parts,
        resolution=config.vhacd_voxels,
        asyncACD=False,
    )
    return [np.asarray(points, float) for points, _ in pieces]


_SPLITTERS: Mapping[str, Callable[[Array, Faces, ProxyConfig], list[Array]]] = {
    "coacd": _split_coacd,
    "vhacd": _split_vhacd,
}


def _decimated(vertices: Array, faces: Faces, target: int) -> tuple[Array, Faces]:
    if len(faces) <= target:
        return vertices, faces
    import fast_simplification

    result = fast_simplification.simplify(vertices, faces, target_count=target)
    return np.asarray(result[0], float), np.asarray(result[1], np.int32)


# The cache


def _key(vertices: Array, faces: Faces, config: ProxyConfig) -> str:
    digest = hashlib.sha256(f"{PROXY_VERSION} {_json(config)} {vertices.shape} {faces.shape}".encode())
    digest.update(vertices.tobytes())
    digest.update(faces.tobytes())
    return digest.hexdigest()


def _json(config: ProxyConfig) -> str:
    return json.dumps(asdict(config), sort_keys=True)


def _pack(parts: Sequence[ConvexPart]) -> Arrays:
    """Parts as arrays that ``_unpack`` reads: all vertices, all faces, and the counts (parts, 2) of each."""
    return {
        "vertices": np.concatenate([p.vertices for p in parts]),
        "faces": np.concatenate([p.faces for p in parts]),
        "counts": np.array([(len(p.vertices), len(p.faces)) for p in parts], np.int32),
    }


def _unpack(data: Mapping[str, Any]) -> tuple[ConvexPart, ...]:
    cuts = np.cumsum(data["counts"], axis=0)[:-1]
    vertices, faces = np.split(data["vertices"], cuts[:, 0]), np.split(data["faces"], cuts[:, 1])
    return tuple(ConvexPart(vertices=v.copy(), faces=f.copy()) for v, f in zip(vertices, faces, strict=True))


def _stored(proxy: Proxy) -> tuple[dict[str, Any], Arrays]:
    sheet = {
        "method": proxy.method,
        "decisions": [asdict(d) for d in proxy.decisions],
        "inflation": proxy.inflation,
        "outside": proxy.outside,
    }
    return sheet, _pack(proxy.parts)


def _restored(sheet: dict[str, Any], arrays: Arrays) -> Proxy:
    decisions = tuple(Decision(**d) for d in sheet.pop("decisions"))
    return Proxy(parts=_unpack(arrays), decisions=decisions, **sheet)


if __name__ == "__main__":
    _worker(*sys.argv[1:])
