"""Goals in plain English to requests: a small grammar, no model, the same answer every time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from f3sr.goals.refusal import Refusal, quoted
from f3sr.language.grammar.clause_arguments import Clause, starts_clause
from f3sr.language.grammar.clause_parser import clause, other
from f3sr.language.grammar.intents import request
from f3sr.language.grammar.normaliser import canonical, plain
from f3sr.language.grammar.quantities import amount_in, manner_in
from f3sr.language.grammar.request import Request
from f3sr.language.grammar.verb_lexicon import BEFORE_INSTRUCTIONS, INJECTED, INSTRUCTIONS, NEGATIONS, SHOWN

PADDING = (
    r"\||please|kindly|hey|hi|hello|ok|okay|now|well|then|first|just|simply|go ahead and|go and|lets|let us|to",
    r"(?:can|could|would|will) (?:you|we)|(?:i|we) (?:want|wish|need|would (?:like|love)) (?:you )?to(?: see)?",
    r"id (?:like|love) (?:you )?to(?: see)?|try to|try and|attempt to|you (?:should|must)|we should",
    r"(?:your |the )?(?:task|goal) is to|what (?:happens )?if|imagine|show me(?: how)?|show",
    r"(?:can|could|will|would)(?= (?:the|an?|my|it)\b)|\d{1,2} and then",
    r"make (?:it so|sure)(?: that)?|ensure(?: that)?|so that",
)
POLITE = re.compile(rf"^(?:(?:{'|'.join(PADDING)})(?: |$))+")
"""Before a goal, again and again; it changes nothing."""
THANKS = re.compile(
    r"(?: (?:please|thanks|thank you|for me|now|ok|okay|will you|would you|if you can|stop|again|and|then|\|))+$"
)
FRAME = re.compile(
    r"^(?P<verb>(?:i|we) (?:want|need|would (?:like|love))|id (?:like|love)|make|let|have|get|cause|force|allow|watch|"
    r"see) (?=\w)"
)
"""Before a subject that is to do something: ``make the ball roll``."""
IDIOMS: tuple[tuple[str, str], ...] = (
    (r"\bplease\b|\bkindly\b", " "),
    (r"\bgive (.{1,80}?) an? (?:gentle|little|light|small) (\w+)", r"gently \2 \1"),
    (r"\bgive (.{1,80}?) an? (?:hard|strong|big|good|firm) (\w+)", r"\2 \1 hard"),
    (r"\bgive (.{1,80}?) an? (\w+)", r"\2 \1"),
    (r"\bsend (.{1,80}?) (rolling|flying|sliding|tumbling|falling)\b", r"\2 \1"),
    (r"\benough to\b", "and"),
    (r"\ball the way\b", " "),
    (r"\blet go of\b", "drop"),
    (r"\blet (?:it |them )?go\b", "drop it"),
    (r"^use (.{1,80}?) to (.+)$", r"\2 with \1"),
    (r"\b(?:pick|take|grab|lift|raise)(?: it)? up\b", "lift"),
    (r"\b(?:pick|grab|take) (.{1,80}?) up\b", r"lift \1"),
    (r"\b(?:lay|put|place|set|push|knock|tip|turn|roll) (.{1,80}?) (?:onto|on|to) its side\b", r"topple \1"),
    (r"\b(?:onto|on|to) its side\b", "over"),
    (r"\b(up|upwards|air) and (?:back(?: down| again)?|down again|down)\b", r"\1 and return"),
    (r"\bback to (?:where it (?:was|started|came from|stood)|its (?:place|spot|start(?:ing point)?))\b", "back"),
    (
        r"\b(?:(?:on|in|at|to) )?(?:where it (?:was|started|came from|stood)|its (?:old |original )?(?:place|spot))\b",
        "back",
    ),
    (
        r"\b(?:come|comes|coming|fall|falls|drop|drops|land|lands|falling) (?:straight )?back(?: down| again)?\b",
        "return",
    ),
    (r"\b(?:come|comes|fall|falls) down again\b|\breturns? back\b", "return"),
    (r"(?<=\d) in(?=$| (?:to )?(?:the )?(?:left|right|back|away|forward|up)\b)", " inches"),
    (r"\bstart(?:s|ed)? (?:to |(?=\w+ing))", ""),
)
"""Turns of phrase, in this order."""
_IDIOMS = tuple((re.compile(pattern), words) for pattern, words in IDIOMS)
JOINTS = {"and", "then", "so", "until", "such", "that", "also"}
CLAUSES = 3
"""Clauses of one goal: ``lift it, drop it on the box and let it roll``."""


def understand(text: str) -> Request | Refusal:
    """What a goal asks for, or why it cannot be acted on."""
    words = plain(text)
    if isinstance(words, Refusal):
        return words
    if refused := _screened(words.split()):
        return refused
    words = _polished(words)
    quantified = amount_in(words)
    if isinstance(quantified, Refusal):
        return quantified
    words, amount = quantified
    mannered = manner_in(words)
    if isinstance(mannered, Refusal):
        return mannered
    words, manner = mannered
    found = _request(_bare(words))
    if isinstance(found, Refusal):
        return found
    return replace(found, amount=amount, manner=manner, text=text.strip())


def _screened(words: Sequence[str]) -> Refusal | None:
    """Refuses what no goal holds: negations, and instructions to do something else."""
    said = set(words)
    if found := next((w for w in words if w in INJECTED), None):
        return other(found)
    if INSTRUCTIONS & said and BEFORE_INSTRUCTIONS & said:
        return other("instructions")
    if found := next((w for w in words if w in NEGATIONS), None):
        message = f"{quoted(found)}: what must not happen cannot be asked for; accepted: what is to happen"
        return Refusal(reason="negation", message=message)
    return None


def _polished(words: str) -> str:
    """Without padding, and with turns of phrase in one form."""
    words = THANKS.sub("", words)
    words = POLITE.sub("", words)
    for pattern, replacement in _IDIOMS:
        words = pattern.sub(replacement, words)
    return " ".join(words.split())


def _bare(words: str) -> str:
    return THANKS.sub("", POLITE.sub("", " ".join(words.split())))


def _request(words: str) -> Request | Refusal:
    words = canonical(words)
    frame = FRAME.match(words)
    tokens = words[frame.end() :].split() if frame else words.split()
    if not any(t != "|" for t in tokens):
        return Refusal(reason="verb", message=f"the goal has no verb; accepted: {SHOWN}")
    parts = _parts(tokens)
    if len(parts) > CLAUSES:
        return Refusal(reason="several", message="the goal asks for more than one thing; accepted: one at a time")
    clauses: list[Clause] = []
    for part in parts:
        found = clause(part)
        if isinstance(found, Refusal):
            return found
        clauses.append(found)
    return request(clauses, let=frame is not None and frame["verb"] in ("let", "allow"))


def _parts(tokens: Sequence[str]) -> list[list[str]]:
    """The clauses between ``and``, ``then``, ``so that`` and ``until``, where a clause follows."""
    parts: list[list[str]] = [[]]
    i = 0
    while i < len(tokens):
        end = i
        while end < len(tokens) and tokens[end] in JOINTS | {"|"}:
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
