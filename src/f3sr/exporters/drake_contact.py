"""What Drake is told of contacts: areas touch, not points."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from f3sr.exporters.xml_text import numbers

MODULUS = 1e9
"""Hydroelastic modulus [Pa], that of soft wood. With 1e8 fruit rolls over its facets' edges, with 1e10 the smallest
overlaps throw thin things."""
DISSIPATION = 100.0
"""Of Hunt and Crossley [s/m]: what overlaps parts at no more than a centimetre a second."""
DRAKE_CONTACT: Mapping[str, str | None] = MappingProxyType(
    {
        "compliant_hydroelastic": None,
        "hydroelastic_modulus": numbers(MODULUS),
        "hunt_crossley_dissipation": numbers(DISSIPATION),
    }
)
"""Elements of ``drake:proximity_properties`` with their values.

Drake's other model makes one contact of a pair of convex shapes, at a point: what stands on a face rocks and turns."""
