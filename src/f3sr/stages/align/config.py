"""What can be set about alignment."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval, Len

from f3sr.settings import settings
from f3sr.vision.silhouette import LossWeights

Turn = Annotated[float, Interval(ge=-np.pi, le=np.pi)]
Weight = Annotated[float, Interval(ge=0, le=10)]
Share = Annotated[float, Interval(ge=0, le=1)]


@settings
class CameraConfig:
    """Six degrees of freedom about the scene's middle, intrinsics fixed (equation 7)."""

    rotation: Annotated[float, Interval(gt=0, le=np.pi / 4)] = math.radians(1)
    """Trust region of the camera's turn per axis [rad]. The ground tells gravity to half a degree
    (.34 in the mean of ten known scenes); three degrees of freedom here made that 1.2 and gained .002 mIoU."""
    translation: Annotated[float, Interval(gt=0, le=0.5)] = 0.05
    """Trust region of the camera's move, as a share of its distance to the scene."""
    iterations: Annotated[int, Interval(ge=1, le=1000)] = 25
    """Steps tried."""
    prior: Weight = 0.01
    """Quadratic prior on the motion over its trust region."""
    focal: bool = False
    """Then try other focal lengths too, kept where the mean IoU rises and the ground stays where it is."""
    focal_range: Annotated[float, Interval(gt=0, lt=1)] = 0.1
    """Largest change of the logarithm of the focal length."""
    evidence: Annotated[int, Interval(ge=32, le=1024)] = 192
    """Longer side [px] of the image in which depths are compared with the geometry, which may not fit worse."""


@settings
class TiltConfig:
    """An extension of equation 8 by a full rotation, kept where the picture gains and the geometry does not object."""

    enabled: bool = True
    """Tilt is searched."""
    most: Annotated[float, Interval(gt=0, le=np.pi / 4)] = 0.15
    """Largest tilt about each horizontal axis [rad]; generated poses tilt by up to ten degrees."""
    spread: Annotated[float, Interval(ge=0, le=1)] = 0.01
    """Spread of rendered depths about those of the geometry, as a share of the distance, up to which it does not
    object: its own noise. Beyond, the spread may not grow."""


@settings
class AppearanceConfig:
    """The photo's detail against the textured render's: tells the turn of what a silhouette cannot tell."""

    enabled: bool = True
    """Detail is compared, where an object has a texture or colours by vertex."""
    resolution: Annotated[int, Interval(ge=32, le=1024)] = 128
    """Longer side [px] of the window that is compared."""
    weight: Weight = 0.1
    """Of 1 - correlation beside the losses of the silhouette, of which 1 is the mask's whole area."""
    search: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(40)
    """Turns to either side that are searched [rad]."""
    step: Annotated[float, Interval(gt=0, le=np.pi / 4)] = math.radians(8)
    """Between two of them [rad]: detail of that window moves by a few pixels, from where the final search arrives."""
    known: Share = 0.7
    """Correlation from which on no other turn is tried."""
    blind: Share = 0.02
    """A silhouette is blind to a turn about an own axis that costs it no more IoU than this."""
    gain: Share = 0.03
    """Least gain of correlation for a turn to be tried."""
    loss: Share = 0.005
    """IoU that a better correlation may cost."""


@settings
class FacetConfig:
    """Objects are tried on their nearest stable facet; the picture guards what is turned."""

    enabled: bool = True
    """Facets are tried."""
    most: Annotated[float, Interval(gt=0, le=np.pi / 2)] = math.radians(10)
    """Turns up to this are tried [rad]: tilts are known to a few degrees by then."""
    loss: Share = 0.005
    """What standing on a facet may cost of IoU and weighted correlation."""


@settings
class DepthConfig:
    """An object is moved along its viewing rays, silhouette unchanged, to where the geometry sees it."""

    enabled: bool = True
    """Objects are moved so, where the photo has a geometry."""
    most: Annotated[float, Interval(gt=0, lt=1)] = 0.2
    """Largest move, as a share of the distance."""
    pixels: Annotated[int, Interval(ge=1, le=100_000)] = 50
    """Fewest pixels that must tell it."""
    spread: Annotated[float, Interval(gt=0, le=1)] = 0.05
    """Largest spread of those pixels about their median, as a share of the distance."""


@settings
class AlignConfig:
    """Equations 7 to 9 and their extensions."""

    resolution: Annotated[int, Interval(ge=64, le=4096)] = 384
    """Longer side [px] of the image the camera is refined in, and of the window around one object."""
    camera: bool = True
    """Refine the camera first."""
    objects: bool = True
    """Refine the objects."""
    freedom: Literal["image", "support"] = "image"
    """Objects shift in the image plane and scale about their middle (equation 8), or, where they already rest, shift
    horizontally and scale about the middle of their base, so that they stay on their support."""
    max_faces: Annotated[int, Interval(ge=1000, le=10_000_000)] = 8_000
    """Larger meshes are simplified to as many faces for the search."""
    yaw_seeds: Annotated[tuple[Turn, ...], Len(1, 64)] = tuple(math.radians(a) for a in (-30, -15, 0, 15, 30))
    """Turns about the vertical that a search starts from [rad]."""
    kept_seeds: Annotated[int, Interval(ge=1, le=64)] = 2
    """Seeds that are refined, the best first."""
    iterations: Annotated[int, Interval(ge=1, le=1000)] = 12
    """Steps tried by the final search; each seed gets half of them."""
    max_shift: Annotated[float, Interval(gt=0, le=2)] = 0.35
    """Largest move in the image plane, as a share of the object's size; the report's bound."""
    max_yaw: Annotated[float, Interval(gt=0, le=np.pi)] = math.radians(45)
    """Largest turn about the vertical [rad]."""
    max_scale: Annotated[float, Interval(gt=0, lt=1)] = 0.25
    """Largest change of scale; the report's bound."""
    prior: tuple[Weight, Weight, Weight, Weight, Weight, Weight] = (0.01, 0.01, 0.05, 0.02, 0.02, 0.02)
    """Quadratic priors on the shifts, yaw, two tilts and scale, each over its bound. A silhouette that is blind to yaw
    prefers one or another by noise; a generated pose is right to ten degrees, of which this costs .0025."""
    iou_tolerance: Annotated[float, Interval(ge=0, le=0.1)] = 0.0
    """IoU an accepted step may lose."""
    least_iou: Share = 0.2
    """Below it a mask and a mesh, fitted, do not show the same thing: the object stays as it came."""
    weights: LossWeights = field(default_factory=LossWeights)
    """Of the loss that silhouettes are compared by."""
    camera_step: CameraConfig = field(default_factory=CameraConfig)
    tilt: TiltConfig = field(default_factory=TiltConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)
    facets: FacetConfig = field(default_factory=FacetConfig)
    depth: DepthConfig = field(default_factory=DepthConfig)
