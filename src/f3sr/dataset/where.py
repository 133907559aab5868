"""Conditions on rows of the index, as ``mIoU_visible > .9 and not (label contains "mug")``: read, never evaluated.

condition := all {"or" all}        all := one {"and" one}
one := "not" one | "(" condition ")" | COLUMN test
test := ("=" | "==" | "!=" | "<" | "<=" | ">" | ">=") VALUE | "contains" TEXT | "in" "(" VALUE {"," VALUE} ")"
        | "is" ["not"] "null"
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

from f3sr.dataset.columns import COLUMNS, Column, Kind, Type
from f3sr.dataset.index import arrow
from f3sr.errors import InputError

LONGEST = 2000
"""Characters of a condition."""
DEEPEST = 20
"""Parentheses and negations inside each other."""
TOKEN = re.compile(
    r"""\s*(?:(?P<text>"[^"]*"|'[^']*')|(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.])"""
    r"""|(?P<name>[A-Za-z_][\w-]*)|(?P<sign><=|>=|!=|==|[=<>(),]))"""
)
COMPARED: Mapping[str, Callable[[Any, Any], Any]] = {
    "=": operator.eq, "==": operator.eq, "!=": operator.ne,
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
}  # fmt: skip
BY_NAME: Mapping[str, Column] = {column.name: column for column in COLUMNS}


def condition(text: str, kind: Kind = "scene", where: str = "--where") -> Any:
    """The Arrow expression of a condition on rows of a kind. Raises InputError naming what is wrong and what is
    accepted."""
    if len(text) > LONGEST:
        raise InputError(where, found=f"{len(text)} characters", accepted=f"at most {LONGEST}")
    return _ConditionReader(text, kind, where).whole()


class _ConditionReader:
    def __init__(self, text: str, kind: Kind, where: str) -> None:
        self.text, self.kind, self.where, self.at = text, kind, where, 0
        self.tokens, self.depth = self._split(), 0
        self.pc: Any = arrow("pyarrow.compute")

    def whole(self) -> Any:
        found = self._or()
        if self.at < len(self.tokens):
            raise self._wrong("and, or, or the end")
        return found

    def _split(self) -> list[tuple[str, str]]:
        tokens: list[tuple[str, str]] = []
        at = 0
        while self.text[at:].strip():
            found = TOKEN.match(self.text, at)
            if found is None:
                shown = self.text[at:].strip()[:20]
                raise InputError(self.where, found=f"{shown!r}", accepted="columns, numbers, texts in quotes, signs")
            tokens.append((str(found.lastgroup), found[str(found.lastgroup)]))
            at = found.end()
        return tokens

    def _or(self) -> Any:
        found = self._and()
        while self._took("or"):
            found = found | self._and()
        return found

    def _and(self) -> Any:
        found = self._one()
        while self._took("and"):
            found = found & self._one()
        return found

    def _one(self) -> Any:
        self.depth += 1
        if self.depth > DEEPEST:
            raise InputError(self.where, found="a condition nested too deeply", accepted=f"{DEEPEST} levels")
        try:
            if self._took("not"):
                return ~self._one()
            if self._took("("):
                found = self._or()
                self._need(")")
                return found
            return self._test()
        finally:
            self.depth -= 1

    def _test(self) -> Any:
        name = self._column()
        field, type_ = self.pc.field(name), BY_NAME[name].type
        if self._took("is"):
            negated = self._took("not")
            self._need("null")
            return field.is_valid() if negated else field.is_null()
        if self._took("in"):
            self._need("(")
            values = [self._value(type_)]
            while self._took(","):
                values.append(self._value(type_))
            self._need(")")
            return field.isin(values)
        if type_ == "text" and self._took("contains"):
            return self.pc.match_substring(field, self._value(type_), ignore_case=True)
        sign = self._next(f"one of {' '.join(COMPARED)}, in, is null{', contains' if type_ == 'text' else ''}")
        if sign[1] not in COMPARED:
            self.at -= 1
            raise self._wrong(f"one of {' '.join(COMPARED)}, in, is null{', contains' if type_ == 'text' else ''}")
        return COMPARED[sign[1]](field, self._value(type_))

    def _column(self) -> str:
        kind, name = self._next("a column")
        own = [column.name for column in COLUMNS if self.kind in column.of]
        if kind != "name" or name not in BY_NAME:
            self.at -= 1
            raise self._wrong(f"a column: {', '.join(own)}")
        if self.kind not in (of := BY_NAME[name].of):
            found = f"the column {name}, which rows of {self.kind}s do not have"
            raise InputError(self.where, found=found, accepted=f"{', '.join(own)}; or --of {of[0]}")
        return name

    def _value(self, type_: Type) -> Any:
        wanted = "a text in quotes" if type_ == "text" else "a number"
        kind, word = self._next(wanted)
        if kind == "text" and type_ == "text":
            return word[1:-1]
        if kind == "number" and type_ != "text" and math.isfinite(float(word)):
            return float(word)
        self.at -= 1
        raise self._wrong(wanted)

    def _took(self, word: str) -> bool:
        taken = self.at < len(self.tokens) and self.tokens[self.at][1] == word and self.tokens[self.at][0] != "text"
        self.at += taken
        return taken

    def _need(self, word: str) -> None:
        if not self._took(word):
            raise self._wrong(word)

    def _next(self, wanted: str) -> tuple[str, str]:
        if self.at >= len(self.tokens):
            raise self._wrong(wanted)
        self.at += 1
        return self.tokens[self.at - 1]

    def _wrong(self, accepted: str) -> InputError:
        found = repr(self.tokens[self.at][1]) if self.at < len(self.tokens) else "the end"
        return InputError(self.where, found=f"{found} in {self.text!r}", accepted=accepted)
