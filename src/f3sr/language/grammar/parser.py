"""Goals in plain English to requests: a small grammar, no model, the same answer every time.

    goal    = {padding} [frame] clause {joint clause} {thanks}
    padding = "please" | "can you" | "i want you to" | ...
    frame   = "make" | "let" | "i want" | ...
    joint   = "and" | "then" | "so that" | "until"

The text goes through ``normaliser.plain`` (characters), the idioms of ``vocabulary/phrases.toml`` (turns of phrase),
``quantities`` (amounts and manner are taken out) and ``normaliser.canonical`` (one spelling). What remains is split
into ``clauses``, which ``intents`` and ``outcome_clauses`` make a request of.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from f3sr.goals.refusal import NotUnderstoodError, Refusal, quoted, refuse
from f3sr.language.grammar.clauses import clause, refuse_other, refuse_several, starts_clause
from f3sr.language.grammar.intents import request
from f3sr.language.grammar.lexicon import lexicon
from f3sr.language.grammar.normaliser import canonical, plain, rewritten
from f3sr.language.grammar.quantities import amount_in, manner_in
from f3sr.language.grammar.request import Request

CLAUSES = 3
"""Clauses of one goal: ``lift it, drop it on the box and let it roll``."""


def understand(text: str) -> Request | Refusal:
    """What a goal asks for, or why its words are refused. Deterministic; work grows linearly with the text."""
    try:
        return _understood(text)
    except NotUnderstoodError as error:
        return error.refusal


def _understood(text: str) -> Request:
    words = rewritten(plain(text), lexicon().results)
    _screen(words.split())
    words, amount = amount_in(rewritten(_bare(words), lexicon().idioms))
    words, manner = manner_in(words)
    found = _request(_bare(" ".join(words.split())))
    return replace(found, amount=amount, manner=manner, text=text.strip())


def _screen(words: Sequence[str]) -> None:
    """Refuses what no goal holds: negations, and instructions to do something else."""
    if found := next((w for w in words if w in lexicon().injected), None):
        refuse_other(found)
    if not (lexicon().instructions.isdisjoint(words) or lexicon().before_instructions.isdisjoint(words)):
        refuse_other("instructions")
    if found := next((w for w in words if w in lexicon().negations), None):
        refuse("negation", f"{quoted(found)} forbids something; accepted: what is to happen")


def _bare(words: str) -> str:
    """Without what is polite before and behind a goal."""
    polite = rf"^(?:(?:{'|'.join(lexicon().padding)})(?: |$))+"
    return re.sub(polite, "", re.sub(rf"(?: (?:{'|'.join(lexicon().thanks)}))+$", "", words))


def _request(words: str) -> Request:
    """The request of a goal without padding and amounts."""
    words = canonical(words)
    frame = re.match(rf"(?:(?P<let>{'|'.join(lexicon().lets)})|{'|'.join(lexicon().frames)}) (?=\w)", words)
    parts = _parts(words[frame.end() :].split() if frame else words.split())
    if len(parts) > CLAUSES:
        refuse_several()
    return request([clause(part) for part in parts], let=frame is not None and frame["let"] is not None)


def _parts(tokens: Sequence[str]) -> list[list[str]]:
    """The clauses between ``and``, ``then``, ``so that`` and ``until``, where a clause follows."""
    parts: list[list[str]] = [[]]
    i = 0
    while i < len(tokens):
        end = i
        while end < len(tokens) and (tokens[end] in lexicon().joints or tokens[end] == "|"):
            end += 1
        joint = set(tokens[i:end]) - {"|", "that"}
        follows = end < len(tokens) and (starts_clause(tokens[end]) or bool(joint & {"so", "until", "such"}))
        if joint and follows and parts[-1]:
            i = end + (tokens[end] in ("let", "make", "have", "cause"))
            parts.append([])
        else:
            parts[-1].append(tokens[i])
            i += 1
    return parts
