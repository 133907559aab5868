"""What can be set about alignment, and the constants of its steps."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from f3sr.mesh_poses.orientations import OrientationConfig
from f3sr.settings import constants, settings


@settings
class CameraConfig:
    """Six degrees of freedom about the scene's middle, intrinsics fixed (equation 7)."""

    rotation: Annotated[float, Interval(gt=0, le=np.pi / 4)] = math.radians(1)
    """Largest turn of the camera per axis [rad]. The ground tells gravity to half a degree."""
    translation: Annotated[float, Interval(gt=0, le=0.5)] = 0.05
    """Largest move of the camera [share of its distance to the scene]."""
    focal: bool = False
    """Search the focal length too. It is kept where mean IoU rises and the ground fits no worse."""


@constants
class SearchConfig:
    """The search for one object's pose (equations 8 and 9)."""

    max_faces: int = 8_000
    """Most faces of a mesh in the search; larger meshes are simplified."""
    yaw_seeds: tuple[float, ...] = tuple(math.radians(a) for a in (-30, -15, 0, 15, 30))
    """Turns about the vertical at which a search starts [rad]."""
    overlap_scales: tuple[float, ...] = (0.8, 0.9, 1.0, 1.1, 1.2)
    """Scales at which all shifts of what misses its mask are compared; the refinement corrects half a step."""
    kept_seeds: int = 2
    """Number of seeds that are refined, the best first."""
    iterations: int = 12
    """Most steps of the final search; each seed gets half of them."""
    further: int = 4
    """Most further searches, each from where the last one ended at the bounds of shift or scale."""
    prior: tuple[float, float, float, float, float, float] = (0.01, 0.01, 0.05, 0.02, 0.02, 0.02)
    """Quadratic priors on shifts, yaw, two tilts and scale, each over its bound. A silhouette without yaw prefers one
    by noise; generated poses are right to ten degrees, which cost .0025 here."""


@constants
class TiltConfig:
    """Equation 8 with a full rotation, kept where the picture gains and the geometry does not object."""

    enabled: bool = True
    """Search tilt."""
    most: float = 0.15
    """Largest tilt about each horizontal axis [rad]; generated poses tilt by up to ten degrees."""


@constants
class AppearanceConfig:
    """Detail of the photo against that of the textured render: it tells turns that a silhouette does not."""

    enabled: bool = True
    """Compare detail of objects with a texture or vertex colours."""
    resolution: int = 128
    """Longer side [px] of the window that is compared."""
    weight: float = 0.1
    """Weight of 1 - correlation in the objective, in which the mask's whole area weighs 1."""
    search: float = math.radians(40)
    """Largest turn to either side that is tried first [rad]."""
    step: float = math.radians(8)
    """Step between turns that are tried [rad]; it moves detail by a few pixels, which the final search corrects."""
    known: float = 0.7
    """Correlation from which no other turn is tried."""
    doubted: float = 0.3
    """Correlation below which any orientation is tried."""
    share: float = 0.6
    """Of what an object misses, the most that it may still miss in another orientation that detail alone asks for. Most
    poses come right. Of 22 that came turned by half a turn and fitted their masks, 21 end below .6."""
    blind: float = 0.02
    """Largest loss of IoU by a turn about an own axis to which the silhouette counts as blind."""
    gain: float = 0.03
    """Least gain of correlation for a turn to be tried."""
    far_gain: float = 0.1
    """The same for a turn beyond ``search``."""
    loss: float = 0.005
    """Largest loss of IoU for a better correlation."""

    @property
    def near(self) -> list[float]:
        """Turns up to ``search`` [rad], 0 left out."""
        count = max(1, round(self.search / self.step))
        return [k * self.step for k in range(-count, count + 1) if k]

    @property
    def far(self) -> list[float]:
        """All turns beyond those, up to half a turn to either side [rad]."""
        first = self.near[-1] + self.step
        count = math.ceil(2 * (math.pi - first) / self.step)
        return np.linspace(first, 2 * math.pi - first, count + 1).tolist()


@constants
class FacetConfig:
    """Objects are tried on their nearest stable facet; the picture guards what is turned."""

    enabled: bool = True
    """Try facets."""
    most: float = math.radians(10)
    """Largest turn onto a facet [rad]; the search before leaves a few degrees of tilt."""
    loss: float = 0.005
    """Largest loss of IoU and weighted correlation on a facet."""


@constants
class DepthConfig:
    """An object moves along its viewing rays, silhouette unchanged, to where the geometry sees it."""

    enabled: bool = True
    """Move objects so, where the photo has a geometry. ``vision.depth_prior`` bounds the move."""


@settings
class AlignConfig:
    """Equations 7 to 9 and their extensions."""

    resolution: Annotated[int, Interval(ge=64, le=4096)] = 384
    """Longer side [px] of the image for the camera, and of the window for one object."""
    camera: bool = True
    """Refine the camera."""
    objects: bool = True
    """Refine the objects."""
    freedom: Literal["image", "support"] = "image"
    """Plane in which objects shift: that of the image (equation 8), or the horizontal one of their support."""
    max_shift: Annotated[float, Interval(gt=0, le=2)] = 0.35
    """Largest shift per axis [share of the object's size]; the report's bound."""
    max_yaw: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(45)
    """Largest turn about the vertical [rad]."""
    max_scale: Annotated[float, Interval(gt=0, lt=1)] = 0.25
    """Largest change of scale [share of the scale]; the report's bound."""
    camera_step: CameraConfig = field(default_factory=CameraConfig)
    search: SearchConfig = SearchConfig()
    tilt: TiltConfig = TiltConfig()
    appearance: AppearanceConfig = AppearanceConfig()
    orientations: OrientationConfig = OrientationConfig()
    facets: FacetConfig = FacetConfig()
    depth: DepthConfig = DepthConfig()

    @property
    def anywhere(self) -> bool:
        """Whether objects may end far from where they came: those that rest may not."""
        return self.orientations.enabled

    def under_contact(self) -> AlignConfig:
        """For objects that rest: they stay on their supports, and only small moves without tilt are tried."""
        return replace(
            self,
            camera=False,
            freedom="support",
            max_shift=min(self.max_shift, 0.2),
            max_yaw=min(self.max_yaw, 0.35),
            max_scale=min(self.max_scale, 0.15),
            search=replace(self.search, yaw_seeds=(0.0,)),
            tilt=replace(self.tilt, enabled=False),
            orientations=replace(self.orientations, enabled=False),
            facets=replace(self.facets, enabled=False),
            depth=replace(self.depth, enabled=False),
            appearance=replace(self.appearance, known=0.0),
        )

    def upright(self, *, within: float) -> AlignConfig:
        """For objects that toppled: they stand on their nearest stable facet ``within`` a turn [rad], whatever the
        picture loses."""
        return replace(
            self,
            camera=False,
            orientations=replace(self.orientations, enabled=False),
            facets=FacetConfig(most=within, loss=1.0),
        )
