"""Solids warped until their outline is the mask's: families are simpler than the things that they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import UP, Array
from f3sr.lifting.fits import SLIDE, FittedShape
from f3sr.lifting.inner_edges import near_rim
from f3sr.lifting.outlined import Outlined
from f3sr.vision.regions import depth_inside, grown, interpolated, shrunk, smoothed

WIDTHS = (0.15, 0.15, 0.08, 0.08, 0.05, 0.05)
"""Standard deviations of the smoothing of the displacement, step after step [size of the mask]: the whole before its
parts. Finer outlines are noise in masks from a few strokes."""
AFFINE = 2
"""Steps before those, in which the whole is stretched and sheared: straight edges stay straight, hidden ones too."""
STIFF = 0.01
"""Weight of no stretch beside all of the outline that is seen: a part of one tells little of the rest."""
ENOUGH = 0.97
"""Overlap with the mask above which what is regular is not bent: the rest is about half a pixel of a mask 60 wide,
as masks are wrong. A bent cube stands askew, a dented ball rolls in curves."""
FARTHEST = 3.0
"""Largest displacement of a step, in its smoothing widths: what is farther belongs to another part."""
FOLD = 0.3
"""Least area that a step leaves of any part of the picture: at 0 it folds."""
LEVEL = 1e-3
"""Distance from the lowest and the highest point up to which points belong to a level face [height of the solid]."""

NO_EDGE = np.zeros((0, 2)), np.zeros((0, 2))
"""No points of an inner edge, and no ways."""


def fitted_to_outline(
    fit: FittedShape, seen: Outlined, *, on_a_point: bool = False, regular: bool = False
) -> FittedShape:
    """A shape whose outline meets the mask's wherever nothing may hide it.

    A smooth displacement of the picture moves the solid, front and back alike. What is ``regular`` is moved by an
    affine one first, and by no other where that explains the mask. Points keep their depth, but a level top stays
    level, and an underside on its support: things stand on both. What rests ``on_a_point`` is brought to its support as
    a whole, along the rays. Each step smooths the distance between both outlines along the shape's normals (non-rigid
    registration of signed distance fields, from coarse to fine). Where the photo shows the near rim of what is hollow,
    that pulls as the outline does. Of all steps that stays whose outline and rim leave least between them and the
    picture's.
    """
    solid = fit.solid
    size = math.sqrt(float(seen.mask.sum()))
    groups = [solid.vertices, *solid.pieces, *([] if solid.rim is None else [solid.rim])]
    ends = np.cumsum([len(g) for g in groups])[:-1]
    points = np.concatenate(groups)
    floor, top = float(solid.vertices[:, 2].min()), float(solid.vertices[:, 2].max())
    near = LEVEL * (top - floor)
    below, above = points[:, 2] <= floor + near, points[:, 2] >= top - near
    if on_a_point:
        below[:] = False
    wanted, hidden = depth_inside(seen.mask), grown(~seen.valid, 2)
    rim = None if solid.rim is None else near_rim(seen, solid.rim)

    def inner_edge(points: Array) -> tuple[Array, Array]:
        return NO_EDGE if rim is None else rim.residuals(np.split(points, ends)[-1], seen)

    def left(edge: tuple[Array, Array], overlap: float) -> float:
        return 1 - overlap + float(np.linalg.norm(edge[1], axis=1).sum()) / size**2

    best, overlap, edge = points, fit.overlap, inner_edge(points)
    least = left(edge, overlap)
    foot, head = seen.camera.project(solid.vertices.mean(0) + np.outer([0.0, top - floor], UP))[0]
    up = (head - foot) / max(float(np.linalg.norm(head - foot)), 1e-9)
    steps = [(WIDTHS[0], True)] * AFFINE * regular + [(width, False) for width in WIDTHS]
    for width, whole in steps:
        if regular and overlap > ENOUGH:
            break
        shown = seen.silhouette(points[: len(solid.vertices)], solid.faces)
        pulls = _Pulls.of(shown, wanted, hidden, edge, width * size)
        shift = pulls.affine(size, up) if whole else pulls.smooth(width * size)
        while (area := _least_area(shift, shown)) < FOLD:
            shift = shift / (2 - area)
        points = _moved(points, below, above, -np.inf if on_a_point else floor, shift, seen)
        reached = seen.overlap(points[: len(solid.vertices)], solid.faces)
        edge = inner_edge(points)
        if (still := left(edge, reached)) < least:
            best, overlap, least = points, reached, still
    if on_a_point:
        centre = seen.camera.center
        best = centre + (floor - centre[2]) / (best[: len(solid.vertices), 2].min() - centre[2]) * (best - centre)
    vertices, *rest = np.split(best, ends)
    warped = replace(
        solid,
        vertices=vertices,
        pieces=tuple(rest[: len(solid.pieces)]),
        rim=None if solid.rim is None else rest[-1],
        form=solid.symmetric,
    )
    return replace(fit, solid=warped, overlap=overlap)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pulls:
    """What pulls at a solid in a picture of ``shape`` (h, w)."""

    shape: tuple[int, ...]
    places: NDArray[np.int64]
    """(n, 2) rows and columns."""
    moves: Array
    """(n, 2) displacements [px], x first."""
    inward: Array
    """(n, 2) unit normals of the outline, along which alone it tells; 0 of an inner edge."""

    @classmethod
    def of(
        cls,
        shown: NDArray[np.bool_],
        wanted: Array,
        hidden: NDArray[np.bool_],
        inner: tuple[Array, Array],
        sigma: float,
    ) -> Self:
        """The outline of what is ``shown`` (h, w) to where the signed distance ``wanted`` (h, w) is 0, by its normals,
        and points ``inner`` (n, 2) by their own displacements (n, 2), all as far as they belong to parts of a size
        ``sigma`` [px]. Outlines where things are ``hidden`` (h, w) tell nothing."""
        own = depth_inside(shown)
        outline = shown & ~shrunk(shown, 1) & ~hidden
        down, right = np.gradient(own)
        inward = np.stack([right, down], axis=-1)[outline]
        inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-6)
        reach = np.clip((wanted - own)[outline], -FARTHEST * sigma, FARTHEST * sigma)
        lengths = np.linalg.norm(inner[1], axis=1, keepdims=True)
        edge = inner[1] * np.minimum(1, FARTHEST * sigma / np.maximum(lengths, 1e-9))
        at = np.clip(inner[0].astype(int)[:, ::-1], 0, np.array(shown.shape) - 1)
        return cls(
            shape=shown.shape,
            places=np.concatenate([np.argwhere(outline), at]),
            moves=np.concatenate([-reach[:, None] * inward, edge]),
            inward=np.concatenate([inward, np.zeros_like(edge)]),
        )

    def smooth(self, sigma: float) -> Array:
        """Displacements (h, w, 2) [px]: their means under a Gaussian [px]."""
        moves, told = np.zeros((*self.shape, 2)), np.zeros(self.shape)
        rows, columns = self.places.T
        np.add.at(moves, (rows, columns), self.moves)
        np.add.at(told, (rows, columns), 1.0)
        weight = smoothed(told, sigma)
        total = np.stack([smoothed(moves[..., k], sigma) for k in (0, 1)], axis=-1)
        return total / np.maximum(weight, 1e-4 * max(float(weight.max()), 1e-30))[..., None]

    def affine(self, size: float, up: Array) -> Array:
        """Displacements (h, w, 2) [px] by an affine map for the outline of what is so large [px]: least squares of
        distances along its normals (point to line, Chen and Medioni 1992). Nothing comes to lean against ``up`` (2,),
        a unit vector of the picture: what leans falls."""
        rows, columns = self.places.T
        middle = np.array([columns.mean(), rows.mean()]) if len(rows) else np.zeros(2)
        axes = np.array([[-up[1], up[0]], up])  # across, and up
        across, upward = ((np.column_stack([columns, rows]) - middle) @ axes.T / size).T
        aside, along = (self.inward @ axes.T).T
        terms = np.column_stack([aside * across, aside, along * across, along * upward, along])
        stiff = STIFF * max(len(rows), 1) * np.diag([1.0, 1e-3, 1.0, 1.0, 1e-3])
        told = (self.moves * self.inward).sum(1)
        wider, right, shear, taller, higher = np.linalg.solve(terms.T @ terms + stiff, terms.T @ told)
        y, x = np.indices(self.shape)
        across, upward = np.moveaxis(np.stack([x - middle[0], y - middle[1]], axis=-1) @ axes.T / size, -1, 0)
        moved = np.stack([wider * across + right, shear * across + taller * upward + higher], axis=-1)
        return np.asarray(moved @ axes, float)


def _least_area(shift: Array, shown: NDArray[np.bool_]) -> float:
    """Of a pixel of what is ``shown`` (h, w), displaced with its neighbours."""
    (xy, xx), (yy, yx) = (np.gradient(shift[..., k]) for k in (0, 1))
    return float(((1 + xx) * (1 + yy) - xy * yx).min(initial=1.0, where=shown))


def _moved(
    points: Array, below: NDArray[np.bool_], above: NDArray[np.bool_], floor: float, shift: Array, seen: Outlined
) -> Array:
    """Points (n, 3) displaced in the picture, at their depths; those ``below`` (n,), and those that would be under the
    ``floor`` [m], on it, and those ``above`` (n,) at one height."""
    camera = seen.camera
    pixels, depth = camera.project(points)
    rays = seen.rays(pixels + np.column_stack([interpolated(shift[..., k], pixels) for k in (0, 1)]))
    moved = camera.center + depth[:, None] * rays
    height = moved[:, 2].copy()
    height[above] = np.median(moved[above, 2])
    height[below | (height < floor)] = floor
    level = moved * [1, 1, 0] + height[:, None] * UP
    with np.errstate(divide="ignore", invalid="ignore"):
        slide = camera.center + rays * ((height - camera.center[2]) / rays[:, 2])[:, None] - level
        slide *= np.minimum(1, SLIDE * np.linalg.norm(moved - points, axis=1) / np.linalg.norm(slide, axis=1))[:, None]
    return level + np.where(np.isfinite(slide), slide, 0)
