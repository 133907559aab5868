"""The key of a service: from the environment only, and cut out of every text that a server sends."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, cached_property

from f3sr.errors import InputError

MIN_KEY = 8
"""Fewest characters of a key: services give at least thirty, and a short one would be cut out of plain words."""
PART = 12
"""Characters of a key in a row, anywhere in it, that are cut out: servers show some, and messages are shortened."""
CUT = "[key]"


@dataclass(frozen=True)
class ServiceKey:
    """A key, or none; it is in no text of this."""

    value: str = field(default="", repr=False)

    def redacted(self, text: str) -> str:
        """A text without the key and without its parts, plain or escaped as in URLs and JSON, in any case."""
        end, kept = 0, list[str]()
        for start, stop in _merged(found.span() for part in self._parts for found in part.finditer(text)):
            kept += [text[end:start], CUT]
            end = stop
        return "".join(kept) + text[end:]

    def is_in(self, text: str) -> bool:
        """Whether a text holds the key or a part of it."""
        return self.redacted(text) != text

    @cached_property
    def _parts(self) -> list[re.Pattern[str]]:
        """Patterns of all parts that are long enough to tell. Every text of a server is searched for each."""
        size = min(PART, len(self.value) // 2)
        parts = {self.value[k : k + size] for k in range(len(self.value) - size + 1)} if self.value else set[str]()
        return [re.compile("".join(map(_forms, part)), re.IGNORECASE) for part in parts]


def _merged(spans: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """The same places, those that touch as one."""
    merged = list[tuple[int, int]]()
    for start, stop in sorted(spans):
        if merged and start <= merged[-1][1]:
            merged[-1] = merged[-1][0], max(stop, merged[-1][1])
        else:
            merged.append((start, stop))
    return merged


@cache
def _forms(character: str) -> str:
    """The pattern of a character as it is, after a backslash, or as %41 or \\u0041."""
    return rf"(?:\\?{re.escape(character)}|%{ord(character):02x}|\\u{ord(character):04x})"


def service_key(variable: str) -> ServiceKey:
    """The key in an environment variable; an empty name of one asks for none.

    Raises InputError where it is not set, or cannot be a key."""
    if not variable:
        return ServiceKey()
    value = os.environ.get(variable, "").strip()
    if not value:
        raise InputError(f"${variable}", found="no key", accepted="the key of your account, in this variable")
    if len(value) < MIN_KEY or not re.fullmatch(r"[!-~]+", value):
        accepted = f"a key of at least {MIN_KEY} characters of plain ASCII"
        raise InputError(f"${variable}", found="characters or a length that no key has", accepted=accepted)
    return ServiceKey(value)
