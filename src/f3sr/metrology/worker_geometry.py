"""Geometry models of workers by name, their depths given a camera and a unit by what is known (docs: workers)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import EstimatedGeometry, GeometryEstimator, PromptedImage
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array
from f3sr.metrology.fitted_depth import geometry_of_depths, relative_geometry
from f3sr.metrology.ground_metrology import GroundMetrology
from f3sr.metrology.scaled_depth import fit_scale
from f3sr.workers.geometry_worker import GeometryWorker
from f3sr.workers.job_worker import WorkerModel


class WorkerGeometry:
    """A GeometryEstimator of a worker.

    The camera is the one that somebody tells, else the model's own, else the metrology's. Metric depths stay. Scaled
    ones get the metrology's height of the camera, and relative ones are fitted to its ground plane."""

    takes_normals: ClassVar[bool] = True

    def __init__(self, worker: GeometryWorker, reference: GeometryEstimator | None = None) -> None:
        self.worker = worker
        self.reference = reference or GroundMetrology()

    @property
    def provenance(self) -> Mapping[str, str]:
        """What the worker tells of its model."""
        return self.worker.provenance

    def needs(self) -> tuple[Need, ...]:
        """Of the worker: a command."""
        return self.worker.needs()

    def telling(self, tell: Callable[[str], None]) -> WorkerGeometry:
        """The same, whose worker tells what it is at."""
        self.worker.telling(tell)
        return self

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        """Points at the pixels of the model's map. Raises InputError for a bad answer, and for one that cannot be
        fitted; WorkerError where the worker ends badly."""
        known = self.reference.estimate(image)
        answer = self.worker.predict(image, known.K)
        name = answer.told or self.worker.model.name
        if answer.meaning == "relative":
            return relative_geometry(image, answer.values, known, name, self.worker.model.name)
        own = answer.K is not None and image.focal is None
        K = answer.K if answer.K is not None and own else known.K
        camera = f"focal length {K[0, 0]:.0f} px by the model" if own else known.told
        if answer.meaning == "metric":
            told = f"metric depths of {name}; {camera}"
            return geometry_of_depths(image.photo, K, answer.values, told, guessed_unit=False)
        as_given = geometry_of_depths(image.photo, K, answer.values, "", guessed_unit=True)
        scale = fit_scale(_ground_points(as_given, known, image), _height(known), self.worker.model.name)
        told = (
            f"depths of {name} up to scale, times {scale.factor:.3g} +- {100 * scale.error:.1f} %, which puts "
            f"{100 * scale.inliers:.0f} % of the ground's points at the camera's height; {camera}; {known.told}"
        )
        depths = answer.values * np.float32(scale.factor)
        return geometry_of_depths(image.photo, K, depths, told, guessed_unit=True)


def _ground_points(found: EstimatedGeometry, known: EstimatedGeometry, image: PromptedImage) -> NDArray[np.floating]:
    """Points (n, 3) of the model on the ground: on its mask, else where the metrology sees it."""
    h, w = found.valid.shape
    ground = resample(known.valid, w, h)
    if image.ground_mask is not None:
        ground = ground & resample(image.ground_mask, w, h)
    return found.points[found.valid & ground]


def _height(known: EstimatedGeometry) -> float:
    """Height of the camera above the plane of the metrology's points [its unit]."""
    points: Array = known.points[known.valid].astype(float)
    plane = np.linalg.lstsq(points, np.ones(len(points)))[0] if len(points) else np.full(3, np.inf)
    return 1 / float(np.linalg.norm(plane))


@dataclass(frozen=True, eq=False)
class WorkerGeometryMaker:
    """Makes the estimator of a model, for the command that follows its name."""

    model: WorkerModel
    takes_model = True

    def __call__(self, choice: ModelChoice) -> WorkerGeometry:
        """A command that is missing shows when it is needed."""
        return WorkerGeometry(GeometryWorker(self.model, choice))


def _of(name: str, script: str, licence: str = "") -> WorkerGeometryMaker:
    return WorkerGeometryMaker(WorkerModel(name=name, script=script, licence=licence))


depth_anything3 = _of(
    "depth-anything-3", "workers/depth_anything3.py", "Apache-2.0; large any-view and nested models CC BY-NC 4.0"
)
unidepth = _of("unidepth", "workers/unidepth.py", "CC BY-NC 4.0")
metric3d = _of("metric3d", "workers/metric3d.py", "BSD-2-Clause")
vggt = _of("vggt", "workers/vggt.py", "VGGT License")
worker = _of("geometry", "YOUR_WORKER.py")
"""Any program that keeps to the job folder; its variable is F3SR_WORKER_GEOMETRY."""
