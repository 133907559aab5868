"""What fields mean, from the docstrings below them, read from the source when somebody asks.

pydantic's ``use_attribute_docstrings`` reads them at every start: a fifth of the time to import the pipeline.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from functools import cache
from itertools import pairwise
from typing import Any

from pydantic import BaseModel, GetJsonSchemaHandler
from pydantic_core import CoreSchema


@cache
def meanings(cls: type) -> dict[str, str]:
    """The docstrings below the fields of a class, and of those it inherits from; by the field's name.

    Empty where the source is not at hand."""
    found = dict[str, str]()
    for base in reversed(cls.__mro__):
        if "__annotations__" in vars(base) and base is not BaseModel:
            found |= _own(base)
    return found


def _own(cls: type) -> dict[str, str]:
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    except (OSError, TypeError):
        return {}
    (definition,) = tree.body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: inspect.cleandoc(below.value.value)
        for field, below in pairwise(definition.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
        and isinstance(below.value.value, str)
    }


class Documented(BaseModel):
    """A model whose JSON Schema says what its fields mean."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema)["properties"]
        for name, meaning in meanings(cls).items():
            properties[name].setdefault("description", meaning)
        return schema
