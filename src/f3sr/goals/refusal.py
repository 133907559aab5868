"""What is refused: for which reason, told in one line, and what could be said instead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NoReturn

from f3sr.errors import printable

Reason = Literal[
    "empty",
    "long",
    "characters",
    "language",
    "verb",
    "grammar",
    "several",
    "contradiction",
    "negation",
    "other",
    "amount",
    "direction",
    "unknown",
    "ambiguous",
    "plural",
    "fixed",
    "same",
    "impossible",
]
SHOWN = 60
"""Characters of somebody's words that a message repeats."""


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why words are not acted on, and the phrases that would be understood in their place."""

    reason: Reason
    message: str
    """One line that any terminal can show."""
    candidates: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "message", printable(self.message))


class NotUnderstoodError(Exception):
    """Carries a refusal from the word that fails to the function that was asked."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.message)
        self.refusal = refusal


def refuse(reason: Reason, message: str, candidates: tuple[str, ...] = ()) -> NoReturn:
    """Raises NotUnderstoodError with a refusal."""
    raise NotUnderstoodError(Refusal(reason=reason, message=message, candidates=candidates))


def quoted(words: str) -> str:
    """Somebody's words inside a message, cut where they are long."""
    return f"'{words if len(words) <= SHOWN else words[: SHOWN - 3] + '...'}'"


def listed(words: tuple[str, ...], last: str = "or") -> str:
    """``a, b or c``"""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else "nothing"
