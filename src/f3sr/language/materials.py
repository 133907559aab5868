"""What everyday things are made of, by their labels: priors where a package knows only shapes.

Densities are those of the whole thing over the volume its mesh shows, contents and air included, since labels name
things and not substances: a full can, an empty mug. They are the masses of the YCB object set (Calli et al., IEEE RAM
2015) over the volumes of its meshes where that has the thing. Restitution of balls is that of their sports' rules, from
the heights they must rebound to (tennis: 135 to 147 cm of 254; table tennis 24 to 26 cm of 30.5; basketball 120 to 140
cm of 180) or as a coefficient (baseball .55, golf .83). All else are estimates, to be overruled by whoever knows more.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

Structure = Literal["solid", "hollow"]


@dataclass(frozen=True, kw_only=True)
class MaterialPrior:
    """What a kind of thing is to physics."""

    name: str
    structure: Structure
    density: float
    """[kg/m3] over the volume that the mesh shows."""
    friction: float
    restitution: float
    """Of speed, from a hard table."""
    rolling_friction: float = 1e-3
    """[m]"""


_ROWS: tuple[tuple[str, str, Structure, float, float, float], ...] = (
    ("tennis ball", "felted rubber", "hollow", 400, 0.7, 0.74),
    ("golf ball", "ionomer", "solid", 1130, 0.4, 0.83),
    ("base ?ball|soft ?ball", "leather", "solid", 700, 0.6, 0.55),
    ("ping ?pong ball|table tennis ball", "celluloid", "hollow", 85, 0.4, 0.9),
    ("racquet ?ball|rubber ball|bouncy ball", "rubber", "hollow", 450, 0.9, 0.8),
    ("ball", "inflated ball", "hollow", 90, 0.6, 0.8),
    ("apple|pear|peach|plum|nectarine", "fruit", "solid", 850, 0.45, 0.4),
    ("orange|lemon|lime|tangerine|grapefruit", "citrus fruit", "solid", 930, 0.5, 0.45),
    ("strawberry|strawberrie|banana|tomato|tomatoe|grape|kiwi|avocado", "soft fruit", "solid", 950, 0.5, 0.2),
    ("foam brick|foam|sponge", "foam", "solid", 150, 0.7, 0.3),
    ("brick|stone|rock", "stone", "solid", 2000, 0.65, 0.2),
    ("can|tin", "full tin", "solid", 950, 0.4, 0.2),
    ("box|boxe|carton|packet|package", "cardboard with contents", "solid", 400, 0.5, 0.15),
    ("bottle|cleanser|mustard|ketchup|windex|shampoo|detergent", "full plastic bottle", "solid", 950, 0.45, 0.2),
    ("mug|cup|teacup", "ceramic", "hollow", 2000, 0.5, 0.3),
    ("glass|jar|vase", "glass", "hollow", 2400, 0.4, 0.4),
    ("bowl|plate|dish|saucer", "ceramic", "solid", 2200, 0.45, 0.3),
    ("pan|frypan|skillet|pot|kettle|lid", "metal sheet", "solid", 5000, 0.4, 0.25),
    ("hammer|wrench|spanner|pliers|screwdriver|padlock|lock|clamp|drill|key", "steel tool", "solid", 4000, 0.45, 0.25),
    ("spoon|fork|knife|spatula|ladle", "cutlery", "solid", 4500, 0.35, 0.3),
    ("lego|duplo|toy|airplane|car|figurine|cube", "plastic", "hollow", 500, 0.4, 0.3),
    ("book|notebook|magazine|newspaper", "paper", "solid", 750, 0.45, 0.1),
    ("block|wooden|board|plank|tray", "wood", "solid", 650, 0.5, 0.35),
    ("chair|table|stool|shelf|cabinet|desk", "wooden furniture", "hollow", 300, 0.5, 0.2),
    ("bin|basket|bucket|crate", "plastic", "hollow", 900, 0.4, 0.3),
    ("microwave|oven|toaster|printer|monitor|laptop|computer|television|radio", "appliance", "hollow", 350, 0.5, 0.1),
    ("pillow|cushion|teddy|plush|bear|cloth|towel|bag|backpack|shoe", "fabric", "solid", 150, 0.7, 0.05),
)
"""Words, name, structure, density, friction, restitution."""

_KINDS = tuple(
    (
        re.compile(rf"\b(?:{words})s?\b"),
        MaterialPrior(name=name, structure=structure, density=density, friction=friction, restitution=restitution),
    )
    for words, name, structure, density, friction, restitution in _ROWS
)


def material_of(label: str) -> MaterialPrior | None:
    """What a label tells; None where it tells nothing. What a thing is comes last in English, so of several words that
    tell something the last counts, and of those that end there the longest."""
    words = " ".join(re.findall(r"[a-z]+", label.lower()))
    found = [
        (match.end(), match.end() - match.start(), -k)
        for k, (pattern, _) in enumerate(_KINDS)
        for match in pattern.finditer(words)
    ]
    return _KINDS[-max(found)[2]][1] if found else None
