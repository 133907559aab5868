"""A request whose words are settled, as the planner hands it to the conditions of success."""

from __future__ import annotations

from dataclasses import dataclass

from f3sr.core.transforms import Array
from f3sr.language.grammar.request import Request


@dataclass(frozen=True, eq=False, kw_only=True)
class Meant:
    """A request whose words are settled: objects, direction and metres."""

    request: Request
    active: int
    target: int | None
    direction: Array | None
    """Unit vector (3,) of the world."""
    amount: float
    """[m]"""
    asked: bool
    """Whether the words gave the amount."""
    assumptions: tuple[str, ...]
