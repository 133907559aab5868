"""Wikidata's codes of what objects are, which catalogues of simulation assets ask for."""

from __future__ import annotations

PHYSICAL_OBJECT = "Q223557"
"""Wikidata's "physical object", true of everything in a scene."""

CODES: dict[str, str] = {
    "apple": "Q89",
    "banana": "Q503",
    "book": "Q571",
    "bottle": "Q80228",
    "bowl": "Q153988",
    "chair": "Q15026",
    "cup": "Q81727",
    "fork": "Q81881",
    "hammer": "Q25294",
    "knife": "Q32489",
    "lemon": "Q1093742",
    "orange": "Q13191",
    "plate": "Q57216",
    "spoon": "Q81895",
    "strawberry": "Q14458220",
    "table": "Q14748",
    "vase": "Q191851",
}
"""By the last word of a label."""


def class_of(label: str) -> str:
    """The code of what the last word of a label names, or of a physical object."""
    words = label.lower().split()
    return CODES.get(words[-1], PHYSICAL_OBJECT) if words else PHYSICAL_OBJECT
