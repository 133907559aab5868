"""Refusals of goals: the reason, one line for people, and words that would be understood."""

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
    "model",
]
SHOWN = 60
"""Most characters of a user's words that a message repeats."""


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why a goal is refused. ``candidates`` are phrases that would be understood in place of the refused words."""

    reason: Reason
    message: str
    """One printable line."""
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
    """A user's words inside a message, shortened to SHOWN characters."""
    return f"'{words if len(words) <= SHOWN else words[: SHOWN - 3] + '...'}'"


def listed(words: tuple[str, ...], last: str = "or") -> str:
    """``a, b or c``"""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else "nothing"
