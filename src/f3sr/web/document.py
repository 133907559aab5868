"""A whole HTML document: one file whose policy allows its own style, script and data, and nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from string import Template
from typing import Any

from f3sr.web.markup import Child, Markup, join

WEB = Path(__file__).parent
"""Holds the style and scripts that pages share."""


def document(title: str, body: Child, *, style: Markup, script: Markup, films: bool = False) -> bytes:
    """The document's bytes. ``films``: whether it may show films, from data of its own."""
    policy = (
        f"default-src 'none'; img-src data:; {'media-src data:; ' if films else ''}"
        f"style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    )
    template = Template(part(WEB / "page.html"))
    text = template.substitute(policy=policy, title=join(title), style=style, script=script, body=join(body))
    return text.encode("utf-8")


def data(values: Any) -> Markup:
    """Plain values as JSON that cannot end its script element."""
    return Markup(json.dumps(values, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def part(*files: Path) -> Markup:
    """A style or script of the package, from some files in order."""
    return Markup("".join(file.read_text(encoding="utf-8") for file in files))


def _hash(text: str) -> str:
    """What a content security policy names an inline style or script by."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
