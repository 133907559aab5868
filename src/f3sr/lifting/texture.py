"""Colours of lifted meshes: the photo where it shows the object, and its soft colours on what it does not show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from f3sr.background import from_patches
from f3sr.background.membrane import membrane
from f3sr.background.patchmatch import Picture
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Material, Mesh, area_vectors
from f3sr.core.transforms import UP, Array
from f3sr.lifting.round_texture import round_texture
from f3sr.lifting.solids import Solid
from f3sr.lifting.turned_texture import turned_texture
from f3sr.lifting.unshaded import SeenSolid
from f3sr.scene import Photo
from f3sr.vision.regions import distance_to, grown, interpolated, nearest_in, opened, shrunk, smooth_step, smoothed

LONGEST = 1024
"""Longer side of the photo's part of a texture [px]."""
FINER = 2.0
"""Texels per pixel of the photo at most: what draws the texture interpolates once more."""
LIMB = 0.03
"""Standard deviation of the blur where the photo shows a round side along the rays [longer side of the mask]."""
SHADED = 0.04
"""Width around what hides a part of a solid that it darkens or tints [longer side of the mask]."""
ERODED = 2
"""Width of the mask's border whose colours are mixed with what is behind [px]."""
GRAZING = math.cos(math.radians(78))
"""Least cosine between a face's normal and the ray to the camera for the photo to show it: else print smears."""
SOFT = 0.12
"""Standard deviation of the blur where the photo shows nothing [longer side of the mask]: no print is seen there."""
FINE = 5.0
"""Standard deviation of that blur in the pixels in which it is computed."""
FADED = 0.47
"""Cosine between a normal and the ray to the camera below which the photo goes over into its blurred copy."""
INSET = 0.004
"""Distance of texture coordinates from the border of their half: filters do not mix the two."""
FLATTENED = 0.05
"""Variance of places [blur's own] at which a slope of colours counts half: fewer places tell no slope."""
COVERED = 3
"""Half the width of what hides a part of a solid [px]: less is the error of an outline."""
UNUSUAL = 2.0
"""Distance of a colour from the median, over the median distance, at which it counts a quarter."""
ALIKE = 24
"""Side of the cells in which colours are counted [levels of 255]: shade and noise of one ink share a cell or two."""
TOP = 4
"""Number of a box's top among its sides; upright ones have smaller numbers."""
EMPTY = 1e-3
"""Least weight of known colours around a pixel from which its colour is made."""


def textured(solid: Solid, origin: Array, photo: Photo, mask: NDArray[np.bool_], camera: Camera) -> Mesh:
    """A solid about ``origin`` (3,), in world axes, its texture the photo inside the mask (H, W).

    The texture has two halves, both seen from the camera: the photo, and a blurred copy. Faces that the photo does not
    show look as those that are the same by a box's symmetry. Others look as what is before them in the photo. Along the
    rays, where that would smear, they look as the blurred copy. What is round has a texture of its own.
    What hides a part of the solid is replaced by patches of the part that is seen; else its colours go on softly beyond
    the mask."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    longest = max(len(rows), len(columns))
    pad = 2 + math.ceil(0.1 * longest)
    top, bottom = max(0, rows[0] - pad), min(photo.height, rows[-1] + 1 + pad)
    left, right = max(0, columns[0] - pad), min(photo.width, columns[-1] + 1 + pad)
    crop, known = photo.rgb[top:bottom, left:right], _own(mask[top:bottom, left:right])
    window = camera.cropped(left, top, right - left, bottom - top)
    sides = _sides(solid, window)
    rolls = solid.symmetry == "round" and not solid.stands_flat
    hidden = _hidden(sides >= 0, mask[top:bottom, left:right])
    sharp = _continued(crop, known, hidden, sides, printed=not rolls)
    soft = _shaded(crop, _usual(crop, known) if rolls else known.astype(float), SOFT * longest, level=rolls)
    if solid.symmetry == "round":
        if rolls:
            limb = _shaded(sharp, (known | hidden).astype(float), LIMB * longest, level=True)
            worn = round_texture(solid, sharp, limb, soft, window)
        else:
            worn = turned_texture(solid, sharp, soft, window)
        return replace(worn, vertices=worn.vertices - origin)
    if solid.symmetry != "box":  # no edge where round sides turn away and the photo ends
        facing = SeenSolid.of(solid, mask, camera).facing
        beside = (rows[0] - top, bottom - rows[-1] - 1), (columns[0] - left, right - columns[-1] - 1)
        share = smooth_step(np.pad(facing, beside, mode="edge") / FADED)[..., None]
        sharp = soft + share * (sharp - soft)
    image = Image.fromarray(np.concatenate([sharp, soft], axis=1).astype(np.uint8))
    scale = min(FINER, LONGEST / max(right - left, bottom - top))
    filtered = Image.Resampling.BICUBIC if scale > 1 else Image.Resampling.BOX
    image = image.resize((round(image.width * scale), round(image.height * scale)), filtered)
    vertices, faces, looks, is_soft = _split(solid, camera)
    pixels, _ = camera.project(looks)
    uv = np.clip((pixels - [left, top]) / [right - left, bottom - top], INSET, 1 - INSET)
    return Mesh(
        vertices=vertices - origin,
        faces=faces,
        uv=np.column_stack([(uv[:, 0] + is_soft) / 2, 1 - uv[:, 1]]),
        materials=(Material(texture=np.asarray(image)),),
        pieces=tuple(ConvexPart.hull_of(corners - origin) for corners in solid.pieces),
    )


def _sides(solid: Solid, window: Camera) -> NDArray[np.int64]:
    """Which side of a box (h, w) is seen in a ``window`` of the photo, -1 beyond the solid; 0 on what is no box."""
    face = solid.drawn(window).face
    if solid.symmetry != "box":
        return np.where(face >= 0, 0, -1)
    x, y, z = area_vectors(solid.symmetric[solid.faces]).T
    quarter = np.round((np.arctan2(y, x) - _yaw(solid.symmetric, solid.faces)) / (np.pi / 2)).astype(int) % 4
    side = np.where(np.abs(z) > np.hypot(x, y), TOP + (z < 0), quarter)
    return np.where(face >= 0, side[np.maximum(face, 0)], -1)


def _hidden(shape: NDArray[np.bool_], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What the mask (h, w) lacks of the solid's silhouette (h, w); nothing where that is only the error of an
    outline."""
    beyond = shape & ~mask
    return beyond & opened(beyond, COVERED).any()


def _continued(
    crop: NDArray[np.uint8],
    known: NDArray[np.bool_],
    hidden: NDArray[np.bool_],
    sides: NDArray[np.int64],
    *,
    printed: bool,
) -> Picture:
    """The ``known`` colours (h, w, 3), where they are ``hidden`` patches of them, each of the same of the ``sides``
    (h, w), and softly on around both. Of a side that is hidden for the most part patches would be the same few again
    and again: it has its commonest colour, as has what is not ``printed`` all over: a ball has its print once."""
    if hidden.any():
        longest = max(np.ptp(np.argwhere(known), axis=0))
        whole, hole = known | grown(hidden, ERODED + 1), grown(hidden, max(ERODED + 1, round(SHADED * longest)))
        side_of, told = sides[nearest_in(sides >= 0)], known & ~hole
        for side in np.unique(side_of[hole & whole]):
            here = whole & (side_of == side)
            lost, own = hole & here, told & here
            # A side of which nothing is told has the colour of the others that are as upright.
            alike = own if own.any() else told & ((side_of < TOP) == (side < TOP))
            if not alike.any():
                continue
            patched = from_patches(crop, lost, apart=~here) if printed and lost.sum() <= own.sum() else None
            crop = _plain(crop, lost, alike, SOFT * longest) if patched is None else patched
            known = known | here
    return membrane((crop * known[..., None]).astype(np.float32), known)


def _plain(
    crop: NDArray[np.uint8], hole: NDArray[np.bool_], known: NDArray[np.bool_], reach: float
) -> NDArray[np.uint8]:
    """A picture (h, w, 3) with the usual colour of what is ``known`` (h, w) in a ``hole`` (h, w), into which colours
    around it go over within a ``reach`` [px]."""
    around = membrane((crop * known[..., None]).astype(np.float32), known)
    share = np.exp(-distance_to(known) / reach)[..., None]
    usual = _commonest(crop[known])
    return np.where(hole[..., None], np.rint(usual + share * (around - usual)), crop).astype(np.uint8)


def _commonest(colours: NDArray[np.uint8]) -> Array:
    """The colour (3,) that most of some (n, 3) are near to: a median of two inks would be neither."""
    cells, cell, count = np.unique(colours // ALIKE, axis=0, return_inverse=True, return_counts=True)
    near = np.abs(cells.astype(int) - cells[count.argmax()]).max(1) <= 1
    return np.asarray(colours[near[cell.ravel()]].mean(0), float)


def _own(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask (h, w) without its border; all of one that is hardly more than a border."""
    inner = shrunk(mask, ERODED)
    return inner if inner.sum() > 0.5 * mask.sum() else mask


def _usual(image: NDArray[np.uint8], known: NDArray[np.bool_]) -> Array:
    """Weights (h, w) of the ``known`` colours: what is far from their median is print or a leaf, which the other side
    need not have (Cauchy weights)."""
    colours = image[known].astype(float)
    off = np.linalg.norm(colours - np.median(colours, axis=0), axis=1)
    weights = np.zeros(known.shape)
    weights[known] = 1 / (1 + (off / (UNUSUAL * max(float(np.median(off)), 1.0))) ** 2) ** 2
    return weights


def _shaded(image: Picture | NDArray[np.uint8], weights: Array, sigma: float, *, level: bool) -> Array:
    """Planes fitted to colours with ``weights`` (h, w) under a Gaussian [px], at every pixel (h, w, 3): a mean alone
    would be brighter than a border in shadow, as all it averages lies inside (normalized convolution of first order,
    Farneback 2002). ``level``: means all the same, of what has no side in shadow."""
    k = max(1, int(sigma / FINE))
    weight, colours = (
        _reduced(weights[..., None], k)[..., 0],
        _reduced(weights[..., None] * image, k),
    )
    rows, columns = (np.indices(weight.shape) + 0.5) * k / sigma
    basis = np.stack([np.ones(weight.shape), columns, rows], axis=-1)
    second, first = np.empty((*weight.shape, 3, 3)), np.empty((*weight.shape, 3, 3))
    for i, j in np.ndindex(3, 3):
        first[..., i, j] = smoothed(basis[..., i] * colours[..., j], sigma / k)
        if j >= i:
            second[..., i, j] = second[..., j, i] = smoothed(basis[..., i] * basis[..., j] * weight, sigma / k)
    here = np.tile(np.eye(3), (*weight.shape, 1, 1))  # about the pixel itself: the plane's value there is its constant
    here[..., 1, 0], here[..., 2, 0] = -columns, -rows
    second, first = here @ second @ np.swapaxes(here, -1, -2), here @ first
    flat = (1 / EMPTY if level else FLATTENED) * np.maximum(second[..., 0, 0], EMPTY)
    second += flat[..., None, None] * np.diag([0.0, 1.0, 1.0])
    second[..., 0, 0] += 1e-9
    soft = np.linalg.solve(second, first)[..., 0, :]
    y, x = (np.indices(weights.shape).reshape(2, -1) + 0.5) / k
    at = np.column_stack([x, y])
    whole = np.stack([interpolated(soft[..., c], at).reshape(weights.shape) for c in range(3)], axis=-1)
    return np.asarray(np.clip(whole, *np.quantile(image[weights > 0], [0.01, 0.99], axis=0)), float)


def _reduced(image: Array, k: int) -> Array:
    """Means over squares of ``k`` pixels of an image (h, w, c), which is 0 beyond its border."""
    h, w = (-(-n // k) for n in image.shape[:2])
    padded = np.pad(image, ((0, h * k - image.shape[0]), (0, w * k - image.shape[1]), (0, 0)))
    return np.asarray(padded.reshape(h, k, w, k, -1).mean((1, 3)), float)


@dataclass(frozen=True, eq=False)
class _Likeness:
    """Points (n, 3) of a surface that look as its vertices do; ``flips``: its faces are turned over there."""

    points: Array
    flips: bool = False

    def facing(self, faces: NDArray[np.int32], camera: Camera) -> Array:
        """Cosine (m,) between the normals of the faces there and the rays to the camera."""
        corners = self.points[faces]
        normals, towards = area_vectors(corners), camera.center - corners.mean(1)
        lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(towards, axis=1)
        return (-1 if self.flips else 1) * (normals * towards).sum(1) / np.maximum(lengths, 1e-30)


def _split(solid: Solid, camera: Camera) -> tuple[Array, NDArray[np.int32], Array, NDArray[np.bool_]]:
    """Vertices (n, 3), faces (m, 3), the points (n, 3) as which they look, and whether each (n,) is blurred: vertices
    between faces of different looks are there twice."""
    behind = _Likeness(solid.vertices, flips=True)
    likenesses = [_Likeness(solid.vertices), *_by_symmetry(solid), behind]
    chosen = np.full(len(solid.faces), len(likenesses))
    for k in reversed(range(len(likenesses))):
        chosen[likenesses[k].facing(solid.faces, camera) >= GRAZING] = k
    kinds = len(likenesses) + 1
    places, faces = np.unique(kinds * solid.faces.astype(np.int64) + chosen[:, None], return_inverse=True)
    vertex, kind = places // kinds, places % kinds
    looks = np.stack([*(likeness.points for likeness in likenesses), solid.vertices])[kind, vertex]
    return solid.vertices[vertex], faces.reshape(-1, 3).astype(np.int32), looks, kind == kinds - 1


def _by_symmetry(solid: Solid) -> Iterator[_Likeness]:
    """Other places of a box that look as its vertices: its back as its front turned about the vertical, where no side
    is seen as its front a quarter round, and its underside as its top."""
    if solid.symmetry == "box":
        form = solid.symmetric
        across = form.min(0) + form.max(0) - 2 * form
        yield _Likeness(_on_surface(solid, form + across * [1, 1, 0]))
        yield from (_Likeness(_on_surface(solid, points)) for points in _quarter_turns(form, solid.faces))
        yield _Likeness(_on_surface(solid, form + across * UP), flips=True)


def _quarter_turns(form: Array, faces: NDArray[np.int32]) -> Iterator[Array]:
    """Vertices (n, 3) of an upright box a quarter about the vertical, either way, stretched to its other side."""
    yaw = _yaw(form, faces)
    axes = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    flat = form[:, :2] @ axes.T
    middle, size = (flat.min(0) + flat.max(0)) / 2, np.ptp(flat, axis=0)
    share = (flat - middle) / size
    for way in (1, -1):
        turned = middle + np.column_stack([-way * share[:, 1], way * share[:, 0]]) * size
        yield np.column_stack([turned @ axes, form[:, 2]])


def _yaw(form: Array, faces: NDArray[np.int32]) -> float:
    """Angle of an upright box (n, 3) about the vertical, up to quarter turns [rad]."""
    doubled = (area_vectors(form[faces])[:, :2] @ [1, 1j]) ** 2  # sides a quarter round are opposite, then alike
    return float(np.angle((doubled**2).sum())) / 4


def _on_surface(solid: Solid, points: Array) -> Array:
    """Points (n, 3) of a solid's symmetric form, moved as its nearest vertex."""
    from scipy.spatial import KDTree

    if solid.form is None:
        return points
    nearest = KDTree(solid.form).query(points)[1]
    return points + (solid.vertices - solid.form)[nearest]
