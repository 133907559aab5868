"""The process of the ``f3sr`` command: signals and threads are looked after before anything heavy is imported."""

import os
from contextlib import suppress

from f3sr.runtime import signals
from f3sr.runtime.kept_imports import kept_imports
from f3sr.runtime.machine import ONE_THREAD


def run() -> None:
    """Console script. The process ends without interpreter shutdown, which takes up to half a second: a signal would
    kill it then, although its result is told."""
    os._exit(_code())


def _code() -> int:
    try:
        signals.watch()
        for name, threads in ONE_THREAD.items():
            os.environ.setdefault(name, threads)
        with kept_imports():
            from f3sr.cli import main
        return main.run()
    except Exception as error:  # no memory or no threads for the libraries
        from f3sr.errors import printable, unforeseen

        with suppress(OSError):  # nobody reads stderr
            os.write(2, f"f3sr: {printable(unforeseen(error, signals.state()))}\n".encode(errors="replace"))
        return 1


if __name__ == "__main__":
    run()
