"""One clause of a goal, read from left to right: who does what to what, where to, which way, with what.

    clause      = [subject {auxiliary}] verb {part}
    part        = phrase | direction | particle | preposition phrase | ("with" | "by") phrase | filler | "|"
    direction   = heading | ("to" | "towards") side {side} | side {side} | "from" ("above" | "behind" | side {side})
                | ("to" | "towards" | "away-from") viewer
    particle    = "over" | "down" | "off"

A side is a direction only where no noun follows: ``push it to the left`` but ``push it to the left cup``. Phrases stay
canonical words; ``referring_expressions`` parses them. Words are in ``vocabulary/verbs.toml``, ``directions.toml`` and
``phrases.toml``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NoReturn, cast

from f3sr.goals.refusal import quoted, refuse
from f3sr.language.grammar.lexicon import Direction, Family, lexicon
from f3sr.language.grammar.normaliser import spoken
from f3sr.language.grammar.request import OPPOSITE, Preposition

PARTICLES = ("over", "down", "off")
DIRECTIONS = "left, right, away from me, towards me, to the back left"
"""The directions that a refusal names."""
DROPPED: frozenset[Family] = frozenset(("drop", "put", "throw", "jump", "bounce", "fall", "lift"))
"""Families whose ``on`` and ``in`` say where to."""
LIMP: frozenset[Family] = frozenset(("tip", "push", "pull", "hit", "fall"))
"""Families whose verbs take ``over`` and ``down`` for a fall: ``knock over the can``."""
PLACED: dict[str, Preposition] = {"on": "onto", "in": "into", "above": "onto"}
Found = tuple[list[Direction], int]
"""Directions, and how many words say them."""


@dataclass(kw_only=True)
class Clause:
    """What a verb and the words around it say. Phrases are canonical words."""

    verb: str
    family: Family
    subject: str = ""
    object: str = ""
    targets: list[tuple[Preposition, str]] = field(default_factory=list[tuple[Preposition, str]])
    """Prepositions and what follows them."""
    tool: str = ""
    """What follows ``with``, or ``by`` in the passive."""
    directions: list[Direction] = field(default_factory=list[Direction])
    over: bool = False
    """Whether a particle says that something falls over."""
    off: bool = False
    """Whether a particle says that it leaves what it is on."""


def clause(tokens: Sequence[str]) -> Clause:
    """The parts of one clause from its canonical words, imperative or with a subject before its verb. Raises
    NotUnderstoodError where the clause has no verb, or a word is out of place."""
    at = _verb_at(tokens)
    verb, family = lexicon().forms[tokens[at]]
    subject, passive = _subject(tokens[:at], tokens[at])
    scan = _Scan(tokens=tokens, at=at + 1, clause=Clause(verb=verb, family=family, subject=subject))
    scan.run()
    if passive:
        scan.clause.subject, scan.clause.object = "", subject
    elif subject.startswith("with "):
        scan.clause.subject, scan.clause.tool = "", subject.removeprefix("with ")
    return scan.clause


def starts_clause(token: str) -> bool:
    """Whether a clause may begin with a word."""
    return token in lexicon().forms or token in lexicon().other_verbs or token in ("let", "make", "have", "it", "cause")


def refuse_other(word: str) -> NoReturn:
    """Refuses a word that is no verb of the lexicon, or means no motion."""
    refuse("other", f"{quoted(word)} is no known verb; accepted verbs: {lexicon().shown_verbs}")


def refuse_several() -> NoReturn:
    """Refuses a goal that asks for two motions."""
    refuse("several", "the goal asks for more than one motion; accepted: one, or 'then' between motions")


def _verb_at(tokens: Sequence[str]) -> int:
    """Where the verb is: first, or after a subject; of two that follow each other the first is a noun (the toilet
    roll falls)."""
    words, forms = [t for t in tokens if t != "|"], lexicon().forms
    if words and words[0] in lexicon().other_verbs:
        refuse_other(words[0])
    found = [i for i, t in enumerate(tokens) if t in forms]
    if not found:
        _refuse_verb(words)
    first = found[0]
    return first + 1 if first > 0 and first + 1 in found else first


def _refuse_verb(words: Sequence[str]) -> NoReturn:
    if not lexicon().foreign.isdisjoint(words):
        refuse("language", "the goal seems to be in another language; accepted: English")
    found = f"{quoted(spoken(' '.join(words)))} has no verb" if words else "the goal has no verb"
    refuse("verb", f"{found}; accepted: {lexicon().shown_verbs}")


def _subject(words: Sequence[str], verb: str) -> tuple[str, bool]:
    """The words before a verb without auxiliaries, and whether the verb is passive."""
    end = len(words)
    while end > 1 and words[end - 1] in (*lexicon().auxiliaries, *lexicon().passive, "|"):
        end -= 1
    passive = not lexicon().passive.isdisjoint(words[end:]) and not verb.endswith("ing")
    subject = " ".join(w for w in words[:end] if w != "|")
    return ("" if subject in lexicon().nobody else subject), passive


@dataclass(kw_only=True)
class _Scan:
    """Reads the words after a verb from left to right. A reader returns how many words it took."""

    tokens: Sequence[str]
    at: int
    clause: Clause
    slot: list[str] = field(default_factory=list[str])
    """Words of the phrase that is being read."""
    role: str = "object"
    """The preposition of that phrase."""
    closed: bool = False
    """Whether a direction or an amount came after the phrase, so that nothing can be added to it."""

    def run(self) -> None:
        """Fills the clause."""
        if self.clause.family in LIMP and self._word() in ("over", "down"):
            self.clause.over, self.at = True, self.at + 1
        while self.at < len(self.tokens):
            self.at += self._pause() or self._direction() or self._particle() or self._preposition() or self._name()
        self._finish()

    def _word(self, ahead: int = 0) -> str:
        return self.tokens[self.at + ahead] if self.at + ahead < len(self.tokens) else ""

    def _ends(self, ahead: int) -> bool:
        """Whether no noun follows so many words on."""
        word, known = self._word(ahead), lexicon()
        ends = word in known.targets or word in known.headings or word in known.relations or word in known.at
        return ends or word in ("", "|", "by", "and", *PARTICLES) or word in lexicon().fillers

    def _pause(self) -> int:
        if self._word() != "|" and self._word() not in lexicon().fillers:
            return 0
        self.closed |= self._word() == "|" and bool(self.slot)
        return 1

    def _direction(self) -> int:
        found = self._heading() or self._towards_side() or self._bare_side() or self._from_side()
        if not found:
            return 0
        self.clause.directions += found[0]
        self.closed |= bool(self.slot)
        return found[1]

    def _heading(self) -> Found | None:
        """``upwards``, ``away from me``, ``towards the camera``"""
        word, then, known = self._word(), self._word(1), lexicon()
        if word in known.viewer and self.role == "object" and not self.slot:
            return ["towards"], 1
        further = then in known.headings or then in known.sides or then in ("to", "towards", "away-from")
        if word == "and" and self.clause.directions and further:
            return [], 1
        if word in ("towards", "to", "at", "away-from") and then in known.viewer:
            return ["away" if word == "away-from" else "towards"], 2
        nearer = word in ("closer", "nearer")
        if word not in known.headings or (nearer and not self.slot and not self.clause.subject):
            return None
        if nearer and then == "to":
            return (["towards"], 3) if self._word(2) in known.viewer else None
        return [known.headings[word]], 1

    def _towards_side(self) -> Found | None:
        """``to the back left``, unless a noun follows: ``to the left cup``."""
        sides = self._sides(1) if self._word() in ("to", "towards") else []
        return (sides, 1 + len(sides)) if sides else None

    def _bare_side(self) -> Found | None:
        """``push the cup left``, ``make the ball roll right``, but not ``the left cup`` or ``right into``."""
        sides, at = self._sides(0), lexicon().at
        if not sides or (self.slot and self.slot[-1] in at):
            return None
        if self._word() == "right" and self._word(1) in lexicon().targets:
            return [], 1
        named = any(w not in lexicon().orders and w not in at for w in self.slot)
        named = named or (self.clause.subject and not self.slot) or self.closed or self.clause.directions
        return (sides, len(sides)) if named else None

    def _from_side(self) -> Found | None:
        """``hit it from the left`` sends it right; ``the second from the left`` is a phrase."""
        ranked = any(w in (*lexicon().ranks, "last") or w[:1].isdigit() for w in self.slot)
        if self._word() != "from" or ranked:
            return None
        if self._word(1) in ("above", "behind"):
            return (["towards"] if self._word(1) == "behind" else []), 2
        sides = self._sides(1)
        return ([OPPOSITE[s] for s in sides], 1 + len(sides)) if sides else None

    def _sides(self, ahead: int) -> list[Direction]:
        """The sides so many words on; none where a noun follows them."""
        sides: list[Direction] = []
        while (word := self._word(ahead + len(sides))) in lexicon().sides:
            sides.append(lexicon().sides[word])
        return sides if self._ends(ahead + len(sides)) else []

    def _particle(self) -> int:
        """``knock the can over``, ``drop it down``"""
        word, family = self._word(), self.clause.family
        if word not in PARTICLES or not self._ends(1):
            return 0
        if word == "over" and self._word(1) == "to" and family != "tip":
            return 1
        self.clause.over |= word != "off" and family in LIMP
        self.clause.off |= word == "off"
        if word == "down" and family == "throw":
            self.clause.directions.append("down")
        self.closed |= bool(self.slot)
        return 1

    def _preposition(self) -> int:
        """Opens the phrase of a target or a tool."""
        word, place = self._word(), self._word(1) in lexicon().orders and self._ends(2)
        told = place and bool(self.slot)
        if word in lexicon().targets and not (word == "at" and told):
            return self._open(word)
        if word == "from" and not told and self._word(1):
            return self._open("off")
        if self._tool():
            return self._open("with")
        if word in PLACED and self.closed and self.clause.family in DROPPED:
            return self._open(PLACED[word])
        return 2 if word == "on" and self.closed and self._word(1) in lexicon().ground else 0

    def _tool(self) -> bool:
        if self._word() == "with":
            content = any(self.tokens[i : i + 2] == ["in", "it"] for i in range(self.at, len(self.tokens)))
            return bool(self.slot or self.clause.subject) and not content  # the bowl with the ball in it
        return self._word() == "by" and bool(self._word(1))

    def _open(self, role: str) -> int:
        self._finish()
        self.role, self.slot, self.closed = role, [], False
        return 1

    def _name(self) -> int:
        """A word of a phrase."""
        word = self._word()
        if word in lexicon().no_directions:
            refuse("direction", f"{quoted(word)} is no direction; accepted: {DIRECTIONS}")
        if self.closed and (word in lexicon().forms or (word == "and" and starts_clause(self._word(1)))):
            refuse_several()
        if self.closed:
            refuse("grammar", f"{quoted(spoken(word))} is out of place; accepted: verb, object, target or direction")
        self.slot.append(word)
        return 1

    def _finish(self) -> None:
        """Puts the phrase that was read where it belongs."""
        phrase = " ".join(self.slot)
        if self.role == "object":
            self.clause.object = phrase
        elif self.role == "with":
            self.clause.tool = f"{self.clause.tool} and {phrase}" if self.clause.tool else phrase
        else:
            self.clause.targets.append((cast(Preposition, self.role), phrase))
