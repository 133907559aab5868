"""The errors a user can meet, each saying what was asked, what was found and what is accepted."""

from __future__ import annotations

import os
import traceback
from pathlib import Path

LONGEST = 300
"""Characters of a value or a path that a message holds, and"""
LONGEST_LINE = 1000
"""of a whole message."""
TRACEBACK = "F3SR_TRACEBACK"
"""Variable of the environment that asks for the traceback of an error nobody foresaw."""


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


class F3srWarning(UserWarning):
    """Something that works, but not as it was asked for; its message is one line."""


class RefusedError(F3srError):
    """A goal that cannot be acted on; nothing was written for it."""


class MissedError(F3srError):
    """A goal whose best rollout does not meet it; it was written all the same."""


def unforeseen(error: Exception, state: str) -> str:
    """One line on an error that nobody raised on purpose; ``state`` says what is on disk.

    Where ``$F3SR_TRACEBACK`` is set its traceback is printed first."""
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    kind = "out of memory" if isinstance(cause, MemoryError) else f"unforeseen {type(cause).__name__}"
    said = ": ".join(filter(None, (kind, str(cause).strip().partition("\n")[0])))
    return f"{cut(said)}; {state}; {TRACEBACK}=1 shows where"


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
