"""The contact margin, and every distance that follows from it: how far bodies rest apart, touch, or do not matter."""

from __future__ import annotations

from f3sr.settings import constants


@constants
class ContactMargin:
    """Distances between bodies [m]. All of them derive from ``body``, the margin that physics gives each body."""

    body: float = 2e-4
    """Contact distance of one body while it settles. It keeps soft contact from turning into overlap.

    Two such margins stay between bodies at rest. It is the release protocol's, which would lift or drop bodies by any
    difference, level by level, and what is lifted may slide: with .16 mm a tower of ten moved by 1.2 to 1.9 mm."""

    @property
    def clearance(self) -> float:
        """Gap of two bodies at rest: the engine adds both margins. A gap left before physics makes nothing move."""
        return 2 * self.body

    @property
    def reach(self) -> float:
        """Largest gap of two bodies that touch, as they rest or come to rest by ``SINKING``."""
        return self.clearance + SINKING

    @property
    def loose(self) -> float:
        """Largest gap of two bodies that a footing may bring into contact: colliders stand off their meshes."""
        return 2 * self.reach

    @property
    def apart(self) -> float:
        """Gap from which two bodies do not affect each other while they settle: about six clearances."""
        return 12.5 * self.body


SINKING = 2.8e-4
"""Distance [m] over which soft contacts close and tremble while bodies come to rest."""
TOUCHING = 3e-6
"""Gap [m] of two colliders that meet while a body is moved geometrically, without physics: rounding, ten times."""
DEFAULT_MARGIN = ContactMargin()
