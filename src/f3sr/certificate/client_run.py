"""A client run to its end: in a worker with a deadline, so that its crash or hang is one line."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from f3sr.certificate.client_answers import FindingsAnswer, Missing, ReleaseAnswer, read_answer
from f3sr.certificate.clients_table import Client
from f3sr.errors import InputError, printable
from f3sr.runtime.cache_folder import PRIVATE
from f3sr.workers.worker_process import WorkerError, WorkerLimits, run_worker

PROTOCOL = 1
"""Of ``clients/client_job.py``."""
REQUEST = "request.json"
FOLDER_BYTES = 1_000_000_000
"""Most bytes that a client may write."""
Answer = TypeVar("Answer", ReleaseAnswer, FindingsAnswer)


@dataclass(frozen=True, kw_only=True)
class ClientOutcome(Generic[Answer]):
    """What came of a client: its answer, or why there is none."""

    answer: Answer | None = None
    missing: str = ""
    """Of a program that is not installed."""
    problem: str = ""
    """Of one that is, and gave no answer that can be believed."""


def run_client(
    client: Client,
    kind: type[Answer],
    request: Mapping[str, Any],
    *,
    program: str | None,
    deadline: float,
    told: Callable[[str], None],
) -> ClientOutcome[Answer]:
    """Ask a client. ``program``: the interpreter of its environment, else this one, or node for a script of node's.

    ``deadline``: wall time [s]. Raises no error of the client."""
    wanted = program or ("node" if client.runs_in_node else sys.executable)
    place = shutil.which(wanted)
    if place is None:
        return ClientOutcome(missing=f"no program {printable(wanted)}")
    found = str(Path(place).absolute())  # links stay: an environment's interpreter is one
    command = [found, str(client.path)] if client.runs_in_node else [found, "-E", str(client.path)]
    with tempfile.TemporaryDirectory(prefix="f3sr-certify-") as place:
        job = Path(place)
        job.chmod(PRIVATE)
        (job / REQUEST).write_text(json.dumps({"protocol": PROTOCOL, **request}))
        limits = WorkerLimits(wall_s=deadline, silence_s=deadline, folder_bytes=FOLDER_BYTES)
        try:
            run_worker(command, job, limits, lambda said: told(said.state), resumable=False)
            answer = read_answer(job, kind)
        except InputError as error:
            return ClientOutcome(problem=_without(str(error), job))
        except WorkerError as error:
            return ClientOutcome(problem=_without(str(error), job))
        if isinstance(answer, Missing):
            return ClientOutcome(missing=printable(answer.missing))
        assert isinstance(answer, kind)
        return ClientOutcome(answer=answer)


def require_programs(programs: Mapping[str, str], names: Sequence[str]) -> None:
    """Raises InputError unless every given interpreter is for a known client and can be started."""
    for name, program in programs.items():
        if name not in names:
            raise InputError("--python", found=name, accepted=f"a client of {', '.join(names)}, and its interpreter")
        if shutil.which(program) is None:
            raise InputError("--python", found=f"{name}={program}", accepted="a program that can be started")


def _without(words: str, job: Path) -> str:
    """The words without the job folder, which is gone, and in which the answer always has one name."""
    return printable(words.replace(f"{job}{os.sep}", "").replace(str(job), "its job folder"))
