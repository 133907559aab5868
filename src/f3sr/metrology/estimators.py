"""Estimators of geometry and of normals by name: ours, and what other packages add in the entry point groups
``f3sr.geometry`` and ``f3sr.normals``."""

from __future__ import annotations

from f3sr.backends.protocols import GeometryEstimator, NormalEstimator
from f3sr.backends.registry import Kind

DEFAULT_ESTIMATOR = "metrology"
"""Where a folder has no geometry and nobody names another."""
GEOMETRY_ESTIMATORS = Kind(
    name="geometry",
    protocol=GeometryEstimator,
    built_in={
        DEFAULT_ESTIMATOR: "f3sr.metrology.ground_metrology:GroundMetrology",
        "moge": "f3sr.neural.moge_points:MogeGeometry",
        "depth-pro": "f3sr.neural.depth_pro:DepthProGeometry",
        "depth-anything": "f3sr.metrology.fitted_depth:DepthAnythingGeometry",
        "dpt": "f3sr.metrology.fitted_depth:DptGeometry",
        "depth-anything-3": "f3sr.metrology.worker_geometry:depth_anything3",
        "unidepth": "f3sr.metrology.worker_geometry:unidepth",
        "metric3d": "f3sr.metrology.worker_geometry:metric3d",
        "vggt": "f3sr.metrology.worker_geometry:vggt",
        "worker": "f3sr.metrology.worker_geometry:worker",
    },
)
NORMAL_ESTIMATORS = Kind(
    name="normals",
    protocol=NormalEstimator,
    built_in={
        "omnidata": "f3sr.metrology.network_normals:OmnidataNormals",
        "dsine": "f3sr.metrology.network_normals:DsineNormals",
    },
)
