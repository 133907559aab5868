"""A whole HTML document from a template: one file whose policy allows its own style, script and data, nothing else.

Templates escape every text. What they print unescaped is marked ``|safe`` and comes from this package.
"""

from __future__ import annotations

import base64
import hashlib
import unicodedata
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment

WEB = Path(__file__).parent
"""Holds the style, scripts and base template that pages share."""
LONGEST_TEXT = 600
"""Characters of a text from outside that are shown."""
INVISIBLE = {"Cc", "Cs", "Zl", "Zp"}
"""Unicode categories that no label needs: controls, lone surrogates, line separators."""
TURNS = set("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Characters that turn the direction of the text around them."""


def document(
    template: Path,
    values: Mapping[str, Any],
    *,
    styles: tuple[Path, ...],
    scripts: tuple[Path, ...],
    films: bool = False,
    pictures: bool = False,
    served: bool = False,
) -> bytes:
    """The bytes of the document that ``template`` makes of ``values``, with its files of style and script.

    Other templates are found beside it. ``films``: whether it may show films, from data of its own. ``pictures``:
    whether it may show pictures from files beside it. ``served``: whether it may show pictures of the server that it
    comes from, and ask that server.
    """
    style, script = _joined(styles), _joined(scripts)
    beside = " 'self'" if served else " 'self' file:" if pictures else ""
    asked = "connect-src 'self'; " if served else ""
    policy = (
        f"default-src 'none'; img-src data:{beside}; {'media-src data:; ' if films else ''}{asked}"
        f"style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    )
    page = environment(template.parent).get_template(template.name)
    return page.render(values, policy=policy, style=style, script=script).encode("utf-8")


@cache
def environment(folder: Path) -> Environment:
    """Templates of ``folder`` and those that pages share. Every text is cleaned and escaped, also in JSON; a name
    without a value is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    found = Environment(
        loader=FileSystemLoader([folder, WEB / "templates"]),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return found


def clean(text: str) -> str:
    """A text from outside with what a page cannot show replaced, and at most ``LONGEST_TEXT`` long."""
    shown = text if len(text) <= LONGEST_TEXT else text[:LONGEST_TEXT] + " …"
    return "".join("\ufffd" if unicodedata.category(c) in INVISIBLE or c in TURNS else c for c in shown)


def _shown(value: Any) -> Any:
    """What a template prints of a value: its clean text, or markup as it is."""
    assert value is not None, "a template says itself what stands for nothing"
    return value if hasattr(value, "__html__") else clean(str(value))


def _joined(files: tuple[Path, ...]) -> str:
    return "".join(file.read_text(encoding="utf-8") for file in files)


def _hash(text: str) -> str:
    """What a content security policy names an inline style or script by."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
