"""Solids for the example's objects, each with the convex parts that physics sees.

Every shape lives in its own frame: metres, +Z up, base at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import manifold3d as mf
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from f3sr.core.transforms import Array

SEGMENTS = 128
"""Facets around an axis of revolution."""
WEDGES = 32
"""Convex parts around a hollow ring."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A watertight ``solid`` and ``parts``: corner points (n, 3) of convex pieces that together cover it."""

    solid: mf.Manifold
    parts: tuple[Array, ...]


def vertices(solid: mf.Manifold) -> Array:
    return np.asarray(solid.to_mesh().vert_properties[:, :3], float)


def convex(solid: mf.Manifold) -> Shape:
    return Shape(solid=solid, parts=(vertices(solid.hull()),))


def rounded_box(size: ArrayLike, radius: float) -> mf.Manifold:
    """A box of ``size`` (3,) on z = 0, centred in x and y, with round edges."""
    x, y, z = np.asarray(size, float)
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    centers = signs * (np.array([x, y, z]) / 2 - radius) + [0, 0, z / 2]
    ball = mf.Manifold.sphere(radius, 24)
    return mf.Manifold.batch_hull([ball.translate(c) for c in centers])


def curve(points: ArrayLike, count: int) -> Array:
    """A smooth open curve (count, 2) through (r, z) points, evenly spaced along their polyline."""
    p = np.asarray(points, float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    return np.asarray(PchipInterpolator(along, p)(np.linspace(0, along[-1], count)))


def lathe(profile: ArrayLike) -> mf.Manifold:
    """The solid of revolution about z of a closed profile of (r, z) points, counter-clockwise."""
    section = mf.CrossSection([np.asarray(profile, float)], mf.FillRule.EvenOdd)
    return section.revolve(SEGMENTS)


def ring_parts(section: ArrayLike) -> tuple[Array, ...]:
    """Convex pieces of a revolved convex (r, z) polygon: one when it touches the axis, else wedges."""
    r, z = np.asarray(section, float).T
    count = 1 if r.min() <= 0 else WEDGES
    pieces: list[Array] = []
    for k in range(count):
        start, stop = 2 * np.pi * k / count, 2 * np.pi * (k + 1) / count
        angle = np.linspace(start, stop, SEGMENTS // count + 1)[:, None]
        piece = np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z, (len(angle), len(z)))], -1)
        pieces.append(piece.reshape(-1, 3))
    return tuple(pieces)


def solid_of_revolution(outline: Array, sections: Sequence[ArrayLike]) -> Shape:
    """A full body: ``outline`` from the axis at the bottom to the axis at the top."""
    return Shape(solid=lathe(outline), parts=tuple(p for s in sections for p in ring_parts(s)))


def vessel(outer: Array, inner: Array, *, every: int) -> Shape:
    """An open container of revolution between two curves (n, 2) from base to rim.

    Its parts join each ``every``-th point of the curves.
    """
    floor = np.array([[0.0, inner[0, 1]]])
    base = np.array([[0.0, outer[0, 1]]])
    solid = lathe(np.concatenate([base, outer, inner[::-1], floor]))
    sections = [np.concatenate([base, outer[:1], inner[:1], floor])]
    for a, b in zip(range(0, len(outer) - every, every), range(every, len(outer), every), strict=True):
        sections.append(np.stack([outer[a], outer[b], inner[b], inner[a]]))
    return Shape(solid=solid, parts=tuple(p for s in sections for p in ring_parts(s)))


def box(size: ArrayLike, radius: float) -> Shape:
    return convex(rounded_box(size, radius))


def book(size: tuple[float, float, float], *, cover: float = 0.002, inset: float = 0.004) -> Shape:
    """A hardback lying flat, spine at -x: two covers, a spine and an inset block of pages."""
    x, y, z = size
    board = rounded_box([x, y, cover], cover * 0.45)
    spine = rounded_box([cover, y, z], cover * 0.45).translate([-(x - cover) / 2, 0, 0])
    pages = rounded_box([x - inset - cover / 2, y - 2 * inset, z - cover], 0.0002)
    pages = pages.translate([(cover / 2 - inset) / 2, 0, cover / 2])
    top = board.translate([0, 0, z - cover])
    solid = mf.Manifold.batch_boolean([board, top, spine, pages], mf.OpType.Add)
    return Shape(solid=solid, parts=(vertices(solid.hull()),))


def tin(radius: float, height: float, *, rim: float = 0.0016) -> Shape:
    """A food tin: a proud seam at both ends, lid and bottom set back, beads in the lid."""
    R, h, r, lid = radius, height, radius - rim, radius - 2.2 * rim
    outline = [
        (0, rim), (lid, rim), (lid, 0), (R - rim / 2, 0), (R, rim), (R, 2 * rim), (r, 2.6 * rim),
        (r, h - 2.6 * rim), (R, h - 2 * rim), (R, h - rim), (R - rim / 2, h), (lid, h), (lid, h - 2 * rim),
        (0.8 * lid, h - 2 * rim), (0.76 * lid, h - 1.5 * rim), (0.56 * lid, h - 1.5 * rim),
        (0.52 * lid, h - 2 * rim), (0, h - 2 * rim),
    ]  # fmt: skip
    body = [(0, rim), (R, rim), (R, h - 2 * rim), (0, h - 2 * rim)]
    bead = [(0, h - 2 * rim), (0.8 * lid, h - 2 * rim), (0.76 * lid, h - 1.5 * rim), (0, h - 1.5 * rim)]
    low = [(lid, 0), (R - rim / 2, 0), (R, rim), (lid, rim)]
    high = [(lid, h - 2 * rim), (R, h - 2 * rim), (R, h - rim), (R - rim / 2, h), (lid, h)]
    return solid_of_revolution(np.array(outline), [body, bead, low, high])


def bowl(radius: float, height: float) -> Shape:
    outer = np.array([[0.40, 0], [0.44, 0.07], [0.66, 0.21], [0.83, 0.45], [0.94, 0.74], [0.985, 0.97]])
    inner = np.array([[0.30, 0.13], [0.46, 0.165], [0.63, 0.29], [0.78, 0.49], [0.90, 0.76], [0.955, 0.98]])
    size = [radius, height]
    lip = np.array([[0.982, 1.0], [0.962, 1.003]]) * size
    sides = [np.concatenate([curve(c * size, 25), lip[k : k + 1]]) for k, c in enumerate((outer, inner))]
    return vessel(*sides, every=5)


def mug(radius: float, height: float, *, wall: float = 0.0035) -> Shape:
    """A mug with its handle towards +x."""
    R, h, w = radius, height, wall
    outer = [[0.82 * R, 0], [0.9 * R, 0.002], [0.97 * R, 0.01], [R, 0.025], [R, h - 0.003]]
    inner = [[0.6 * R, 0.005], [0.82 * R, 0.006], [0.9 * R, 0.012], [R - w, 0.027], [R - w, h - 0.003]]
    outer, inner = [*outer, [R - 0.0006, h - 0.0008]], [*inner, [R - w + 0.0008, h]]
    body = vessel(curve(outer, 31), curve(inner, 31), every=6)
    links = handle_links(np.array([R - w / 2, 0, 0.54 * h]), 0.30 * h, width=0.0062, depth=0.0038)
    inside = lathe([[0, 0.0065], [R - 1.05 * w, 0.0065], [R - 1.05 * w, 2 * h], [0, 2 * h]])
    handle = mf.Manifold.batch_boolean(links, mf.OpType.Add) - inside
    ears = tuple(vertices(link) for link in links[3:-3:2])
    return Shape(solid=body.solid + handle, parts=(*body.parts, *ears))


def handle_links(center: Array, radius: float, *, width: float, depth: float) -> list[mf.Manifold]:
    """A half ring towards +x as a chain of hulls; the band is ``width`` by ``depth`` (half axes)."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 25)
    place = center + np.stack([radius * 0.95 * np.cos(angle), 0 * angle, radius * np.sin(angle)], -1)
    bead = mf.Manifold.sphere(1.0, 24).scale([depth, width, depth])
    beads = [bead.rotate([0, -np.degrees(a), 0]).translate(p) for a, p in zip(angle, place, strict=True)]
    return [mf.Manifold.batch_hull([a, b]) for a, b in pairwise(beads)]


def bottle(radius: float, height: float) -> Shape:
    R, h = radius, height
    body = [
        [0.86 * R, 0], [0.97 * R, 0.004], [R, 0.012], [R, 0.56 * h], [0.93 * R, 0.63 * h],
        [0.66 * R, 0.71 * h], [0.42 * R, 0.79 * h], [0.39 * R, 0.86 * h],
    ]  # fmt: skip
    cap = [[0.44 * R, 0.86 * h], [0.46 * R, 0.87 * h], [0.46 * R, 0.985 * h], [0.42 * R, h]]
    outline = np.concatenate([[[0, 0]], curve(body, 61), cap, [[0, h]]])
    slices = [[[0, a[1]], a, b, [0, b[1]]] for a, b in pairwise([*body, *cap]) if a[1] < b[1]]
    return solid_of_revolution(outline, slices)


def citrus(radius: float, half_length: float, *, nub: float = 0.0) -> Shape:
    """A fruit lying with its axis along x; ``nub`` [m] lengthens the tips as a lemon's."""
    t = np.linspace(-np.pi / 2, np.pi / 2, 49)
    r = radius * np.cos(t) ** (1 if nub == 0 else 0.9)
    z = half_length * np.sin(t) + nub * np.sign(t) * np.abs(np.sin(t)) ** 24
    r[[0, -1]] = 0
    solid = lathe(np.stack([r, z], -1)).rotate([0, 90, 0])
    return convex(solid.translate([0, 0, radius]))


def spoon(length: float) -> Shape:
    """A wooden spoon along x, its bowl at +x."""
    scoop = mf.Manifold.sphere(1.0, 64).scale([0.032, 0.021, 0.010]).translate([0, 0, 0.0165])
    head = mf.Manifold.sphere(1.0, 96).scale([0.036, 0.0245, 0.014]).translate([0, 0, 0.014])
    head = (head.trim_by_plane([0, 0, -1], -0.015) - scoop).translate([length / 2 - 0.036, 0, 0])
    tip = mf.Manifold.sphere(0.0052, 32).translate([-length / 2, 0, 0.0085])
    neck = mf.Manifold.sphere(0.0044, 32).translate([length / 2 - 0.066, 0, 0.0105])
    shaft = mf.Manifold.batch_hull([tip, neck])
    return Shape(solid=head + shaft, parts=(vertices(head.hull()), vertices(shaft)))
