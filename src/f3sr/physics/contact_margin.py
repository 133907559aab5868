"""The contact margin, and every distance that follows from it: how far bodies rest apart, touch, or do not matter."""

from __future__ import annotations

from f3sr.settings import constants


@constants
class ContactMargin:
    """Distances between bodies [m]. All of them derive from ``body``, the margin that physics gives each body."""

    body: float = 1.7e-4
    """Contact distance of one body while it settles. It keeps soft contact from turning into overlap.

    Two such margins stay between bodies at rest. The release protocol has .2 mm at true size. It lifts what rests
    nearer, with energy in the square of the difference, and lets fall what rests farther apart, with energy in
    proportion to it. Scenes whose size is guessed from one photo are up to 1.2 times as large in truth. So nothing may
    rest much farther apart than .2 mm over 1.2 (docs: physics)."""

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
