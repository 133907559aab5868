"""The camera that posed meshes imply: a focal length by which they cover their masks, and what may be up.

A generator poses its meshes in a camera that it need not tell. A folder may hold them without the geometry they were
made with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import CameraByPoses, KnownFocal
from f3sr.contact.stable_facets import stable_normals
from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.io.geometry import MAX_FOCAL, MIN_FOCAL
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.outline_votes import DEFAULT_OUTLINES, MaskOutline
from f3sr.settings import constants
from f3sr.vision.silhouette import Mask, union_of


@constants
class CameraByPosesConfig:
    """How the edges of masks' boxes scatter about those of the meshes' boxes."""

    beside: int = 2
    """Distance beyond an edge in which another mask may hide the rest of the object [px per 1000 of the photo]."""
    hidden: float = 0.5
    """Share of an edge's pixels beside another mask, or the photo's border, from which on the edge is not the
    object's."""
    most: float = 0.2
    """Mean distance of the edges [diagonals of the masks' boxes] above which the poses are those of another photo."""
    alike: float = 1.2
    """Readings whose edges are farther by no more than this factor are compared by silhouettes."""
    compared: int = 8
    """Most readings that are, the nearest first."""
    tied: float = 1.1
    """Readings that miss no more of the masks than this factor are as likely as the best one."""
    unusual: float = 0.8
    """Of the distance by the usual unit, the most that another unit may leave."""
    alone: float = 0.1
    """Standard error by a single object: its distance is not told apart from its size."""
    worth: float = 2.0
    """Objects that this is worth where several tell the error: the jackknife of two or three may be zero."""
    reach: float = 0.2
    """How far from the boxes' focal length silhouettes are compared, of its logarithm."""
    rounds: int = 20
    """Most comparisons, each about the best focal length of the last one where that was the last within reach."""
    step: float = 0.01
    """Step of the logarithm, and the least standard error that is told."""


DEFAULT_CAMERA_BY_POSES = CameraByPosesConfig()


@dataclass(frozen=True, eq=False, kw_only=True)
class _Edges:
    """The edges of masks' boxes that are the objects' own; all where none is."""

    owner: NDArray[np.int64]
    """(e,) of the objects, in order."""
    which: NDArray[np.int64]
    """(e,): 0 left, 1 top, 2 right, 3 bottom."""
    place: Array
    """(e,) from the photo's middle [px]."""
    size: Array
    """(e,) of the objects: the diagonals of their masks' boxes [px]."""


def camera_by_poses(
    masks: Mapping[int, Mask],
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    config: CameraByPosesConfig = DEFAULT_CAMERA_BY_POSES,
    *,
    units: bool,
    declared: str = "",
) -> CameraByPoses | None:
    """The camera in which ``places`` are given, of a photo with ``masks`` (H, W) by id. Its principal point is the
    photo's middle. None where no camera shows the meshes near their masks. The likeliest reading of the places counts,
    and the likeliest unit of the files where ``units`` are unknown.

    Boxes sieve the readings: where a mesh's has an edge at x (over its depth), its mask has one at f x from the middle.
    f is the weighted median of all ratios, the likeliest one where distances of edges are double exponential. From
    there silhouettes tell f: it has the least mean of 1 - IoU. The jackknife over objects gives its standard error.
    Of readings that miss as little the first counts, which is the documented one. The ``declared`` one counts anyhow;
    where others miss less, its axes are in doubt."""
    h, w = masks[places.ids[0]].shape
    K = np.array([[1.0, 0, w / 2], [0, 1, h / 2], [0, 0, 1]])
    unzoomed = Camera(width=w, height=h, K=K, T_world_camera=np.eye(4))
    outlines = [MaskOutline.of(masks, unzoomed, id, meshes[id], DEFAULT_OUTLINES) for id in places.ids]
    alike = _sieved(masks, outlines, places, config, units=units, declared=declared)
    if not alike:
        return None
    fits = [_by_silhouettes(outlines, meshes, places, reading, config) for reading in alike]
    most = config.tied * min(fit.missed for fit in fits)
    tied = [k for k, fit in enumerate(fits) if fit.missed <= most]
    names = [places.names[reading.k] for reading in alike]
    taken = names.index(declared) if declared in names else min(tied, key=lambda k: alike[k].k)
    apart = max(abs(math.log(fits[k].focal / fits[taken].focal)) for k in tied)
    sigma = math.hypot(fits[taken].error, apart, config.step)
    focal = KnownFocal(pixels=fits[taken].focal, sigma=sigma, source="the poses of the meshes")
    is_documented = declared in names or alike[taken].k == 0
    if taken not in tied or (len(tied) > 1 and not is_documented):
        return CameraByPoses(focal=focal, upward=())
    upward = (
        -stable_normals(meshes[id].hull, meshes[id].center_of_mass) @ R.T
        for id, R in zip(places.ids, places.R[alike[taken].k], strict=True)
    )
    return CameraByPoses(focal=focal, upward=tuple(upward))


class _Reading(NamedTuple):
    """How far the edges are off on average [diagonals], with which focal length [px], in which reading and unit."""

    away: float
    focal: float
    k: int
    unit: float


class _Fit(NamedTuple):
    """What silhouettes miss of the masks, the mean of 1 - IoU, with which focal length [px], and the standard error of
    its logarithm."""

    missed: float
    focal: float
    error: float


def _sieved(
    masks: Mapping[int, Mask],
    outlines: Sequence[MaskOutline],
    places: CandidatePlaces,
    config: CameraByPosesConfig,
    *,
    units: bool,
    declared: str,
) -> list[_Reading]:
    """The readings whose boxes are nearly as near to the masks' as the nearest, which come first, each way of turning
    the meshes once; none where all are far. The ``declared`` one is among them unless it is far."""
    edges = _edges(masks, places.ids, config)
    light = [o.vertices for o in outlines]
    found, longest = list[_Reading](), max(masks[places.ids[0]].shape)
    for k in range(len(places)):
        for unit in DEFAULT_OUTLINES.units if units else (1.0,):
            boxes = _boxes(light, places, k, unit)
            if boxes is not None:
                away, focal = _fitted(edges, boxes[edges.owner, edges.which])
                if MIN_FOCAL <= focal / longest <= MAX_FOCAL:
                    found.append(_Reading(away if unit == 1.0 else away / config.unusual, focal, k, unit))
    found = sorted(r for r in found if r.away <= config.most)
    first = [r for r in found if places.names[r.k] == declared][:1]
    distinct = dict[bytes, _Reading]()
    for r in first + [r for r in found if r.away <= config.alike * found[0].away]:
        distinct.setdefault(np.round(places.R[r.k], 6).tobytes(), r)
    return list(distinct.values())[: config.compared]


def _by_silhouettes(
    outlines: Sequence[MaskOutline],
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    reading: _Reading,
    config: CameraByPosesConfig,
) -> _Fit:
    """One reading with its best focal length."""
    R, t, scales = places.R[reading.k], places.t[reading.k], reading.unit * places.scale[reading.k]
    middles = np.array([meshes[id].bounds.mean(0) for id in places.ids])
    depth = np.median((scales[:, None] * np.einsum("nij,nj->ni", R, middles) + t)[:, 2])
    t, scales = t / depth, scales / depth  # a unit in which nothing is too near to be drawn

    def missed(focal: float) -> Array:
        zoomed = (replace(o, K=o.K * [[focal, 1, 1], [1, focal, 1], [1, 1, 1]]) for o in outlines)
        return np.array([o.missed(R[v], t[v], float(scales[v])) for v, o in enumerate(zoomed)])

    steps = np.arange(-config.reach, config.reach + config.step / 2, config.step)

    def compared(focal: float, rounds: int) -> _Fit:
        table = np.stack([missed(focal * zoom) for zoom in np.exp(steps)], axis=1)
        least = int(np.argmin(table.sum(0)))
        found = focal * math.exp(steps[least])
        if rounds > 1 and least in (0, len(steps) - 1):
            return compared(found, rounds - 1)
        left_out, n = steps[np.argmin(table.sum(0) - table, axis=1)], len(outlines)
        jackknife = (n - 1) / n * ((left_out - left_out.mean()) ** 2).sum()
        variance = ((n - 1) * jackknife + config.worth * config.alone**2 / n) / (n - 1 + config.worth)
        return _Fit(missed=float(table[:, least].mean()), focal=found, error=math.sqrt(variance))

    return compared(reading.focal, config.rounds)


def _edges(masks: Mapping[int, Mask], ids: tuple[int, ...], config: CameraByPosesConfig) -> _Edges:
    rows, (h, w) = list[tuple[tuple[int, int, float, float], bool]](), masks[ids[0]].shape
    beside, covered = max(1, round(config.beside * max(h, w) / 1000)), union_of(masks.values(), (h, w))
    for v, id in enumerate(ids):
        y, x = np.nonzero(masks[id])
        ends = [
            (x, x.min(), -beside, 0),
            (y, y.min(), -beside, 0),
            (x, x.max() + 1, beside, w),
            (y, y.max() + 1, beside, h),
        ]
        size = math.hypot(np.ptp(x) + 1, np.ptp(y) + 1)
        for which, (along, at, step, border) in enumerate(ends):
            last = along == (at if step < 0 else at - 1)
            over_x, over_y = (0, step) if which % 2 else (step, 0)
            beyond = covered[np.clip(y[last] + over_y, 0, h - 1), np.clip(x[last] + over_x, 0, w - 1)]
            is_own = abs(at - border) > beside and beyond.mean() < config.hidden
            rows.append(((v, which, float(at - (h if which % 2 else w) / 2), size), is_own))
    table = np.array([row for row, is_own in rows if is_own] or [row for row, _ in rows])
    return _Edges(owner=table[:, 0].astype(int), which=table[:, 1].astype(int), place=table[:, 2], size=table[:, 3])


def _boxes(vertices: list[Array], places: CandidatePlaces, k: int, unit: float) -> Array | None:
    """(n, 4): left, top, right, bottom of every mesh over its depth; None where one reaches behind the camera."""
    boxes = list[Array]()
    for v, own in enumerate(vertices):
        placed = own @ (unit * places.scale[k, v] * places.R[k, v]).T + places.t[k, v]
        if placed[:, 2].min() <= 0:
            return None
        x = placed[:, :2] / placed[:, 2:]
        boxes.append(np.concatenate([x.min(0), x.max(0)]))
    return np.array(boxes)


def _fitted(edges: _Edges, x: Array) -> tuple[float, float]:
    """How far edges at ``x`` (e,) are off on average [their objects' sizes] with the best focal length [px], and it."""
    usable = x * edges.place > 0
    weights = np.abs(x) / edges.size
    ratio = np.where(usable, edges.place / np.where(usable, x, 1), 0.0)
    order = np.argsort(ratio)
    half = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    focal = float(ratio[order][min(half, len(order) - 1)])
    return float((np.abs(edges.place - focal * x) / edges.size).mean()), focal
