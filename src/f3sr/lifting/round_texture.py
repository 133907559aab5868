"""Textures of balls and fruit: what is round has no face that the photo shows as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from f3sr.background.patchmatch import Picture
from f3sr.core.camera import Camera
from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array
from f3sr.lifting.solids import Solid
from f3sr.vision.regions import interpolated, smooth_step

if TYPE_CHECKING:
    from scipy.spatial import KDTree

CAP, LIMB, BACK = np.radians([55, 80, 100])
"""Angles from the camera up to which a texture is the photo, then the photo a little blurred, then goes over into what
is invented. Print is along the rays at the limb."""
INVENTED = 0.2
"""Share of print that is left where the photo shows none: it tells that a thing is not smooth, but blotches of light
and shade that the photo has on one side would be none on another."""
LEVELS = 1.0
"""Least size of a detail [of 255 levels]: below it is rounding."""
FINE = 4.0
"""Size of details, in the median of the seen ones, that is halved where the photo shows none: grain goes on, the edge
of a leaf does not."""
EXTENT = math.radians(120)
"""Angle from its middle that each half of a texture covers: faces across the border are whole in both."""
NEIGHBOURS = 4
"""Vertices between which a point of the surface is interpolated."""
COARSE = 96
"""Side of the grid on which places in the photo are computed; between they are interpolated [texels]."""
DENSITY = 4
"""Texels of each half, over the longer side of the photo's part: two per pixel where it faces the camera."""
LARGEST = 1024
"""Side of each half at most [px]."""


def round_texture(solid: Solid, sharp: Picture, limb: Array, soft: Array, window: Camera) -> Mesh:
    """A solid in the world that is star-shaped about its middle, in the ``window`` that shows it. Its colours (h, w, 3)
    are a part of the photo: as it is, a little blurred, and blurred without print.

    The picture has two halves: what the camera sees, and the other. Vertices on their border are there twice.

    Colours are those of the pixel on whose ray a point lies, before it or behind. Print around the point nearest to the
    camera goes on over the other side in a mirror, larger and faint, with its grain. So there is no seam."""
    surface = _StarShaped.of(solid, window)
    n = min(LARGEST, max(COARSE, DENSITY * max(sharp.shape[:2])))
    invented = INVENTED * (limb - soft) + _grain(sharp - limb)
    halves = [_half(surface, (sharp, limb, soft, invented), window, n, back=back) for back in (False, True)]
    angles = surface.angles(surface.directions)
    backward = np.cos(angles)[solid.faces].mean(1) < 0
    places, faces = np.unique(2 * solid.faces.astype(np.int64) + backward[:, None], return_inverse=True)
    vertex, half = places // 2, places % 2
    across = surface.across(surface.directions[vertex])
    radius = np.where(half == 1, np.pi - angles[vertex], angles[vertex]) / EXTENT
    uv = (1 + radius[:, None] * across) / 2
    picture = np.rint(np.concatenate(halves, axis=1)).astype(np.uint8)
    return Mesh(
        vertices=solid.vertices[vertex],
        faces=faces.reshape(-1, 3).astype(np.int32),
        uv=np.column_stack([(uv[:, 0] + half) / 2, 1 - uv[:, 1]]),
        materials=(Material(texture=picture),),
    )


def _half(
    surface: _StarShaped, photo: tuple[Picture, Array, Array, Array], window: Camera, n: int, *, back: bool
) -> Picture:
    """One half (n, n, 3): azimuthal equidistant about the point nearest to the camera, or about that opposite."""
    places = np.linspace(-1, 1, COARSE)
    x, y = np.meshgrid(places, places)
    angle = np.minimum(np.hypot(x, y) * EXTENT, np.pi)
    angle = np.pi - angle if back else angle
    turn = np.arctan2(y, x)
    own, _ = window.project(surface.points(surface.turned(angle, turn)))
    nearer = np.where(angle > CAP, CAP * (np.pi - angle) / (np.pi - CAP), angle)
    print_at, _ = window.project(surface.points(surface.turned(nearer, turn)))
    rows, columns = np.meshgrid(*2 * [(np.arange(n) + 0.5) * COARSE / n], indexing="ij")
    at = np.column_stack([columns.ravel(), rows.ravel()])

    def fine(pixels: Array) -> Array:
        return np.column_stack([interpolated(pixels[:, k].reshape(COARSE, COARSE), at) for k in (0, 1)])

    own, print_at, angle = fine(own), fine(print_at), interpolated(angle, at)
    blurred = smooth_step((angle - CAP) / (LIMB - CAP))
    unseen = smooth_step((angle - LIMB) / (BACK - LIMB))
    channels = list[Array]()
    for k in range(3):
        sharp, limb, soft, invented = (image[..., k] for image in photo)
        seen = (1 - blurred) * interpolated(sharp, own, cubic=True) + blurred * interpolated(limb, own)
        behind = interpolated(soft, own) + interpolated(invented, print_at, cubic=True)
        channels.append((1 - unseen) * seen + unseen * behind)
    return np.clip(np.stack(channels, axis=-1), 0, 255).astype(np.float32).reshape(n, n, 3)


def _grain(details: Array) -> Array:
    """Details (h, w, 3) without those that stand out (Cauchy weights)."""
    size = np.linalg.norm(details, axis=2, keepdims=True)
    usual = float(np.median(np.append(size[size > LEVELS], LEVELS)))
    return np.asarray(details / (1 + (size / (FINE * usual)) ** 2), float)


@dataclass(frozen=True, eq=False)
class _StarShaped:
    """A surface of which every ray from the ``middle`` (3,) meets one point: unit ``directions`` (n, 3), distances
    ``radii`` (n,) [m]. The rows of ``axes`` (3, 3) are to the right, down, as the camera sees it, and towards it."""

    middle: Array
    directions: Array
    radii: Array
    axes: Array

    @classmethod
    def of(cls, solid: Solid, camera: Camera) -> _StarShaped:
        middle = (solid.vertices.min(0) + solid.vertices.max(0)) / 2
        off = solid.vertices - middle
        radii = np.maximum(np.linalg.norm(off, axis=1), 1e-12)
        towards = (camera.center - middle) / np.linalg.norm(camera.center - middle)
        down = camera.T_world_camera[:3, 1] - (camera.T_world_camera[:3, 1] @ towards) * towards
        down /= np.linalg.norm(down)
        return cls(middle, off / radii[:, None], radii, np.stack([np.cross(towards, down), down, towards]))

    @cached_property
    def _tree(self) -> KDTree:
        from scipy.spatial import KDTree

        return KDTree(self.directions)

    def angles(self, directions: Array) -> Array:
        """From the ray to the camera (n,) [rad]."""
        return np.arccos(np.clip(directions @ self.axes[2], -1, 1))

    def across(self, directions: Array) -> Array:
        """Unit vectors (n, 2) to the right and down, as the camera sees directions (n, 3)."""
        flat = directions @ self.axes[:2].T
        return flat / np.maximum(np.linalg.norm(flat, axis=1), 1e-12)[:, None]

    def turned(self, angle: Array, turn: Array) -> Array:
        """Directions (n, 3) at an angle from the ray to the camera, in a ``turn`` about it [rad]."""
        local = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=-1)
        return local.reshape(-1, 3) @ self.axes

    def points(self, directions: Array) -> Array:
        """Points (n, 3) of the surface in unit directions (n, 3)."""
        distances, nearest = self._tree.query(directions, k=NEIGHBOURS)
        weights = 1 / np.maximum(distances, 1e-9)
        reach = (weights * self.radii[nearest]).sum(1) / weights.sum(1)
        return self.middle + reach[:, None] * directions
