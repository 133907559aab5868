"""Footings: thin convex wedges under an underside that hold an object in the pose of the photo.

No photo shows an underside, so a generated one is a guess, commonly turned by some degrees against its body. Physics
would tip the object onto it, against the picture. A footing fills the space between the underside and the plane below
(docs: contact). A round object has none to fall onto: it would roll onto a facet of its proxy, or down a slope that
is as uncertain. Its footing is as small as it can be. So it rests by its shape, and rolls once it is moved.
A footing is collision geometry only; the mesh does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from f3sr.contact.compounds import Compound, placed, smallest_shift
from f3sr.contact.tops import facet_above, highest_points
from f3sr.contact.undersides import (
    GRAIN,
    GROUND_PLANE,
    FlatUnderside,
    FootingConfig,
    Outline,
    StandingBody,
    SupportPlane,
    outermost,
)
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array
from f3sr.scene import GROUND, SceneObject

SLOPE_HEIGHT = 0.003
"""Height of the section of a body [size] under which the slope of what carries it is taken."""
TURNS = 4
"""Most turns in which the plane below and the underside that meets it are found."""
SAME = 1e-4
"""Difference of two normals [rad] that counts as none."""


def footing(
    o: SceneObject, plane: SupportPlane, config: FootingConfig, *, below: float = 0.0, center: Array | None = None
) -> tuple[ConvexPart, ...]:
    """Wedges (asset frame) that keep an object in its pose on a plane below it (world frame).

    They reach down to ``below`` [m] under its lowest point, which a round object does not need. Negative, they end over
    it. There are none for an object that needs none, would fall anyway, or would need more than ``max_height``.
    ``center`` (3,) is the centre of mass of the object and all it carries, by default its own.
    """
    body = StandingBody.of(o, center)
    if body is None:
        return ()
    lowest, grain = body.lowest(plane) - below, GRAIN * body.size
    flat = FlatUnderside.of(o, body, plane, config)
    missing = plane.heights(flat.corners) - lowest if flat else np.array([np.inf])
    outlines = flat.patches(config.pieces) if flat else []
    pads = _pads(outlines, flat, plane, lowest, config) if flat else []
    if missing.max() <= grain and not pads:
        return ()
    if flat and missing.mean() <= config.max_height * body.size and flat.carries(plane, lowest, config):
        pieces = pads or [(outline, plane) for outline in outlines]
        return _in_asset(o, [_wedge(outline, flat.facet, under, lowest, grain) for outline, under in pieces])
    return () if below > 0 else _in_asset(o, _under_round(body, plane, config, above=-below))


def footing_again(
    o: SceneObject,
    carriers: Sequence[SceneObject],
    around: Compound,
    config: FootingConfig,
    *,
    clearance: float,
    center: Array,
    below: float = 0.0,
) -> tuple[tuple[ConvexPart, ...], float]:
    """The footing (asset frame) of an object whose ``carriers`` changed, made anew; and the rise [m] it then needs.

    After that rise the object is ``clearance`` [m] from all ``around`` it. What carries it may rise beside its lowest
    point. Then the footing ends there, and the object stays low. Where it would still rise by more than a grain it
    keeps its footing. The rest is as for ``footing``."""
    wedges, rise = o.footing, 0.0
    plane = plane_below(o, carriers, config, center=center)
    for _ in range(2):
        if plane and (found := footing(o, plane, config, below=below - rise, center=center)):
            wedges = found
            body = placed((*o.parts, *wedges), o.T_world_asset)
            rise = max(0.0, smallest_shift(body, around, UP, clearance), clearance - body.lowest)
    return (wedges, rise) if rise <= GRAIN * o.size else (o.footing, 0.0)


def _pads(
    outlines: Sequence[Array], flat: FlatUnderside, plane: SupportPlane, lowest: float, config: FootingConfig
) -> list[tuple[Array, SupportPlane]]:
    """Quarters of the outlines (k, 3) of an underside, each with the plane on what is below it.

    There are none where one plane meets all that is below, where nothing is missing, where the pads would be too many,
    and where one would be too high."""
    if not plane.tops or 4 * len(outlines) > config.pieces:
        return []
    grain, highest = GRAIN * flat.body.size, config.max_height * flat.body.size
    pads = [(q, _plane_under(q, plane, config)) for outline in outlines for q in _quarters(outline)]
    domed = any((plane.below(q, 0.0) - under.below(q, 0.0))[:, 2].max() > grain for q, under in pads)
    missing = [under.heights(flat.facet.below(q, 0.0)) - lowest for q, under in pads]
    fit = max(m.max() for m in missing) > grain and max(m.mean() for m in missing) <= highest
    return pads if domed and fit else []


def _quarters(outline: Array) -> list[Array]:
    """The four quarters (k, 3) of a convex outline seen from above, cut along its principal axes."""
    corners = Outline.of(outline)
    if corners is None:
        return []
    polygon = np.column_stack([corners.corners, np.zeros(len(corners.corners))])
    middle = polygon.mean(0)
    long, across = np.linalg.svd((polygon - middle)[:, :2])[2]
    halves = [_clipped(polygon, middle, way) for way in (long, -long)]
    return [q for half in halves for way in (across, -across) if len(q := _clipped(half, middle, way)) >= 3]


def _clipped(polygon: Array, point: Array, direction: Array) -> Array:
    """The part of a convex polygon (k, 3) ahead of a vertical plane through a point (Sutherland and Hodgman 1974)."""
    ahead = (polygon - point)[:, :2] @ direction
    kept = list[Array]()
    for a, b, here, there in zip(polygon, np.roll(polygon, -1, 0), ahead, np.roll(ahead, -1), strict=True):
        if here >= 0:
            kept.append(a)
        if here * there < 0:
            kept.append(a + here / (here - there) * (b - a))
    return np.array(kept)


def _plane_under(outline: Array, plane: SupportPlane, config: FootingConfig) -> SupportPlane:
    """The plane on what is below an outline (k, 3); ``plane`` where there is nothing, or it is steep."""
    region = Outline.of(outline)
    found = facet_above(highest_points(plane.tops, region), outline.mean(0), config.max_turn) if region else None
    return replace(found, tops=plane.tops) if found else plane


def _under_round(body: StandingBody, plane: SupportPlane, config: FootingConfig, *, above: float) -> list[ConvexPart]:
    """The space between the section on which a body stands and the plane through its lowest point."""
    height = body.round_underside(plane, config)
    if height is None or above + GRAIN * body.size > config.flat * body.size:
        return []
    section = outermost(body.section(plane, max(height, above + GRAIN * body.size)))
    return [ConvexPart.hull_of(np.concatenate([section, plane.below(section, body.lowest(plane) + above)]))]


def _in_asset(o: SceneObject, wedges: Sequence[ConvexPart]) -> tuple[ConvexPart, ...]:
    T_asset_world: Array = np.linalg.inv(o.T_world_asset).astype(np.float64)
    return tuple(wedge.moved(T_asset_world) for wedge in wedges)


def supplied(o: SceneObject) -> float:
    """Height [m] that the footing of an object supplies below the lowest point of its mesh; 0 without one.

    It is that of the highest piece: others reach lower only as what is below them does."""
    lowest = max((float(p.moved(o.T_world_asset).vertices[:, 2].min()) for p in o.footing), default=np.inf)
    return max(0.0, float(o.vertices_world[:, 2].min()) - lowest)


def flush(o: SceneObject, plane: SupportPlane) -> tuple[ConvexPart, ...]:
    """The parts of an object (asset frame), cut at the mesh's lowest point along the plane's normal.

    Below that point they cover nothing. Without them the object rests on its footing alone."""
    lowest = float(plane.heights(o.vertices_world).min())
    # World plane to asset frame: x_world = R (scale x) + t, so n' = R' n and the offset loses n . t and the scale.
    normal = plane.normal @ o.T_world_object[:3, :3]
    offset = (plane.offset + lowest - float(plane.normal @ o.T_world_object[:3, 3])) / o.scale
    return tuple(_above(part, normal, offset) for part in o.parts)


def _above(part: ConvexPart, normal: Array, offset: float) -> ConvexPart:
    try:
        return part.above(normal, offset)
    except ValueError:  # hardly a volume is left
        return part


def _wedge(outline: Array, facet: SupportPlane, plane: SupportPlane, lowest: float, grain: float) -> ConvexPart:
    """The wedge inside an outline (k, 3), from ``lowest`` above the plane up to the facet under the body.

    It is at least ``grain`` high, so that it has a volume."""
    top = facet.below(outline, grain)
    bottom = plane.below(outline, lowest)
    # Where the facet dips below the wedge's bottom, the wedge keeps a height.
    top[:, 2] = np.maximum(top[:, 2], bottom[:, 2] + grain)
    return ConvexPart.hull_of(np.concatenate([top, bottom]))


def plane_below(
    o: SceneObject, carriers: Sequence[SceneObject], config: FootingConfig, *, center: Array | None = None
) -> SupportPlane | None:
    """The plane that the underside of ``o`` would rest on: the ground, or ``support_plane`` of what carries it."""
    if o.supported_by == GROUND:
        return GROUND_PLANE
    tops = [part for carrier in carriers for part in carrier.colliders_world]
    return support_plane(o, tops, config, center=center)


def support_plane(
    o: SceneObject, tops: Sequence[ConvexPart], config: FootingConfig, *, center: Array | None = None
) -> SupportPlane | None:
    """The plane on which the underside of ``o`` would come to rest on ``tops`` (convex parts, world frame).

    It is a facet of the hull of their upper sides under the underside: the one under its centre of mass. None if there
    is none or it is steep. Which underside that is depends on the plane, so both are found in turn. ``center`` (3,) as
    for ``footing``."""
    body = StandingBody.of(o, center)
    if body is None or not tops:
        return None
    plane = GROUND_PLANE
    for _ in range(TURNS):
        regions = filter(None, map(Outline.of, _regions(o, body, plane, config)))
        points = np.concatenate([np.zeros((0, 3)), *(highest_points(tops, r) for r in regions)])
        found = facet_above(points, body.center, config.max_turn)
        if found is None:
            return None
        was, plane = plane, replace(found, tops=tuple(tops))
        if np.allclose(plane.normal, was.normal, atol=SAME):
            break
    return plane


def _regions(o: SceneObject, body: StandingBody, plane: SupportPlane, config: FootingConfig) -> list[Array]:
    """Where the underside of a body would meet a plane: points (k, 3) around each region."""
    flat = FlatUnderside.of(o, body, plane, config)
    if flat and flat.carries(plane, body.lowest(plane), config):
        return flat.patches(config.pieces)
    section = body.section(plane, body.round_underside(plane, config) or SLOPE_HEIGHT * body.size)
    return [outermost(section)] if len(section) else []
