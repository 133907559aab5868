"""JSON from outside: UTF-8, no key twice in an object, no NaN or Infinity, nothing nested beyond reason."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from f3sr.errors import InputError
from f3sr.files import limited_file
from f3sr.files.limited_file import MAX_JSON_BYTES

MAX_DIGITS = 400
"""Longest whole number: no float is longer."""


def read(file: Path, *, most: int = MAX_JSON_BYTES, accepted: str = "a JSON document") -> Any:
    """The value of a JSON file of at most so many bytes. Raises InputError."""
    data = limited_file.read(file, most=most, accepted=accepted)
    try:
        return loads(data)
    except ValueError as error:
        raise InputError(file, found=f"no valid JSON ({error})", accepted=accepted) from error


def loads(data: bytes) -> Any:
    """The value of a JSON text, with or without byte order mark. Raises ValueError with a short reason."""
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


def problem(error: ValidationError, fields: str, page: str = "docs/conventions.md") -> tuple[str, str]:
    """What a document holds, and what is accepted, of the first thing that is wrong with it. ``page`` describes it."""
    first = error.errors(include_url=False)[0]
    where, message = ".".join(map(str, first["loc"])) or "the document", first["msg"]
    if first["type"] == "missing":
        return f"no {where}", f"an object with {fields}"
    if first["type"] == "value_error":
        found, _, accepted = message.removeprefix("Value error, ").partition("; accepted: ")
        return f"{where}: {found}", accepted or f"an object with {fields}"
    if first["type"] == "extra_forbidden":
        return f"an unknown {where} = {first['input']!r:.60}", f"the fields that {page} names"
    if first["type"] in ("model_type", "dict_type"):
        return f"{where} = {first['input']!r:.60}", "an object" if first["loc"] else f"an object with {fields}"
    wanted = re.sub(r"^(Input should be|(Value|List|Tuple|String) should have) | after validation", "", message)
    return f"{where} = {first['input']!r:.60}", wanted
