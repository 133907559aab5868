"""Text as it is typed to plain words: one case, one spelling, one space between them, no articles.

All work is linear in the text, which is at most 300 characters long.
"""

from __future__ import annotations

import re
import unicodedata
from typing import NoReturn

from f3sr.goals.refusal import quoted, refuse
from f3sr.language.grammar.lexicon import Rules, lexicon

LONGEST = 300
"""Characters of a goal: a sentence or two."""
SYMBOLS = "+=<>~$%|^`°⁄−×"
"""Characters besides letters, digits and punctuation that are read over."""
DASHES = re.compile("[\u2010-\u2015\u2212]")
FRACTIONS = re.compile("(?=[\u00bc-\u00be\u2150-\u215e])")
"""Before one half and its like, which compatibility forms would glue to the number that precedes."""
TYPED: tuple[tuple[str, str], ...] = (
    ("\u2044", "/"),
    ("%", " percent "),
    (r"(\d\s*[^\W\d_]+)/(?=(?:s|h|min|sec|hour|second)\b)", r"\1 per "),
    ("°", " degrees "),
    (r"[.!?;:\n](?=\s+\S*[^\W_])", " and then "),
    ("['\u2018\u2019\u02bc`]", ""),
    (r"(?<![\w.,])-\s?(?=[.\d])", " minus "),
    (r"(?<=\d),(?=\d{3}\b)", ""),
    (r"(?<=\d),(?=\d)", "."),
    (r"(?<![\d.])\.(?=\d)", "0."),
    (r"(\d)(?!st\b|nd\b|rd\b|th\b)(?=[^\W\d_])", r"\1 "),
)
"""What is typed, and what it becomes, in this order."""
SCIENTIFIC = re.compile(r"\b\d+(?:\.\d+)?e\+?\d+\b")
TOKEN = re.compile(r"\d+(?:\.\d+|/\d+)?(?:st|nd|rd|th)?\b|\d+|[^\W\d_]+")
"""A number, an ordinal number or a word."""


def plain(text: str) -> str:
    """The text in small letters without accents and punctuation; hyphens part words, a minus stays with its number.
    Raises NotUnderstoodError where it is empty, too long, or holds what is not written English."""
    if len(text) > LONGEST:
        refuse("long", f"the goal has {len(text):,} characters; accepted: one sentence, at most {LONGEST}")
    if strange := next((c for c in text if not _english(c)), None):
        _refuse_character(strange)
    return _spaced(text) or refuse("empty", "the goal has no words; accepted: 'push the cup to the left'")


def canonical(words: str) -> str:
    """Plain words without articles, relations spelt one way: ``to the left of`` is ``left-of``. Twice is as once."""
    return rewritten(words, lexicon().spellings)


def rewritten(words: str, rules: Rules) -> str:
    """Words after all rules, each applied once in order, with one space between words."""
    for pattern, replacement in rules:
        words, found = pattern.subn(replacement, words)
        words = " ".join(words.split()) if found else words
    return words


def words_of(text: str) -> tuple[str, ...]:
    """The plain words of a label, whatever it holds."""
    return tuple(_spaced(text).split())


def spoken(phrase: str) -> str:
    """A canonical phrase as a person says it: ``next-to`` is ``next to``."""
    return phrase.replace("-", " ")


def _english(c: str) -> bool:
    kind = unicodedata.category(c)
    if kind[0] == "L":
        return unicodedata.name(c, "").startswith(("LATIN", "FULLWIDTH LATIN", "MASCULINE", "FEMININE"))
    known = c in SYMBOLS or c in " \t\r\n" or c in "0123456789"
    return known or kind[0] == "P" or kind in ("Zs", "No") or "\u0300" <= c <= "\u036f"


def _refuse_character(c: str) -> NoReturn:
    name = unicodedata.name(c, "a control character").lower()
    if unicodedata.category(c)[0] == "L":
        refuse("language", f"the goal holds {quoted(name)}; accepted: English in Latin letters")
    refuse("characters", f"the goal holds U+{ord(c):04X} ({name}); accepted: letters, digits, punctuation")


def _spaced(text: str) -> str:
    """Words and numbers with one space between them."""
    text = unicodedata.normalize("NFKD", FRACTIONS.sub(" ", DASHES.sub("-", text))).casefold()
    text = "".join(c for c in text if not unicodedata.combining(c))
    text = SCIENTIFIC.sub(lambda m: f"{min(float(m[0]), 1e12):f}", text)
    for pattern, replacement in TYPED:
        text = re.sub(pattern, replacement, text)
    return " ".join(TOKEN.findall(text))
