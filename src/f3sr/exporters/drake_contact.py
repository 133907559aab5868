"""What Drake is told of contacts: areas touch, not points, and all surfaces are equally stiff."""

from __future__ import annotations

from collections.abc import Mapping

from f3sr.core.mesh import ConvexPart, qhull
from f3sr.exporters.xml_text import numbers

STIFFNESS = 2e10
"""Pressure per depth of every surface [Pa/m], as of soft wood ten centimetres thick. With 1e11 thin parts tremble."""
DISSIPATION = 100.0
"""Of Hunt and Crossley [s/m]: what overlaps parts at no more than a centimetre a second."""


def drake_contact(depth: float) -> Mapping[str, str | None]:
    """Elements of ``drake:proximity_properties`` with their values, of a shape whose middle is ``depth`` [m] under its
    surface.

    Drake's pressure grows from nothing at the surface to the modulus in the middle. One modulus for all makes parts of
    a millimetre a hundred times as stiff as fruit: they were thrown, or deep grounds gave way. Drake's other model
    makes one contact of a pair of convex shapes, at a point: what stands on a face rocks and turns."""
    return {
        "compliant_hydroelastic": None,
        "hydroelastic_modulus": numbers(STIFFNESS * depth),
        "hunt_crossley_dissipation": numbers(DISSIPATION),
    }


def depth_of(part: ConvexPart) -> float:
    """Distance [m] of the centroid from the nearest facet's plane: where Drake has the middle of a convex mesh."""
    planes = qhull(part.vertices).equations
    return float(-(planes[:, :3] @ part.centroid + planes[:, 3]).max())
