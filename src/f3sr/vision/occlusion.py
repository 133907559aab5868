"""Which objects may hide which, and where in the photo an object can be compared with its mask."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.depth_prior import sigma
from f3sr.vision.regions import grown, joined_to, nearest_in, opened
from f3sr.vision.silhouette import Mask, union_of

RESOLUTION = 384
"""Longer side [px] of the images that depths are compared in."""
ENOUGH = 20
"""Least number of common pixels at which rendered depths are compared there."""
UNSURE = 0.04
"""Median distance between two objects [size of the smaller] below which depths do not order them: poses are off by as
much. In 21 scenes only nested bowls come as near, in five pairs, of which depths ordered three wrongly. Nor do depths
order what is as near as the geometry errs, or as the two may be."""
SPREAD = (25, 75)
"""Percentiles of the factors from an object's depths to the geometry's between which its own may be. Of an object
that is off across the rays other surfaces are compared: of a bowl's rim its inside."""
LEAST_SHOWN = 1 / 3
"""Where two such objects both cover a pixel, the photo shows one of them. From this share of such pixels on, an object
may hide the other."""
BESIDE = 0.2
"""How far what may hide an object in part rises over the object's bottom, at least, as a share of the object's height:
a wall stands beside an object, a support below it, into which wrong poses are sunk by less."""

ROUNDING = 1e-6
"""Share of a depth that is rounding: geometries have single precision. Faces in one plane are at the same depth."""

BORDER = 3
"""Pixels of the geometry at the border of a mask whose depths may be mixed with its neighbour's."""
SEAM = 2
"""Pixels of the geometry, half the width up to which what no mask shows may be a seam between masks."""
ABOVE = 3.0
"""By how many standard deviations of the geometry a surface that no mask shows is before the ground, at least: nearer
ones may be the ground. Also without a mask of the ground, all occluders of four scenes were found so."""
GRAZING = np.radians(25)
"""Flattest angle [rad] at which a surface is seen: seen flatter, one that goes on looks like a step."""
NOWHERE = slice(0), slice(0)
"""A part of a picture without pixels."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Occluders:
    """What may hide an object: ``nearer`` objects, wherever they are seen, and others ``in_part``: in some pixels (h,
    w) of their masks, as the near wall of a bowl hides what is in it."""

    nearer: list[SceneObject]
    in_part: list[tuple[SceneObject, Mask]]

    def pixels(self, height: int, width: int) -> Mask:
        """The pixels (H, W) in which the object may be hidden."""
        hidden = union_of((p.mask for p in self.nearer), (height, width))
        for p, there in self.in_part:
            hidden |= p.mask & resample(there, width, height)
        return hidden


def nearer_objects(scene: Scene) -> dict[int, list[SceneObject]]:
    """Per object, those that may hide it as a whole (``occluders``)."""
    views = _views(scene)
    return {o.id: _nearer_than(views[o.id], views.values()) for o in scene}


def occluders(scene: Scene) -> dict[int, Occluders]:
    """Per object, what may hide it: by the rendered depths where two objects overlap in the picture, else by their
    median depths. Two that cannot be ordered may hide each other.

    Each object counts at the distance at which the photo's geometry sees its mask: generated poses are off by
    centimetres along the viewing rays. Nested bowls are millimetres apart. There the photo orders two objects: what is
    seen of more of the pixels that both cover is nearer. Without a geometry no object hides another in part: it may
    as well be sunk into it."""
    views, found = _views(scene), dict[int, Occluders]()
    for id, mine in views.items():
        nearer = _nearer_than(mine, views.values())
        known = {id, *(p.id for p in nearer)}
        farther = [other for k, other in views.items() if k not in known] if scene.geometry else []
        parts = ((other.object, _nearer_part(other, mine)) for other in farther)
        found[id] = Occluders(nearer=nearer, in_part=[(p, there) for p, there in parts if there is not None])
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class _DepthView:
    """An object with its depth image (h, w), inf where it is not, and its mask (h, w)."""

    object: SceneObject
    depth: Array
    mask: Mask
    error: float
    """Standard deviation of the geometry's depths as a share of them; 0 without a geometry."""
    room: tuple[float, float]
    """By which shares of its depth it may be nearer, and farther; 0 where the geometry tells nothing."""


def _views(scene: Scene) -> dict[int, _DepthView]:
    small = scene.camera.limited(RESOLUTION)
    seen, views = _seen_depths(scene, small), dict[int, _DepthView]()
    error = sigma(scene.geometry) if scene.geometry else 0.0
    for o in scene:
        mask = resample(o.mask, small.width, small.height)
        depth = rasterizer.render([o], small).depth
        k, room = _distance(mask, depth, seen)
        views[o.id] = _DepthView(object=o, depth=k * depth, mask=mask, error=error, room=room)
    return views


def _nearer_than(mine: _DepthView, views: Iterable[_DepthView]) -> list[SceneObject]:
    return [other.object for other in views if other is not mine and _is_nearer(other, mine)]


def _seen_depths(scene: Scene, camera: Camera) -> Array:
    """The geometry's depths (h, w) at a camera's resolution, NaN where there are none."""
    if scene.geometry is None:
        return np.full((camera.height, camera.width), np.nan)
    depths = np.where(scene.geometry.valid, scene.geometry.points[..., 2], np.nan)
    return resample(depths, camera.width, camera.height)


def _distance(mask: Mask, depth: Array, seen: Array) -> tuple[float, tuple[float, float]]:
    """The factor from an object's depths (h, w) to where the geometry's depths (h, w) see its mask (h, w), and by which
    shares of it it may be less or more; 1 and 0 where too little is seen."""
    both = mask & np.isfinite(depth) & np.isfinite(seen)
    if np.count_nonzero(both) <= ENOUGH:
        return 1.0, (0.0, 0.0)
    least, k, most = np.percentile(seen[both] / depth[both], (SPREAD[0], 50, SPREAD[1])).tolist()
    return k, (1 - least / k, most / k - 1)


def visible_region(o: SceneObject, nearer: Iterable[SceneObject]) -> Mask:
    """The pixels (H, W) where an object's silhouette must agree with its mask: not in a nearer object's mask."""
    return ~union_of((p.mask for p in nearer), o.mask.shape)


def comparable_region(o: SceneObject, hiding: Occluders, scene: Scene) -> Mask:
    """The pixels (H, W) where an object is compared with its mask: not those in which it may be hidden, nor what the
    photo's geometry shows before it."""
    valid = ~hiding.pixels(*o.mask.shape)
    if scene.geometry:
        valid &= ~behind_the_photo(o.mask, (p.mask for p in scene if p.id != o.id), scene.geometry, scene.camera)
    return valid


_FOUND: WeakKeyDictionary[Geometry, dict[tuple[object, ...], _Hidden]] = WeakKeyDictionary()
"""What was found in geometries that are in use: poses change, masks do not, and every pose is compared anew."""


def behind_the_photo(mask: Mask, others: Iterable[Mask], geometry: Geometry, camera: Camera) -> Mask:
    """The pixels (H, W) outside of an object's ``mask`` where the geometry shows a surface before it, as a bowl's wall
    before the fruit in it, or a hand that nobody outlined: there the object would be hidden. Its pose does not matter.
    The ground, z = 0 below the ``camera``, hides nothing. ``others`` are the masks of all other objects.

    Before it is what is nearer than the object's own nearest pixel by more than the geometry's error. Where an object
    stands on another, depth goes on without a step. A crate's wall, seen from above, begins with a step and gets deeper
    downwards. It is before the object as long as it is nearer across the ground.
    """
    masks = (mask, *others)
    found, key = _FOUND.setdefault(geometry, {}), (*map(id, masks), camera.T_world_camera[2].tobytes())
    if key not in found:
        found[key] = _Hidden.of(masks, geometry, camera)
    hidden = np.zeros(geometry.valid.shape, np.bool_)
    hidden[found[key].there] = found[key].pixels
    return resample(hidden, mask.shape[1], mask.shape[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Hidden:
    """The ``pixels`` of a part of the geometry where an object would be hidden, and the masks that tell it."""

    there: tuple[slice, slice]
    pixels: Mask
    masks: tuple[Mask, ...]
    """Held, so that no other mask gets the id of one of them."""

    @classmethod
    def of(cls, masks: tuple[Mask, ...], geometry: Geometry, camera: Camera) -> _Hidden:
        mine = geometry.inside(masks[0])
        sure = _inner(mine)
        if not sure.any():
            return cls(there=NOWHERE, pixels=np.zeros((0, 0), np.bool_), masks=masks)
        others = geometry.inside(union_of(masks[1:], masks[0].shape))
        bare = opened(_before_ground(geometry, camera) & ~mine & ~others, SEAM)
        rest, there = others | bare, around(mine)
        beside = _Beside.of(geometry, sure, there)
        pixels = rest[there] & beside.is_nearer()
        steps = np.zeros_like(mine)
        steps[there] = beside.begins(pixels & grown(mine[there], 2 * BORDER))
        if steps.any():
            hidden = np.zeros_like(mine)
            hidden[there] = pixels
            there = around(mine, widely=True)
            beside = _Beside.of(geometry, sure, there)
            walls = rest[there] & beside.is_nearer_across_ground(camera)
            pixels = hidden[there] | joined_to(steps[there], within=hidden[there] | walls)
        seeds = pixels & bare[there]
        if seeds.any():
            pixels |= joined_to(seeds, within=seeds | bare[there] & beside.may_stand_on_it(camera))
        return cls(there=there, pixels=pixels, masks=masks)


def _before_ground(geometry: Geometry, camera: Camera) -> Mask:
    """The pixels (h, w) of a geometry that show something before the ground z = 0."""
    up = camera.T_world_camera[2, :3].astype(np.float32)
    # A viewing ray meets the ground where it is as far below the camera as the ground is.
    below = -(np.where(geometry.valid[..., None], geometry.points, 0) @ up)
    return geometry.valid & (below < (1 - ABOVE * sigma(geometry)) * camera.center[2])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Beside:
    """A part of the geometry: ``points`` (h, w, 3), for each the nearest of the object's own with its row and column
    (h, w) in the part, and the standard deviation of depths as a share of them."""

    points: NDArray[np.float32]
    own: NDArray[np.float32]
    nearest: tuple[NDArray[np.int32], NDArray[np.int32]]
    noise: float

    @classmethod
    def of(cls, geometry: Geometry, sure: Mask, there: tuple[slice, slice]) -> _Beside:
        points, nearest = geometry.points[there], nearest_in(sure[there])
        return cls(points=points, own=points[nearest], nearest=nearest, noise=sigma(geometry))

    def is_nearer(self) -> Mask:
        return self.points[..., 2] < (1 - self.noise) * self.own[..., 2]

    def is_nearer_across_ground(self, camera: Camera) -> Mask:
        """Whether the horizontal distance from the camera is shorter."""
        up = camera.T_world_camera[2, :3].astype(np.float32)
        points, own = ((p * p).sum(-1) - (p @ up) ** 2 for p in (self.points, self.own))
        return points < (1 - self.noise) ** 2 * own

    def may_stand_on_it(self, camera: Camera) -> Mask:
        """Whether a surface is over the object in the picture, and not behind it."""
        rows, columns = np.indices(self.nearest[0].shape)
        down, right, up = rows - self.nearest[0], columns - self.nearest[1], camera.T_world_camera[2, :2]
        return (self.points[..., 2] < (1 + self.noise) * self.own[..., 2]) & (right * up[0] + down * up[1] > 0)

    def begins(self, some: Mask) -> Mask:
        """Which of some pixels are nearer than a surface would be that goes on from the object's own."""
        points, own = self.points[some], self.own[some]
        cosine = (points * own).sum(-1) / np.sqrt((points * points).sum(-1) * (own * own).sum(-1))
        room = np.sqrt(np.maximum(2 - 2 * cosine, 0)) / np.tan(GRAZING)
        found = np.zeros_like(some)
        found[some] = points[:, 2] < (1 - self.noise - room) * own[:, 2]
        return found


def _inner(mask: Mask) -> Mask:
    """A mask without its border, where depths mix; of a small object what lies farthest from it."""
    from scipy.ndimage import binary_erosion

    inner = mask
    for _ in range(BORDER):
        less = np.asarray(binary_erosion(inner), np.bool_)
        if not less.any():
            break
        inner = less
    return inner


def around(mask: Mask, *, widely: bool = False) -> tuple[slice, slice]:
    """Rows and columns of a mask's box, with as much again on every side; ``widely``: twice its longer side."""
    spans = [np.flatnonzero(mask.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)]
    sides = [1 + last - first for first, last in spans]
    room = [2 * max(sides)] * 2 if widely else sides
    rows, columns = (slice(max(0, first - r), last + r + 1) for (first, last), r in zip(spans, room, strict=True))
    return rows, columns


def _is_nearer(a: _DepthView, b: _DepthView) -> bool:
    """Whether an object lies in front of another; True when unsure."""
    both = _both(a, b)
    if np.count_nonzero(both) > ENOUGH:
        shown = _shown(a, b)
        return bool(np.median(a.depth[both] / b.depth[both]) < 1 - ROUNDING) if shown is None else shown > LEAST_SHOWN
    if not np.isfinite(a.depth).any() or not np.isfinite(b.depth).any():
        return True
    first, second = (float(np.median(v.depth[np.isfinite(v.depth)])) for v in (a, b))
    return first < (1 - ROUNDING) * second


def _both(a: _DepthView, b: _DepthView) -> Mask:
    """The pixels (h, w) that two objects cover."""
    return np.isfinite(a.depth) & np.isfinite(b.depth)


def _shown(a: _DepthView, b: _DepthView) -> float | None:
    """The share of the first of two objects in what the photo shows of them where both are; None where depths order
    them, and where both are, or it shows, too little."""
    both = _both(a, b)
    if np.count_nonzero(both) <= ENOUGH:
        return None
    apart, depth = float(np.median(b.depth[both] - a.depth[both])), float(np.median(a.depth[both]))
    front, back = (a, b) if apart > 0 else (b, a)
    near = max(UNSURE * min(a.object.size, b.object.size), depth * max(a.error, front.room[1] + back.room[0]))
    first, second = (np.count_nonzero(both & v.mask) for v in (a, b))
    if abs(apart) >= near or first + second <= ENOUGH:
        return None
    return float(first / (first + second))


def _nearer_part(a: _DepthView, b: _DepthView) -> Mask | None:
    """The pixels (h, w) in which an object that stands beside another is nearer than it, though farther elsewhere; None
    where these are few, and where the photo orders the two.

    A pixel that not both cover is like the nearest one that both do."""
    (bottom, top), rim = b.object.bounds_world[:, 2], a.object.bounds_world[1, 2]
    if rim - bottom < BESIDE * (top - bottom):
        return None
    both = _both(a, b)
    before = np.zeros_like(both)
    before[both] = a.depth[both] < (1 - ROUNDING) * b.depth[both]
    if np.count_nonzero(before) <= ENOUGH or _shown(a, b) is not None:
        return None
    return before[nearest_in(both)]
