"""What Drake is told of contacts: areas touch, not points."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from f3sr.exporters.xml_text import numbers

MODULUS = 1e10
"""Hydroelastic modulus [Pa], that of hard wood or glass fibre: with 1e8 fruit rolls over the edges of its facets."""
DISSIPATION = 1.0
"""Of Hunt and Crossley [s/m]: nothing bounces."""
DRAKE_CONTACT: Mapping[str, str | None] = MappingProxyType(
    {
        "compliant_hydroelastic": None,
        "hydroelastic_modulus": numbers(MODULUS),
        "hunt_crossley_dissipation": numbers(DISSIPATION),
    }
)
"""Elements of ``drake:proximity_properties`` with their values.

Drake's other model makes one contact of a pair of convex shapes, at a point: what stands on a face rocks and turns."""
