"""The errors a user can meet, each saying what was asked, what was found and what is accepted."""

from __future__ import annotations

from pathlib import Path


class F3srError(Exception):
    """Base of every error that f3sr raises on purpose."""


class InputError(F3srError):
    """Something that was handed in is wrong: one file, what was found in it, what is accepted."""

    def __init__(self, where: str | Path, *, found: str, accepted: str) -> None:
        self.where, self.found, self.accepted = str(where), found, accepted
        super().__init__(f"{where}: found {found}; accepted: {accepted}")


class OutputError(F3srError):
    """The place where results should go cannot take them."""
