"""The words after a verb read from left to right: what it acts on, where to, which way, with what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from f3sr.goals.refusal import Refusal, quoted
from f3sr.language.grammar.directions import HEADINGS, OPPOSITE, SIDES, VIEWER, Direction
from f3sr.language.grammar.normaliser import each, spoken
from f3sr.language.grammar.noun_lexicon import GROUND_NAMES
from f3sr.language.grammar.referring_expressions import AT, ORDERS, RANKS, RELATIONS
from f3sr.language.grammar.verb_lexicon import OTHER, Family, base_forms

VERBS = base_forms()
TARGETS = {"into", "onto", "against", "towards", "to", "at", "over", "off", "away-from"}
FILLERS = set(each("straight directly simply just around again together once freely completely entirely"))
PARTICLES = {"over", "down", "off"}
UNTOLD = set(each("sideways aside diagonally somewhere anywhere sidewards"))
DIRECTIONS = "left, right, away from me, towards me, to the back left"
ENDS = TARGETS | set(HEADINGS) | RELATIONS | AT | PARTICLES | {"|", "with", "by", "and", "from"} | FILLERS
DROPPED: set[Family] = {"drop", "put", "throw", "jump", "bounce", "fall", "lift"}
"""Families whose ``on`` and ``in`` say where to."""
PLACED = {"on": "onto", "in": "into", "above": "onto"}
LIMP: set[Family] = {"tip", "push", "pull", "hit", "fall"}
"""Families whose verbs take ``over`` and ``down`` for a fall: ``knock over the can``."""


@dataclass
class Clause:
    """What one verb says; phrases are canonical words."""

    verb: str
    family: Family
    subject: str = ""
    object: str = ""
    targets: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    """Prepositions and what follows them."""
    tool: str = ""
    """What follows ``with``, or ``by`` in the passive."""
    directions: list[Direction] = field(default_factory=list[Direction])
    over: bool = False
    """Whether a particle says that something falls over."""
    off: bool = False
    """Whether a particle says that it leaves what it is on."""


def starts_clause(token: str) -> bool:
    return token in VERBS or token in OTHER or token in ("let", "make", "have", "it", "cause")


@dataclass
class Scan:
    """Reads the words after a verb from left to right."""

    tokens: Sequence[str]
    at: int
    clause: Clause
    slot: list[str] = field(default_factory=list[str])
    """Words of the phrase that is being read."""
    role: str = "object"
    closed: bool = False
    """Whether a direction or an amount came after the phrase, so that nothing can be added to it."""

    def run(self) -> Refusal | None:
        if self.clause.family in LIMP and self._word() in ("over", "down"):
            self.clause.over, self.at = True, self.at + 1
        while self.at < len(self.tokens):
            if not (self._boundary() or self._direction() or self._particle() or self._preposition()):
                refused = self._plain()
                if refused:
                    return refused
        self._finish()
        return None

    def _word(self, ahead: int = 0) -> str:
        return self.tokens[self.at + ahead] if self.at + ahead < len(self.tokens) else ""

    def _ends(self, ahead: int) -> bool:
        """Whether no noun follows so many words on."""
        word = self._word(ahead)
        return not word or word in ENDS

    def _boundary(self) -> bool:
        if self._word() != "|" and self._word() not in FILLERS:
            return False
        self.closed |= self._word() == "|" and bool(self.slot)
        self.at += 1
        return True

    def _direction(self) -> bool:
        found, length = self._heading() or self._towards_side() or self._bare_side() or self._from_side() or ([], 0)
        if not length:
            return False
        self.clause.directions += found
        self.closed |= bool(self.slot)
        self.at += length
        return True

    def _heading(self) -> tuple[list[Direction], int] | None:
        """``upwards``, ``away from me``, ``towards the camera``"""
        word, then = self._word(), self._word(1)
        if word in VIEWER and self.role == "object" and not self.slot:
            return ["towards"], 1
        further = then in HEADINGS or then in SIDES or then in ("to", "towards", "away-from")
        if word == "and" and self.clause.directions and further:
            return [], 1
        if word in ("towards", "to", "at", "away-from") and then in VIEWER:
            return ["away" if word == "away-from" else "towards"], 2
        nearer = word in ("closer", "nearer")
        if word not in HEADINGS or (nearer and not self.slot and not self.clause.subject):
            return None
        if nearer and then == "to":
            return (["towards"], 3) if self._word(2) in VIEWER else None
        return [HEADINGS[word]], 1

    def _towards_side(self) -> tuple[list[Direction], int] | None:
        """``to the back left``, unless a noun follows: ``to the left cup``."""
        if self._word() not in ("to", "towards"):
            return None
        sides = self._sides(1)
        return (sides, 1 + len(sides)) if sides and self._ends(1 + len(sides)) else None

    def _bare_side(self) -> tuple[list[Direction], int] | None:
        """``push the cup left``, ``make the ball roll right``, but not ``the left cup`` or ``right into``."""
        named = any(w not in ORDERS and w not in AT for w in self.slot) or (self.clause.subject and not self.slot)
        sides = self._sides(0)
        if not sides or not self._ends(len(sides)) or (self.slot[-1:] and self.slot[-1] in AT):
            return None
        if self._word() == "right" and self._word(1) in TARGETS:
            return [], 1
        return (sides, len(sides)) if named or self.closed or self.clause.directions else None

    def _from_side(self) -> tuple[list[Direction], int] | None:
        """``hit it from the left`` sends it right; ``the second from the left`` is a phrase."""
        if self._word() != "from" or any(w in RANKS or w[:1].isdigit() for w in self.slot):
            return None
        if self._word(1) == "above":
            return [], 2
        if self._word(1) == "behind":
            return ["towards"], 2
        sides = self._sides(1)
        return ([OPPOSITE[s] for s in sides], 1 + len(sides)) if sides and self._ends(1 + len(sides)) else None

    def _sides(self, ahead: int) -> list[Direction]:
        sides: list[Direction] = []
        while (word := self._word(ahead + len(sides))) in SIDES:
            sides.append(SIDES[word])
        return sides

    def _particle(self) -> bool:
        """``knock the can over``, ``drop it down``"""
        if self._word() not in PARTICLES or not self._ends(1):
            return False
        if self._word() == "over" and self._word(1) == "to" and self.clause.family != "tip":
            self.at += 1
            return True
        self.clause.over |= self._word() != "off" and self.clause.family in LIMP
        self.clause.off |= self._word() == "off"
        if self._word() == "down" and self.clause.family == "throw":
            self.clause.directions.append("down")
        self.closed |= bool(self.slot)
        self.at += 1
        return True

    def _preposition(self) -> bool:
        """Opens the phrase of a target or a tool."""
        word, place = self._word(), self._word(1) in ORDERS and self._ends(2)
        if word in TARGETS and not (word == "at" and place and self.slot):
            self._open(word)
        elif word == "from" and not (place and self.slot) and self._word(1):
            self._open("off")
        elif self._tool():
            self._open("with")
        elif word in PLACED and self.closed and self.clause.family in DROPPED:
            self._open(PLACED[word])
        elif word == "on" and self.closed and self._word(1) in GROUND_NAMES:
            self.at += 1
        else:
            return False
        self.at += 1
        return True

    def _tool(self) -> bool:
        if self._word() == "with":
            return bool(self.slot or self.clause.subject) and not self._with_content()
        return self._word() == "by" and bool(self._word(1))

    def _with_content(self) -> bool:
        """``the bowl with the ball in it``"""
        return any(self.tokens[i : i + 2] == ["in", "it"] for i in range(self.at, len(self.tokens)))

    def _open(self, role: str) -> None:
        self._finish()
        self.role, self.slot, self.closed = role, [], False

    def _plain(self) -> Refusal | None:
        """A word of a phrase."""
        word = self._word()
        if word in UNTOLD:
            return Refusal(reason="direction", message=f"{quoted(word)} is no direction; accepted: {DIRECTIONS}")
        if (self.closed and word == "and" and starts_clause(self._word(1))) or (self.closed and word in VERBS):
            return Refusal(reason="several", message="the goal asks for more than one thing; accepted: one at a time")
        if self.closed:
            return Refusal(reason="grammar", message=f"{quoted(spoken(word))} has no place in the goal where it stands")
        self.slot.append(word)
        self.at += 1
        return None

    def _finish(self) -> None:
        """Puts the phrase that was read where it belongs."""
        phrase = " ".join(self.slot)
        if self.role == "object":
            self.clause.object = phrase
        elif self.role == "with":
            self.clause.tool = f"{self.clause.tool} and {phrase}" if self.clause.tool else phrase
        else:
            self.clause.targets.append((self.role, phrase))
