"""Geometry from networks without a camera: the built-in metrology tells K, and the ground plane that relative depths
are fitted to.

It stands here and not in ``neural/``, which knows no metrology: a network is asked for its map alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import EstimatedGeometry, GeometryEstimator, PromptedImage
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array
from f3sr.metrology.affine_depth import AffineDepth, fit_affine_depth
from f3sr.metrology.ground_metrology import GroundMetrology
from f3sr.neural.depth_maps import DepthAnythingNetwork, DepthNetwork, DptNetwork
from f3sr.neural.pixel_rays import rays
from f3sr.scene import Photo

PIXELS = 20_000
"""Most ground pixels that are fitted to: a network's errors reach over many."""
STRIPS = 4
"""Strips along each axis of the photo that make the groups of the jackknife."""
FARTHEST = 100.0
"""Largest depth that counts, in depths of the nearest ground: beyond it 1/z is within its error of 0."""


class FittedDepth:
    """A GeometryEstimator of a depth network. Metric depths take K of the metrology, or the known focal length."""

    takes_model: ClassVar[bool] = True
    takes_normals: ClassVar[bool] = True
    network_class: ClassVar[type[DepthNetwork]]

    def __init__(self, choice: ModelChoice | None = None, reference: GeometryEstimator | None = None) -> None:
        self.network = self.network_class(choice)
        self.reference = reference or GroundMetrology()

    @property
    def provenance(self) -> Mapping[str, str]:
        """Of the network."""
        return self.network.provenance

    def needs(self) -> tuple[Need, ...]:
        """Of the network."""
        return self.network.needs()

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        """Points at every pixel of the photo whose depth is known; relative depths by the ground plane, in its unit.

        Raises InputError where they cannot be fitted."""
        depth, known = self.network.predict(image.photo), self.reference.estimate(image)
        if depth.metric:
            told = f"metric depths of {self.network.name}; {known.told}"
            return geometry_of_depths(image.photo, known.K, depth.values, told, guessed_unit=False)
        return relative_geometry(image, depth.values, known, self.network.name, self.network.family.title)


class DepthAnythingGeometry(FittedDepth):
    """The GeometryEstimator ``depth-anything``."""

    network_class: ClassVar[type[DepthNetwork]] = DepthAnythingNetwork


class DptGeometry(FittedDepth):
    """The GeometryEstimator ``dpt``."""

    network_class: ClassVar[type[DepthNetwork]] = DptNetwork


def relative_geometry(
    image: PromptedImage, values: NDArray[np.floating], known: EstimatedGeometry, name: str, where: str
) -> EstimatedGeometry:
    """Points of relative inverse depths (h, w) of the whole photo, fitted to the plane of ``known``, in its unit.

    Raises InputError, which names ``where`` they come from, where they cannot be fitted."""
    fit = fitted(values, known, image.ground_mask, where)
    inverse = fit.inverse(values)
    nearest = float(_ground_depths(known).min())
    z = np.where(inverse > 1 / (FARTHEST * nearest), 1 / np.where(inverse > 0, inverse, 1), np.nan)
    h, w = values.shape
    told = f"{_told(name, fit, values, [resample(i.mask, w, h) for i in image.instances])}; {known.told}"
    return geometry_of_depths(image.photo, known.K, z, told, guessed_unit=True)


def fitted(
    values: NDArray[np.floating], known: EstimatedGeometry, ground: NDArray[np.bool_] | None, where: str
) -> AffineDepth:
    """The fit of relative inverse depths (h, w) of the whole photo to the plane of ``known``, whose points are those of
    the ground.

    Of these the ``ground`` mask (H, W) counts where somebody gives it. Raises InputError likewise."""
    height, width = values.shape
    usable = resample(known.valid, width, height)
    usable = usable & resample(ground, width, height) if ground is not None else usable
    step = max(1, int(np.sqrt(usable.sum() / PIXELS)))
    rows, columns = (part * step for part in np.nonzero(usable[::step, ::step]))
    groups = (rows * STRIPS // height) * STRIPS + columns * STRIPS // width
    inverse = _plane_inverse(known, (width, height), columns.astype(float) + 0.5, rows.astype(float) + 0.5)
    return fit_affine_depth(values[rows, columns], inverse, groups, where)


def _plane_inverse(known: EstimatedGeometry, size: tuple[int, int], x: Array, y: Array) -> Array:
    """1/z of the plane at pixels of the photo (n,): over a plane it is affine in x and y."""
    h, w = known.valid.shape
    rows, columns = np.nonzero(known.valid)
    seen = np.stack([(columns + 0.5) * size[0] / w, (rows + 0.5) * size[1] / h, np.ones(len(rows))], 1)
    plane = np.linalg.lstsq(seen, 1 / _ground_depths(known), rcond=None)[0] if len(rows) else np.zeros(3)
    return np.stack([x, y, np.ones_like(x)], 1) @ plane


def _ground_depths(known: EstimatedGeometry) -> Array:
    return known.points[known.valid][:, 2].astype(float)


def geometry_of_depths(
    photo: Photo, K: Array, z: NDArray[np.floating], told: str, *, guessed_unit: bool
) -> EstimatedGeometry:
    """Points at the pixel centres of a depth map (h, w) of the whole photo, NaN where unknown; ``K`` (3, 3) in pixels
    of the photo."""
    h, w = z.shape
    valid = np.isfinite(z) & (z > 0)
    of_map = K * [[w / photo.width], [h / photo.height], [1]]
    points = rays(of_map, w, h) * np.where(valid, z, 0)[..., None]
    return EstimatedGeometry(points=points.astype(np.float32), valid=valid, K=K, guessed_unit=guessed_unit, told=told)


def _told(name: str, fit: AffineDepth, values: NDArray[np.floating], masks: Sequence[NDArray[np.bool_]]) -> str:
    errors = [fit.error(float(np.nanmedian(values[mask]))) for mask in masks if np.isfinite(values[mask]).any()]
    objects = f", distances of objects +- {100 * float(np.median(errors)):.1f} %" if errors else ""
    return (
        f"relative depths of {name}, their scale {fit.scale:.3g} and shift {fit.shift:.3g} 1/m fitted to the ground "
        f"plane by {fit.pixels} pixels ({100 * fit.inliers:.0f} % of those tried, {100 * fit.residual:.1f} % off)"
        f"{objects} by the fit alone"
    )
