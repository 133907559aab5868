"""Work in a second thread: its result and errors come back, and nobody who is interrupted waits for it."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from f3sr.runtime.daemon_thread import AHEAD, ahead, begun


def test_the_result_comes_back_from_another_thread():
    here = threading.get_ident()
    assert begun(lambda: threading.get_ident()).result() != here
    assert begun(divmod, 7, 2).result() == (3, 1)


def test_what_it_raises_is_raised_where_the_result_is_asked_for():
    with pytest.raises(ZeroDivisionError):
        begun(divmod, 1, 0).result()


def test_an_interrupted_process_does_not_wait_for_it():
    program = (
        "import time; from f3sr.runtime.daemon_thread import begun; begun(time.sleep, 60); raise KeyboardInterrupt"
    )
    ended = subprocess.run([sys.executable, "-c", program], timeout=30, capture_output=True, check=False)
    assert b"KeyboardInterrupt" in ended.stderr


def test_values_come_in_order_and_only_so_many_ahead():
    made: list[int] = []

    def values() -> Iterator[int]:
        for k in range(40):
            made.append(k)
            yield k

    for k, value in enumerate(ahead(values())):
        assert value == k and len(made) <= k + AHEAD + 2
    assert list(ahead([])) == [] and list(ahead([None, 0])) == [None, 0]


def test_what_making_a_value_raises_comes_in_its_place():
    def values() -> Iterator[int]:
        yield 1
        raise ZeroDivisionError

    got: list[int] = []
    with pytest.raises(ZeroDivisionError):
        got.extend(ahead(values()))
    assert not got or got == [1]


def test_the_thread_ends_when_nobody_asks_any_more():
    left = ahead(iter(int, 1))
    assert next(left) == 0
    left.close()  # type: ignore[attr-defined]
    deadline = time.monotonic() + 5
    while any(t.name == "ahead" for t in threading.enumerate()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
