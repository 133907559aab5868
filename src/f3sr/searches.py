"""Searches as generators: each asks for values at some points and goes on once it is told.

So a search is written once and read from top to bottom, while who answers decides how: one question after the other,
or those of many searches in one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from typing import TypeVar

Question = TypeVar("Question")
Answer = TypeVar("Answer")
Result = TypeVar("Result")

Search = Generator[Sequence[Question], Sequence[Answer], Result]
"""Yields questions, is sent as many answers, returns its result."""


def answered(
    search: Search[Question, Answer, Result], answers: Callable[[Sequence[Question]], Sequence[Answer]]
) -> Result:
    """The result of a search whose questions ``answers`` answers."""
    try:
        questions = next(search)
        while True:
            questions = search.send(answers(questions))
    except StopIteration as end:
        return end.value


def together(
    searches: Iterable[Search[Question, Answer, Result]],
) -> Search[Question, Answer, list[Result]]:
    """Several searches as one: every round asks what all that have not ended ask, in their order."""
    running = list(searches)
    results: dict[int, Result] = {}
    asked: dict[int, Sequence[Question]] = {}
    told: dict[int, Sequence[Answer] | None] = dict.fromkeys(range(len(running)))
    while told:
        for k, answers in told.items():
            try:
                asked[k] = next(running[k]) if answers is None else running[k].send(answers)
            except StopIteration as end:
                results[k] = end.value
                asked.pop(k, None)
        if not asked:
            break
        answers = list((yield [question for questions in asked.values() for question in questions]))
        told = {}
        for k, questions in asked.items():
            told[k], answers = answers[: len(questions)], answers[len(questions) :]
    return [results[k] for k in range(len(running))]
