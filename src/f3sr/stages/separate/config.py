"""Settings of ``separate``."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from annotated_types import Interval

from f3sr.contact.footing import FootingConfig
from f3sr.contact.stabilize import BalanceConfig
from f3sr.contact.tipping import LandingConfig
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.settings import settings


@settings
class SeparateConfig:
    contact: ContactMargin = DEFAULT_MARGIN
    """Its clearance is left between parted objects (eps_g of equation 11), so that nothing pushes when physics starts.
    """
    ground: bool = True
    """Move the ground first to where most of the objects on it stand."""
    max_ray_scale: Annotated[float, Interval(ge=0, le=0.5)] = 0.1
    """How far an object may slide along its viewing rays to reach its support, as a share of its distance to the
    camera; 0 turns it off. The right factor lies within .07 of 1 on scenes with known poses."""
    depth_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.01
    """How well the distance to an object is known where the photo has a geometry, as a share of it (one standard
    deviation; .009 between the objects of ten known scenes after alignment)."""
    unknown_depth_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.03
    """The same where it has none (.022 of the poses of generated assets)."""
    picture_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.02
    """How well an object's place in the picture is known, as the IoU with its mask that lifting or lowering it costs:
    more trust in the picture costs places in depth, less costs the picture without places gained."""
    slide_sigma: Annotated[float, Interval(gt=0, le=10)] = 0.25
    """How well its place on another object is known, as a share of its size: moving along the viewing rays must not
    take it over the edge of what it rests on."""
    rounds: Annotated[int, Interval(ge=1, le=100)] = 16
    """Most rounds of horizontal parting; the report allows 32."""
    margin: bool = True
    """Tell the stability margin also of what stands: ten times the time of finding out that it does."""
    footing: FootingConfig = field(default_factory=FootingConfig)
    balancing: BalanceConfig = field(default_factory=BalanceConfig)
    landing: LandingConfig = field(default_factory=lambda: LandingConfig(max_turn=0.5, max_shift=0.1))

    @property
    def clearance(self) -> float:
        """[m]"""
        return self.contact.clearance
