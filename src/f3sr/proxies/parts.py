"""The convex parts of one normalised mesh, and how well they fit it: cut up, joined again, simplified outward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.mesh import ConvexPart, is_closed
from f3sr.core.transforms import Array
from f3sr.proxies import fit
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.cuts import Piece, cut_up
from f3sr.proxies.fit import Excess
from f3sr.proxies.hulls import Hull, hull_of, planes, without_hidden
from f3sr.proxies.joins import joined
from f3sr.proxies.loss import of_samples
from f3sr.proxies.simplify import flats_of, simplified_outward
from f3sr.proxies.surface import (
    PROBES,
    Faces,
    NearestTriangles,
    Subject,
    Surroundings,
    area_of,
    close_to,
    samples_of,
    stand_off,
    surroundings,
    weighted,
)
from f3sr.proxies.symmetry import axis_of

SHEET = 0.004
"""Thickness given to a mesh that spans no volume [size]."""
THINNEST = 0.02
"""Least thickness of a hull where the mesh is as thick [size]: 2 mm of a thing of 10 cm."""
LARGEST_HOLE = 0.02
"""Share of its area that an open mesh may lack where its hull is taken for it."""


@dataclass(frozen=True, kw_only=True)
class FittedParts:
    """Convex parts and how well they fit the mesh."""

    parts: tuple[ConvexPart, ...]
    inflation: float | None
    outside: float
    excess: Excess


def nearly_convex(vertices: Array, faces: Faces, config: ProxyConfig) -> str | None:
    """Why one hull is enough, or None.

    An open mesh may be a container where much of it is missing: its other side is not seen."""
    hull = hull_of(vertices[np.unique(faces)])
    if hull is None:
        return "the mesh spans no volume"
    if not is_closed(faces) and _missing_share(vertices[faces]) > LARGEST_HOLE:
        return None
    samples = samples_of(vertices[faces], config.cuts.samples)
    loss = of_samples(stand_off(samples, hull.normals, hull.offsets), len(samples.points), config.tolerance)
    return None if loss.pays else f"surface within {loss.off * config.tolerance:.1%} of its size below the hull"


def _missing_share(triangles: Array) -> float:
    """How much a surface lacks to be closed, seen from its best side: the normals of a closed one add up to nothing."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(cross.sum(0)) / np.linalg.norm(cross, axis=1).sum())


def one_hull(vertices: Array, faces: Faces, config: ProxyConfig) -> FittedParts:
    points = vertices[np.unique(faces)]
    try:
        part = simplified_outward(points, config.made_vertices)
    except ValueError:
        part = ConvexPart.hull_of(_thickened(points))
    return _fitted([part], vertices, faces, fit.excess([part], NearestTriangles.on(vertices, faces), None, PROBES[0]))


def several(vertices: Array, faces: Faces, config: ProxyConfig, near: Array | None = None) -> FittedParts:
    """Parts that hold all of the surface, and those of the solid below it that cuts lay bare.

    ``near``: points (n, 3) of other bodies close to it."""
    whole = ConvexPart.hull_of(vertices)
    subject = subject_of(vertices, faces, whole, config, near)
    hulls = _best_hulls(subject, config)
    base, most = flats_of(whole), config.made_vertices
    parts = without_hidden([simplified_outward(_thick(h, subject.around), most, base) for h in hulls])
    excess = fit.excess(parts, subject.nearest, subject.around, PROBES[0])
    return _fitted(parts, vertices, faces, replace(excess, floor=fit.floor_excess(parts, subject.samples)))


def _best_hulls(subject: Subject, config: ProxyConfig) -> list[Hull]:
    """The hulls of the lower price: cut freely, or into sectors first where the surface has an axis."""
    most, axis = round(config.cuts.surplus * config.max_parts), axis_of(subject.samples)
    proposals = [joined(_hulls(cut_up(subject, config, most)), subject, config)]
    if axis and len(proposals[0][0]) > 1:
        proposals.append(joined(_hulls(cut_up(subject, config, most, axis)), subject, config))
    hulls, _ = min(proposals, key=lambda p: p[1])
    if len(hulls) > config.max_parts:  # what is left are no neighbours
        return _hulls(cut_up(subject, config, config.max_parts))
    return hulls


def subject_of(
    vertices: Array, faces: Faces, whole: ConvexPart, config: ProxyConfig, near: Array | None = None
) -> Subject:
    """All that cutting needs to know of a mesh with its hull ``whole``."""
    around = surroundings(vertices, faces)
    samples = samples_of(vertices[faces], config.cuts.samples)
    felt = around.felt(samples.points, samples.normals)
    touched = replace(samples, weight=felt).chosen(felt > 0)
    simpler = decimated(vertices, faces, config.cuts.target_faces)
    return Subject(
        triangles=vertices[faces],
        simplified=simpler[0][simpler[1]],
        samples=close_to(weighted(touched, planes(whole)), near)
        if near is not None
        else weighted(touched, planes(whole)),
        area=area_of(vertices[faces]),
        around=around,
        nearest=NearestTriangles.on(vertices, faces),
    )


def _hulls(pieces: Sequence[Piece]) -> list[Hull]:
    """Of pieces; one that spans no volume, as a single layer of triangles does, gets a thickness."""
    found: list[Hull] = []
    for piece in pieces:
        points = np.concatenate([piece.triangles.reshape(-1, 3), piece.core])
        hull = piece.hull or hull_of(_thickened(points))
        if hull is None:
            raise ValueError("a piece of the mesh spans no volume")
        found.append(hull)
    return found


def _thick(hull: Hull, around: Surroundings) -> Array:
    """Corners (n, 3) of a hull; of a thin one, also those of the same hull moved into the solid behind it.

    Engines lose contact with thin hulls. Where the mesh itself is thin, they stay."""
    width = np.ptp(hull.corners @ hull.normals.T, axis=0)
    k = int(width.argmin())
    for sign in (1, -1) if width[k] < THINNEST else ():
        moved = hull.corners + sign * (THINNEST - width[k]) * hull.normals[k]
        if around.is_solid(moved).all():
            return np.concatenate([hull.corners, moved])
    return hull.corners


def _thickened(points: Array) -> Array:
    """A sheet with a thickness along its normal."""
    normal = np.linalg.svd(points - points.mean(0), full_matrices=False)[2][2]
    offset = SHEET / 2 * normal
    return np.concatenate([points - offset, points + offset])


def _fitted(parts: Sequence[ConvexPart], vertices: Array, faces: Faces, excess: Excess) -> FittedParts:
    return FittedParts(
        parts=tuple(parts),
        inflation=fit.inflation(parts, vertices, faces),
        outside=fit.largest_outside(parts, vertices[np.unique(faces)]),
        excess=excess,
    )


def decimated(vertices: Array, faces: Faces, target: int) -> tuple[Array, Faces]:
    """A simpler surface of at most about ``target`` triangles."""
    if len(faces) <= target:
        return vertices, faces
    import fast_simplification

    result = fast_simplification.simplify(vertices, faces, target_count=target)
    return np.asarray(result[0], float), np.asarray(result[1], np.int32)
