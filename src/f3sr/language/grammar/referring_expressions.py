"""A phrase such as ``second red mug from the left next to the box``, parsed: names, colours, order and places.

    phrase = {adjective} name {place} [relation phrase] | ("object" | "number") digits
    adjective = colour | order | rank | word of a label
    place  = ("on" | "in" | "at" | "to" | "from") order | ("nearest-to" | "farthest-from") viewer

Words are in ``vocabulary/adjectives.toml`` (orders, colours, ranks) and ``directions.toml`` (relations, viewers).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from f3sr.goals.refusal import quoted, refuse
from f3sr.language.grammar.lexicon import Axis, lexicon
from f3sr.language.grammar.normaliser import canonical, spoken
from f3sr.language.grammar.nouns import compounded, singular

PLACES: frozenset[Axis] = frozenset(("left", "right", "front", "back", "upper", "lower", "middle"))
"""Axes of the photo; the others are of size."""
SEEN_FROM: dict[str, Axis] = {"nearest-to": "front", "farthest-from": "back"}
"""Relations to the viewer that are an order."""
MOST = 4
"""Relations in one phrase: more are no description."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """The object of a rank (0 the first, -1 the last) along an axis; None where the words do not say which."""

    axis: Axis | None
    rank: int = 0


@dataclass(frozen=True, kw_only=True)
class Phrase:
    """What a phrase says of an object; the phrase fits every object of which all of it is true."""

    words: str
    names: tuple[str, ...] = ()
    """What it is called, the head noun last; empty for any object."""
    id: int | None = None
    plural: bool = False
    colours: tuple[str, ...] = ()
    orders: tuple[Order, ...] = ()
    relation: tuple[str, Phrase] | None = None


def parsed(words: str, vocabulary: Collection[str]) -> Phrase:
    """The parts of a phrase. ``vocabulary`` holds the words of the scene's labels: these name before they describe.
    Raises NotUnderstoodError where a relation has no second object, or the phrase has too many relations."""
    tokens = compounded(canonical(words).split())
    if sum(t in lexicon().relations for t in tokens) > MOST:
        refuse("grammar", f"{quoted(words)} has too many relations; accepted: at most {MOST}")
    return _parsed(tokens, vocabulary)


def _parsed(tokens: Sequence[str], vocabulary: Collection[str]) -> Phrase:
    head, placed, rest = _split(tokens)
    phrase = _head(head, spoken(" ".join(tokens)), placed, vocabulary)
    if not rest:
        return phrase
    if len(rest) == 1:
        refuse("grammar", f"{quoted(phrase.words)} lacks its last word; accepted: an object's name after it")
    return _with(phrase, rest[0], _parsed(rest[1:], vocabulary))


def _split(tokens: Sequence[str]) -> tuple[Sequence[str], list[Order], Sequence[str]]:
    """The words before the first relation, the places of the photo that follow them, and the relation with its rest."""
    opening, at = lexicon().relations | lexicon().at, lexicon().at
    first = next((i for i, t in enumerate(tokens) if t in opening), len(tokens))
    head, rest, placed = tokens[:first], tokens[first:], list[Order]()
    while rest:
        word, then, after = (*rest[:3], "", "")[:3]
        axis = lexicon().orders.get(then)
        if word in at and axis in PLACES and (not after or after in opening):
            placed.append(Order(axis=axis))
        elif word in SEEN_FROM and then in lexicon().viewer:
            placed.append(Order(axis=SEEN_FROM[word]))
        elif word not in at or then != "it":
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
    several = not _several().isdisjoint(head) or telling[-1:] in (["objects"], ["things"], ["ones"], ["items"])
    if one_of and names:
        names[-1] = singular(names[-1])
    return Phrase(
        words=words,
        names=tuple(names),
        plural=(several and not one_of) or "and" in names,
        colours=tuple(colours),
        orders=tuple(_placed(orders, placed)),
    )


def _several() -> frozenset[str]:
    return lexicon().many | lexicon().counts


def _telling(head: Sequence[str]) -> list[str]:
    """The words that say which object: no numbers of objects, no shades of colours, no ``one of``."""
    colours, start = lexicon().colours_of, head.index("of") if "of" in head else 0
    words = [w for i, w in enumerate(head) if i > start or singular(w) not in lexicon().anything or not start]
    empty = {*_several(), *lexicon().untelling, "of", "that", "which", *(["and"] if _joins_colours(head) else [])}
    words = [w for w in words if w not in empty]
    pairs = zip(words, [*words[1:], ""], strict=False)
    return [word for word, then in pairs if word not in lexicon().shades or then not in colours]


def _sorted_out(words: Sequence[str], vocabulary: Collection[str]) -> tuple[list[str], list[str], list[Order]]:
    """Names, colours and orders. The last word names wherever it can; the others do where a label has them and they
    are no adjective."""
    names, colours, orders = list[str](), list[str](), list[Order]()
    for i, word in enumerate(words):
        last = i == len(words) - 1
        rank, axis, colour = _rank(word), lexicon().orders.get(word), word in lexicon().colours_of
        adjective = (colour and not (last and word in lexicon().colour_things)) or axis is not None or rank is not None
        if (last and word in vocabulary) or not (adjective or (last and singular(word) in lexicon().anything)):
            names.append(word)
        elif colour:
            colours.append(word)
        elif rank is not None:
            orders.append(Order(axis=None, rank=rank))
        elif axis is not None:
            orders = _ordered(orders, axis)
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
    """Which in an order, from 0; -1 is the last."""
    if word == "last":
        return -1
    if word in lexicon().ranks:
        return lexicon().ranks.index(word)
    number = re.fullmatch(r"(\d{1,3})(?:st|nd|rd|th)", word)
    return int(number[1]) - 1 if number and int(number[1]) else None


def _ordered(orders: list[Order], axis: Axis) -> list[Order]:
    """``second largest``: a rank that waits for its axis gets it."""
    if orders and orders[-1].axis is None:
        return [*orders[:-1], replace(orders[-1], axis=axis)]
    return [*orders, Order(axis=axis)]


def _placed(orders: list[Order], placed: list[Order]) -> list[Order]:
    """``second from the left``: the first place is that of a waiting rank."""
    for place in placed:
        waiting = next((i for i, o in enumerate(orders) if o.axis is None), len(orders))
        rank = orders[waiting].rank if waiting < len(orders) else 0
        orders = [*orders[:waiting], replace(place, rank=rank), *orders[waiting + 1 :]]
    return orders


def _joins_colours(head: Sequence[str]) -> bool:
    """``black and white``"""
    i, colours = head.index("and") if "and" in head else 0, lexicon().colours_of
    return 0 < i < len(head) - 1 and head[i - 1] in colours and head[i + 1] in colours
