"""TabletopGen's layout from sizes and rotations, named and short: each object alone, then a top view, then physics.

Wang et al., "TabletopGen: Instance-Level Interactive 3D Tabletop Scene Generation from Text or Single Image", 2025,
arXiv 2512.01204; its repository is github.com/D-Robotics-AI-Lab/TabletopGen, read at commit 90b0189. This is an
independent implementation.

Implemented: canonical axes, an upright pose with one angle left; the rotation optimiser, which searches that angle by
silhouette, edges and appearance in a tight crop, 72 angles first and then the best eight refined; a size for each
object; positions from the top view; heights from who stands on whom, each box on the highest box below it; physics.

Replaced, and why:

- Uprightness told by a language model: the axis of the asset that its given pose holds nearest to the vertical.
- Inpainted hidden parts of an object: what its given pose shows behind nearer masks.
- Gradient steps on the angle: a bounded search of the same loss in one dimension. LPIPS and DINOv2 (networks): the
  correlation of band-passed colours, as 1 - correlation. Weights are the defaults of the published class.
- Sizes by a language model, common sense in centimetres, and one scale for all from an anchor: the size at which the
  object fills its mask at its measured distance. It is uniform, as the measures want the asset's own shape.
- A generated top view with boxes found by a language model: the top view of the objects at their measured distances.
- Snapping of angles to quarter turns is left out: tables are not aligned with the camera here.
- Isaac Sim by MuJoCo without momentum (``simulator``): what overlaps does not fly apart.

All that is measured instead of guessed favours it. It has no tilt, and it never looks at the scene as a whole again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baselines.given import depth_of
from baselines.simulator import DEFAULT_SIMULATION, Simulation, at_rest
from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array, pose, rotation_about, rotation_between, turn_about
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.occlusion import nearer_objects
from f3sr.vision.photometric import Appearance
from f3sr.vision.silhouette import Mask, iou, union_of

CROP = 256
"""Longer side of the crop [px]."""
COARSE = math.radians(5)
"""Between angles of the first search [rad]."""
KEPT = 8
"""Angles that are refined."""
FINE = math.radians(0.25)
"""How well they are [rad]."""
WEIGHTS = {"silhouette": 1.0, "edges": 0.5, "appearance": 0.12}
STEPS = 2
"""Corrections of place and size in the crop: the second finds what perspective made of the first."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Crop:
    """One object's mask, hidden part included, and its photo in a window."""

    camera: Camera
    """Of the window."""
    mask: Mask
    """(h, w)"""
    edges: Array
    """(h, w) distance to the mask's outline over the window's diagonal."""
    appearance: Appearance
    depth: float
    """Measured distance [m] along the camera's axis; nan where none is."""


def reconstruct(scene: Scene, *, simulation: Simulation = DEFAULT_SIMULATION) -> Scene:
    """``scene`` is levelled, with supports and proxies."""
    nearer = nearer_objects(scene)
    alone = scene.with_objects(*(placed_alone(o, nearer[o.id], scene) for o in scene))
    return at_rest(stacked(alone), simulation)


def placed_alone(o: SceneObject, nearer: list[SceneObject], scene: Scene) -> SceneObject:
    """The object upright, at the angle, in the size and at the distance that its mask and photo tell of it alone."""
    crop = crop_of(o, nearer, scene)
    upright = canonical(o)
    angle = best_angle(upright, crop)
    return filling(turned(upright, angle), crop)


def canonical(o: SceneObject) -> SceneObject:
    """The object with the axis of its asset that is nearest to the vertical made vertical, about its middle."""
    axes = o.T_world_object[:3, :3]
    k = int(np.argmax(np.abs(axes[2])))
    return _about_middle(o, rotation_between(axes[:, k] * np.sign(axes[2, k]), UP))


def turned(o: SceneObject, angle: float) -> SceneObject:
    """About the vertical through its middle [rad]."""
    return _about_middle(o, rotation_about(UP, angle))


def crop_of(o: SceneObject, nearer: list[SceneObject], scene: Scene) -> Crop:
    """The window around an object's mask, completed where nearer masks hide what its given pose shows."""
    hidden = full_silhouette(o, scene.camera) & union_of((p.mask for p in nearer), o.mask.shape)
    window = window_around(o, scene.camera, CROP)
    shown, mask = (sampled(m, scene.camera, window, fill=False) for m in (o.mask, o.mask | hidden))
    return Crop(
        camera=window,
        mask=mask,
        edges=_distance(mask) / math.hypot(*mask.shape),
        appearance=Appearance.of(scene.photo, scene.camera, window, shown),
        depth=depth_of(o, scene.geometry) if scene.geometry else np.nan,
    )


def best_angle(o: SceneObject, crop: Crop) -> float:
    """The turn about the vertical [rad] of an upright object with the least loss."""
    from scipy.optimize import minimize_scalar

    def loss(angle: float) -> float:
        return loss_of(filling(turned(o, angle), crop), crop)

    angles = np.arange(0, 2 * np.pi, COARSE)
    seeds = sorted((loss(a), a) for a in angles)[:KEPT]
    refined = [
        minimize_scalar(loss, bounds=(a - COARSE, a + COARSE), method="bounded", options={"xatol": FINE})
        for _, a in seeds
    ]
    return min([*seeds, *((float(r.fun), float(r.x)) for r in refined)])[1]


def loss_of(o: SceneObject, crop: Crop) -> float:
    """1 - IoU, the mean distance of the outline from the mask's, and 1 - correlation of colours, weighed."""
    seen = full_silhouette(o, crop.camera)
    outline = _outline(seen)
    terms = {
        "silhouette": 1 - iou(seen, crop.mask),
        "edges": float(crop.edges[outline].mean()) if outline.any() else 1.0,
        "appearance": 1 - crop.appearance.correlation(o),
    }
    return sum(WEIGHTS[name] * value for name, value in terms.items())


def filling(o: SceneObject, crop: Crop) -> SceneObject:
    """The object moved and scaled so that its box in the crop is the mask's, at its measured distance.

    The longer sides of both boxes are equal, and so are their middles: tight square crops compare so.
    """
    target = _box(crop.mask)
    for _ in range(STEPS):
        pixels, _ = crop.camera.project(o.vertices_world)
        box = np.stack([pixels.min(0), pixels.max(0)])
        k = float(np.ptp(target, axis=0).max() / np.ptp(box, axis=0).max())
        middle = o.middle
        z = float(crop.camera.to_camera(middle[None])[0, 2])
        shift = (target.mean(0) - box.mean(0)) * z / np.diag(crop.camera.K)[:2]
        shift_world = crop.camera.T_world_camera[:3, :2] @ shift
        o = o.moved(pose(t=middle - k * middle + shift_world), scale=k, stage="tabletopgen", reason="fills its mask")
    rendered = rasterizer.render([o], crop.camera).depth
    where = np.isfinite(rendered) & crop.appearance.shown
    if not where.any() or not np.isfinite(crop.depth):
        return o
    k = crop.depth / float(np.median(rendered[where]))
    return o.moved(crop.camera.homothety(k), scale=k, stage="tabletopgen", reason="at its measured distance")


def stacked(scene: Scene) -> Scene:
    """Places in the top view are kept; heights are those of boxes: each on the highest one below it, or on z = 0."""
    for id in scene.supports_first:
        o = scene[id]
        top = max((float(scene[c].bounds_world[1, 2]) for c in o.carriers if c != GROUND), default=0.0)
        lift = (top - float(o.bounds_world[0, 2])) * UP
        scene = scene.with_objects(o.moved(pose(t=lift), stage="tabletopgen", reason="onto what it stands on"))
    return scene


def _about_middle(o: SceneObject, R: Array) -> SceneObject:
    return o.moved(turn_about(o.middle, R), stage="tabletopgen", reason="rotation")


def _box(mask: Mask) -> Array:
    """Lowest and highest corner (2, 2) of a mask, x and y [px]."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], float)


def _outline(mask: Mask) -> Mask:
    """Pixels of a mask with a neighbour outside of it."""
    from scipy.ndimage import binary_erosion

    return mask & ~np.asarray(binary_erosion(mask, border_value=1), np.bool_)


def _distance(mask: Mask) -> Array:
    """(h, w) [px] to a mask's outline."""
    from scipy.ndimage import distance_transform_edt

    return np.asarray(distance_transform_edt(~_outline(mask)))
