"""A phrase such as ``second red mug from the left next to the box``, parsed: names, colours, order and places."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from f3sr.goals.refusal import Refusal, quoted
from f3sr.language.grammar.colours import NAMED, THINGS
from f3sr.language.grammar.directions import VIEWER
from f3sr.language.grammar.normaliser import canonical, each, spoken
from f3sr.language.grammar.noun_lexicon import ANYTHING, compounded, singular

Axis = Literal["left", "right", "front", "back", "upper", "lower", "middle", "big", "small", "tall", "short", "long"]

AXES: dict[Axis, str] = {
    "left": "left leftmost",
    "right": "right rightmost",
    "front": "front frontmost foremost nearest closest nearer closer near",
    "back": "back rear rearmost backmost hindmost farthest furthest farther further far",
    "upper": "upper top topmost uppermost highest",
    "lower": "lower bottom bottommost lowest lowermost",
    "middle": "middle centre center central middlemost",
    "big": "big bigger biggest large larger largest huge",
    "small": "small smaller smallest little tiny tiniest littlest",
    "tall": "tall taller tallest",
    "short": "short shorter shortest",
    "long": "long longer longest",
}
"""What objects may be ordered by, and the words for the first of that order."""
ORDERS: dict[str, Axis] = {word: axis for axis, words in AXES.items() for word in words.split()}
PLACES: set[Axis] = {"left", "right", "front", "back", "upper", "lower", "middle"}
RANKS = {
    **{w: k for k, w in enumerate(each("first second third fourth fifth sixth seventh eighth ninth tenth"))},
    "last": -1,
}
RELATIONS = set(each("on in under behind above with next-to left-of right-of in-front-of nearest-to farthest-from"))
AT = {"on", "in", "at", "to", "from"}
"""Before a place of the photo: ``on the left``."""
MANY = set(each("all every each both these those everything them they others some several many"))
COUNTS = set(each("two three four five six seven eight nine ten"))
SHADES = {"dark", "bright", "pale", "deep", "light", "shiny"}
UNTELLING = {"coloured", "colored", "colourful", "colorful", "multicoloured", "multicolored", "patterned"}
"""Adjectives that fit nearly everything."""
MOST = 4
"""Relations in one phrase: more are no description."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """The object of a rank (0 the first, -1 the last) along an axis; None where the words do not say which."""

    axis: Axis | None
    rank: int = 0


@dataclass(frozen=True, kw_only=True)
class Phrase:
    words: str
    names: tuple[str, ...] = ()
    """What it is called, the head noun last; empty for any object."""
    id: int | None = None
    plural: bool = False
    colours: tuple[str, ...] = ()
    orders: tuple[Order, ...] = ()
    relation: tuple[str, Phrase] | None = None


def parsed(words: str, vocabulary: Collection[str]) -> Phrase | Refusal:
    """The parts of a phrase; ``vocabulary`` are the words of the scene's labels, which name before they describe."""
    tokens = compounded(canonical(words).split())
    if sum(t in RELATIONS for t in tokens) > MOST:
        return Refusal(
            reason="grammar", message=f"{quoted(words)} has too many relations; accepted: at most {MOST} in one phrase"
        )
    return _parsed(tokens, vocabulary)


def _parsed(tokens: Sequence[str], vocabulary: Collection[str]) -> Phrase | Refusal:
    head, placed, rest = _split(tokens)
    phrase = _head(head, spoken(" ".join(tokens)), placed, vocabulary)
    if not rest:
        return phrase
    relation, anchor = rest[0], _parsed(rest[1:], vocabulary) if rest[1:] else None
    if anchor is None:
        return Refusal(reason="grammar", message=f"{quoted(phrase.words)} ends early; accepted: a name after it")
    if isinstance(anchor, Refusal):
        return anchor
    return _with(phrase, relation, anchor)


def _split(tokens: Sequence[str]) -> tuple[Sequence[str], list[Order], Sequence[str]]:
    """The words before the first relation, the places of the photo that follow them, and the relation with its rest."""
    first = next((i for i, t in enumerate(tokens) if t in RELATIONS | AT), len(tokens))
    head, rest, placed = tokens[:first], tokens[first:], list[Order]()
    while rest:
        axis = ORDERS.get(rest[1]) if len(rest) > 1 else None
        ends = len(rest) == 2 or (len(rest) > 2 and rest[2] in RELATIONS | AT)
        viewer = len(rest) > 1 and rest[1] in VIEWER
        if rest[0] in AT and axis in PLACES and ends:
            placed.append(Order(axis=axis, rank=0))
        elif rest[0] in ("nearest-to", "farthest-from") and viewer:
            placed.append(Order(axis="front" if rest[0] == "nearest-to" else "back"))
        elif rest[1:2] != ("it",) or rest[0] not in AT:
            break
        rest = rest[2:]
    return head, placed, rest


def _head(head: Sequence[str], words: str, placed: list[Order], vocabulary: Collection[str]) -> Phrase:
    """The names, adjectives and number of a phrase without its relations."""
    if (number := re.fullmatch(r"(?:object|number|thing|item|id) (\d{1,9})", " ".join(head))) is not None:
        return Phrase(words=words, id=int(number[1]), orders=tuple(placed))
    one_of = "of" in head
    telling = _telling(head)
    names, colours, orders = _sorted_out(telling, vocabulary)
    several = any(w in MANY | COUNTS for w in head) or telling[-1:] in (["objects"], ["things"], ["ones"], ["items"])
    if one_of and names:
        names[-1] = singular(names[-1])
    return Phrase(
        words=words,
        names=tuple(names),
        plural=(several and not one_of) or "and" in names,
        colours=tuple(colours),
        orders=tuple(_placed(orders, placed)),
    )


def _telling(head: Sequence[str]) -> list[str]:
    """The words that say which object: no numbers of objects, no shades of colours, no ``one of``."""
    start = head.index("of") if "of" in head else 0
    words = [w for i, w in enumerate(head) if i > start or singular(w) not in ANYTHING or not start]
    empty = MANY | COUNTS | UNTELLING | {"of", "that", "which"} | ({"and"} if _joins_colours(head) else set[str]())
    words = [w for w in words if w not in empty]
    return [w for i, w in enumerate(words) if w not in SHADES or (words[i + 1 : i + 2] or [""])[0] not in NAMED]


def _sorted_out(words: Sequence[str], vocabulary: Collection[str]) -> tuple[list[str], list[str], list[Order]]:
    """Names, colours and orders. The last word names wherever it can; the others do where a label has them and they
    are no adjective."""
    names, colours, orders = list[str](), list[str](), list[Order]()
    for i, word in enumerate(words):
        last = i == len(words) - 1
        adjective = (word in NAMED and not (last and word in THINGS)) or word in ORDERS or _rank(word) is not None
        if (last and word in vocabulary) or not (adjective or (last and singular(word) in ANYTHING)):
            names.append(word)
        elif word in NAMED:
            colours.append(word)
        elif (rank := _rank(word)) is not None:
            orders.append(Order(axis=None, rank=rank))
        elif word in ORDERS:
            orders = _ordered(orders, ORDERS[word])
    return names, colours, orders


def _with(phrase: Phrase, relation: str, anchor: Phrase) -> Phrase:
    """``left of the two cups`` says which of the cups; everything else stands in a relation to another object."""
    side = relation.removesuffix("-of")
    several = anchor.plural or any(n != singular(n) for n in anchor.names[-1:])
    if several and side in ("left", "right") and not (phrase.names or phrase.colours):
        names = (*anchor.names[:-1], *(singular(n) for n in anchor.names[-1:]))
        orders = (*anchor.orders, Order(axis="left" if side == "left" else "right"))
        return Phrase(words=phrase.words, names=names, colours=anchor.colours, orders=orders, relation=anchor.relation)
    return replace(phrase, relation=(relation, anchor))


def _rank(word: str) -> int | None:
    if word in RANKS:
        return RANKS[word]
    number = re.fullmatch(r"(\d{1,3})(?:st|nd|rd|th)", word)
    return int(number[1]) - 1 if number and int(number[1]) else None


def _ordered(orders: list[Order], axis: Axis) -> list[Order]:
    """``second largest``: a rank that waits for its axis gets it."""
    if orders and orders[-1].axis is None:
        return [*orders[:-1], Order(axis=axis, rank=orders[-1].rank)]
    return [*orders, Order(axis=axis)]


def _placed(orders: list[Order], placed: list[Order]) -> list[Order]:
    """``second from the left``: the first place is that of a waiting rank."""
    for place in placed:
        waiting = next((i for i, o in enumerate(orders) if o.axis is None), None)
        if waiting is None:
            orders = [*orders, place]
        else:
            orders = [*orders[:waiting], Order(axis=place.axis, rank=orders[waiting].rank), *orders[waiting + 1 :]]
    return orders


def _joins_colours(head: Sequence[str]) -> bool:
    """``black and white``"""
    i = head.index("and") if "and" in head else 0
    return 0 < i < len(head) - 1 and head[i - 1] in NAMED and head[i + 1] in NAMED
