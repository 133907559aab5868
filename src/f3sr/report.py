"""The result sheet of a stage: a typed outcome, the report derived from it, and the guard that accepts or reverts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One number with its unit; ``before`` is None where the quantity did not exist before the stage."""

    name: str
    after: float
    before: float | None = None
    unit: str = ""
    about: int | None = None
    """Object id, or None for the whole scene."""


@dataclass(frozen=True, kw_only=True)
class Decision:
    """A choice that a user should know of: an accepted or rejected step, a fallback, an assumption."""

    choice: str
    reason: str
    about: int | None = None
    """Object id, or None for the whole scene."""
    fallback: bool = False


@dataclass(frozen=True, kw_only=True)
class Report:
    """The result sheet of one stage."""

    stage: str
    measures: tuple[Measure, ...] = ()
    decisions: tuple[Decision, ...] = ()
    cut_short: bool = False
    """A time limit cut some of the work."""

    def value(self, name: str) -> float:
        """The scene-wide measure of that name after the stage. Raises StopIteration if there is none."""
        return next(m.after for m in self.measures if m.name == name and m.about is None)

    @property
    def fallbacks(self) -> tuple[Decision, ...]:
        """Decisions that replaced the normal method by a weaker one."""
        return tuple(d for d in self.decisions if d.fallback)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The typed result sheet of a stage, one subclass per stage.

    Without arguments it is the outcome of a stage that did nothing. Fields are plain values that can be stored, in SI
    units unless stated. Code reads fields; people read ``measures`` and ``report``.
    """

    stage: ClassVar[str]
    decisions: tuple[Decision, ...] = ()
    cut_short: bool = False
    """A time limit cut some of the work. Another run may do better, so the result is not stored."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        """The numbers for people, in the report's order and units."""
        return ()

    @property
    def report(self) -> Report:
        return Report(stage=self.stage, measures=self.measures, decisions=self.decisions, cut_short=self.cut_short)


def keep_better(
    before: T,
    after: T,
    *,
    score: Callable[[T], float],
    step: str,
    measure: str,
    tolerance: float = 0.0,
    about: int | None = None,
) -> tuple[T, Decision]:
    """Keep ``after`` unless its score (higher is better) is more than ``tolerance`` below that of ``before``.

    Returns the kept value and a Decision with both scores; ``step`` and ``measure`` are words for it.
    """
    was, now = score(before), score(after)
    accepted = now >= was - tolerance
    decision = Decision(
        choice=f"{step}: {'accepted' if accepted else 'rolled back'}",
        reason=f"{measure} {was:.4f} -> {now:.4f}",
        about=about,
    )
    return (after if accepted else before), decision
