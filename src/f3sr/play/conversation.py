"""A talk about one scene: a goal a line, and short lines that change the goal before."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from f3sr.goals.refusal import Refusal
from f3sr.language.capabilities import menu
from f3sr.language.grammar.parser import understand
from f3sr.language.reference_resolution import names, resolve
from f3sr.scene import GROUND, Scene

HELP = """Say what is to happen: push the mug off the book, then knock over the can.
Then: again | slower | faster | the other mug | slow motion | real time | objects | help | quit"""
SLOWEST = 8.0
"""Largest factor of slow motion that is reached by saying so again."""
GENTLER = re.compile(r"(?:a (?:bit|little) )?(?:slower|more slowly|gentler|more gently|softer|less hard)", re.I)
HARDER = re.compile(r"(?:a (?:bit|little) )?(?:faster|quicker|more quickly|harder|stronger|with more force)", re.I)
OTHER = re.compile(r"(?:no,? )?(?:(?:now )?with )?the other (?P<noun>[\w ]{1,60})", re.I)
MANNER = re.compile(
    r"\b(?:very |as )?(?:gently|softly|slowly|carefully|hard|fast|quickly|strongly)(?: as possible)?\b", re.I
)


@dataclass(frozen=True, kw_only=True)
class Wish:
    """What a line asks for: a goal to be played, and how slow its film is."""

    goal: str
    slow: float


@dataclass(eq=False)
class Conversation:
    """Lines of a user about one scene, each understood after the ones before."""

    scene: Scene
    goal: str = ""
    before: str = ""
    """The goal before, to which the talk goes back where the last is refused."""
    slow: float = 1.0
    ended: bool = False

    def heard(self, line: str) -> Wish | str:
        """A goal to be played, or words to be shown. ``ended`` after a farewell."""
        said = " ".join(line.split()).strip(" .!")
        known: dict[str, Callable[[], Wish | str]] = {
            "": lambda: "",
            "help": lambda: HELP,
            "?": lambda: HELP,
            "objects": self._objects,
            "again": self._again,
            "once more": self._again,
            "slow motion": lambda: self._paced(min(SLOWEST, 2 * self.slow)),
            "real time": lambda: self._paced(1.0),
            **dict.fromkeys(("quit", "exit", "bye", "q"), self._farewell),
        }
        if answer := known.get(said.lower()):
            return answer()
        if GENTLER.fullmatch(said) or HARDER.fullmatch(said):
            return self._with_manner("gently" if GENTLER.fullmatch(said) else "hard")
        if other := OTHER.fullmatch(said):
            return self._with_other(other["noun"])
        return self._wish(line.strip())

    def refused(self) -> None:
        """The last goal was refused: what follows is about the one before."""
        self.goal = self.before

    def _wish(self, goal: str) -> Wish:
        """A goal in place of the last one."""
        self.before, self.goal = self.goal, goal
        return Wish(goal=goal, slow=self.slow)

    def _again(self) -> Wish | str:
        return Wish(goal=self.goal, slow=self.slow) if self.goal else NOTHING

    def _paced(self, slow: float) -> Wish | str:
        self.slow = slow
        return self._again() if self.goal else f"films are now {slow:g} times slower than life"

    def _with_manner(self, manner: str) -> Wish | str:
        if not self.goal:
            return NOTHING
        bare = " ".join(MANNER.sub(" ", self.goal).split()).rstrip(" .!")
        first, then, rest = re.split(r"(,? then | and then |;|$)", bare, maxsplit=1)[:3] if bare else ("", "", "")
        return self._wish(f"{first} {manner}{then}{rest}")

    def _with_other(self, noun: str) -> Wish | str:
        """The goal with another object in place of the one that was set off."""
        if not self.goal:
            return NOTHING
        requests = understand(self.goal)
        if isinstance(requests, Refusal):
            return f"not understood: {requests.message}"
        phrase = requests[0].active
        active = resolve(phrase, self.scene)
        if isinstance(active, Refusal):
            return f"not understood: {active.message}"
        wanted = phrase.split()[-1] if noun.strip().lower() in ("one", "thing", "object") else noun
        other = resolve(f"other {wanted}", self.scene, active=active)
        if isinstance(other, Refusal) or other == GROUND:
            return f"not understood: {other.message if isinstance(other, Refusal) else 'the ground'}"
        words = re.compile(r"\W+(?:(?:the|a|an|my)\W+)?".join(map(re.escape, phrase.split())), re.I)
        if not words.search(self.goal):
            return f"say the whole goal with the {names(self.scene)[other]}"
        return self._wish(words.sub(names(self.scene)[other], self.goal, count=1))

    def _objects(self) -> str:
        return "\n".join(f"{e.name}: {', '.join(e.verbs) or 'fixed'}" for e in menu(self.scene))

    def _farewell(self) -> str:
        self.ended = True
        return ""


NOTHING = "nothing was played yet; say a goal, as: push the cup to the left"
