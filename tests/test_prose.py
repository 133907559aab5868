"""Laws of the project's English: short sentences, and the field's own terms instead of private ones."""

from __future__ import annotations

import re

import pytest

from prose import docstrings, long_sentences, page_text, pages, sentences, words

PAGE, DOCSTRING = 20, 30
"""Most words of a sentence."""
PRIVATE = r"\b(told|as it came|as they came|seated|but for|whatever|the picture feels|beside)\b"
"""Words that once were terms of this project only; docs/glossary.md has the field's."""


def test_no_sentence_of_a_page_is_long() -> None:
    assert [row for row in long_sentences(PAGE) if not row[1].startswith("src/")] == []


def test_no_sentence_of_a_public_docstring_is_very_long() -> None:
    rows = long_sentences(DOCSTRING, "src/")
    assert rows == []


@pytest.mark.parametrize("page", pages())
def test_pages_use_no_private_terms(page: str) -> None:
    text = " ".join(page_text(pages()[page]))
    assert re.findall(PRIVATE, text) == []


def test_sentences_are_counted_as_they_are_read() -> None:
    text = "First `a.b: c` one (an aside, as such). Second:\nthird, e.g. this one"
    assert [words(s) for s in sentences(text)] == [4, 3, 1, 4]
    page = (
        "# A heading\n\n| a | table |\n\n- one item\n- [another](x.md) **item**\n\n```sh\ncode\n```\n\n    more code\n"
    )
    assert [block for block in page_text(page) if block] == ["one item", "another item"]


def test_docstrings_of_private_things_and_bodies_are_left_out() -> None:
    source = '"""Module."""\nx = 1\n"""Field."""\n\ndef f():\n    """Public."""\n\ndef _g():\n    """Own."""\n'
    assert [text for _, text in docstrings(source)] == ["Module.", "Field.", "Public."]
