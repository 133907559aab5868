"""Textures of cans, jars and bottles: the side unrolled, and its two ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from f3sr.background.membrane import membrane
from f3sr.background.patchmatch import Picture
from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Material, Mesh, area_vectors
from f3sr.core.transforms import Array
from f3sr.lifting.solids import Solid
from f3sr.vision import rasterizer
from f3sr.vision.regions import interpolated, nearest_in, smoothed

LEVEL = math.cos(math.radians(45))
"""Least vertical part of a face's unit normal for it to belong to an end."""
SHOWN, END_SHOWN = math.cos(math.radians(70)), math.cos(math.radians(85))
"""Least cosine between a normal and the ray to the camera for the photo to show the side's print, and the upper end:
that is there once, and smeared it is still nearer to what the photo shows than a plain one."""
LEAST = math.radians(50)
"""Least angle of the side that the photo shows for its print to go on around it."""
OVERLAP = 0.08
"""Width of the band in which a copy's seam is sought, over what the photo shows."""
DENSITY = 2.0
"""Texels per pixel of the photo, where the side faces the camera."""
LARGEST = 1024
"""Longer side of the picture at most, but for what goes beyond the cut [px]."""
GAP = 2
"""Texels around each part: filters do not mix them."""
OCCLUDED = 0.03
"""Distance behind what the camera sees from which on a point is hidden [largest side of the solid]."""
WIDE = 0.6
"""Least radius of the upper end, over the lower one's, for both to look alike: else the upper one is a neck."""
SIDE, UPPER, LOWER = range(3)


def turned_texture(solid: Solid, sharp: Picture, soft: Array, window: Camera) -> Mesh:
    """A solid of revolution that stands flat, in the world, from a part of the photo (h, w, 3), as it is and blurred,
    in the ``window`` that shows it.

    What the photo shows of the side goes on around it: copies of it are laid side by side, none a mirror image, along
    seams where they differ least (image quilting, Efros & Freeman 2001). The lower end has the rings of the upper one,
    without what is in them."""
    unrolled = _Unrolled.of(solid, window)
    height, width = unrolled.shape
    pixels, facing = unrolled.shown(window)
    colours, blurred = (
        np.stack([interpolated(image[..., k], pixels, cubic=True).reshape(height, width) for k in range(3)], axis=-1)
        for image in (sharp, soft)
    )
    picture = np.zeros((height, width, 3))
    side, upper, lower = unrolled.parts
    picture[side] = strip = _around(colours[side], blurred[side], facing[side] >= SHOWN, unrolled.columns)
    picture[upper], known = _upper(colours[upper], facing[upper] >= END_SHOWN, strip[0].mean(0))
    alike = known and unrolled.radii[0] >= WIDE * unrolled.radii[1]
    picture[lower] = _ringed(picture[upper], lower) if alike else strip[-1].mean(0)
    return Mesh(
        vertices=solid.vertices[unrolled.vertex],
        faces=unrolled.faces,
        uv=unrolled.places / [width, height] * [1, -1] + [0, 1],
        materials=(Material(texture=np.rint(np.clip(picture, 0, 255)).astype(np.uint8)),),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Unrolled:
    """A solid of revolution cut open at its back: vertices on cuts are there twice. ``vertex`` (m,) are those of the
    ``solid``, ``faces`` (k, 3) in their order, ``places`` (m, 2) in the picture [texel]."""

    solid: Solid
    vertex: NDArray[np.int64]
    faces: NDArray[np.int32]
    places: Array
    shape: tuple[int, int]
    parts: tuple[tuple[slice, slice], ...]
    """Rows and columns of the side, the upper and the lower end."""
    columns: int
    """Texels around the side: those after them are the first ones again."""
    radii: tuple[float, float]
    """Of the upper and the lower end [m]."""

    @classmethod
    def of(cls, solid: Solid, camera: Camera) -> _Unrolled:
        form, faces = solid.symmetric, solid.faces
        middle = (form.min(0) + form.max(0)) / 2
        towards = camera.center - middle
        front = towards[:2] / max(float(np.linalg.norm(towards[:2])), 1e-12)
        across = (form - middle)[:, :2] @ np.array([[-front[1], front[0]], front]).T  # aside, and to the camera
        depth = (form[:, 2].max() - form[:, 2])[faces]
        part, angle = _part_of(form, faces), _angles(across, faces)
        reach = [float(np.hypot(*across[faces[part == k]].T).max(initial=1e-9)) for k in range(3)]
        tall, around, widest = float(depth.max()), 2 * np.pi * reach[SIDE], max(reach[1:])
        pixel = float(np.linalg.norm(towards)) / float(camera.K[0, 0])
        texel = max(pixel / DENSITY, around / LARGEST, (tall + 2 * widest) / LARGEST)

        columns, rows = max(16, math.ceil(around / texel)), max(4, math.ceil(tall / texel))
        beyond = math.ceil(max(0.0, float(angle.max()) - 2 * np.pi) * columns / (2 * np.pi)) + GAP
        upper, lower = (max(4, math.ceil(2 * r / texel)) for r in reach[1:])
        below = rows + GAP
        parts = (
            (slice(0, rows), slice(0, columns + beyond)),
            (slice(below, below + upper), slice(0, upper)),
            (slice(below, below + lower), slice(upper + GAP, upper + GAP + lower)),
        )
        places = np.stack([angle / (2 * np.pi) * columns, depth / max(tall, 1e-12) * rows], axis=-1)
        for k in (UPPER, LOWER):
            (high, left), size = (s.start for s in parts[k]), parts[k][0].stop - parts[k][0].start
            disc = (across[faces] / reach[k] + 1) / 2 * size + np.array([left, high])
            places = np.where((part == k)[:, None, None], disc, places)
        corners = np.column_stack([faces.ravel(), np.repeat(part, 3), np.rint(64 * places.reshape(-1, 2))])
        _, first, index = np.unique(corners.astype(np.int64), axis=0, return_index=True, return_inverse=True)
        return cls(
            solid=solid,
            vertex=faces.ravel()[first].astype(np.int64),
            faces=index.reshape(-1, 3).astype(np.int32),
            places=places.reshape(-1, 2)[first],
            shape=(below + max(upper, lower), max(columns + beyond, upper + GAP + lower)),
            parts=parts,
            columns=columns,
            radii=(reach[UPPER], reach[LOWER]),
        )

    def _surface(self) -> tuple[Array, Array]:
        """Points (h, w, 3) of the surface at every texel, and unit normals; between parts those of the nearest."""
        h, w = self.shape
        flat = np.column_stack([self.places, np.ones(len(self.places))])
        drawn = rasterizer.rasterize(flat, self.faces, np.zeros(len(self.faces), np.int32), np.eye(3), w, h)
        nearest = nearest_in(drawn.face >= 0)
        face, bary = drawn.face[nearest], drawn.bary[nearest]
        corners = corner_normals(Mesh(vertices=self.solid.vertices, faces=self.solid.faces))
        points = np.einsum("hwk,hwkc->hwc", bary, self.solid.vertices[self.solid.faces][face])
        normals = np.einsum("hwk,hwkc->hwc", bary, corners[face], dtype=float)
        return points, normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)

    def shown(self, window: Camera) -> tuple[Array, Array]:
        """Pixels (h w, 2) of a part of the photo that show the texels, and the cosine (h, w) between the normal there
        and the ray to the camera; -1 where the solid itself is before it."""
        points, normals = self._surface()
        flat = points.reshape(-1, 3)
        pixels, depth = window.project(flat)
        towards = window.center - points
        facing = (normals * towards).sum(2) / np.linalg.norm(towards, axis=2)
        solid = self.solid
        drawn = solid.drawn(window)
        before = np.where(drawn.face >= 0, drawn.depth, np.inf)
        x, y = (np.clip(pixels[:, k].astype(int), 0, n - 1) for k, n in ((0, window.width), (1, window.height)))
        size = float(np.ptp(solid.vertices, axis=0).max())
        hidden = (depth > before[y, x] + OCCLUDED * size).reshape(self.shape)
        return pixels, np.where(hidden, -1.0, facing)


def _part_of(form: Array, faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """The part (m,) that every face belongs to."""
    normals = area_vectors(form[faces])
    steep = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)
    return np.where(steep > LEVEL, UPPER, np.where(steep < -LEVEL, LOWER, SIDE))


def _angles(across: Array, faces: NDArray[np.int32]) -> Array:
    """Angles (m, 3) of the faces' corners about the axis, from the back [rad]: pi is the front, and faces that reach
    over the back go beyond 2 pi. ``across`` (n, 2) are aside, and to the camera. The axis has its neighbours' mean."""
    angle = (np.arctan2(*across.T) + np.pi)[faces]
    angle = np.where((np.ptp(angle, axis=1) > np.pi)[:, None] & (angle < np.pi), angle + 2 * np.pi, angle)
    radius = np.hypot(*across.T)[faces]
    off_axis = radius > 1e-6 * radius.max()
    mean = (angle * off_axis).sum(1, keepdims=True) / np.maximum(1, off_axis.sum(1, keepdims=True))
    return np.where(off_axis, angle, mean)


def _around(colours: Array, blurred: Array, shown: NDArray[np.bool_], columns: int) -> Array:
    """The side (h, w, 3), of which the photo shows some; ``columns`` texels go once around."""
    seen = shown[:, :columns].mean(0) >= 0.5
    front = columns // 2
    right = front + int(np.argmin(np.append(seen[front:], False)))
    left = front - int(np.argmin(np.append(seen[:front][::-1], False)))
    if (right - left) * 2 * np.pi < LEAST * columns:
        return blurred
    made = np.roll(quilted(colours[:, left:right], columns), left, axis=1)
    return made[:, np.arange(colours.shape[1]) % columns]


def quilted(known: Array, columns: int) -> Array:
    """A picture (h, columns, 3) without a border at its sides that begins with the ``known`` one (h, w, 3); copies of
    its middle follow it. Neighbours overlap, and the seam between them runs where they differ least.

    Where a seam differs more than columns do in the mean, as on a thing with two halves, a mirror image follows."""
    length = known.shape[1]
    if length >= columns:
        return known[:, :columns]
    overlap = max(1, round(OVERLAP * length))
    copies = math.ceil((columns - length + overlap) / max(1, length - overlap))
    width = math.ceil((columns - length + (copies + 1) * overlap) / copies)
    middle = (length - width) // 2
    copy = known[:, middle : middle + width]
    made = np.zeros((len(known), columns + overlap, 3))
    made[:, :length] = known
    starts = np.rint(np.linspace(length - overlap, columns + overlap - width, copies)).astype(int)
    end, errors = length, list[float]()

    def join(at: slice, left: Array, right: Array) -> None:
        made[:, at], error = _joined(left, right)
        errors.append(error)

    for start in starts:
        both = end - start
        join(slice(start, end), made[:, start:end], copy[:, :both])
        made[:, end : start + width] = copy[:, both:]
        end = start + width
    join(slice(0, overlap), made[:, columns:end], known[:, :overlap])
    if max(errors) <= 2 * float(known.var(1).sum(1).mean()):
        return made[:, :columns]
    back = np.linspace(length - 1, 0, columns - length).round().astype(int)
    return np.concatenate([known, known[:, back]], axis=1)


def _joined(left: Array, right: Array) -> tuple[Array, float]:
    """Two pictures (h, w, 3) of one place, the one left of a seam and the other right of it, and the mean square by
    which they differ there."""
    error = ((left - right) ** 2).sum(2)
    cost = error.copy()
    for row in range(1, len(cost)):
        above = np.pad(cost[row - 1], 1, constant_values=np.inf)
        cost[row] += np.minimum(np.minimum(above[:-2], above[1:-1]), above[2:])
    seam = np.empty(len(cost), int)
    seam[-1] = int(np.argmin(cost[-1]))
    for row in range(len(cost) - 2, -1, -1):
        low = max(0, seam[row + 1] - 1)
        seam[row] = low + int(np.argmin(cost[row, low : seam[row + 1] + 2]))
    share = smoothed(np.arange(error.shape[1]) >= seam[:, None], 1.0)[..., None]
    return (1 - share) * left + share * right, float(cost[-1].min()) / len(cost)


def _upper(colours: Array, shown: NDArray[np.bool_], plain: Array) -> tuple[Array, bool]:
    """The upper end (h, w, 3), and whether the photo shows it: else it is ``plain``."""
    if shown.mean() < 0.5:
        return np.broadcast_to(plain, colours.shape), False
    return np.asarray(membrane((colours * shown[..., None]).astype(np.float32), shown), float), True


def _ringed(disc: Array, size: tuple[slice, slice]) -> Array:
    """A disc of another ``size`` with the mean colours of a disc's (n, n, 3) rings."""
    n, m = len(disc), size[0].stop - size[0].start

    def radii(k: int) -> Array:
        off = (np.arange(k) + 0.5) * 2 / k - 1
        return np.asarray(np.hypot(off[:, None], off))

    rings = np.minimum((radii(n) * n / 2).astype(int), n // 2)
    counts = np.maximum(np.bincount(rings.ravel(), minlength=n // 2 + 1), 1)
    means = np.stack([np.bincount(rings.ravel(), disc[..., k].ravel()) / counts for k in range(3)], axis=-1)
    inside = means[: n // 2]
    at = radii(m) * n / 2 - 0.5
    return np.stack([np.interp(at, np.arange(len(inside)), inside[:, k]) for k in range(3)], axis=-1)
