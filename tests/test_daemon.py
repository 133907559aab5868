"""Work in a second thread: its result and errors come back, and nobody who is interrupted waits for it."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from f3sr.daemon import begun


def test_the_result_comes_back_from_another_thread():
    here = threading.get_ident()
    assert begun(lambda: threading.get_ident()).result() != here
    assert begun(divmod, 7, 2).result() == (3, 1)


def test_what_it_raises_is_raised_where_the_result_is_asked_for():
    with pytest.raises(ZeroDivisionError):
        begun(divmod, 1, 0).result()


def test_an_interrupted_process_does_not_wait_for_it():
    program = "import time; from f3sr.daemon import begun; begun(time.sleep, 60); raise KeyboardInterrupt"
    ended = subprocess.run([sys.executable, "-c", program], timeout=30, capture_output=True, check=False)
    assert b"KeyboardInterrupt" in ended.stderr
