"""Boxes as bodies at rest: what the tests of statics, stabilizing and tipping share."""

from __future__ import annotations

import numpy as np

from f3sr.contact.compounds import Compound
from f3sr.contact.polytopes import Polytope
from f3sr.contact.static_bodies import StaticBody
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import pose
from f3sr.physics.contact_margin import DEFAULT_MARGIN

GAP = DEFAULT_MARGIN.clearance
"""Left between bodies [m], as the product does."""


def block(size=(0.1, 0.1, 0.1), at=(0.0, 0.0, 0.05), R=None) -> Polytope:
    """A box of ``size`` [m] about ``at``."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / 2
    return Polytope.of(ConvexPart.hull_of(signs * np.array(size))).moved(pose(R, at))


def body(id: int, *parts: Polytope, mass=1.0, friction=0.6, fixed=False) -> StaticBody:
    """A body whose centre of mass is that of its evenly filled parts."""
    volumes = np.array([np.prod(p.edge_lengths[:1]) * np.ptp(p.vertices, axis=0).prod() for p in parts])
    middles = np.array([p.vertices.mean(0) for p in parts])
    return StaticBody(
        id=id,
        parts=Compound.of(parts),
        mass=mass,
        centers=volumes @ middles / volumes.sum(),
        friction=friction,
        fixed=fixed,
    )
