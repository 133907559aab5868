"""How far and how: amounts in metres or in an object's own sizes, vague words for distance and force."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, cast

from f3sr.goals.plan import Manner
from f3sr.goals.refusal import Refusal, quoted
from f3sr.language.grammar.normaliser import each

Unit = Literal["m", "length", "width", "height"]
Vague = Literal["slightly", "far"]

LARGEST = 100.0
"""Largest amount, in metres or in an object's own sizes."""
METRES = {
    "metre": 1.0,
    "meter": 1.0,
    "m": 1.0,
    "decimetre": 0.1,
    "decimeter": 0.1,
    "dm": 0.1,
    "centimetre": 0.01,
    "centimeter": 0.01,
    "cm": 0.01,
    "millimetre": 0.001,
    "millimeter": 0.001,
    "mm": 0.001,
    "kilometre": 1000.0,
    "kilometer": 1000.0,
    "km": 1000.0,
    "inch": 0.0254,
    "foot": 0.3048,
    "yard": 0.9144,
    "mile": 1609.344,
}
"""Length of units [m]."""
PLURALS = {"inches": "inch", "feet": "foot", "ft": "foot", "yd": "yard"}
OWN: dict[str, Unit] = {
    "length": "length",
    "size": "length",
    "width": "width",
    "breadth": "width",
    "diameter": "width",
    "height": "height",
}
NUMBERS: dict[str, float] = {
    **{w: k for k, w in enumerate(each("zero one two three four five six seven eight nine ten eleven twelve"))},
    **{w: 10 * k for k, w in enumerate(each("twenty thirty forty fifty sixty seventy eighty ninety hundred"), 2)},
    "fifteen": 15,
    "thousand": 1000,
    "million": 1e6,
    "half": 1 / 2,
    "third": 1 / 3,
    "quarter": 1 / 4,
    "once": 1,
    "twice": 2,
    "thrice": 3,
    "double": 2,
    "couple": 2,
    "few": 3,
}
"""Numbers in words."""
NONSENSE = each(
    "kg kilos? kilograms? grams? g pounds? lbs? newtons? n joules? seconds? secs? s minutes? mins? hours? days? years? "
    "degrees? deg radians? rad percent litres? liters? volts? watts? hertz pixels? px lightyears? light years? "
    "parsecs? bananas? dollars? euros? furlongs? miles per hour mph kmh"
)
"""Units of something else than length."""
LIMIT_WORDS = "on in into onto to towards at against over off from and so until then with by left right back up away"
SLIGHTLY = (
    r"(?:by )?(?:just )?(?:slightly|somewhat|(?:a )?(?:(?:tiny|little|wee) )?bit|a touch|a little|"
    r"(?:a )?short (?:way|distance))"
)
FAR = (
    r"(?:by )?(?:very )?(?:far(?! (?:left|right))|(?:a )?(?:long|great) (?:way|distance)|a lot|as far as possible|"
    r"further)"
)
GENTLY = r"(?:very )?(?:gently|softly|lightly|slowly|carefully|tenderly|with care)"
HARD = (
    r"(?:very |really |as )?(?:hard(?: as possible)?|forcefully|strongly|firmly|fast|quickly|rapidly|vigorously|"
    r"violently|powerfully|with (?:great |full |a lot of )?(?:force|power|strength|speed)|at (?:full|high) speed)"
)


@dataclass(frozen=True, kw_only=True)
class Amount:
    """``value`` metres, or so many of the active object's own sizes."""

    value: float
    unit: Unit = "m"


def _any(words: list[str]) -> str:
    return "|".join(sorted(words, key=len, reverse=True))


_NUMBER = rf"\d+(?:\.\d+|/\d+)?|{_any(list(NUMBERS))}"
_UNITS = rf"(?:{_any(list(METRES))})s?|{_any(list(PLURALS))}|(?:{_any(list(OWN))})s?"
_LEAD = (
    r"(?:(?:by|for|of|about|around|roughly|approximately|exactly|at least|from|to a height of|from a height of|"
    r"to|up to) )*"
)
_OWN = r"(?:times )?(?:of )?(?:its |their )?(?:own )?"
AMOUNT = re.compile(
    rf"\b{_LEAD}(?P<minus>minus )?(?:an? )?(?P<n>(?:{_NUMBER})(?: (?:and )?(?:an? )?(?:{_NUMBER}))*)"
    rf"(?: of)?(?: an?)? {_OWN}(?P<unit>{_UNITS})\b(?: (?:high|far)\b)?"
)
ONE = re.compile(
    rf"\b(?:{_LEAD.replace(')*', ')+')}(?:an? )?|an? )(?P<unit>(?:{_any(list(METRES))})s?|{_any(list(PLURALS))})\b"
    rf"|\bby (?:an? |its |the )?(?:own )?(?P<own>{_any(list(OWN))})\b"
)
WRONG = re.compile(
    rf"\b(?:minus )?(?:{_NUMBER}) (?:{'|'.join(NONSENSE)})\b|\b(?:by|minus) (?:minus )?(?:{_NUMBER})\b(?: \w+)?"
)
_END = rf"(?=$| \|| (?:{'|'.join(LIMIT_WORDS.split())})\b)"


def amount_in(words: str) -> tuple[str, Amount | Vague | None] | Refusal:
    """The words with ``|`` where the amount was, and the amount."""
    found: list[Amount | Vague] = []
    for pattern in (AMOUNT, ONE):
        for match in pattern.finditer(words):
            amount = _amount(match)
            if isinstance(amount, Refusal):
                return amount
            found.append(amount)
        words = pattern.sub(" | ", words)
    if wrong := WRONG.search(words):
        return _impossible(wrong[0])
    words, vague = _either(words, SLIGHTLY, "slightly", FAR, "far")
    found += cast(list[Vague], vague)
    if len(found) > 1:
        return Refusal(reason="contradiction", message="the goal gives two amounts; accepted: one")
    return words, found[0] if found else None


def manner_in(words: str) -> tuple[str, Manner | None] | Refusal:
    """The words with ``|`` where it said how, and how."""
    words, found = _either(words, GENTLY, "gently", HARD, "hard")
    if len(set(found)) > 1:
        return Refusal(reason="contradiction", message="the goal says both gently and hard; accepted: one of them")
    return words, cast(Manner, found[0]) if found else None


def _either(words: str, first: str, a: str, second: str, b: str) -> tuple[str, list[str]]:
    """Words without those of two vague meanings, and which were there. Adverbs count anywhere, what may also describe
    a thing (a hard disk, the far cup) only where no noun follows."""
    found: list[str] = []
    for pattern, meaning in ((first, a), (second, b)):
        ended = re.compile(rf"(?<!\bthe )(?<!\bon )(?<!\bat )\b{pattern}\b{_END}")
        adverb = re.compile(rf"\b(?=\w+ly\b){pattern}\b")
        for p in (adverb, ended):
            found += [meaning] * len(p.findall(words))
            words = p.sub(" | ", words)
    return words, found


def _amount(match: re.Match[str]) -> Amount | Refusal:
    groups = match.groupdict()
    unit = groups["unit"] or groups.get("own") or "m"
    unit = PLURALS.get(unit, unit)
    unit = unit if unit in METRES or unit in OWN else unit.removesuffix("s")
    value = _value(groups.get("n") or "one") * METRES.get(unit, 1.0)
    if groups.get("minus") or not 0 < value <= LARGEST:
        return _impossible(match[0])
    return Amount(value=round(value, 9), unit=OWN.get(unit, "m"))


def _value(number: str) -> float:
    """``2``, ``1/2``, ``one and a half``, ``half``; words for hundreds multiply what precedes them."""
    total = 0.0
    for word in number.split():
        if word in ("and", "a", "an"):
            continue
        top, _, bottom = word.partition("/")
        value = NUMBERS[word] if word in NUMBERS else float(top) / (float(bottom or 1) or float("nan"))
        total = total * value if total and value >= 100 and word in NUMBERS else total + value
    return total


def _impossible(amount: str) -> Refusal:
    return Refusal(
        reason="amount",
        message=f"{quoted(amount.strip())} is no amount that can be met; accepted: above 0 and at most 100 metres, "
        "as '20 cm', '3 inches', 'by its own width', 'two lengths', 'a bit' or 'far'",
    )
