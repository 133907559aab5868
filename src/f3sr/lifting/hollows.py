"""Bowls, plates, pans and cups with a real inside, and with handles, from an outline."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.many_starts import BEHIND_CAMERA, refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.silhouettes import inflated_mask, lying_at
from f3sr.lifting.solids import Solid, clipped, joined, revolved
from f3sr.vision.regions import grown, parts_of

HANDLE = 0.03
"""Least share of the mask that what sticks out has for it to be a handle."""
ROOT = 6
"""Length of a handle's root within the body [px of the window]."""
RINGS = 8
"""Rings of a bowl's outside."""
WIDENS, SPREAD = 0.4, (0.6, 0.8, 0.4)
"""The logarithm of the power by which it widens, before its picture tells. Standard deviations: of the logarithm of
height over radius, of the logit of the base's radius over the rim's, and of the former."""
THINNEST = 0.002
"""Least thickness of a wall [m]: thinner convex parts make contact solvers unstable."""
SECTORS, FACETS = 14, 3
"""Convex pieces around the wall, and facets of the surface in each: a piece reaches .025 radii into the hollow."""
BULGE = 0.05
"""Largest distance that a wall's inside bends from its chord in one piece [radius of the rim]."""


class Usual(NamedTuple):
    """What a kind of hollow things usually measures, over the radius of its rim."""

    height: float
    base: float
    wall: float


def fit_hollow(seen: Outlined, floor: float, *, usual: Usual, upside_down: bool = False) -> FittedShape | None:
    """A bowl, plate, pan or cup on the height ``floor`` [m], with handles: its outline touches the lines that the
    mask's touches, in all directions. Its wall is no thinner than 2 mm."""
    anchor = anchored(seen, floor)
    if anchor is None:
        return None
    handles = seen.handles
    body = replace(seen, mask=seen.mask & ~handles, valid=seen.valid & ~grown(handles, 1))
    _, size = anchor
    centre = seen.on_plane(body.widest[None], UP, floor)[0]
    if not np.isfinite(centre).all():
        return None
    away = horizontal(seen, centre)
    side = np.array([-away[1], away[0], 0])
    directions, wanted, scatter = body.support
    middle, spread = (
        np.array([math.log(usual.height), math.log(usual.base / (1 - usual.base)), WIDENS]),
        np.array(SPREAD),
    )

    def foot(x: Array) -> Array:
        return centre + size * (x[0] * side + x[1] * away)

    def profile(x: Array) -> Array:
        rim = size * math.exp(x[2])
        return _bowl(rim, rim * math.exp(x[3]), float(1 / (1 + math.exp(-x[4]))), math.exp(x[5]))

    def residual(x: Array) -> Array:
        made = revolved(foot(x), profile(x), sectors=24).vertices
        pixels, depth = seen.camera.project(_turned_over(made, foot(x), profile(x)) if upside_down else made)
        if not (depth > 0.05 * size).all():
            return np.full(len(wanted) + 3, BEHIND_CAMERA)
        return np.concatenate([((pixels @ directions.T).max(0) - wanted) / scatter, (x[3:] - middle) / spread])

    start = np.array([[0.0, -0.3, math.log(0.5), *middle]])
    x = refined(lambda x: np.array([residual(one) for one in x]), start, iterations=40)[0][0]
    outer = profile(x)
    hollowed = _hollowed(outer, usual.wall)
    solid = replace(
        revolved(foot(x), hollowed, sectors=SECTORS * FACETS),
        pieces=_pieces(foot(x), outer, hollowed),
        rim=_sector(foot(x), outer[-2:-1], 0, SECTORS),
    )
    if upside_down:
        solid = Solid(
            vertices=_turned_over(solid.vertices, foot(x), outer),
            faces=solid.faces[:, ::-1],
            pieces=tuple(_turned_over(corners, foot(x), outer) for corners in solid.pieces),
        )
        return FittedShape.of("bowl or cup upside down", solid, seen)
    return FittedShape.of("bowl or cup", _with_handles(seen, handles, solid, foot(x), outer), seen)


def _turned_over(points: Array, foot: Array, profile: Array) -> Array:
    """Points (n, 3) of a bowl mirrored at half its height: its rim is below."""
    return points * [1, 1, -1] + (2 * foot[2] + float(profile[-1, 1])) * UP


def _bowl(rim: float, height: float, base: float, power: float) -> Array:
    """Radii and heights (n, 2) of a bowl's outside, from the axis below to the axis above [m]: from a flat ``base``
    [radius of the ``rim``] it widens as a power of the height."""
    t = np.linspace(0, 1, RINGS)
    radii = rim * (base + (1 - base) * t ** (1 / power))
    return np.concatenate([[[0, 0]], np.column_stack([radii, height * t]), [[0, height]]])


def _hollowed(profile: Array, wall: float) -> Array:
    """A profile with an inside: from its widest height, walls of one thickness, and a floor of that: a
    share ``wall`` of the rim's radius."""
    rim = int(np.argmax(profile[:, 0]))
    outer = profile[: rim + 1]
    wall = max(wall * float(outer[-1, 0]), THINNEST)
    inner = outer[1:][outer[1:, 1] > wall][::-1] - [wall, 0]
    inner = inner[inner[:, 0] > wall]
    if len(inner) < 2:
        return profile
    return np.concatenate([outer, inner, [[inner[-1, 0], wall], [0, wall]]])


def _pieces(foot: Array, outer: Array, hollowed: Array) -> tuple[Array, ...]:
    """Corners (n, 3) of convex pieces that hold a bowl: its floor, and bands of its wall by sectors."""
    inside = hollowed[len(outer) - 1 : -1]  # from the rim down to the floor
    if len(inside) < 2:
        return ()
    wall = float(hollowed[-1, 1])
    low, high = wall, float(outer[-2, 1])
    cuts = _bands(inside[:-1][::-1], float(outer[-2, 0]), low, high)
    made = [_sector(foot, _between(outer[1:-1], 0.0, low), 0, SECTORS)]
    for a, b in itertools.pairwise(cuts):
        band = np.concatenate([_between(outer[1:-1], a, b), _between(inside[:-1][::-1], a, b)])
        made += [_sector(foot, band, k, k + 1) for k in range(SECTORS)]
    return tuple(made)


def _bands(inside: Array, rim: float, low: float, high: float) -> list[float]:
    """Heights, from ``low`` to ``high``, between which the inside's profile (n, 2) is nearly straight."""
    middle = (low + high) / 2
    a, m, b = np.interp([low, middle, high], inside[:, 1], inside[:, 0])
    if abs(m - (a + b) / 2) <= BULGE * rim or high - low < 2 * BULGE * rim:
        return [low, high]
    return [*_bands(inside, rim, low, middle)[:-1], *_bands(inside, rim, middle, high)]


def _between(profile: Array, low: float, high: float) -> Array:
    """The piece (n, 2) of a rising profile between two heights, with points there."""
    kept = profile[(profile[:, 1] > low) & (profile[:, 1] < high)]
    ends = [[np.interp(z, profile[:, 1], profile[:, 0]), z] for z in (low, high)]
    return np.concatenate([ends[:1], kept, ends[1:]])


def _sector(foot: Array, profile: Array, first: int, last: int) -> Array:
    """Points (n, 3) of a profile (n, 2) turned from one sector to another, at the corners of the surface's facets."""
    angles = 2 * np.pi * np.arange(first * FACETS, last * FACETS + 1) / (SECTORS * FACETS)
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    points = profile[:, None, :1] * ring
    raised = np.broadcast_to(profile[:, None, 1:], (*points.shape[:2], 1))
    return foot + np.concatenate([points, raised], axis=2).reshape(-1, 3)


def _with_handles(seen: Outlined, handles: NDArray[np.bool_], body: Solid, foot: Array, profile: Array) -> Solid:
    """A hollow body with the ``handles`` (h, w) beside it: at the height of the rim where it is flat, else about the
    vertical sheet through its axis."""
    labels = parts_of(handles)
    flat = profile[:, 1].max() < profile[:, 0].max()
    for k in range(1, int(labels.max()) + 1):
        part = labels == k
        if part.sum() < HANDLE * seen.mask.sum():
            continue
        handle = replace(seen, mask=grown(part, ROOT) & seen.mask)
        if flat:
            rim = foot + float(profile[np.argmax(profile[:, 0]), 1]) * UP
            made = lying_at(handle, rim)
        else:
            made = inflated_mask(handle, -horizontal(seen, foot), foot)
        made = made and clipped(made, float(foot[2]))
        both = made and joined(body, made)
        if made and both:
            pieces = (*body.pieces, made.vertices) if body.pieces else ()
            body = replace(both, pieces=pieces, rim=body.rim)
    return body
