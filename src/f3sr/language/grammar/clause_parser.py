"""One clause of a goal taken apart: its verb, what stands before it, and what ``clause_arguments`` finds behind it."""

from __future__ import annotations

from collections.abc import Sequence

from f3sr.goals.refusal import Refusal, quoted
from f3sr.language.grammar.clause_arguments import VERBS, Clause, Scan
from f3sr.language.grammar.normaliser import each, spoken
from f3sr.language.grammar.verb_lexicon import FOREIGN, OTHER, SHOWN

AUXILIARIES = set(
    each(
        "to should must shall will would is are be being get gets got has have needs need goes go starts start can may"
    )
)
PASSIVE = {"is", "are", "be", "being", "get", "gets", "got"}
NOBODY = {"you", "we", "i", "robot", "someone", "somebody", "they"}
"""Subjects that are not of the scene: whose doing it is does not matter."""


def clause(tokens: Sequence[str]) -> Clause | Refusal:
    """The parts of one clause, imperative or with a subject before its verb."""
    at = _verb_at(tokens)
    if isinstance(at, Refusal):
        return at
    verb, family = VERBS[tokens[at]]
    subject, passive = _subject(tokens[:at], tokens[at])
    scan = Scan(tokens=tokens, at=at + 1, clause=Clause(verb=verb, family=family, subject=subject))
    refused = scan.run()
    if refused:
        return refused
    if passive:
        scan.clause.subject, scan.clause.object = "", subject
    elif subject.startswith("with "):
        scan.clause.subject, scan.clause.tool = "", subject.removeprefix("with ")
    return scan.clause


def _verb_at(tokens: Sequence[str]) -> int | Refusal:
    """Where the verb is: first, or after a subject; of two that follow each other the first is a noun (the toilet
    roll falls)."""
    words = [t for t in tokens if t != "|"]
    if words and words[0] in OTHER and words[0] not in VERBS:
        return other(words[0])
    found = [i for i, t in enumerate(tokens) if t in VERBS]
    if not found:
        return _no_verb(words)
    first = found[0]
    return first + 1 if first > 0 and first + 1 in found else first


def other(word: str) -> Refusal:
    message = f"{quoted(word)} asks for something else than a motion; accepted verbs: {SHOWN}"
    return Refusal(reason="other", message=message)


def _no_verb(words: Sequence[str]) -> Refusal:
    if any(w in FOREIGN for w in words):
        return Refusal(reason="language", message="the goal does not seem to be English; accepted: English")
    found = f"no verb in {quoted(spoken(' '.join(words)))}" if words else "no verb"
    return Refusal(reason="verb", message=f"{found}; accepted: {SHOWN}")


def _subject(words: Sequence[str], verb: str) -> tuple[str, bool]:
    """The words before a verb without auxiliaries, and whether the verb is passive."""
    end = len(words)
    while end > 1 and words[end - 1] in AUXILIARIES | {"|"}:
        end -= 1
    passive = bool(PASSIVE & set(words[end:])) and not verb.endswith("ing")
    subject = " ".join(w for w in words[:end] if w != "|")
    return ("" if subject in NOBODY else subject), passive
