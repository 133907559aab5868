"""The built-in AssetGenerator: for every mask the family of shapes that explains it best, on its support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import GeneratedAsset, PromptedImage
from f3sr.background import BackgroundConfig, complete_background, widened
from f3sr.background.support import support_behind
from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose
from f3sr.lifting.choice import Choice, carries, choose
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.texture import textured
from f3sr.lifting.unshaded import PhotoLight, SeenSolid, light_of
from f3sr.scene import GROUND, Geometry, Instance, Photo
from f3sr.vision.ground_camera import camera_over_ground
from f3sr.vision.image_supports import below
from f3sr.vision.occlusion import behind_the_photo
from f3sr.vision.regions import without_strays
from f3sr.vision.silhouette import union_of

FAR = 2.5
"""Distance of a hanging thing [camera heights] where nothing else is seen."""

GAP = 0.02
"""Width of a gap in a mask, as a share of its diagonal, that thin parts leave where a threshold breaks them."""
STRAY = 0.1
"""Most of a mask that a piece apart from the rest holds if it is a flaw: larger ones are seen behind something that has
no mask."""


@dataclass(frozen=True, eq=False)
class LiftedAssets:
    """Meshes from masks, the photo and the ground alone; no network."""

    choices: dict[int, Choice] = field(default_factory=dict[int, Choice])
    """What was chosen for every object of the last photo, by id."""

    def generate(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, GeneratedAsset]:
        """A closed, textured mesh per instance, upright on the ground or on the object below it. ``K`` (3, 3) [px]."""
        camera = camera_over_ground(image, geometry, K)
        self.choices.clear()
        masks = {i.id: i.mask for i in image.instances}
        masked, under = union_of(masks.values(), image.photo.rgb.shape[:2]), below(masks)
        shown = dict[int, SeenSolid]()
        for instance in _from_below(image.instances, under):
            whole = _without_strays(instance, image.instances)
            seen = Outlined.of(whole, camera, image.photo.rgb)
            carrier = self.choices.get(under[instance.id])
            if carrier is not None and not carries(seen, carrier):
                carrier, under = None, {**under, instance.id: GROUND}
            done = [id for id in _beneath(instance.id, under) if id in self.choices]  # all, but in a ring
            walls = [self.choices[id].near_wall(masks[id], camera) for id in done]
            hidden = union_of(walls, whole.shape) | _may_hide(instance, image.instances, under)
            if geometry.source != "ground":
                others = (mask for id, mask in masks.items() if id != instance.id)
                hidden |= behind_the_photo(instance.mask, others, geometry, camera) & ~masked
            seen = seen.behind(hidden)
            far = [self.choices[id].distance(camera.center) for id in self.choices] or [camera.center[2] * FAR]
            loaded = instance.id in under.values()
            found = choose(instance, seen, carrier, distance=float(np.median(far)), loaded=loaded)
            self.choices[instance.id] = found
            shown[instance.id] = SeenSolid.of(found.best.solid, whole, camera)
        light = light_of(list(shown.values()), image.photo.rgb, _background(image, camera), camera)
        return {i.id: _asset(i, self.choices[i.id], shown[i.id], image.photo, light) for i in image.instances}


def _background(image: PromptedImage, camera: Camera) -> NDArray[np.uint8]:
    """The photo (H, W, 3) behind the objects and their shadows."""
    masks = [i.mask for i in image.instances]
    hole = widened(masks, BackgroundConfig().margin)
    known = np.full(hole.shape, image.ground_mask is not None)
    seen = known if image.ground_mask is None else image.ground_mask
    return complete_background(image.photo, masks, support=support_behind(known, seen, hole, camera)).rgb


def _asset(instance: Instance, found: Choice, shown: SeenSolid, photo: Photo, light: PhotoLight) -> GeneratedAsset:
    """The mesh of an object about its foot, with the photo's colours as they are without its light."""
    vertices = shown.solid.vertices
    origin = np.array([*vertices[:, :2].mean(0), vertices[:, 2].min()])
    plain = Photo(rgb=light.removed(photo.rgb, shown))
    return GeneratedAsset(
        mesh=textured(shown.solid, origin, plain, shown.mask, shown.camera),
        T_camera_object=shown.camera.T_camera_world @ pose(t=origin),
        told=found.told + _strays_told(instance.mask, shown.mask),
        fixed=found.fixed,
        lifted=True,
    )


def _without_strays(instance: Instance, instances: tuple[Instance, ...]) -> NDArray[np.bool_]:
    """An object's mask without small pieces that belong to no body with the rest."""
    others = union_of((i.mask for i in instances if i.id != instance.id), instance.mask.shape)
    rows, columns = np.flatnonzero(instance.mask.any(1)), np.flatnonzero(instance.mask.any(0))
    gap = max(2, round(GAP * math.hypot(np.ptp(rows), np.ptp(columns))))
    return without_strays(instance.mask, others, gap=gap, share=STRAY)


def _strays_told(mask: NDArray[np.bool_], whole: NDArray[np.bool_]) -> str:
    left = float(1 - whole.sum() / mask.sum())
    return f"; {100 * left:.1f} % of its mask lies apart and is left out" if left > 0 else ""


def _from_below(instances: tuple[Instance, ...], under: Mapping[int, int]) -> list[Instance]:
    """Instances so that what is below one comes before it; in a ring the lowest in the picture first."""
    left, order = list(instances), list[Instance]()
    done = {GROUND}
    while left:
        ready = [i for i in left if under[i.id] in done] or [max(left, key=_bottom)]
        for i in ready:
            left.remove(i)
            done.add(i.id)
        order += ready
    return order


def _may_hide(instance: Instance, instances: tuple[Instance, ...], under: Mapping[int, int]) -> NDArray[np.bool_]:
    """Pixels (H, W) of what may stand before an object: its mask reaches farther down, or it is above the object; what
    is below the object is not."""

    def may_hide(other: Instance) -> bool:
        above = instance.id in _beneath(other.id, under)
        lower = _bottom(other) > _bottom(instance) and other.id not in _beneath(instance.id, under)
        return other.id != instance.id and (above or lower)

    return union_of((other.mask for other in instances if may_hide(other)), instance.mask.shape)


def _beneath(id: int, under: Mapping[int, int]) -> list[int]:
    """What is below an object in the picture, and below that."""
    found = list[int]()
    while (id := under.get(id, GROUND)) not in (GROUND, *found):
        found.append(id)
    return found


def _bottom(instance: Instance) -> int:
    return int(np.flatnonzero(instance.mask.any(1))[-1])
