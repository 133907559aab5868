"""The errors that a user can meet. A message is one line: the place, what was found, what is accepted."""

from __future__ import annotations

import os
import traceback
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import cast

LONGEST = 300
"""Most characters of a value or a path in a message."""
LONGEST_LINE = 1000
"""Most characters of a whole message."""
TRACEBACK = "F3SR_TRACEBACK"
"""Environment variable that asks for the traceback of an unforeseen error."""


class F3srError(Exception):
    """Base of every error that f3sr raises on purpose; its message is one printable line."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class InputError(F3srError):
    """An input is invalid. ``where`` names the file or setting; ``found`` and ``accepted`` say what and what instead.

    The command line ends with exit code 2.
    """

    def __init__(self, where: str | Path, *, found: str, accepted: str) -> None:
        self.where, self.accepted = str(where), accepted
        self.found = cut(found)
        super().__init__(f"{cut(self.where)}: found {self.found}; accepted: {accepted}")


class OutputError(F3srError):
    """The output path cannot be used; nothing was written there. The command line ends with exit code 1."""


class NoAnswerError(F3srError):
    """A service gave no answer. What can be done without it is done without, and the report says so."""


class F3srWarning(UserWarning):
    """A request was carried out in another way than asked; the message is one line."""


class RefusedError(F3srError):
    """A goal was refused; nothing was written for it. Exit code 3."""


class MissedError(F3srError):
    """The best rollout of a goal does not meet it; it was written. Exit code 4."""


def require_known(option: str, names: Collection[str], known: Sequence[str]) -> None:
    """Raise InputError where an option has a value that is none of ``known``."""
    if unknown := sorted(set(names) - set(known)):
        raise InputError(option, found=", ".join(unknown), accepted=", ".join(known))


def require_kind(where: str, value: object, *kinds: type, accepted: str) -> None:
    """Raise InputError unless an argument is of one of the ``kinds``: a path is often given for what is in it."""
    if not isinstance(value, kinds):
        found = "a path" if isinstance(value, str | os.PathLike) else f"a value of type {type(value).__name__}"
        raise InputError(where, found=found, accepted=accepted)


def require_path(where: str, value: object, *, accepted: str = "a path") -> Path:
    """An argument that names a file or a folder. Raises InputError for a value of another kind."""
    require_kind(where, value, str, os.PathLike, accepted=accepted)
    return Path(os.fspath(cast("str | os.PathLike[str]", value)))


def require_names(where: str, names: object) -> None:
    """Raise InputError for anything but a collection of names: the letters of a text would count as names."""
    if isinstance(names, str):
        raise InputError(where, found="a text", accepted="a list of names")
    require_kind(where, names, Collection, accepted="a list of names")
    if strange := [name for name in cast(Collection[object], names) if not isinstance(name, str)]:
        raise InputError(where, found=f"{strange[0]!r:.60} in it", accepted="a list of names")


def unforeseen(error: Exception, state: str) -> str:
    """One line about an unforeseen error; ``state`` says what is on disk.

    If ``$F3SR_TRACEBACK`` is set, its traceback is printed first.
    """
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    kind = "out of memory" if isinstance(cause, MemoryError) else f"unforeseen {type(cause).__name__}"
    said = ": ".join(filter(None, (kind, str(cause).strip().partition("\n")[0])))
    return f"{cut(said)}; {state}; {TRACEBACK}=1 shows where"


def reason(error: OSError | ValueError | RuntimeError) -> str:
    """The system's reason for a failed access, for the middle of a sentence."""
    text = (getattr(error, "strerror", None) or "unreadable").strip()
    return text[:1].lower() + text[1:]


def one_line(message: str) -> str:
    """The message as one printable line of at most LONGEST_LINE characters."""
    return cut(printable(message), LONGEST_LINE)


def cut(text: str, most: int = LONGEST) -> str:
    """The text, without its middle if it has more than ``most`` characters: its ends are most informative."""
    half = (most - 3) // 2
    return text if len(text) <= most else f"{text[:half]}...{text[-half:]}"


def printable(text: str) -> str:
    """The text with escapes for characters that move the cursor, turn the writing direction or are invisible."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
