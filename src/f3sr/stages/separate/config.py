"""Settings and constants of ``separate``."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Interval

from f3sr.contact.stabilize import BalanceConfig
from f3sr.contact.tipping import LandingConfig
from f3sr.contact.undersides import FootingConfig
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.settings import settings
from f3sr.vision.depth_prior import CONTACT_REACH

PICTURE_SIGMA = 0.02
"""Standard deviation of an object's place in the picture, as IoU that a lift costs: less costs the picture and gains no
places, more costs places in depth."""

MATCHED = 0.05
"""1 - IoU of a silhouette that matches its mask. What an object misses beyond it adds to its standard deviation in
proportion: an object that fits its mask badly is known badly, and rather moves than its well-known neighbour."""

UNDERSIDE_SIGMA = 0.02
"""Standard deviation of a generated underside, which no photo shows, as a share of the object's size. The undersides of
18 objects of SAM 3D are .014 off in the median, once their depth is right."""


@settings
class SeparateConfig:
    max_ray_scale: Annotated[float, Interval(ge=0, le=0.5)] = CONTACT_REACH
    """Largest move along viewing rays onto a support [share of the distance]. At 0 objects only lift."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Its clearance is left between parted objects (eps_g of equation 11), so that nothing pushes when physics starts.
    """
    footing: FootingConfig = FootingConfig()
    balancing: BalanceConfig = BalanceConfig()
    landing: LandingConfig = LandingConfig()

    @property
    def clearance(self) -> float:
        """[m]"""
        return self.contact.clearance
