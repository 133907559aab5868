"""Work in a second thread that nobody who is interrupted has to wait for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from queue import Full, Queue
from threading import Event, Thread
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def begun(work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
    """The result of a call that goes on beside the caller, in a daemon thread: unlike those of an executor it ends with
    the process. ``result()`` waits for it and raises what it raised."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work(*args, **kwargs))
        except BaseException as error:  # raised again where the result is asked for
            future.set_exception(error)

    Thread(target=run, daemon=True, name=getattr(work, "__name__", "work")).start()
    return future


AHEAD = 4
"""Values that are made before they are asked for, at most."""
WAKE_S = 0.2
"""How soon a thread finds out that nobody wants its values any more [s]."""


def ahead(values: Iterable[T]) -> Iterator[T]:
    """The same values in the same order, made in a thread of its own while the last ones are used. What making one
    raises is raised here in its place; the thread ends when nobody asks any more."""
    made: Queue[tuple[list[T], BaseException | None]] = Queue(AHEAD)
    unwanted = Event()

    def put(value: list[T], error: BaseException | None = None) -> None:
        while not unwanted.is_set():
            with suppress(Full):
                made.put((value, error), timeout=WAKE_S)
                return

    def run() -> None:
        try:
            for value in values:
                put([value])
                if unwanted.is_set():
                    return
            put([])
        except BaseException as error:  # raised again where the value is asked for
            put([], error)

    Thread(target=run, daemon=True, name="ahead").start()
    try:
        while True:
            value, error = made.get()
            if error is not None:
                raise error
            if not value:
                return
            yield value[0]
    finally:
        unwanted.set()
