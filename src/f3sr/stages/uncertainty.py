"""uncertainty: how well the pose of every object is known, by the photo, its geometry and contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from f3sr.core.pose_uncertainty import PoseUncertainty
from f3sr.report import Measure, Outcome
from f3sr.scene import Scene
from f3sr.uncertainty.config import UncertaintyConfig
from f3sr.uncertainty.pose_information import Information


@dataclass(frozen=True, kw_only=True)
class Uncertain(Outcome):
    stage: ClassVar[str] = "uncertainty"
    poses: Mapping[int, PoseUncertainty] = field(default_factory=dict[int, PoseUncertainty])
    """By object id; none of objects that nothing moves."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        """Half widths of 90 % intervals."""
        return tuple(
            Measure(name=name, after=value, unit=unit, about=id)
            for id, p in self.poses.items()
            for name, value, unit in (
                ("along the viewing ray", 1000 * p.along_ray, "mm"),
                ("across the viewing ray", 1000 * p.across_ray, "mm"),
                ("yaw", np.degrees(p.yaw), "deg"),
                ("tilt", np.degrees(p.tilt), "deg"),
                ("size", 100 * p.size, "%"),
            )
        )


def uncertainty(scene: Scene, config: UncertaintyConfig | None = None) -> tuple[Scene, Uncertain]:
    """The scene as it is, and the covariance of every pose by the curvature of what was minimised (docs: uncertainty).

    The Laplace approximation: one joint Gaussian over all poses, the camera's intrinsics and the ground. Silhouettes,
    detail, depth and contacts each add their Fisher information.
    """
    config = config or UncertaintyConfig()
    found = Information.of(scene, config)
    covariance, conditional = found.covariance(), found.conditional()
    poses: dict[int, PoseUncertainty] = {}
    for o in scene:
        if o.mobility == "dynamic":
            ray = o.middle - scene.camera.center
            # No photo shows the far side of a shape; the middle lies half between it and the near side.
            hidden = np.diag([(config.shape * o.size / 2) ** 2] * 3 + [0.0] * 4)
            poses[o.id] = PoseUncertainty.of(covariance[o.id] + hidden, conditional[o.id], ray / np.linalg.norm(ray))
    return scene, Uncertain(poses=poses)
