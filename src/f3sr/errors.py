"""The errors a user can meet, each saying what was asked, what was found and what is accepted."""

from __future__ import annotations

from pathlib import Path

LONGEST = 300
"""Characters of a value or a path that a message holds, and"""
LONGEST_LINE = 1000
"""of a whole message."""


class F3srError(Exception):
    """Base of every error that f3sr raises on purpose; its message is one line that any terminal can show."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class InputError(F3srError):
    """Something that was handed in is wrong: one file, what was found in it, what is accepted."""

    def __init__(self, where: str | Path, *, found: str, accepted: str) -> None:
        self.where, self.accepted = str(where), accepted
        self.found = cut(found)
        super().__init__(f"{cut(self.where)}: found {self.found}; accepted: {accepted}")


class OutputError(F3srError):
    """The place where results should go cannot take them."""


class RefusedError(F3srError):
    """A goal that cannot be acted on; nothing was written for it."""


class MissedError(F3srError):
    """A goal whose best rollout does not meet it; it was written all the same."""


def reason(error: OSError | ValueError | RuntimeError) -> str:
    """What the system says of a failed access, in the middle of a sentence."""
    text = (getattr(error, "strerror", None) or "unreadable").strip()
    return text[:1].lower() + text[1:]


def one_line(message: str) -> str:
    """A message as any terminal can show it."""
    return cut(printable(message), LONGEST_LINE)


def cut(text: str, most: int = LONGEST) -> str:
    """The text without its middle where it is longer: what begins it and what ends it tell the most."""
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}...{text[-half:]}"


def printable(text: str) -> str:
    """The text with everything escaped that would move a cursor, turn the writing direction or not show at all."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
