"""Programs whose scenes can be imported, in the order in which a folder is asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from f3sr.importing import fysiverse
from f3sr.importing.composition import Composition


@dataclass(frozen=True, kw_only=True)
class Producer:
    """A program: how its folders are told, and how they are read."""

    accepted: str
    """What its folder holds, for messages."""
    matches: Callable[[Path], bool]
    read: Callable[[Path], Composition]


PRODUCERS = (
    Producer(
        accepted=f"a session of Fysiverse-3D, with {fysiverse.MANIFEST}", matches=fysiverse.matches, read=fysiverse.read
    ),
)
