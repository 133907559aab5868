"""The global search: every orientation in which an object may have been meant, for those that miss their masks.

Generated poses are right to ten degrees, or wrong by far: half a turn, upside down, or the other half of a near
symmetry. A silhouette compares them all in a tenth of a second, as each gets its shift and scale in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact.stable_facets import resting_turn
from f3sr.core.transforms import UP, Array, rotation_about, rotation_angle, rotation_between, turn_about
from f3sr.scene import SceneObject
from f3sr.settings import constants
from f3sr.vision.photometric import principal_axes
from f3sr.vision.silhouette_fit import EVERYTHING, ObjectFit

FINER = 3
"""By how much the steps between yaws in place are finer: thin parts miss their mask sooner."""


@constants
class OrientationConfig:
    """The global search of an object that misses its mask: all yaws, as it came and upside down."""

    enabled: bool = True
    """Search."""
    enough: float = 0.965
    """IoU with the valid mask from which on no other orientation is sought."""
    share: float = 0.9
    """Of what an object misses (of its mask, the photo's detail and the geometry's depths), the most that it may still
    miss in another orientation. Meshes are wrong themselves, and most come right to ten degrees."""
    detail: float = 0.3
    """Weight of the photo's detail, 1 - correlation, in what it misses; the mask's, 1 - IoU, weighs 1."""
    depth: float = 2.0
    """Weight of the spread of depth [share of the distance] in that."""
    step: float = math.radians(15)
    """Step between yaws [rad]; the refinement corrects half of it."""
    facet: float = math.radians(45)
    """Largest turn from an end of a principal axis onto a stable facet [rad]."""
    iterations: int = 6
    """Most steps in which the silhouette of one that fits better than its neighbours is refined."""
    compared: int = 6
    """Orientations that are then compared at full resolution, the best first."""
    detailed: int = 3
    """Of these, the most that are refined by the photo's detail too."""
    slack: float = 0.02
    """How much more of mask and depth than before these may miss, unless the photo's detail makes up for it."""
    max_faces: int = 1_000
    """Most faces of a mesh in the search."""
    resolution: int = 128
    """Longer side [px] of the window in the search."""

    def missed(self, iou: float, spread: float, correlation: float | None = None) -> float:
        """How far mask, depth and detail are from those of a perfect mesh in its place: 0 is perfect.

        ``spread`` of the depths is a share of the distance; ``correlation`` is None where there is no detail."""
        return 1 - iou + self.depth * spread + (0.0 if correlation is None else self.detail * (1 - correlation))


@dataclass(frozen=True, eq=False, kw_only=True)
class Orientation:
    """An object turned by ``T`` (4, 4) about its middle in the world; ``u`` (6,) is where its silhouette then fits,
    with the loss ``value``. ``side`` counts what faces down; 0 is as it came."""

    T: Array
    u: Array
    value: float
    side: int = 0


def best_orientations(o: SceneObject, fit: ObjectFit, config: OrientationConfig) -> list[Orientation]:
    """Orientations of an object, best first, whose silhouettes fit its mask better than their neighbours do.

    ``fit`` is the object's, and should be a light one: some hundred silhouettes are compared.
    """
    lowest = local_minima(tried_orientations(o, fit, config))
    return sorted((_refined(fit, f, config) for f in lowest), key=lambda f: f.value)[: config.compared]


def best_in_place(o: SceneObject, fit: ObjectFit, config: OrientationConfig, *, tilt: float) -> list[Orientation]:
    """Other orientations of an object where it is, whose silhouettes fit its mask better than their neighbours do: the
    best of other yaws, and the best yaw on its nearest stable facet where it is off that by more than ``tilt``.

    What is thin, as the legs of a chair, or is hidden in part, tells neither shift nor scale in closed form. Where
    these are right already, a turn is enough."""

    def ring(R: Array) -> list[Orientation]:
        return _ring(o, fit, R, UP, 0, config.step / FINER, in_place=True)

    here = ring(np.eye(3))
    lowest = [found for found in local_minima([here]) if found is not here[0]]
    best = sorted(lowest, key=lambda f: f.value)[: config.detailed]
    onto = facet_turn(o, config.facet)
    if onto is not None and rotation_angle(onto) > tilt:
        best.append(min(ring(onto), key=lambda f: f.value))
    return [_refined(fit, f, config) for f in best]


def local_minima(rings: list[list[Orientation]]) -> list[Orientation]:
    """Orientations of rings of yaws that fit no worse than both neighbours do."""
    return [
        found
        for ring in rings
        for k, found in enumerate(ring)
        if found.value <= min(ring[k - 1].value, ring[(k + 1) % len(ring)].value)
    ]


def tried_orientations(o: SceneObject, fit: ObjectFit, config: OrientationConfig) -> list[list[Orientation]]:
    """All yaws of an object, a ring for each side that may face down, the first as it came.

    Each has the shift and scale that fit its mask in closed form."""
    return [_ring(o, fit, R, UP, side, config.step) for side, R in enumerate(_sides(o, config))]


def leaning_orientations(
    o: SceneObject, fit: ObjectFit, along: Array, first: int, config: OrientationConfig
) -> list[list[Orientation]]:
    """An object with its long axis, either way, along a unit vector (3,) of the world, and all turns about that.

    Sides are counted from ``first``."""
    long = principal_axes(o)[0]
    starts = [rotation_between(sign * long, along) for sign in (1, -1)]
    return [_ring(o, fit, R, along, first + k, config.step) for k, R in enumerate(starts)]


def _ring(
    o: SceneObject, fit: ObjectFit, R: Array, axis: Array, side: int, step: float, *, in_place: bool = False
) -> list[Orientation]:
    """All turns about an axis, a ``step`` [rad] apart, of an object that is turned by R (3, 3) first.

    Each has the shift and scale that fit its mask in closed form, or none ``in_place``."""
    count = max(1, round(2 * math.pi / step))
    turns = (rotation_about(axis, 2 * math.pi * k / count) @ R for k in range(count))
    return [_tried(o, fit, turn, side, in_place=in_place) for turn in turns]


def facet_turn(o: SceneObject, most: float) -> Array | None:
    """The world rotation (3, 3) that puts an object on its nearest stable facet; None where that is over ``most``."""
    return _turn_onto_facet(o, o.T_world_object[:3, :3], most)


def _turn_onto_facet(o: SceneObject, R_world: Array, most: float) -> Array | None:
    return resting_turn(o.mesh.hull, o.mesh.center_of_mass, R_world, max_tilt=most)


def _sides(o: SceneObject, config: OrientationConfig) -> list[Array]:
    """World rotations (3, 3): the object as it came, and with either end of each principal axis down, on the stable
    facet there."""
    found = [np.eye(3)]
    for down in (sign * axis for axis in principal_axes(o) for sign in (1, -1)):
        R = rotation_between(down, -UP)
        onto = _turn_onto_facet(o, R @ o.T_world_object[:3, :3], config.facet)
        side = R if onto is None else onto @ R
        # What faces down tells sides apart: yaws are tried of each.
        if all(side[2] @ other[2] < math.cos(config.step) for other in found):
            found.append(side)
    return found


def _tried(o: SceneObject, fit: ObjectFit, R: Array, side: int, *, in_place: bool) -> Orientation:
    T = turn_about(o.middle, R)
    turned = _turned(fit, T)
    u = np.zeros(6) if in_place else turned.seed(0.0)
    return Orientation(T=T, u=u, value=turned.value(u), side=side)


def _refined(fit: ObjectFit, found: Orientation, config: OrientationConfig) -> Orientation:
    least = _turned(fit, found.T).refined(found.u, iterations=config.iterations, free=EVERYTHING)
    return replace(found, u=least.x, value=least.value)


def _turned(fit: ObjectFit, T: Array) -> ObjectFit:
    return replace(fit, surface=fit.surface.moved(T, 1.0))
