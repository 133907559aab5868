"""What the photo, its geometry and contact tell of every pose: Fisher information of one joint Gaussian.

A pose has seven parameters: a shift along the world's axes [m], a rotation vector [rad] and the logarithm of the scale,
both about the middle of the object's box. The camera's principal point [px] and the logarithm of its focal length, and
the ground's height [m] and two tilts [rad], are parameters too: their errors are common to all objects.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from f3sr.contact.compounds import placed
from f3sr.contact.contact_patches import find_contacts
from f3sr.core.camera import Camera
from f3sr.core.pose_uncertainty import PARAMETERS, SCALE
from f3sr.core.transforms import Array, skew
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.uncertainty.config import UncertaintyConfig
from f3sr.vision import depth_prior
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.decimated import outlined
from f3sr.vision.motion_params import intrinsics_velocities, similarity_velocities
from f3sr.vision.occlusion import comparable_region, occluders
from f3sr.vision.photometric import Appearance
from f3sr.vision.silhouette import LossWeights, Mask, Surface, Target, loss

CAMERA, LAND = 3, 3
"""Numbers of parameters of the camera and of the ground."""

LEAST_ERROR = 1e-4
"""Of the ground's height [m] and tilts [rad], however many points measured it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Information:
    """``matrix`` (7 n + 6, 7 n + 6): objects in the scene's order, then the camera, then the ground."""

    matrix: Array
    ids: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, config: UncertaintyConfig) -> Information:
        ids = tuple(o.id for o in scene)
        places = {id: slice(PARAMETERS * k, PARAMETERS * (k + 1)) for k, id in enumerate(ids)}
        camera = slice(PARAMETERS * len(ids), PARAMETERS * len(ids) + CAMERA)
        land = slice(camera.stop, camera.stop + LAND)
        whole = np.zeros((land.stop, land.stop))
        hiding, sigmas = occluders(scene), depth_prior.sigmas(scene)
        for o in scene:
            both = np.r_[places[o.id], camera]
            whole[np.ix_(both, both)] += of_picture(o, scene, comparable_region(o, hiding[o.id], scene), config)
            whole[places[o.id], places[o.id]] += of_depth(o, scene.camera, sigmas[o.id]) + np.diag(_prior(o, config))
        _add_contacts(whole, scene, places, land, config)
        whole[camera, camera] += np.diag(_intrinsics_prior(scene, config))
        whole[land, land] += np.diag(_ground_prior(scene, config))
        return cls(matrix=whole, ids=ids)

    def covariance(self) -> dict[int, Array]:
        """(7, 7) of every object, by id: all else is as uncertain as it is."""
        inverse = np.asarray(np.linalg.inv(self.matrix), float)
        return {id: _block(inverse, k) for k, id in enumerate(self.ids)}

    def conditional(self) -> dict[int, Array]:
        """(7, 7) of every object, by id, where all else is as the scene has it."""
        return {id: np.asarray(np.linalg.inv(_block(self.matrix, k)), float) for k, id in enumerate(self.ids)}


def _block(matrix: Array, k: int) -> Array:
    return matrix[PARAMETERS * k : PARAMETERS * (k + 1), PARAMETERS * k : PARAMETERS * (k + 1)]


def precisions(scene: Scene, ids: Collection[int], config: UncertaintyConfig) -> dict[int, Array]:
    """(7, 7) of some objects, by id: what moves cost, all else as the scene has it, and contacts left out.

    Every object counts as one that fits its mask. So a move costs what it takes from the picture, also of an object
    that fits badly."""
    hiding, sigmas = occluders(scene), depth_prior.sigmas(scene)
    found = dict[int, Array]()
    for id in ids:
        o = scene[id]
        seen = of_picture(o, scene, comparable_region(o, hiding[id], scene), config, fits=True)
        found[id] = _block(seen, 0) + of_depth(o, scene.camera, sigmas[id]) + np.diag(_prior(o, config))
    return found


def of_picture(o: SceneObject, scene: Scene, valid: Mask, config: UncertaintyConfig, *, fits: bool = False) -> Array:
    """(10, 10), pose and camera: the curvature of silhouette and detail over their noise.

    What the best pose leaves of each loss is its noise: the outline errs in some independent places, ``outline``, and
    the detail in others. So a mesh that is not quite the object tells less of where it is. ``fits``: the noise is that
    of a mesh that fits, whatever the loss is, and of one that is not stretched."""
    camera = scene.camera
    window = window_around(o, camera, config.resolution)
    mask, region = (sampled(m, camera, window, fill=False) for m in (o.mask, valid))
    velocities = np.concatenate([
        similarity_velocities(o.middle, window), intrinsics_velocities(camera)
    ])  # fmt: skip
    target = Target.of(mask, region, LossWeights())
    light = outlined(o, config.max_faces)
    surface = Surface.of([(light.vertices_world, light.mesh.faces)])
    silhouette = loss(surface.integrals(window, target.fields, velocities), target)
    border = 4 * np.sqrt(target.area) / target.area
    noise = config.fitting_outline if fits else max(silhouette.value, config.pixel * border)
    found = config.outline / noise * silhouette.curvature
    if o.mesh.has_detail:
        detail = Appearance.of(scene.photo, camera, window, mask & region).mismatch(o, velocities)
        noise = config.fitting_detail if fits else max(detail.value, config.least_mismatch)
        found += config.detail / noise * detail.curvature
    if fits:
        return found
    # A shape that is stretched looks like another scale: that nuisance is marginalised (a Schur complement).
    stretched = found[:, SCALE]
    return found - np.outer(stretched, stretched) / (found[SCALE, SCALE] + config.stretch**-2)


def of_depth(o: SceneObject, camera: Camera, sigma: float) -> Array:
    """(7, 7): the logarithm of the distance to the front of an object, known to ``sigma``."""
    middle = o.middle
    ray = middle - camera.center
    distance = float(np.linalg.norm(ray))
    ray = ray / distance
    front = float(((o.vertices_world - middle) @ ray).min()) / 2
    row = np.concatenate([ray, np.zeros(3), [front]]) / distance
    return np.outer(row, row) / sigma**2


def _add_contacts(
    whole: Array, scene: Scene, places: Mapping[int, slice], land: slice, config: UncertaintyConfig
) -> None:
    """What rests on something touches it: no gap along the normals of its contacts, but for errors of the shapes."""
    contacts = find_contacts({o.id: placed(o.solids, o.T_world_asset) for o in scene})
    pairs = list(zip(contacts.upper.tolist(), contacts.lower.tolist(), strict=True))
    for k, (upper, lower) in enumerate(pairs):
        point, normal = contacts.points[k], contacts.normals[k]
        row = np.zeros(len(whole))
        row[places[upper]] = normal @ _motion_of(point, scene[upper])
        variance = (config.shape * scene[upper].size) ** 2
        if lower == GROUND:
            row[land] = [-1, -point[1], point[0]]
        else:
            row[places[lower]] = -normal @ _motion_of(point, scene[lower])
            variance += (config.shape * scene[lower].size) ** 2
        # The corners of one pair err together: they count as two.
        whole += np.outer(row, row) * 2 / (variance * pairs.count((upper, lower)))


def _motion_of(point: Array, o: SceneObject) -> Array:
    """(3, 7): how a point of an object moves with its pose."""
    r = point - o.middle
    return np.column_stack([np.eye(3), -skew(r), r])


def _prior(o: SceneObject, config: UncertaintyConfig) -> Array:
    """(7,): an object is near where it is seen, whatever its turn."""
    return np.concatenate([np.full(3, o.size**-2.0), np.full(3, config.turn**-2), [config.scale**-2]])


def _intrinsics_prior(scene: Scene, config: UncertaintyConfig) -> Array:
    if scene.has_measured_depth:
        return np.array([1.0, 1.0, 1e6])
    center = config.center * max(scene.camera.width, scene.camera.height)
    told = scene.geometry.focal_error if scene.geometry else None
    return np.array([center, center, max(config.focal, told or 0.0)]) ** -2.0


def _ground_prior(scene: Scene, config: UncertaintyConfig) -> Array:
    errors = np.array([scene.ground.height_error, scene.ground.tilt_error, scene.ground.tilt_error]) / 2
    unknown = config.ground * np.array([abs(float(scene.camera.center[2])), 1, 1])
    return np.maximum(np.where(np.isfinite(errors), errors, unknown), LEAST_ERROR) ** -2.0
