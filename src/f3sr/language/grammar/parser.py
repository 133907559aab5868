"""Goals in plain English to requests: a small grammar, no model, the same answer every time.

    goal    = phase {sequel phase}
    phase   = {padding} [frame] clause {joint clause} {thanks}
    sequel  = "then" | "after that" | "once it rests" | ...
    padding = "please" | "can you" | "i want you to" | ...
    frame   = "make" | "let" | "i want" | ...
    joint   = "and" | "then" | "so that" | "until"

The text goes through ``normaliser.plain`` (characters), the idioms of ``vocabulary/phrases.toml`` (turns of phrase),
``quantities`` (amounts and manner are taken out) and ``normaliser.canonical`` (one spelling). What remains is split
into ``clauses``, which ``intents`` and ``outcome_clauses`` make a request of.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

from f3sr.goals.plan import MOST_PHASES
from f3sr.goals.refusal import NotUnderstoodError, Refusal, quoted, refuse
from f3sr.language.grammar.clauses import clause, refuse_other, refuse_several, starts_clause
from f3sr.language.grammar.intents import request
from f3sr.language.grammar.lexicon import lexicon
from f3sr.language.grammar.normaliser import LONGEST, canonical, plain, rewritten
from f3sr.language.grammar.quantities import amount_in, manner_in
from f3sr.language.grammar.request import Request

CLAUSES = 3
"""Clauses of one launch: ``lift it, drop it on the box and let it roll``."""
BEFORE_AND_AFTER = (
    (r"before (.+?), *(?:please |first )?(.+)", (2, 1)),
    (r"after (.*?ing\b.+?), *(?:please |then )?(.+)", (1, 2)),
    (r"(.+?),? before (\w+ing\b.+)", (1, 2)),
    (r"(.+?),? after (\w+ing\b.+)", (2, 1)),
)
"""Words that tell an order, and which of their parts comes first and second."""


def understand(text: str) -> tuple[Request, ...] | Refusal:
    """What a goal asks for, a request for each of its phases, or why its words are refused.

    Deterministic; work grows linearly with the text. Words that one launch may mean are one phase."""
    try:
        ordered = _in_order(text) if len(text) <= LONGEST else text  # which is refused
        words = plain(ordered)
        one = _request_or_refusal(words)
        whole = isinstance(one, Request) and not _runs_on(one)
        phases = () if whole else _phases(plain(_with_joints(ordered)))
        if not phases and isinstance(one, Refusal):
            return one
        return tuple(replace(r, text=text.strip()) for r in phases or [one] if isinstance(r, Request))
    except NotUnderstoodError as error:
        return error.refusal


def _in_order(text: str) -> str:
    """``before A, do B`` and ``after A, do B`` in the order in which things happen."""
    for pattern, order in BEFORE_AND_AFTER:
        if found := re.fullmatch(pattern, text.strip(), re.IGNORECASE | re.DOTALL):
            return f"{found[order[0]]}; {found[order[1]]}"
    return text


def _with_joints(text: str) -> str:
    """``do A, do B`` as ``do A then do B``; lines part as commas do."""
    verb = re.compile(r"(?:,\s+|\s*\n\s*)(?=([a-z]+)\b)", re.IGNORECASE)
    return verb.sub(lambda m: " then " if m[1].lower() in lexicon().forms else m[0], text)


def _request_or_refusal(words: str) -> Request | Refusal:
    """One launch in plain words."""
    try:
        return _understood(words)
    except NotUnderstoodError as error:
        return error.refusal


def _runs_on(r: Request) -> bool:
    """Whether the words of a phrase go on into another phase."""
    phrases = (r.active, r.target or "")
    verbs = (word in lexicon().forms for phrase in phrases for word in phrase.split()[1:-1])
    return any(lexicon().sequels.search(phrase) for phrase in phrases) or any(verbs)


def _phases(words: str) -> list[Request]:
    """The requests of words that ask for several launches in order, each as many clauses as one launch may mean; none
    where any of it is not understood."""
    parts = [part for part in _bare_parts(lexicon().sequels.split(words)) if part]
    found, at, verb = list[Request](), 0, ""
    while at < len(parts):
        ends = range(min(len(parts), at + CLAUSES), at, -1)
        tried = ((_with_verb(" and then ".join(parts[at:end]), verb), end) for end in ends)
        request, at = next(((r, end) for r, end in tried if r is not None), (None, at))
        if request is None:
            return []
        found.append(request)
        verb = next((w for w in parts[at - 1].split() if w in lexicon().forms), verb)
    if len(found) > MOST_PHASES:
        refuse("several", f"the goal asks for {len(found)} motions; accepted: at most {MOST_PHASES}, as 'A, then B'")
    return found if len(found) > 1 else []


def _bare_parts(parts: Sequence[str]) -> Iterator[str]:
    for part in parts:
        yield re.sub(r"^(?:(?:and|then|but)(?: |$))+|(?:(?:^| )(?:and|then))+$", "", part.strip())


def _with_verb(words: str, verb: str) -> Request | None:
    """The request of words that may have no verb, as that of the phase before is meant: ``push A left, then B``."""
    found = _request_or_refusal(words)
    if isinstance(found, Refusal) and found.reason == "verb" and verb:
        found = _request_or_refusal(f"{verb} {words}")
        if isinstance(found, Refusal):
            found = _request_or_refusal(f"{verb} it {words}")
    return None if isinstance(found, Refusal) or _runs_on(found) else found


def _understood(words: str) -> Request:
    words = rewritten(words, lexicon().results)
    _screen(words.split())
    words, amount = amount_in(rewritten(_bare(words), lexicon().idioms))
    words, manner = manner_in(words)
    found = _request(_bare(" ".join(words.split())))
    return replace(found, amount=amount, manner=manner)


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
