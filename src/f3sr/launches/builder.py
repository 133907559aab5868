"""The Builder by rules: which launches to try for a task, one search per kind, given all earlier trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from f3sr.goals.language_protocol import Launch, Tried
from f3sr.goals.launch_limits import limits_of
from f3sr.goals.plan import Kind, TaskSpec
from f3sr.goals.scene_layout import SceneLayout
from f3sr.launches import bounces, flights, pushes
from f3sr.launches.launch_context import LaunchContext, Launches

SEARCHES: Mapping[Kind, Callable[[LaunchContext], Launches]] = {
    "topple": pushes.toppling,
    "slide": pushes.sliding,
    "push_into": pushes.pushing,
    "roll": pushes.rolling,
    "drop": flights.dropping,
    "lift_and_drop": flights.dropping,
    "throw": flights.throwing,
    "bounce": bounces.bouncing,
    "launch_and_return": flights.launching,
}
"""The search of every kind of task: a generator that yields launches and is sent what came of them."""


@dataclass(eq=False)
class Builder:
    """The search for one task, which continues while it gets the trials that it asked for.

    With other trials it starts again, so its answer depends on its arguments alone."""

    task: TaskSpec
    layout: SceneLayout
    told: list[Tried] = field(default_factory=list[Tried])
    """Trials that the search has been sent."""
    asked: Sequence[Launch] = ()
    """Launches that it asked for last; empty when it has no more."""
    search: Launches | None = None

    def next(self, tried: Sequence[Tried]) -> Sequence[Launch]:
        """The launches to try after all that were ``tried``, in order; none when the search has ended."""
        if self.search is None or list(tried[: len(self.told)]) != self.told:
            setting = LaunchContext(self.task, self.layout, limits_of(self.layout.scene))
            self.search, self.told = SEARCHES[self.task.kind](setting), []
            self.asked = next(self.search, ())
        while len(self.told) + len(self.asked) <= len(tried) and self.asked:
            answers = tried[len(self.told) : len(self.told) + len(self.asked)]
            self.told = [*self.told, *answers]
            try:
                self.asked = self.search.send(answers)
            except StopIteration:
                self.asked = ()
        return self.asked
