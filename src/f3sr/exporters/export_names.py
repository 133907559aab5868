"""Names and texts of exported objects: one rule for files, USD prims, links and bodies, whatever a label holds."""

from __future__ import annotations

import re
import unicodedata

from f3sr.errors import printable

LONGEST = 40
"""Most characters of the label in a name: paths stay below the 260 that Windows allows."""
JOINERS = "\u200c\u200d"
"""They part or join letters of Persian and Hindi, and pictures of one sign."""


def export_name(id: int, label: str) -> str:
    """Lower-case letters, digits and ``_``, of which the first is a letter: ``red_mug_03``.

    Accents are dropped; every run of other characters is one ``_``. The id ends it, so names differ where ids do, and
    an id is read off its name. A label without usable characters gives ``object_03``; one that begins with a digit
    gives ``object_7_up_03``.
    """
    plain = unicodedata.normalize("NFKD", label.lower()).encode("ascii", "ignore").decode()
    words = re.sub(r"[^a-z0-9]+", "_", plain)[:LONGEST].strip("_")
    if not words or words[0].isdigit():
        words = f"object_{words}".rstrip("_")
    return f"{words}_{id:02d}"


def export_text(text: str) -> str:
    """A label as XML and USD may hold it: letters and spaces of every script, and joiners, which some words need.

    Control characters, turns of the writing direction and the like are escaped."""
    return "".join(c if c in JOINERS or unicodedata.category(c) == "Zs" else printable(c) for c in text)


def id_of(name: str) -> int:
    """The id at the end of an exported name. Raises ValueError for other names."""
    return int(name.rpartition("_")[2])
