"""The words that the grammar knows, read once from ``language/vocabulary/*.toml`` when they are first needed.

One class per file; a field is a table of that file, and the file's comments say what the table means. Every file is
checked as it is read: unknown keys, words that are not in lower case, and words in two tables that exclude each other
raise an InputError that names the file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal, TypeVar, cast

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from f3sr.errors import InputError
from f3sr.files.strict_json import problem
from f3sr.goals.plan import Manner
from f3sr.goals.plan import Way as Preposition
from f3sr.vision.colour_terms import Colour

FOLDER = Path(__file__).parents[1] / "vocabulary"
EDGE = r"(?!(?<=\w)\w)"
"""Not inside a word."""

Family = Literal[
    "tip", "push", "pull", "hit", "collide", "roll", "drop", "put", "lift", "throw", "jump", "bounce", "fall", "return"
]
Axis = Literal["left", "right", "front", "back", "upper", "lower", "middle", "big", "small", "tall", "short", "long"]
Direction = Literal["left", "right", "away", "towards", "up", "down"]
Unit = Literal["m", "length", "width", "height"]
Vague = Literal["slightly", "far"]


def _split(text: object) -> object:
    return text.split() if isinstance(text, str) else text


def _by_word(groups: object) -> object:
    """``{tip = "topple upset"}`` as ``{topple: tip, upset: tip}``; ValueError where a word stands in two groups."""
    found: dict[str, object] = {}
    for name, words in cast(dict[str, str], groups).items():
        for word in words.split():
            if word in found:
                raise ValueError(f"{word!r} stands in {found[word]} and {name}; accepted: every word once")
            found[word] = name
    return found


def _word(text: str) -> str:
    if not re.fullmatch(r"[a-z]+(?:-[a-z]+)*", text):
        raise ValueError(f"{text!r}; accepted: words of small letters with spaces between them")
    return text


def _pattern(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r} ({error}); accepted: a regular expression") from None
    return text


def _rule(text: str) -> re.Pattern[str]:
    return re.compile(f"{EDGE}(?:{_pattern(text)}){EDGE}")


K = TypeVar("K")
Word = Annotated[str, AfterValidator(_word)]
Words = Annotated[tuple[Word, ...], BeforeValidator(_split)]
WordSet = Annotated[frozenset[Word], BeforeValidator(_split)]
ByWord = Annotated[dict[Word, K], BeforeValidator(_by_word)]
"""Groups of words, as the group of each word."""
Patterns = tuple[Annotated[str, AfterValidator(_pattern)], ...]
Rules = tuple[tuple[Annotated[re.Pattern[str], BeforeValidator(_rule)], str], ...]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Nouns(_Table):
    synonyms: tuple[WordSet, ...]
    ground: WordSet
    anything: WordSet
    pairs: WordSet
    kinds: dict[Word, WordSet]
    shapes: dict[Word, WordSet]
    compounds: dict[str, Word]
    plurals: dict[Word, Word]


class Adjectives(_Table):
    ranks: Words
    many: WordSet
    counts: WordSet
    shades: WordSet
    untelling: WordSet
    things: WordSet
    orders: ByWord[Axis]
    colours: dict[Colour, Words]

    @cached_property
    def colours_of(self) -> dict[str, tuple[Colour, ...]]:
        """The basic colours that a word may mean."""
        words = dict.fromkeys(w for colour, others in self.colours.items() for w in (colour, *others))
        return {w: tuple(c for c, others in self.colours.items() if w == c or w in others) for w in words}

    @model_validator(mode="after")
    def _checked(self) -> Adjectives:
        _known("things", self.things, self.colours_of)
        return self


class Directions(_Table):
    viewer: WordSet
    relations: WordSet
    at: WordSet
    targets: Annotated[frozenset[Preposition], BeforeValidator(_split)]
    untold: WordSet
    sides: ByWord[Direction]
    headings: ByWord[Direction]

    @model_validator(mode="after")
    def _checked(self) -> Directions:
        _exclusive(sides=self.sides, headings=self.headings, untold=self.untold)
        return self


class RefusedWords(_Table):
    other: WordSet
    injected: WordSet
    instructions: WordSet
    before_instructions: WordSet
    negations: WordSet
    foreign: WordSet


class Verbs(_Table):
    shown: str
    strikes: WordSet
    families: ByWord[Family]
    irregular: dict[Word, Words]
    refused: RefusedWords

    @cached_property
    def forms(self) -> dict[str, tuple[str, Family]]:
        """Every form of every verb, with the verb and its family; of two verbs of one form the first counts."""
        forms: dict[str, tuple[str, Family]] = {}
        for verb, family in self.families.items():
            for form in (*regular_forms(verb), *self.irregular.get(verb, ())):
                forms.setdefault(form, (verb, family))
        return forms

    @model_validator(mode="after")
    def _checked(self) -> Verbs:
        _known("strikes", self.strikes, self.families)
        _known("irregular", self.irregular, self.families)
        _exclusive(families=self.forms, other=self.refused.other, negations=self.refused.negations)
        return self


class Amounts(_Table):
    ones: Words
    tens: Words
    numbers: dict[Word, float]
    metres: ByWord[float]
    own: ByWord[Unit]
    lead: Patterns
    nonsense: Patterns
    after: Words
    vague: dict[Vague, Patterns]
    manner: dict[Manner, Patterns]

    @cached_property
    def number_of(self) -> dict[str, float]:
        """What a word for a number is."""
        tens = {word: 10.0 * k for k, word in enumerate(self.tens, 1)}
        return {**tens, **{word: float(k) for k, word in enumerate(self.ones)}, **self.numbers}

    @model_validator(mode="after")
    def _checked(self) -> Amounts:
        _exclusive(numbers=self.number_of, metres=self.metres, own=self.own)
        return self


class Phrases(_Table):
    padding: Patterns
    thanks: Patterns
    frames: Patterns
    lets: Patterns
    auxiliaries: WordSet
    passive: WordSet
    nobody: WordSet
    fillers: WordSet
    joints: WordSet
    idioms: Rules
    spellings: Rules


@cache
def nouns() -> Nouns:
    """The names of things. Raises InputError where the file is not as it should be, as do all of these."""
    return read("nouns", Nouns)


@cache
def adjectives() -> Adjectives:
    """The words that say which of several things is meant."""
    return read("adjectives", Adjectives)


@cache
def directions() -> Directions:
    """The words of direction and place."""
    return read("directions", Directions)


@cache
def verbs() -> Verbs:
    """The verbs, and the words that no goal may have."""
    return read("verbs", Verbs)


@cache
def amounts() -> Amounts:
    """The words of number, length and manner."""
    return read("amounts", Amounts)


@cache
def phrases() -> Phrases:
    """The turns of phrase."""
    return read("phrases", Phrases)


T = TypeVar("T", bound=BaseModel)


def read(name: str, table: type[T], folder: Path = FOLDER) -> T:
    """The words of ``NAME.toml``. Raises InputError that names the file, what it holds and what it may."""
    file, fields = folder / f"{name}.toml", ", ".join(table.model_fields)
    try:
        return table.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))
    except ValidationError as error:
        found, accepted = problem(error, fields)
        raise InputError(file, found=found, accepted=accepted) from None
    except (OSError, ValueError) as error:
        raise InputError(file, found=f"no TOML ({error})", accepted=f"tables {fields}") from None


def regular_forms(verb: str) -> list[str]:
    """``drop drops dropping dropped``: a short vowel before one consonant doubles it."""
    stem = verb + verb[-1] if re.fullmatch("[^aeiou]*[aeiou][^aeiouwxy]", verb) else verb
    third = verb + "es" if verb.endswith(("s", "sh", "ch")) else verb + "s"
    if verb.endswith("y") and verb[-2] not in "aeiou":
        third = verb[:-1] + "ies"
    short = verb[:-1] if verb.endswith("e") else stem
    return [verb, third, short + "ing", short + "ed"]


def _exclusive(**groups: Collection[str]) -> None:
    """ValueError where a word stands in two groups."""
    for (one, words), (other, more) in combinations(groups.items(), 2):
        if both := sorted({*words} & {*more}):
            raise ValueError(f"{both[0]!r} stands in {one} and {other}; accepted: every word in one of them")


def _known(name: str, words: Collection[str], known: Collection[str]) -> None:
    """ValueError where one of some words is not among the known ones."""
    if unknown := sorted({*words} - {*known}):
        raise ValueError(f"{unknown[0]!r} in {name}; accepted: {', '.join(sorted(known))[:200]}")
