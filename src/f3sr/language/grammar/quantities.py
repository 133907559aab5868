"""How far and how: amounts in metres or in an object's own sizes, vague words for distance and force.

    amount  = {lead} ["minus"] number {["and"] number} ["of"] ["its own"] unit ["high" | "far"]
            | lead ["a"] unit | "a" unit | "by" ["its"] ["own"] size
    number  = digits | digits "/" digits | word of number

The words of every part are in ``vocabulary/amounts.toml``. Whoever takes an amount out of a goal leaves ``|``.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, NoReturn, TypeVar

from f3sr.goals.plan import Manner
from f3sr.goals.refusal import quoted, refuse
from f3sr.language.grammar.lexicon import Unit, Vague, lexicon

LARGEST = 100.0
"""Largest amount, in metres or in an object's own sizes."""
GONE = " | "
"""What stands where an amount or a manner was."""
Meaning = TypeVar("Meaning", bound=str)


@dataclass(frozen=True, kw_only=True)
class Amount:
    """``value`` metres, or so many of the active object's own sizes."""

    value: float
    unit: Unit = "m"


class Patterns(NamedTuple):
    """The expressions that find amounts."""

    number: re.Pattern[str]
    one: re.Pattern[str]
    """A unit without a number."""
    wrong: re.Pattern[str]
    """A number of something else."""
    speed: re.Pattern[str]
    """A length in a time."""


def amount_in(words: str) -> tuple[str, Amount | Vague | None]:
    """The words with ``|`` where the amount was, and the amount. Raises NotUnderstoodError where the amount is out
    of range or no length, and where there are two."""
    if speed := _patterns().speed.search(words):
        refuse("amount", f"{quoted(speed[0])} is a speed; accepted: a distance, as '20 cm', and 'gently' or 'hard'")
    found: list[Amount | Vague] = []
    for pattern in _patterns()[:2]:
        found += [_amount(match) for match in pattern.finditer(words)]
        words = pattern.sub(GONE, words)
    if wrong := _patterns().wrong.search(words):
        _refuse_amount(wrong[0])
    words, vague = _taken(words, lexicon().vague)
    found += vague
    if len(found) > 1:
        refuse("contradiction", "the goal gives two distances; accepted: one")
    return words, found[0] if found else None


def manner_in(words: str) -> tuple[str, Manner | None]:
    """The words with ``|`` where they say how hard, and how hard. Raises NotUnderstoodError where they say both."""
    words, found = _taken(words, lexicon().manner)
    if len(set(found)) > 1:
        refuse("contradiction", "the goal says both gently and hard; accepted: one of them")
    return words, found[0] if found else None


def _taken(words: str, meanings: Mapping[Meaning, Sequence[str]]) -> tuple[str, list[Meaning]]:
    """Words without those of some meanings, and which meanings were there. Adverbs count anywhere, what may also
    describe a thing (a hard disk, the far cup) only where no noun follows."""
    after = rf"(?=$| \|| (?:{'|'.join(lexicon().amount_ends)})\b)"
    found: list[Meaning] = []
    for meaning, patterns in meanings.items():
        said = rf"\b(?:{'|'.join(patterns)})\b"
        for pattern in (
            rf"\b(?=(?:as |very |really )?\w+ly\b){said}",
            rf"(?<!\bthe )(?<!\bon )(?<!\bat ){said}{after}",
        ):
            words, times = re.subn(pattern, GONE, words)
            found += [meaning] * times
    return words, found


@cache
def _patterns() -> Patterns:
    table = lexicon()
    number = rf"(?:\d+(?:\.\d+|/\d+)?|{_any(table.number_of)})"
    metres, own, lead = rf"(?:{_any(table.metres)})s?", _any(table.own_sizes), rf"(?:{'|'.join(table.amount_leads)}) "
    amount = (
        rf"\b(?:{lead})*(?P<minus>minus )?(?:an? )?(?P<n>{number}(?: (?:and )?(?:an? )?{number})*)(?: of)?(?: an?)? "
        rf"(?:times )?(?:of )?(?:its |their )?(?:own )?(?P<unit>{metres}|(?:{own})s?)\b(?: (?:high|far)\b)?"
    )
    one = (
        rf"\b(?:(?:{lead})+(?:an? )?|an? )(?P<unit>{metres})\b"
        rf"|\bby (?:an? |its |the )?(?:own )?(?P<own>{own})\b"
    )
    wrong = rf"\b(?:minus )?{number} (?:{'|'.join(table.other_units)})\b|\b(?:by|minus) (?:minus )?{number}\b(?: \w+)?"
    speed = rf"\b{number} {metres} (?:per|an?) (?:{'|'.join(table.times)})\b"
    return Patterns(*map(re.compile, (amount, one, wrong, speed)))


def _any(words: Collection[str]) -> str:
    return "|".join(sorted(words, key=len, reverse=True))


def _amount(match: re.Match[str]) -> Amount:
    said = match.groupdict()
    unit = said["unit"] or said["own"]
    unit = unit if unit in lexicon().metres or unit in lexicon().own_sizes else unit.removesuffix("s")
    value = _value(said.get("n") or "one") * lexicon().metres.get(unit, 1.0)
    if said.get("minus") or not 0 < value <= LARGEST:
        _refuse_amount(match[0])
    return Amount(value=round(value, 9), unit=lexicon().own_sizes.get(unit, "m"))


def _value(number: str) -> float:
    """``2``, ``1/2``, ``one and a half``, ``half``; words for hundreds multiply what precedes them."""
    total, named = 0.0, lexicon().number_of
    for word in number.split():
        if word in ("and", "a", "an"):
            continue
        top, _, bottom = word.partition("/")
        value = named[word] if word in named else float(top) / (float(bottom or 1) or float("nan"))
        total = total * value if total and value >= 100 and word in named else total + value
    return total


def _refuse_amount(amount: str) -> NoReturn:
    accepted = "above 0, at most 100 metres, as '20 cm', '3 inches', 'by its own width', 'two lengths', 'a bit', 'far'"
    refuse("amount", f"{quoted(amount.strip())} is no possible distance; accepted: {accepted}")
