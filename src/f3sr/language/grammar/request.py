"""A goal's words, understood: what is asked of which phrases, before any scene is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from f3sr.goals.plan import Kind, Manner
from f3sr.goals.plan import Way as Preposition
from f3sr.language.grammar.lexicon import Direction, Vague
from f3sr.language.grammar.quantities import Amount

What = Literal["topple", "move", "roll", "bounce", "return", "upright", "grounded", "rest"]


OPPOSITE: dict[Direction, Direction] = {
    "left": "right",
    "right": "left",
    "away": "towards",
    "towards": "away",
    "up": "down",
    "down": "up",
}


@dataclass(frozen=True, kw_only=True)
class WantedOutcome:
    """What must happen beyond the kind of goal: ``push the box into the can so that the can falls over``."""

    what: What
    whose: Literal["active", "target"]


@dataclass(frozen=True, kw_only=True)
class Request:
    """One goal. Phrases are canonical words for ``reference_resolution.resolve``."""

    kind: Kind
    active: str
    """What is set off."""
    target: str | None = None
    preposition: Preposition | None = None
    """How the target is meant: ``into`` it, ``off`` it; None without one."""
    direction: tuple[Direction, ...] = ()
    """Seen from the camera; several are combined."""
    amount: Amount | Vague | None = None
    """How far it goes, or how high it is lifted."""
    manner: Manner | None = None
    outcomes: tuple[WantedOutcome, ...] = ()
    spared: tuple[str, ...] = ()
    """Other things that are to stay upright."""
    text: str = field(default="", compare=False)
    """The goal as it was typed."""
