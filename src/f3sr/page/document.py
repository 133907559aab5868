"""A whole HTML document: one file whose policy allows its own style, script and data, and nothing else."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from string import Template

from f3sr.page.markup import Child, Markup, join


def document(title: str, body: Child, *, style: Markup, script: Markup, films: bool = False) -> bytes:
    """The document's bytes. ``films``: whether it may show films, from data of its own."""
    policy = (
        f"default-src 'none'; img-src data:; {'media-src data:; ' if films else ''}"
        f"style-src {_hash(style)}; script-src {_hash(script)}; base-uri 'none'; form-action 'none'"
    )
    template = Template(part(Path(__file__).parent / "page.html"))
    text = template.substitute(policy=policy, title=join(title), style=style, script=script, body=join(body))
    return text.encode("utf-8")


def part(*files: Path) -> Markup:
    """A style or script of the package, from some files in order."""
    return Markup("".join(file.read_text(encoding="utf-8") for file in files))


def _hash(text: str) -> str:
    """What a content security policy names an inline style or script by."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
