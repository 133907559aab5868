"""Sentences of pages and public docstrings, counted as ASD-STE100 (Simplified Technical English) counts them.

``python tests/prose.py [LIMIT]`` lists every sentence of more than LIMIT words (default 20) and the count per place.

A colon, a parenthesis and a list item end a sentence; a semicolon does not. Inline code and a number are one word each.
Code blocks, tables, headings and pictures are left out.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
GENERATED = {"limits.md", "broken_inputs.md"}
"""Pages that tests write from the code; their tables hold no prose."""

_NO_END = re.compile(r"\b(e\.g|i\.e|vs|etc|cf|al|Fig|No)\.$")


_CODE = str.maketrans(" .:!?()", "\ue000\ue001\ue002\ue003\ue004\ue005\ue006")
_BACK = {new: old for old, new in _CODE.items()}


def sentences(text: str) -> Iterator[str]:
    """Sentences of plain text without markup."""
    text = re.sub(r"``[^`]+``|`[^`]+`", lambda code: code[0].translate(_CODE), text)
    inner = re.findall(r"\(([^()]*)\)", text)
    for part in (*inner, re.sub(r"\([^()]*\)", "()", text)):
        yield from (sentence.translate(_BACK) for sentence in _split(part))


def _split(text: str) -> Iterator[str]:
    start = 0
    for end in re.finditer(r"[.!?:](?=[\s\"'*)]|$)", text):
        if _NO_END.search(text[start : end.end()]):
            continue
        yield text[start : end.end()].strip()
        start = end.end()
    yield text[start:].strip()


def words(sentence: str) -> int:
    """Tokens with a letter or a digit; inline code is one."""
    plain = re.sub(r"``[^`]+``|`[^`]+`", "code", sentence)
    return sum(any(c.isalnum() for c in token) for token in plain.split())


def page_text(source: str) -> Iterator[str]:
    """The paragraphs and list items of a Markdown page, as plain text."""
    source = re.sub(r"^```.*?^```", "", source, flags=re.DOTALL | re.MULTILINE)
    source = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", source)
    source = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", source)
    kept = [line for line in source.splitlines() if not line.startswith(("|", "#", ":::"))]
    yield from _blocks("\n".join(kept))


def _blocks(text: str) -> Iterator[str]:
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        if all(line.startswith("    ") for line in block.strip("\n").splitlines()):
            continue  # code, indented
        plain = re.sub(r"^\s*(?:[-*]|\d+\.)\s+", "", block)
        yield " ".join(plain.replace("*", "").split())


@cache
def pages() -> dict[str, str]:
    """Path to source of README and all pages written by hand."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {str(p.relative_to(ROOT)): p.read_text() for p in found if p.name not in GENERATED}


def docstrings(source: str, *, private: bool = False) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings of a module, its public classes and functions, and their fields."""
    tree = ast.parse(source)
    yield from _docstrings(tree, private)


def _docstrings(node: ast.Module | ast.ClassDef | ast.FunctionDef, private: bool) -> Iterator[tuple[int, str]]:
    for k, child in enumerate(node.body):
        text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant) and child.value.value
        if isinstance(text, str) and (k == 0 or isinstance(node.body[k - 1], ast.AnnAssign | ast.Assign)):
            yield child.lineno, inspect.cleandoc(text)
        if isinstance(child, ast.ClassDef | ast.FunctionDef) and (private or not child.name.startswith("_")):
            yield from _docstrings(child, private)


def long_sentences(limit: int, where: str = "") -> list[tuple[int, str, str]]:
    """(words, place, sentence) of what is longer than ``limit``, in places that begin with ``where``."""
    return [row for row in _counted() if row[0] > limit and row[1].startswith(where)]


@cache
def _counted() -> list[tuple[int, str, str]]:
    """(words, place, sentence) of all pages and docstrings."""
    blocks = [(name, block) for name, source in pages().items() for block in page_text(source)]
    for path in sorted((ROOT / "src").rglob("*.py")):
        name = str(path.relative_to(ROOT))
        for line, text in docstrings(path.read_text()):
            blocks += [(f"{name}:{line}", block) for block in _blocks(text)]
    return [(words(s), place, s) for place, block in blocks for s in sentences(block)]


def main() -> None:
    limit = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    rows = long_sentences(limit, sys.argv[2] if len(sys.argv) > 2 else "")
    for count, where, sentence in rows:
        print(f"{count:3} {where}: {sentence}")
    places = Counter(where.split(":")[0].rsplit("/", 1)[0] for _, where, _ in rows)
    print(f"{len(rows)} sentences of more than {limit} words:", dict(places.most_common()))


if __name__ == "__main__":
    main()
