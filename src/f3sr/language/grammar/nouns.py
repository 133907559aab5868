"""How well a name fits the label of an object: plurals, synonyms, kinds of things, and how words are misspelt."""

from __future__ import annotations

from collections.abc import Sequence

from f3sr.language.grammar.lexicon import lexicon

ENDINGS = (("ies", "y"), *((e, e[:-2]) for e in ("xes", "ches", "shes", "sses", "zes")), ("s", ""))
"""Endings of plurals, and those of the singular, in this order."""


def compounded(words: Sequence[str]) -> tuple[str, ...]:
    """Words in which a name of two words is one: ``trash can`` is ``trashcan``."""
    joined: list[str] = []
    for word in words:
        whole = lexicon().compounds.get(f"{joined[-1]} {word}") if joined else None
        joined[-1 if whole else len(joined) :] = [whole or word]
    return tuple(joined)


def singular(word: str) -> str:
    """The singular of a plural: ``boxes`` is ``box``; any other word stays as it is."""
    if word in lexicon().plurals:
        return lexicon().plurals[word]
    if word in lexicon().pairs or len(word) < 4 or word.endswith(("ss", "us", "is")):
        return word
    for ending, replacement in ENDINGS:
        if word.endswith(ending):
            return word.removesuffix(ending) + replacement
    return word


def fit(names: Sequence[str], label: Sequence[str]) -> int | None:
    """How well names (the head noun last) fit a label's words: 0 its head noun, 1 words of it, 2 synonyms,
    3 a kind of things, None not at all."""
    wanted, had = [singular(w) for w in names], [singular(w) for w in label]
    if not had:
        return None
    if set(wanted) <= set(had):
        return 0 if wanted[-1] == had[-1] else 1
    meant = [not synonyms(w).isdisjoint(had) for w in wanted]
    if all(meant):
        return 2
    kinds = lexicon().kinds.get(wanted[-1], frozenset[str]())
    return 3 if all(meant[:-1]) and any(not kinds.isdisjoint(synonyms(w)) for w in had) else None


def fits_shape(name: str, description: str) -> bool:
    """Whether a name suits an object without a label, by its description in the scene graph."""
    shape = description.partition(",")[0].split()[-1:]
    return bool(shape) and (name in shape or name in lexicon().shapes.get(shape[0], ()))


def synonyms(word: str) -> frozenset[str]:
    """All names of what a word names, the word among them."""
    return frozenset((word,)).union(*(line for line in lexicon().synonyms if word in line))


def distance(a: str, b: str, most: int = 24) -> int:
    """Edits between two words: letters put in, left out, changed or swapped with their neighbour (optimal string
    alignment). Only the first ``most`` letters count."""
    a, b = a[:most], b[:most]
    rows = [list(range(len(b) + 1))]
    for i, x in enumerate(a, 1):
        row = [i]
        for j, y in enumerate(b, 1):
            best = min(rows[-1][j] + 1, row[-1] + 1, rows[-1][j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                best = min(best, rows[-2][j - 2] + 1)
            row.append(best)
        rows.append(row)
    return rows[-1][-1]
