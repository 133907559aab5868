"""JSON from outside: UTF-8, no key twice in an object, no NaN or Infinity, nothing nested beyond reason."""

from __future__ import annotations

import json
from typing import Any

MAX_DIGITS = 400
"""Longest whole number: no float is longer."""


def loads(data: bytes) -> Any:
    """The value of a JSON text, with or without byte order mark; ValueError says in a few words what is wrong."""
    try:
        return json.loads(
            data.decode("utf-8-sig"), object_pairs_hook=_once, parse_constant=_no_number, parse_int=_whole
        )
    except json.JSONDecodeError as error:
        raise ValueError(f"{error.msg}, line {error.lineno} column {error.colno}") from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 at byte {error.start}") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    tree = dict(pairs)
    if len(tree) < len(pairs):
        twice = next(key for k, (key, _) in enumerate(pairs) if key in {p[0] for p in pairs[:k]})
        raise ValueError(f"the key {twice[:60]!r} twice in one object")
    return tree


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def _no_number(name: str) -> Any:
    raise ValueError(f"{name} is no JSON number")
