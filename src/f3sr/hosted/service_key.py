"""The key of a service: from the environment only, and cut out of every text that a server sends."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field

from f3sr.errors import InputError

MIN_KEY = 8
"""Fewest characters of a key: services give at least thirty, and a short one would be cut out of plain words."""
PART = 12
"""Characters of a key's beginning or end that are cut out too: servers show some of them."""
CUT = "[key]"


@dataclass(frozen=True)
class ServiceKey:
    """A key, or none; it is in no text of this."""

    value: str = field(default="", repr=False)

    def redacted(self, text: str) -> str:
        """A text without the key, its halves and its ends, plain or escaped as in URLs and JSON, in any case."""
        for secret in self._secrets():
            text = re.sub("".join(map(_forms, secret)), CUT, text, flags=re.IGNORECASE)
        return text

    def is_in(self, text: str) -> bool:
        """Whether a text holds the key or a part of it."""
        return self.redacted(text) != text

    def _secrets(self) -> list[str]:
        """The longest first."""
        if not self.value:
            return []
        half = len(self.value) // 2
        parts = {self.value, self.value[:half], self.value[half:], *re.split(r"[:.]", self.value)}
        parts |= {self.value[:PART], self.value[-PART:]}
        return sorted((p for p in parts if len(p) >= MIN_KEY // 2), key=len, reverse=True)


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
