"""How well the distance of an object from the camera is known before contact tells: the one prior of all stages.

Every number is a share of the distance. Standard deviations are of the distance's logarithm.
"""

from __future__ import annotations

ASSET_SIGMA = 0.03
"""Standard deviation of a generated pose's distance. Generated assets of known scenes have .022."""
GEOMETRY_SIGMA = 0.01
"""Standard deviation where the photo has a geometry. Objects of ten known scenes have .009 after alignment."""
SUPPORT_REACH = 0.12
"""Largest move along viewing rays that ``relate`` tries, four ``ASSET_SIGMA``: what could the object rest on?"""
CONTACT_REACH = 0.1
"""Largest move along viewing rays onto a support that ``separate`` makes. Known scenes need at most .07."""
GEOMETRY_REACH = 0.2
"""Largest move along viewing rays to where the geometry sees an object: a measured depth may move it farther."""
GEOMETRY_SPREAD = 0.05
"""Largest median deviation of an object's depth ratios at which their median tells its distance."""
GEOMETRY_PIXELS = 50
"""Least number of pixels that tell an object's distance."""


def sigma(*, has_geometry: bool) -> float:
    """Standard deviation of an object's distance."""
    return GEOMETRY_SIGMA if has_geometry else ASSET_SIGMA
