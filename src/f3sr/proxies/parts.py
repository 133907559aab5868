"""The convex parts of one normalised mesh, and how well they fit it: cut up, joined again, simplified outward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.core.mesh import ConvexPart, MassProperties, area_vectors, is_closed, mass_properties, signed_volume, union
from f3sr.core.transforms import Array
from f3sr.proxies import fit
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.cuts import Piece, cut_up
from f3sr.proxies.fit import Excess
from f3sr.proxies.hulls import Hull, hull_of, outside, planes, without_hidden
from f3sr.proxies.joins import Join, join_order, joined
from f3sr.proxies.simplify import flats_of, simplified_outward
from f3sr.proxies.surface import PROBE, Faces, NearestTriangles, Subject, area_of, samples_of, surroundings, weighted

HULL_VOLUME_RATIO = 0.93
"""Least share of its hull that a closed mesh fills to get one hull: splitting would add little."""
SHELL_FILL = 0.5
"""Share of its hull below which a closed mesh is a shell: a bowl, a mug, a pan. What lies in it would float on parts
that bridge its curved wall."""
SHEET = 0.004
"""Thickness given to a mesh that spans no volume [size]."""
STRAY_SHARE = 0.02
"""Of the vertices of a mesh that is nearly its own hull, those that may lie deeper: the seam of a ball."""
LARGEST_HOLE = 0.02
"""Share of its area that an open mesh may lack where its hull is taken for it."""


@dataclass(frozen=True, kw_only=True)
class FittedParts:
    """Convex parts and how well they fit the mesh."""

    parts: tuple[ConvexPart, ...]
    inflation: float | None
    outside: float
    excess: Excess
    solid: MassProperties
    """Of the union of the parts."""
    joins: tuple[Join, ...] = ()
    """How parts may be joined further."""


def nearly_convex(vertices: Array, faces: Faces, config: ProxyConfig) -> str | None:
    """Why one hull is enough, or None.

    An open mesh has no volume: its surface alone decides, unless so much is missing that it may be a container."""
    try:
        hull = ConvexPart.hull_of(vertices)
    except ValueError:
        return "the mesh spans no volume"
    used = vertices[np.unique(faces)]
    some = used[:: max(1, len(used) // 2000)]
    below = -np.concatenate([outside([hull], chunk)[:, 0] for chunk in np.array_split(some, 1 + len(some) // 100)])
    depth = float(np.quantile(below, 1 - STRAY_SHARE))
    if depth > config.tolerance:
        return None
    reason = f"surface within {depth:.1%} of its size below the hull"
    if is_closed(faces) and (volume := signed_volume(vertices, faces)) > 0:
        ratio = volume / hull.volume
        return f"fills {ratio:.1%} of its hull, {reason}" if ratio >= HULL_VOLUME_RATIO else None
    return reason if _missing_share(vertices[faces]) <= LARGEST_HOLE else None


def _missing_share(triangles: Array) -> float:
    """How much a surface lacks to be closed, seen from its best side: the normals of a closed one add up to nothing."""
    normals = area_vectors(triangles)
    return float(np.linalg.norm(normals.sum(0)) / np.linalg.norm(normals, axis=1).sum())


def one_hull(vertices: Array, faces: Faces, config: ProxyConfig) -> FittedParts:
    points = vertices[np.unique(faces)]
    try:
        part = simplified_outward(points, config, most=config.most_faces(1))
    except ValueError:
        part = ConvexPart.hull_of(thickened(points))
    return _fitted([part], vertices, faces, fit.excess([part], NearestTriangles.on(vertices, faces), None, PROBE))


def as_given(parts: Sequence[ConvexPart], vertices: Array, faces: Faces) -> FittedParts:
    """Parts that are known already."""
    return _fitted(parts, vertices, faces, fit.excess(parts, NearestTriangles.on(vertices, faces), None, PROBE))


def several(vertices: Array, faces: Faces, config: ProxyConfig) -> FittedParts:
    """Parts that hold all of the surface, and those of the solid below it that cuts lay bare."""
    whole = ConvexPart.hull_of(vertices)
    subject = subject_of(vertices, faces, whole, config)
    # An open surface has no volume, but its signed sum still tells a wall with two sides from a body.
    is_shell = signed_volume(vertices, faces) < SHELL_FILL * whole.volume

    def cut(most: int) -> list[Hull]:
        return _hulls(cut_up(subject, config, most, is_shell=is_shell))

    hulls = joined(cut(round(config.cuts.surplus * config.max_parts)), subject, config, is_shell=is_shell)
    if len(hulls) > config.max_parts:  # what is left are no neighbours
        hulls = cut(config.max_parts)
    base = flats_of(whole)
    parts = without_hidden(
        [simplified_outward(h.corners, config, base, most=config.most_faces(len(hulls))) for h in hulls]
    )
    excess = fit.excess(parts, subject.nearest, subject.around, PROBE)
    excess = replace(excess, floor=fit.floor_excess(parts, subject.samples))
    return replace(_fitted(parts, vertices, faces, excess), joins=join_order(parts, subject))


def subject_of(vertices: Array, faces: Faces, whole: ConvexPart, config: ProxyConfig) -> Subject:
    """All that cutting needs to know of a mesh with its hull ``whole``."""
    around = surroundings(vertices, faces)
    samples = samples_of(vertices[faces], config.cuts.samples)
    touched = samples.chosen(around.is_reached(samples.points, samples.normals, PROBE))
    simpler = decimated(vertices, faces, config.cuts.target_faces)
    return Subject(
        triangles=vertices[faces],
        simplified=simpler[0][simpler[1]],
        samples=weighted(touched, planes(whole)),
        taken=config.cuts.samples,
        area=area_of(vertices[faces]),
        around=around,
        nearest=NearestTriangles.on(vertices, faces),
    )


def _hulls(pieces: Sequence[Piece]) -> list[Hull]:
    """Of pieces; one that spans no volume, as a single layer of triangles does, gets a thickness."""
    found: list[Hull] = []
    for piece in pieces:
        points = np.concatenate([piece.triangles.reshape(-1, 3), piece.core])
        hull = piece.hull or hull_of(thickened(points))
        if hull is None:
            raise ValueError("a piece of the mesh spans no volume")
        found.append(hull)
    return found


def thickened(points: Array) -> Array:
    """A sheet (n, 3), n > 2, with a thickness along its normal; a scrap, which is as thin in other directions, also in
    these."""
    axes = np.linalg.svd(points - points.mean(0), full_matrices=False)[2]
    thin = np.ptp(points @ axes.T, axis=0) < SHEET
    thin[2] = True
    for offset in SHEET / 2 * axes[thin]:
        points = np.concatenate([points - offset, points + offset])
    return points


def _fitted(parts: Sequence[ConvexPart], vertices: Array, faces: Faces, excess: Excess) -> FittedParts:
    solid = mass_properties(*union(parts))
    return FittedParts(
        parts=tuple(parts),
        solid=solid,
        inflation=fit.inflation(solid, vertices, faces),
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
