"""Meanings of fields, read late: the same schema as pydantic makes when it reads them at once."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from f3sr.files.meanings import Documented, meanings


class Late(Documented):
    a: int
    """A number
    on two lines."""
    b: Annotated[str, Field(description="said at the field")] = ""
    """Not this."""
    c: list[int] = Field(default_factory=list)


class LateChild(Late):
    inner: Late | None = None
    """Another one."""


class AtOnce(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True)

    a: int
    """A number
    on two lines."""
    b: Annotated[str, Field(description="said at the field")] = ""
    """Not this."""
    c: list[int] = Field(default_factory=list)


class AtOnceChild(AtOnce):
    inner: AtOnce | None = None
    """Another one."""


def schema(model: type[BaseModel]) -> dict[str, Any]:
    """Of a class: its fields, and those of the class that it names."""
    whole = model.model_json_schema()
    fields = [whole["properties"], *(one["properties"] for one in whole.get("$defs", {}).values())]
    return {
        str(k): {n: {**f, "anyOf": None} if n == "inner" else f for n, f in p.items()} for k, p in enumerate(fields)
    }


def test_a_schema_is_the_one_of_pydantic():
    assert schema(Late) == schema(AtOnce)
    assert schema(LateChild) == schema(AtOnceChild)
    assert schema(LateChild)["0"]["inner"]["description"] == "Another one."


def test_a_class_without_source_has_no_meanings():
    made = type("Made", (), {"__annotations__": {"x": int}})
    assert meanings(made) == {}
