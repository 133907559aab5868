"""HTML that cannot be broken by what it shows: every plain string that goes into an element is escaped."""

from __future__ import annotations

import html
import unicodedata
from collections.abc import Iterable
from typing import Any

LONGEST_TEXT = 600
"""Characters of a text from outside that are shown; a page is no place for more."""
INVISIBLE = {"Cc", "Cs", "Zl", "Zp"}
"""Unicode categories that no label needs: controls, lone surrogates, line separators."""
TURNS = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of the text around them."""
VOID = {"img", "meta", "input", "br"}


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


Child = Any
"""A Markup, anything whose ``str`` is text, None for nothing, or an iterable of these."""


def el(name: str, *children: Child, **attributes: Any) -> Markup:
    """An HTML element. In attribute names a final underscore is dropped, others become hyphens.

    The value None or False omits the attribute, True writes its name alone."""
    start = f"<{name}{''.join(_attribute(k, v) for k, v in attributes.items())}>"
    return Markup(start if name in VOID else f"{start}{join(*children)}</{name}>")


def join(*children: Child) -> Markup:
    """Children after each other, texts escaped."""
    return Markup("".join(_parts(children)))


def clean(text: str) -> str:
    """A text from outside with what a page cannot show replaced, and at most ``LONGEST_TEXT`` long."""
    shown = text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + " …"
    return "".join("\ufffd" if unicodedata.category(c) in INVISIBLE or c in TURNS else c for c in shown)


def _parts(children: Iterable[Child]) -> Iterable[str]:
    for child in children:
        if child is None:
            continue
        if isinstance(child, Markup):
            yield child
        elif isinstance(child, Iterable) and not isinstance(child, str):
            yield from _parts(child)
        else:
            yield html.escape(clean(str(child)))


def _attribute(name: str, value: Any) -> str:
    if value is None or value is False:
        return ""
    name = name.rstrip("_").replace("_", "-")
    if value is True:
        return f" {name}"
    text = value if isinstance(value, Markup) else clean(str(value))
    return f' {name}="{html.escape(text)}"'
