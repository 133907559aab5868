"""What everyday things are made of, by their labels: priors where a package knows only shapes.

Densities are those of the whole thing over its outer volume, contents and air included, as labels name things and not
substances: a full can, an empty mug. Masses of the YCB object set (Calli et al., "Benchmarking in Manipulation Research",
IEEE RAM 2015, table 1) over the volumes of its scans are the main source; restitution on a hard table from Cross,
"The bounce of a ball" (Am. J. Phys. 67, 1999) for balls and from Farkas et al. (Transactions of the ASAE 2001) for fruit,
else handbook values; friction against wood or plastic from handbooks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Material:
    """What a kind of thing is to physics."""

    name: str
    structure: Literal["solid", "hollow"]
    density: float
    """[kg/m3] of the solid that the mesh shows."""
    friction: float
    restitution: float
    """Of speed, from a hard table."""
    rolling_friction: float = 1e-3
    """[m]"""


_KINDS: tuple[tuple[str, Material], ...] = (
    ("tennis ball", Material(name="felted rubber", structure="hollow", density=400, friction=0.7, restitution=0.72)),
    ("golf ball", Material(name="ionomer", structure="solid", density=1130, friction=0.4, restitution=0.8)),
    ("base ?ball|soft ?ball", Material(name="leather", structure="solid", density=700, friction=0.6, restitution=0.55)),
    (
        "ping.?pong ball|table.tennis ball",
        Material(name="celluloid", structure="hollow", density=85, friction=0.4, restitution=0.86),
    ),
    (
        "racquet ?ball|rubber ball|bouncy ball",
        Material(name="rubber", structure="hollow", density=450, friction=0.9, restitution=0.8),
    ),
    (
        "soccer ball|foot ?ball|basket ?ball|volley ?ball|ball",
        Material(name="inflated ball", structure="hollow", density=90, friction=0.6, restitution=0.75),
    ),
    (
        "apple|pear|peach|plum|nectarine",
        Material(name="fruit", structure="solid", density=850, friction=0.45, restitution=0.4),
    ),
    (
        "orange|lemon|lime|tangerine|grapefruit",
        Material(name="citrus fruit", structure="solid", density=930, friction=0.5, restitution=0.45),
    ),
    (
        "strawberry|banana|tomato(?! .*can)|grape|kiwi|avocado",
        Material(name="soft fruit", structure="solid", density=950, friction=0.5, restitution=0.2),
    ),
    ("foam|sponge", Material(name="foam", structure="solid", density=130, friction=0.7, restitution=0.3)),
    ("brick|stone|rock", Material(name="stone", structure="solid", density=2000, friction=0.65, restitution=0.2)),
    ("can|tin", Material(name="full tin", structure="solid", density=950, friction=0.4, restitution=0.2)),
    (
        "box|carton|packet|package",
        Material(name="cardboard with contents", structure="solid", density=400, friction=0.5, restitution=0.15),
    ),
    (
        "bottle|cleanser|mustard|ketchup|windex|shampoo|detergent",
        Material(name="full plastic bottle", structure="solid", density=950, friction=0.45, restitution=0.2),
    ),
    ("mug|cup|teacup", Material(name="ceramic", structure="hollow", density=2000, friction=0.5, restitution=0.3)),
    ("glass|jar|vase", Material(name="glass", structure="hollow", density=2400, friction=0.4, restitution=0.4)),
    (
        "bowl|plate|dish|saucer",
        Material(name="ceramic", structure="solid", density=2200, friction=0.45, restitution=0.3),
    ),
    (
        "pan|frypan|skillet|pot|kettle|lid",
        Material(name="metal sheet", structure="solid", density=5000, friction=0.4, restitution=0.25),
    ),
    (
        "hammer|wrench|spanner|pliers|screwdriver|padlock|lock|clamp|scissors|drill|key",
        Material(name="steel tool", structure="solid", density=4000, friction=0.45, restitution=0.25),
    ),
    (
        "spoon|fork|knife|spatula|ladle",
        Material(name="cutlery", structure="solid", density=4500, friction=0.35, restitution=0.3),
    ),
    (
        "lego|duplo|toy|airplane|car|figurine|rubik|cube",
        Material(name="plastic", structure="hollow", density=500, friction=0.4, restitution=0.3),
    ),
    (
        "book|notebook|magazine|newspaper",
        Material(name="paper", structure="solid", density=750, friction=0.45, restitution=0.1),
    ),
    (
        "block|wood|wooden|board|plank|tray|chopping",
        Material(name="wood", structure="solid", density=650, friction=0.5, restitution=0.35),
    ),
    (
        "chair|table|stool|shelf|cabinet|desk",
        Material(name="wooden furniture", structure="hollow", density=300, friction=0.5, restitution=0.2),
    ),
    (
        "bin|basket|bucket|crate",
        Material(name="plastic", structure="hollow", density=900, friction=0.4, restitution=0.3),
    ),
    (
        "microwave|oven|toaster|printer|monitor|laptop|computer|television|radio",
        Material(name="appliance", structure="hollow", density=350, friction=0.5, restitution=0.1),
    ),
    (
        "pillow|cushion|teddy|plush|bear|cloth|towel|bag|backpack|shoe",
        Material(name="fabric", structure="solid", density=150, friction=0.7, restitution=0.05),
    ),
)
"""By words of a label, the first that fits: what a thing is comes last in English, so each is looked for from the end."""

UNKNOWN = Material(name="unknown", structure="solid", density=600, friction=0.6, restitution=0.2)


def material_of(label: str) -> tuple[Material, bool]:
    """What a label tells, and whether it tells anything."""
    words = " ".join(re.findall(r"[a-z]+", label.lower()))
    found = [
        (match.end(), -order, material)
        for order, (pattern, material) in enumerate(_KINDS)
        for match in re.finditer(rf"\b(?:{pattern})s?\b", words)
    ]
    return (max(found, key=lambda f: f[:2])[2], True) if found else (UNKNOWN, False)
