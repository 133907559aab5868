"""How a command ends early: Ctrl-C, SIGTERM and SIGHUP undo what is half done, say so in one line and exit with 1.

A signal must end the process anywhere: in an import, in compiled code, in a waiting thread. So no exception is raised.
A separate thread waits for the signal and for the end of work under ``held``. Then it undoes what ``undone``
registered and exits. Its line says what is on disk, as given by ``wrote``.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from pathlib import Path  # not while the process starts: every millisecond before ``watch`` counts

T = TypeVar("T")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE_S = 1.5
"""How long work under ``held`` may keep a signal waiting [s]; then the next run has to tidy up."""

_disk = threading.RLock()
_undo: dict[object, Callable[[], object]] = {}
_written: list[Path] = []
_kept: list[str] = []
_watching: list[threading.Thread] = []


def watch() -> None:
    """End this process on the signals, except those that it ignores already (``nohup``). Once, from the main thread."""
    if _watching:
        return
    ear, mouth = os.pipe()
    os.set_blocking(mouth, False)
    signal.set_wakeup_fd(mouth, warn_on_full_buffer=False)
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _heard)
    _watching.append(threading.Thread(target=_end_on_signal, args=[ear], name="f3sr-signals", daemon=True))
    _watching[0].start()


@contextmanager
def held() -> Generator[None]:
    """Work on disk that a signal does not cut: short steps only."""
    with _disk:
        yield


@contextmanager
def undone(start: Callable[[], T], undo: Callable[[T], object]) -> Generator[T]:
    """What ``start`` makes; ``undo`` is called on it if a signal ends the process before the block is left.

    Undoing must bear that other threads go on until the process is gone."""
    token = object()
    with _disk:
        made = start()
        _undo[token] = lambda: undo(made)
    try:
        yield made
    finally:
        del _undo[token]


def wrote(place: Path) -> None:
    """The result is complete, even if a signal comes now."""
    _written.append(place)


def keeps(words: str) -> None:
    """What to say of the disk while no result as a whole is complete."""
    _kept[:] = [words]


def state() -> str:
    """What this process has left on disk, in words."""
    if _written:
        return f"{_written[-1]} is complete"
    return _kept[0] if _kept else "nothing was written"


def _heard(*_: Any) -> None:
    """The signal's number is in the pipe already."""


def _end_on_signal(ear: int) -> None:
    os.read(ear, 1)
    _disk.acquire(timeout=PATIENCE_S)  # a disk that hangs must not hang the user too
    for undo in list(_undo.values()):
        with contextlib.suppress(Exception):
            undo()
    with contextlib.suppress(OSError):
        os.write(2, f"f3sr: interrupted; {state()}\n".encode())
    os._exit(1)
