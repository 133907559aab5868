"""What a user may set: configurations whose values are checked, read from TOML and shown with unit and meaning.

A configuration may also hold ``constants`` of its method: code may vary them, a file of settings may not.
"""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, field, fields, is_dataclass
from dataclasses import dataclass as plain_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast, dataclass_transform

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass, is_pydantic_dataclass

from f3sr.errors import InputError
from f3sr.files import limited_file
from f3sr.files.meanings import meanings

T = TypeVar("T")

MAX_BYTES = 1_000_000
"""Largest file of settings: all of them with their meanings take 8 kB."""

LONGEST_SHOWN = 80
"""Characters of a wrong value that an error repeats."""

BOUNDS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
"""Names of bounds in JSON Schema."""


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def settings(cls: type[T]) -> type[T]:
    """An immutable dataclass whose values are checked when it is made: types strictly, ranges as ``annotated_types``
    give them. The docstring below a field is its meaning, with its unit in brackets. Raises pydantic's ValidationError,
    a ValueError."""
    checks = ConfigDict(
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
    )
    return cast(type[T], dataclass(cls, frozen=True, kw_only=True, config=checks))


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def constants(cls: type[T]) -> type[T]:
    """An immutable dataclass of a method's constants. Tests and ablations vary them; no file of settings names them.
    Inside a configuration they belong to the key of its stored results."""
    return plain_dataclass(cls, frozen=True, kw_only=True)


def read(file: Path, defaults: T) -> T:
    """``defaults`` with what a TOML file sets; InputError names the file, the key, what it holds and what it may."""
    accepted = "a TOML file of settings, as `f3sr config` prints one"
    data = limited_file.read(file, most=MAX_BYTES, accepted=accepted)
    try:
        given = tomllib.loads(data.decode("utf-8"))
        return _checked(file, given, defaults)
    except RecursionError:
        raise InputError(file, found="no TOML (nested too deeply)", accepted=accepted) from None
    except ValueError as error:
        raise InputError(file, found=f"no TOML ({error})", accepted=accepted) from None


def with_values(where: str | Path, values: Mapping[str, Any], defaults: T) -> T:
    """``defaults`` with plain values by dotted name, as ``changed`` gives them. Raises InputError naming ``where``."""
    tree = dict[str, Any]()
    for name, value in values.items():
        *tables, last = name.split(".")
        table = tree
        for step in tables:
            table = table.setdefault(step, {})
            if not isinstance(table, dict):
                raise InputError(where, found=f"both a value and a table at {name}", accepted="one of the two")
        table[last] = value
    return _checked(where, tree, defaults)


def _checked(where: str | Path, given: dict[str, Any], defaults: T) -> T:
    """``defaults`` overlaid with a tree of values. Raises InputError for the first that is wrong."""
    complete = json.dumps(_overlaid(asdict(cast(Any, defaults)), given), default=str)
    if unknown := _unknown(where, given, defaults):
        raise unknown
    try:
        return cast(T, TypeAdapter(type(defaults)).validate_json(complete))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise _input_error(where, first, defaults, given) from None


def describe(config: object) -> str:
    """A configuration as TOML, every setting with its unit, range and meaning: what ``read`` reads."""
    return "\n\n".join("\n".join(table) for table in _tables(config, "")) + "\n"


def changed(config: object, defaults: object) -> dict[str, Any]:
    """The settings and constants that differ from the defaults, by dotted name, as JSON has them: tuples are lists."""
    values, standard = dict(_leaves(config)), dict(_leaves(defaults))
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in values.items()
        if value != standard[name]
    }


def _overlaid(base: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with given values in place of its own, table by table."""
    result = dict(base)
    for name, value in given.items():
        old = base.get(name)
        result[name] = _overlaid(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def _unknown(file: str | Path, given: Mapping[str, Any], config: object, table: str = "") -> InputError | None:
    """What is wrong with the first name in a file that is no setting."""
    known = _names(config)
    for name, value in given.items():
        path = f"{table}.{name}" if table else name
        if name not in known:
            where = f"in [{table}]" if table else "the tables"
            return InputError(file, found=f"unknown {path}", accepted=f"{where} {', '.join(known)}")
        inner = getattr(config, name)
        if is_dataclass(inner) and isinstance(value, dict) and (error := _unknown(file, value, inner, path)):
            return error
    return None


def _input_error(file: str | Path, error: Any, defaults: object, given: Any) -> InputError:
    """The first value that is wrong in a file, in the words of an InputError."""
    at, node, value = defaults, dict[str, Any](), given
    path: list[str] = []
    for step in map(str, error["loc"]):
        if not is_dataclass(at):
            break
        path, value = [*path, step], value.get(step)
        at, node = getattr(at, step), _property(at, step)
    name = ".".join(path) or "the file"
    if error["type"] == "value_error":
        return InputError(file, found=f"{name} = {_shown(value)}", accepted=str(error["ctx"]["error"]))
    accepted = f"a table [{name}]" if is_dataclass(at) else _range(node)
    return InputError(file, found=f"{name} = {_shown(value)}", accepted=accepted)


def _shown(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + "..."


def _names(config: object) -> list[str]:
    """What a user may set in a configuration: values and tables, no constants."""
    values = {f.name: getattr(config, f.name) for f in fields(cast(Any, config))}
    return [name for name, v in values.items() if not is_dataclass(v) or is_pydantic_dataclass(type(v))]


def _tables(config: object, path: str) -> Iterator[list[str]]:
    """Lines of a table, its values first, then of the tables inside it, as TOML wants it."""
    names = _names(config)
    tables = [name for name in names if is_dataclass(getattr(config, name))]
    if len(tables) < len(names):
        yield [f"[{path}]", *(line for name in names if name not in tables for line in _lines(config, name))]
    for name in tables:
        yield from _tables(getattr(config, name), f"{path}.{name}" if path else name)


def _lines(config: object, name: str) -> tuple[str, str]:
    """One setting: its meaning and range, then its value."""
    node = _property(config, name)
    meaning = " ".join(meanings(type(config)).get(name, "").split())
    return f"# {meaning} ({_range(node)})", f"{name} = {json.dumps(getattr(config, name))}"


def _leaves(config: object, path: str = "") -> Iterator[tuple[str, Any]]:
    for f in fields(cast(Any, config)):
        value = getattr(config, f.name)
        name = f"{path}.{f.name}" if path else f.name
        if is_dataclass(value):
            yield from _leaves(value, name)
        else:
            yield name, value


def _property(config: object, name: str) -> dict[str, Any]:
    """The JSON Schema of one setting."""
    return _properties(type(config))[name]


@cache
def _properties(settings: type) -> dict[str, Any]:
    return TypeAdapter(settings).json_schema()["properties"]


def _range(node: Mapping[str, Any]) -> str:
    """What a setting accepts, in words."""
    if "enum" in node:
        return "one of " + ", ".join(map(json.dumps, node["enum"]))
    if node["type"] == "boolean":
        return "true or false"
    if node["type"] == "array":
        items = node.get("prefixItems")
        each = [_range(item) for item in items or [node["items"]]]
        if len(set(each)) > 1:
            return "; ".join(each)
        counts = sorted({node.get("minItems", 0), node.get("maxItems", math.inf)})
        return f"{' to '.join(map(str, counts))} values, each {each[0]}"
    kind = {"integer": "a whole number", "number": "a number", "string": "a text"}[node["type"]]
    bounds = [f"{sign} {node[name]:.8g}" for name, sign in BOUNDS.items() if name in node]
    return " ".join([kind, " and ".join(bounds)]).strip()
