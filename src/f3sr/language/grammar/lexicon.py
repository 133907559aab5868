"""The words that the grammar knows, read once from ``language/vocabulary/*.toml`` when they are first needed.

A field is a table of one of these files, whose comments say what it means. The files are checked as they are read:
unknown or missing tables, words that are not of small letters, and words in two tables that exclude each other.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator

from f3sr.errors import InputError
from f3sr.files.strict_json import problem
from f3sr.goals.plan import Manner
from f3sr.goals.plan import Way as Preposition
from f3sr.vision.colour_terms import Colour

FOLDER = Path(__file__).parents[1] / "vocabulary"
FILES = ("adjectives", "amounts", "directions", "nouns", "phrases", "refused", "verbs")
EDGE = r"(?!(?<=\w)\w)"
"""Not inside a word."""

Family = Literal[
    "tip", "push", "pull", "hit", "collide", "roll", "drop", "put", "lift", "throw", "jump", "bounce", "fall", "return",
    "stay", "rest",
]  # fmt: skip
"""What a verb does to its object; the grammar reads all verbs of a family alike."""
Axis = Literal["left", "right", "front", "back", "upper", "lower", "middle", "big", "small", "tall", "short", "long"]
"""What objects may be ordered by."""
Direction = Literal["left", "right", "away", "towards", "up", "down"]
"""Seen from the camera: ``away`` from it or ``towards`` it, along the ground."""
Unit = Literal["m", "length", "width", "height"]
Vague = Literal["slightly", "far"]


def _split(text: object) -> object:
    return text.split() if isinstance(text, str) else text


def _by_word(groups: dict[str, str]) -> dict[str, str]:
    """``{tip = "topple upset"}`` as ``{topple: tip, upset: tip}``; ValueError where a word stands in two groups."""
    found: dict[str, str] = {}
    for name, words in groups.items():
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
"""The group of each word, from groups of words."""
Patterns = tuple[Annotated[str, AfterValidator(_pattern)], ...]
Rules = tuple[tuple[Annotated[re.Pattern[str], BeforeValidator(_rule)], str], ...]


class Lexicon(BaseModel):
    """Every table of words, in the order of the files."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    # adjectives.toml
    ranks: Words
    many: WordSet
    counts: WordSet
    shades: WordSet
    untelling: WordSet
    colour_things: WordSet
    orders: ByWord[Axis]
    colours: dict[Colour, Words]
    # amounts.toml
    ones: Words
    tens: Words
    numbers: dict[Word, float]
    metres: ByWord[float]
    own_sizes: ByWord[Unit]
    amount_leads: Patterns
    amount_ends: Words
    other_units: Patterns
    times: Patterns
    vague: dict[Vague, Patterns]
    manner: dict[Manner, Patterns]
    # directions.toml
    viewer: WordSet
    relations: WordSet
    at: WordSet
    targets: Annotated[frozenset[Preposition], BeforeValidator(_split)]
    no_directions: WordSet
    sides: ByWord[Direction]
    headings: ByWord[Direction]
    # nouns.toml
    synonyms: tuple[WordSet, ...]
    ground: WordSet
    anything: WordSet
    pairs: WordSet
    kinds: dict[Word, WordSet]
    shapes: dict[Word, WordSet]
    compounds: dict[str, Word]
    plurals: dict[Word, Word]
    # phrases.toml
    padding: Patterns
    thanks: Patterns
    frames: Patterns
    lets: Patterns
    auxiliaries: WordSet
    passive: WordSet
    nobody: WordSet
    fillers: WordSet
    joints: WordSet
    sequel: Patterns
    results: Rules
    idioms: Rules
    spellings: Rules
    # refused.toml
    other_verbs: WordSet
    injected: WordSet
    instructions: WordSet
    before_instructions: WordSet
    negations: WordSet
    foreign: WordSet
    # verbs.toml
    shown_verbs: str
    strikes: WordSet
    families: ByWord[Family]
    irregular: dict[Word, Words]

    @cached_property
    def sequels(self) -> re.Pattern[str]:
        """What stands between two phases."""
        return _rule("|".join(self.sequel))

    @cached_property
    def colours_of(self) -> dict[str, tuple[Colour, ...]]:
        """The basic colours that a word may mean."""
        words = {word for colour, others in self.colours.items() for word in (colour, *others)}
        return {w: tuple(c for c, others in self.colours.items() if w == c or w in others) for w in words}

    @cached_property
    def number_of(self) -> dict[str, float]:
        """The value of every word for a number."""
        tens = {word: 10.0 * k for k, word in enumerate(self.tens, 1)}
        return {**tens, **{word: float(k) for k, word in enumerate(self.ones)}, **self.numbers}

    @cached_property
    def forms(self) -> dict[str, tuple[str, Family]]:
        """Every form of every verb, with the verb and its family; of two verbs of one form the first counts."""
        forms: dict[str, tuple[str, Family]] = {}
        for verb, family in self.families.items():
            for form in (*regular_forms(verb), *self.irregular.get(verb, ())):
                forms.setdefault(form, (verb, family))
        return forms

    @model_validator(mode="after")
    def _checked(self) -> Lexicon:
        _exclusive(sides=self.sides, headings=self.headings, no_directions=self.no_directions)
        _exclusive(families=self.forms, other_verbs=self.other_verbs, negations=self.negations)
        _exclusive(numbers=self.number_of, metres=self.metres, own_sizes=self.own_sizes)
        _exclusive(ground=self.ground, anything=self.anything, colours=self.colours_of, relations=self.relations)
        _known("colour_things", self.colour_things, self.colours_of)
        _known("strikes", self.strikes, self.families)
        _known("irregular", self.irregular, self.families)
        return self


T = TypeVar("T", bound=BaseModel)


@cache
def lexicon() -> Lexicon:
    """The words of all files. Raises InputError, as ``read`` does."""
    return read(Lexicon, *FILES)


def read(model: type[T], *names: str, folder: Path = FOLDER) -> T:
    """The tables of some vocabulary files together. Raises InputError where a file is no TOML, a table is unknown or
    missing, or a value does not suit its table."""
    tables, origin = dict[str, Any](), dict[str, Path]()
    for file in (folder / f"{name}.toml" for name in names):
        try:
            found = tomllib.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(file, found=f"no TOML ({error})", accepted="tables of words") from None
        tables |= found
        origin |= dict.fromkeys(found, file)
    known = f"the tables {', '.join(model.model_fields)}"
    if unknown := next((key for key in tables if key not in model.model_fields), None):
        raise InputError(origin[unknown], found=f"an unknown table {unknown}", accepted=known)
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        where = error.errors(include_url=False)[0]["loc"]
        found, accepted = problem(error, known)
        file = origin.get(str(where[0])) if where else None
        raise InputError(file or folder / f"{'|'.join(names)}.toml", found=found, accepted=accepted) from None


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
