"""Boxes whose outline touches the lines that a mask touches, and boxes cut by the cone of a mask."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.lifting.fits import FittedShape, anchored, horizontal
from f3sr.lifting.inner_edges import SIGMA, InnerCorner, inner_corner
from f3sr.lifting.many_starts import BEHIND_CAMERA, gaussian, refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import BOX_FACES, CELLS, CORNERS, Solid, carved, common, finer, mirrored, subdivided

LEAN = math.radians(0.7)
"""Standard deviation of a box's lean aside, of real boxes and of the camera's error: 2 degrees, as
``metrology.directions`` has it, less by the root of 8, as so many directions meet one corner and share its error. Along
the view nothing tells a lean."""
ASIDE = 6
"""Which parameter the lean is."""
ARC = 4
"""Corners of the outline of a box, seen from above, for each of its rounded edges."""
ROUNDINGS = (-1.0, 1.0)
"""Roundings at which a fit starts, as logits of the radius over half the shorter side: .27 and .73."""
ROUNDER = 0.01
"""Gain of IoU from which on edges are rounded: among rounded boxes are all others."""
ROUNDED_CELLS = 5
"""Cells along the edges of a rounded box's faces, which are smaller."""
LOGIT = 2.0
"""Standard deviation of the logit of the rounding."""
YAWS = 9
"""Turns of a box at which its fit starts, over a quarter turn."""
DEPTHS = (0.4, 1.0, 2.2)
"""Its depths there, over its width."""
EQUAL = 1.25
"""Inverse standard deviation of the logarithms of a box's edges: a factor of 2.2. Of boxes that look alike, the most
compact; seen from its height, a box hides its own depth."""
COMPACT = 4.0
"""The same for a box that is carved: the hull of legs and backs is no outline of a box, and a low camera reads metres
of depth from a few rows."""
SPARE = 0.1
"""Standard error [size of the mask] by which the box reaches beyond the hull: what is too much is cut."""
STARTS = 4
"""Starts that are refined, the best first."""
CUTS = 12
"""Edges of a carved box's faces along its longest side: textures are projected at their corners."""
COMPACT_MASK = 0.75
"""Share of its hull that a mask covers from which on nothing is gained by carving: legs and gaps cover less."""
SYMMETRY = 0.03
"""Loss of IoU up to which a carved box is cut by its mirror image: legs and wheels get their own depth. A chair's back
would be lost by the wrong plane."""
TURNS, SHIFTS = np.radians([-8, -4, 0, 4, 8]), (-0.06, 0.0, 0.06)
"""Turns [rad] and shifts [sides of the box] of its planes of symmetry that are tried: the box is of a convex hull."""
ROUNDING = 1e-3
"""IoU by which a solid may exceed its bound: intersections are made in single precision, pixels on an outline may
change."""


RING_CORNERS = np.repeat([[-1, -1], [1, -1], [1, 1], [-1, 1]], ARC, axis=0)
RING_TURNS = np.pi * np.concatenate([1 + k / 2 + np.linspace(0, 0.5, ARC) for k in range(4)])
RING_ARCS = np.column_stack([np.cos(RING_TURNS), np.sin(RING_TURNS)])
"""The outline of a rounded box from above, counterclockwise: (4 ARC, 2) corners of the box, and directions from the
centres of its edges' arcs."""


def fit_boxes(seen: Outlined, floor: float) -> list[FittedShape]:
    """A box on the height ``floor`` [m], and one with rounded upright edges where that fits better.

    Their outlines touch the lines that the mask's touches, in all directions."""
    model = _BoxModel.of(seen, floor)
    if model is None:
        return []
    x = model.fitted()
    rounded = replace(model, rounded=True)
    tin = rounded.shape(rounded.with_rounding(x))
    return [_with_inner_edges(model, x), *([tin] if tin.overlap > model.shape(x).overlap + ROUNDER else [])]


def _with_inner_edges(model: _BoxModel, x: Array) -> FittedShape:
    """The box of parameters (7,), whose inner edges are where the photo has them."""
    inner = inner_corner(model.seen, model.corners(x[None])[0])
    if inner is None:
        return model.shape(x)
    x = model.refined(x, inner)
    return model.shape(x, inner.moved(model.corners(x[None])[0], model.seen))


@dataclass(frozen=True, eq=False, kw_only=True)
class _BoxModel:
    """Boxes that stand on a plane about ``centre`` (3,), in units of the object's ``size`` [m]: parameters (s, 7) are
    shifts along ``side`` and ``away`` (3,), logarithms of the edges, yaw, and the lean of the upright edges aside.

    ``equal`` is how alike the edges are before the outline tells: an inverse standard deviation, as EQUAL. The outline
    may reach beyond the mask's above by ``spare`` [size of the mask], beside it by half of that, and not below it,
    where it stands. Rounded boxes have one parameter more: the logit of their upright edges' radius over half the
    shorter side."""

    seen: Outlined
    centre: Array
    size: float
    away: Array
    equal: float = EQUAL
    spare: float = 0.0
    rounded: bool = False

    @classmethod
    def of(cls, seen: Outlined, floor: float, equal: float = EQUAL, spare: float = 0.0) -> Self | None:
        """For a mask whose foot is on the height ``floor`` [m]; None where that is beyond the horizon."""
        anchor = anchored(seen, floor)
        if anchor is None:
            return None
        centre, size = anchor
        return cls(seen=seen, centre=centre, size=size, away=horizontal(seen, centre), equal=equal, spare=spare)

    def corners(self, x: Array) -> Array:
        """(s, 8, 3) in the order of CORNERS; of rounded boxes (s, 8 ARC, 3), one ring above the other."""
        side = np.array([-self.away[1], self.away[0], 0])
        c, n = np.cos(x[:, 5, None]), np.sin(x[:, 5, None])
        u, v, w = np.moveaxis(self._upright(x), 2, 0)
        local = np.stack([c * u - n * v, n * u + c * v, w], 2)
        shift = (x[:, :1] * side + x[:, 1:2] * self.away)[:, None]
        return self.centre + self.size * (local + shift + w[..., None] * x[:, ASIDE, None, None] * side)

    def _upright(self, x: Array) -> Array:
        """Corners (s, n, 3) in the box's own axes, in sizes."""
        edges = np.exp(x[:, None, 2:5])
        if not self.rounded:
            return CORNERS * edges
        radius = 0.5 * edges[..., :2].min(2, keepdims=True) / (1 + np.exp(-x[:, 7, None, None]))
        flat = RING_CORNERS * (edges[..., :2] / 2 - radius) + RING_ARCS * radius
        ring = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=2)
        return np.concatenate([ring, ring + edges * [0, 0, 1]], axis=1)

    def residuals(self, x: Array) -> Array:
        """(s, m) in standard errors."""
        directions, wanted, scatter = self.seen.support
        extent = math.sqrt(float(self.seen.mask.sum()))
        beyond = np.hypot(scatter, self.spare * extent * (1 - directions[:, 1]) / 2)
        reached, depth = self.seen.reached(self.corners(x), directions)
        unequal = x[:, 2:5] - x[:, 2:5].mean(1, keepdims=True)
        off = reached - wanted
        off = off / np.where(off > 0, beyond, scatter)
        unlikely = [self.equal * unequal, gaussian(x[:, ASIDE, None] / LEAN), gaussian(x[:, 7:] / LOGIT)]
        all_of_them = np.concatenate([off, *unlikely], axis=1)
        return np.where((depth > 0.05 * self.size)[:, None], all_of_them, BEHIND_CAMERA)

    def fitted(self) -> Array:
        """The parameters (7,) of the box that overlaps most, of those that local searches end at."""
        yaws = np.pi / 2 * np.arange(YAWS) / YAWS
        starts = [[0, 0.3, math.log(0.7), math.log(0.7 * d), math.log(0.5), yaw, 0] for yaw in yaws for d in DEPTHS]
        x = _onto_bounds(self.seen, np.array(starts), self.corners, self.size)
        for kept, iterations in ((STARTS, 8), (STARTS, 40)):
            x, costs = refined(self.residuals, x, iterations=iterations)
            x = x[np.argsort(costs, kind="stable")[:kept]]
        return x[int(np.argmax([self.shape(one).overlap for one in x]))]

    def refined(self, x: Array, inner: InnerCorner) -> Array:
        """Parameters (7,) from ``x``, whose corner inside the outline is where the photo has it too."""

        def residuals(x: Array) -> Array:
            corners = self.corners(x)[:, inner.index]
            pixels, _ = self.seen.camera.project(corners)
            return np.concatenate([self.residuals(x), (pixels - inner.pixel) / SIGMA], axis=1)

        return refined(residuals, x[None], iterations=40)[0][0]

    def shape(self, x: Array, corners: Array | None = None) -> FittedShape:
        """The box of parameters (7,), or the rounded one of (8,), with its ``corners`` (n, 3) where they are others."""
        upright = x * np.where(np.arange(len(x)) == ASIDE, 0.0, 1.0)
        box = Solid(
            vertices=self.corners(x[None])[0] if corners is None else corners,
            faces=_ring_faces(4 * ARC) if self.rounded else BOX_FACES,
            symmetry="box",
            form=self.corners(upright[None])[0],
        )
        made = subdivided(box, ROUNDED_CELLS if self.rounded else CELLS)
        return FittedShape.of("rounded box" if self.rounded else "box", made, self.seen)

    def with_rounding(self, x: Array) -> Array:
        """The parameters (8,) of the rounded box that overlaps most, from those (7,) of a sharp one."""
        starts = np.array([[*x, rounding] for rounding in ROUNDINGS])
        found, _ = refined(self.residuals, starts, iterations=40)
        return found[int(np.argmax([self.shape(one).overlap for one in found]))]


def _onto_bounds(seen: Outlined, x: Array, corners: Callable[[Array], Array], size: float) -> Array:
    """Boxes x (s, 7) of given proportions and yaw, moved and scaled so that their pictures have the mask's bounds."""
    left, top, right, bottom = seen.bounds
    steep = abs(seen.camera.T_world_camera[2, 2]) + 0.05  # sine of the pitch: pixels up are metres away over it
    for _ in range(3):
        points = corners(x)
        pixels, depth = (a.reshape(*points.shape[:2], -1) for a in seen.camera.project(points.reshape(-1, 3)))
        west, north = np.moveaxis(pixels.min(1), 1, 0)
        east, south = np.moveaxis(pixels.max(1), 1, 0)
        metres = depth.mean((1, 2)) / seen.camera.K[0, 0] / size
        moved = x.copy()
        moved[:, 0] -= ((left + right) - (west + east)) / 2 * metres
        moved[:, 1] += (south - bottom) * metres / steep
        moved[:, 2:4] += np.log((right - left) / np.maximum(east - west, 1e-6))[:, None]
        higher = np.log((bottom - top) / np.maximum(south - north, 1e-6))
        moved[:, 4] = np.clip(x[:, 4] + 0.7 * higher, -3, 3)
        x = np.where(depth.min((1, 2))[:, None] > 0, moved, x)
    return x


def _ring_faces(n: int) -> NDArray[np.int32]:
    """Outward triangles between two rings of ``n`` corners, the lower first, both from the right to the left as seen
    from outside, and over their convex ends."""
    k = np.arange(n)
    following, fan = (k + 1) % n, np.arange(1, n - 1)
    first = np.zeros(n - 2, int)
    return np.concatenate([
        np.column_stack([k, following, n + following]),
        np.column_stack([k, n + following, n + k]),
        np.column_stack([first, fan + 1, fan]),
        np.column_stack([n + first, n + fan, n + fan + 1]),
    ]).astype(np.int32)  # fmt: skip


def fit_carved(seen: Outlined, floor: float) -> FittedShape | None:
    """The box of the mask's convex hull, cut by the cone of the mask, and by its mirror images: a chair, a table."""
    model = _BoxModel.of(replace(seen, mask=seen.convex), floor, equal=COMPACT, spare=SPARE)
    if model is None:
        return None
    box = model.corners(model.fitted()[None])[0]
    solid = carved(Solid(vertices=box, faces=BOX_FACES), seen.possible, seen.camera)
    if solid is None:
        return None
    fit = FittedShape.of("carved box", solid, seen)
    if seen.solidity < COMPACT_MASK:
        fit = _mirror_symmetric(fit, box, seen) or fit
    return replace(fit, solid=finer(fit.solid, float(np.ptp(box, axis=0).max()) / CUTS))


def _mirror_symmetric(fit: FittedShape, box: Array, seen: Outlined) -> FittedShape | None:
    """What a shape and its mirror image have in common, for the upright plane along a side of its ``box`` (8, 3) that
    leaves most of the mask; None where the best one loses more than ``SYMMETRY``.

    Branch and bound: what is in both shows only where both show, and drawing takes a hundredth of intersecting."""
    images = [mirrored(fit.solid, normal, offset) for normal, offset in _symmetry_planes(box)]
    shown = seen.silhouette(fit.solid.vertices, fit.solid.faces)
    most = [seen.most_overlap(shown & seen.silhouette(image.vertices, image.faces)) for image in images]
    best, least, best_k = None, fit.overlap - SYMMETRY, len(images)
    for k in sorted(range(len(images)), key=lambda k: -most[k]):
        if most[k] + ROUNDING < least:
            break
        solid = common(fit.solid, images[k])
        found = FittedShape.of(fit.family, solid, seen) if solid else None
        if found and (found.overlap, -k) >= (least, -best_k):  # of equal ones the first plane's
            best, least, best_k = found, found.overlap, k
    return best


def _symmetry_planes(box: Array) -> Iterator[tuple[Array, float]]:
    """Normals (3,) and offsets [m] of upright planes about the middle of a box (8, 3), along either pair of sides."""
    middle = box.mean(0)
    for axis in (box[1] - box[0], box[2] - box[0]):
        size, along = float(np.linalg.norm(axis)), math.atan2(axis[1], axis[0])
        for turn in TURNS:
            normal = np.array([math.cos(along + turn), math.sin(along + turn), 0.0])
            for shift in SHIFTS:
                yield normal, float(normal @ middle) + shift * size
