"""Run a command in a process of its own and sample what it and all that it starts hold in memory, step by step.

Linux only: reads /proc. Imports nothing heavy, for the reason that ``process`` tells.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

EVERY_S, SHARE = 0.1, 0.03
"""Time between samples, longer where sampling would take more than this share of a processor: the kernel walks all
pages of a process to tell what it holds."""
MB = 1e6
TICK = 1 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, kw_only=True)
class Sample:
    """What a process tree held at a time [s] since its start."""

    time: float
    tree: float
    """Memory [MB]: proportional set sizes added, what the processes share counts once."""
    main: float
    """Of the first process [MB]."""
    cpu: float
    """Processor time until then [s], ended processes included."""
    processes: int


@dataclass(kw_only=True)
class Watched:
    """What a command said and held."""

    code: int
    wall: float
    cpu: float
    """Processor time [s], ended child processes included."""
    highest: float
    """The first process's own high-water mark of resident memory [MB], exact where samples may miss a peak."""
    lines: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])
    """Every line of its output with its time [s]."""
    samples: list[Sample] = field(default_factory=list[Sample])
    marks: dict[str, float] = field(default_factory=dict[str, float])
    """When each of the asked-for conditions was first true [s]."""

    def peak(self, start: float, end: float) -> float:
        """Largest memory [MB] of the tree between two times; 0 when nothing was sampled."""
        return max((s.tree for s in self.samples if start <= s.time <= end), default=0.0)

    def busy(self, start: float, end: float) -> float:
        """Processor time [s] of the tree between two times."""
        before, after = (max((s.cpu for s in self.samples if s.time <= t), default=0.0) for t in (start, end))
        return after - before


def watch(
    command: Sequence[str], *, environment: Mapping[str, str], marks: Mapping[str, Callable[[], bool]] | None = None
) -> Watched:
    """Run a command to its end. ``marks``: named conditions, the first time [s] of each is noted."""
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, **environment}
    )
    watched = Watched(code=0, wall=0.0, cpu=0.0, highest=0.0)
    sampler = threading.Thread(target=_sample, args=(process, start, watched, dict(marks or {})))
    sampler.start()
    assert process.stdout is not None
    for line in process.stdout:
        watched.lines.append((time.perf_counter() - start, line.rstrip("\n")))
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = watched.code = os.waitstatus_to_exitcode(status)
    sampler.join()
    watched.wall = time.perf_counter() - start
    watched.cpu = usage.ru_utime + usage.ru_stime
    return watched


def _sample(
    process: subprocess.Popen[str], start: float, watched: Watched, marks: dict[str, Callable[[], bool]]
) -> None:
    while process.returncode is None:
        now, before = time.perf_counter() - start, time.thread_time()
        sizes = {pid: size for pid in _tree(process.pid) if (size := _proportional(pid))}
        main = sizes.get(process.pid, 0.0)
        cpu = sum(map(_processor_time, sizes))
        watched.samples.append(Sample(time=now, tree=sum(sizes.values()), main=main, cpu=cpu, processes=len(sizes)))
        watched.highest = max(watched.highest, _high_water(process.pid))
        for name in [name for name, holds in marks.items() if holds()]:
            watched.marks[name] = now
            del marks[name]
        spent = time.thread_time() - before
        time.sleep(max(EVERY_S, spent / SHARE))


def _tree(pid: int) -> list[int]:
    """A process and all that it started, directly or not."""
    found = [pid]
    for parent in found:
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{parent}/task").iterdir():
                found += map(int, (task / "children").read_text().split())
    return found


def _proportional(pid: int) -> float:
    """Proportional set size [MB]; 0 for a process that is gone."""
    return _field(Path(f"/proc/{pid}/smaps_rollup"), "Pss:")


def _high_water(pid: int) -> float:
    return _field(Path(f"/proc/{pid}/status"), "VmHWM:")


def _processor_time(pid: int) -> float:
    """Of a process and those it waited for [s]; 0 for one that is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return TICK * sum(map(int, fields[11:15]))


def _field(file: Path, name: str) -> float:
    try:
        line = next(line for line in file.read_text().splitlines() if line.startswith(name))
    except (OSError, StopIteration):
        return 0.0
    return int(line.split()[1]) * 1024 / MB
