"""The forest of main supports: a mapping from every id to what carries it, which is no key where that is the ground."""

from __future__ import annotations

from collections.abc import Mapping

Supports = Mapping[int, int | None]


def chain_below(id: int, supports: Supports) -> tuple[int, ...]:
    """What carries it, directly or not, nearest first, without the ground. A cycle is followed once."""
    chain: list[int] = []
    at = supports.get(id)
    while at is not None and at in supports and at not in (id, *chain):
        chain.append(at)
        at = supports[at]
    return tuple(chain)


def carried(id: int, supports: Supports) -> frozenset[int]:
    """It and all that it carries, directly or not."""
    return frozenset(i for i in supports if i == id or id in chain_below(i, supports))


def supports_first(supports: Supports) -> list[int]:
    """All ids, each after those below it."""
    return sorted(supports, key=lambda id: (len(chain_below(id, supports)), id))


def circle_of(supports: Supports) -> int | None:
    """The first id that carries itself, directly or not; None where none does."""
    return next((id for id in sorted(supports) if supports.get((chain_below(id, supports) or (id,))[-1]) == id), None)
