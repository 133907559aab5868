"""Text as it is typed to plain words: one case, one spelling, one space between them, no articles.

All work is linear in the text, which is at most 300 characters long.
"""

from __future__ import annotations

import re
import unicodedata

from f3sr.goals.refusal import Refusal

LONGEST = 300
"""Characters of a goal: a sentence or two."""
SYMBOLS = "+=<>~$%|^`°⁄−×"
"""Characters besides letters, digits and punctuation that are read over."""
DASHES = re.compile("[\u2010-\u2015\u2212]")
FRACTIONS = re.compile("(?=[\u00bc-\u00be\u2150-\u215e])")
"""Before one half and its like, which compatibility forms would glue to the number that precedes."""
ARTICLES = re.compile(r"\b(?:the|an?|this|my|your|our)\b")

SPELLINGS: tuple[tuple[str, str], ...] = (
    (r"\b(?:across|along) (?:ground|floor|table|tabletop|desk|surface|counter)\b", ""),
    (r"\b(left|right|front|back)(?: hand)? side\b|\b(left|right) hand\b", r"\1\2"),
    (r"\b(?:far|very|extreme) (left|right)(?:most)?\b", r"\1"),
    (r"\b(?:right|just|directly|immediately) (?=(?:next to|beside|in front of|behind|under|on top)\b)", ""),
    (r"\b(?:that|which) (?:is|are|lies|stands|sits|rests) (?:(?:lying|standing|sitting|resting) )?", ""),
    (r"\b(?:lying|standing|sitting|resting|placed|located) (?=(?:on|in|next|beside|at|under|behind|near)\b)", ""),
    (r"\b(left|right|front|back|rear) of (?:ground|floor|table|tabletop|desk|counter|photo|picture|image)\b", r"\1"),
    (r"\b(?:whatever|anything that|something that) is\b", "thing"),
    (r"\b(?:(?:to|on|at) )?(left|right) of\b", r"\1-of"),
    (r"\b(?:on (?:the )?top of|atop|upon)\b", "on"),
    (r"\bon to\b", "onto"),
    (r"\bin to\b", "into"),
    (r"\b(?:inside of|inside|within)\b", "in"),
    (r"\b(?:next to|beside|near to|near|close to|adjacent to|touching|alongside)\b", "next-to"),
    (r"\bin front of\b", "in-front-of"),
    (r"\b(?:underneath|below|beneath)\b", "under"),
    (r"\baway from\b", "away-from"),
    (r"\b(?:out of|off of)\b", "off"),
    (r"\b(?:in (?:the )?direction of|toward)\b", "towards"),
    (r"\bup against\b", "against"),
    (r"\b(?:with (?:the )?help of|using|by means of)\b", "with"),
    (r"\b(?:nearest|closest) to\b", "nearest-to"),
    (r"\b(?:farthest|furthest)(?: away)? from\b", "farthest-from"),
    (r"\b(?:straight |high )?(?:up )?(?:into|in) (?:the )?air\b|\bstraight up\b", "upwards"),
)
"""What means the same in one spelling, in this order; words with a hyphen are one word from here on."""
_SPELLINGS = tuple((re.compile(pattern), plain) for pattern, plain in SPELLINGS)


def plain(text: str) -> str | Refusal:
    """The text in small letters without accents and punctuation; hyphens part words, a minus stays with its number.
    Refused where it is empty, too long, or holds what is not written English."""
    if len(text) > LONGEST:
        return Refusal(
            reason="long", message=f"the goal has {len(text):,} characters; accepted: one sentence, at most {LONGEST}"
        )
    if strange := next((c for c in text if not _english(c)), None):
        return _foreign(strange)
    words = _spaced(text)
    return words or Refusal(reason="empty", message="the goal has no words; accepted: 'push the cup to the left'")


def canonical(words: str) -> str:
    """Plain words without articles, relations spelt one way: ``to the left of`` is ``left-of``. Twice is as once."""
    words = " ".join(ARTICLES.sub(" ", words).split())
    for pattern, replacement in _SPELLINGS:
        words = pattern.sub(replacement, words)
    return " ".join(words.split())


def words_of(text: str) -> tuple[str, ...]:
    """The plain words of a label, whatever it holds."""
    return tuple(_spaced(text).split())


def each(words: str) -> list[str]:
    """Words of a table, written with spaces between them."""
    return words.split()


def spoken(phrase: str) -> str:
    """A canonical phrase as one would say it."""
    return phrase.replace("-", " ")


def _english(c: str) -> bool:
    kind = unicodedata.category(c)
    if kind[0] == "L":
        return unicodedata.name(c, "").startswith(("LATIN", "FULLWIDTH LATIN", "MASCULINE", "FEMININE"))
    known = c in SYMBOLS or c in " \t\r\n" or c in "0123456789"
    return known or kind[0] == "P" or kind in ("Zs", "No") or "\u0300" <= c <= "\u036f"


def _foreign(c: str) -> Refusal:
    name = unicodedata.name(c, "a control character").lower()
    if unicodedata.category(c)[0] == "L":
        return Refusal(reason="language", message=f"the goal holds a {name}; accepted: English in Latin letters")
    found = f"U+{ord(c):04X} ({name})"
    return Refusal(reason="characters", message=f"the goal holds {found}; accepted: letters, digits, punctuation")


def _spaced(text: str) -> str:
    """Words and numbers with one space between them."""
    text = unicodedata.normalize("NFKD", FRACTIONS.sub(" ", DASHES.sub("-", text))).casefold()
    text = "".join(c for c in text if not unicodedata.combining(c))
    text = text.replace("\u2044", "/").replace("%", " percent ").replace("°", " degrees ")
    text = re.sub(r"[.!?;:\n](?=\s+\S*[^\W_])", " and then ", text)
    text = re.sub("['\u2018\u2019\u02bc`]", "", text)
    text = re.sub(r"\b\d+(?:\.\d+)?e\+?\d+\b", lambda m: f"{min(float(m[0]), 1e12):f}", text)
    text = re.sub(r"(?<![\w.,])-\s?(?=[.\d])", " minus ", text)
    text = re.sub(r"(?<=\d),(?=\d{3}\b)", "", text)
    text = re.sub(r"(?<=\d),(?=\d)", ".", text)
    text = re.sub(r"(?<![\d.])\.(?=\d)", "0.", text)
    text = re.sub(r"(\d)(?!st\b|nd\b|rd\b|th\b)(?=[^\W\d_])", r"\1 ", text)
    return " ".join(re.findall(r"\d+(?:\.\d+|/\d+)?(?:st|nd|rd|th)?\b|\d+|[^\W\d_]+", text))
