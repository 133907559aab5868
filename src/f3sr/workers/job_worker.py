"""What all workers have: a command of the user's, a job folder in the cache, limits, and words while they work."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from numpy.typing import NDArray

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.errors import F3srError, InputError
from f3sr.runtime.cache_folder import within
from f3sr.runtime.cached_jobs import tidy
from f3sr.workers.worker_process import Progressed, WorkerLimits, run_worker

VARIABLE = "F3SR_WORKER_"
"""Beginning of the environment variables with commands of workers: F3SR_WORKER_SAM3D."""
SEED = 0
FOLDER = "workers"
"""Of all job folders, in the cache."""
SHARE = 1.0
"""Most that job folders take together [share of the cache's size limit]: the one in use may be larger."""


@dataclass(frozen=True, kw_only=True)
class WorkerModel:
    """What is known of a model before it answers."""

    name: str
    licence: str = ""
    script: str = ""
    """The script of f3sr's ``workers/`` folder that runs it."""


class JobWorker:
    """A program of the user's that answers job folders. Its command comes from the spec or from the environment."""

    kind: ClassVar[str]
    """Of the back end, for messages."""

    def __init__(
        self, model: WorkerModel, choice: ModelChoice | None = None, *, limits: WorkerLimits | None = None
    ) -> None:
        self.model = model
        self.command_text = (choice or ModelChoice()).model or os.environ.get(self.variable, "")
        self.limits = limits or WorkerLimits()
        self.tell: Callable[[str], None] = _silent
        self.models = set[str]()

    @property
    def variable(self) -> str:
        """The environment variable that may hold the command."""
        return VARIABLE + self.model.name.upper().replace("-", "_")

    @property
    def provenance(self) -> Mapping[str, str]:
        """What the worker told of its models, and their licence where it told none."""
        return {"model": "; ".join(sorted(self.models)), "licence": "" if self.models else self.model.licence}

    def telling(self, tell: Callable[[str], None]) -> Self:
        """The worker, which tells what it is at from now on."""
        self.tell = tell
        return self

    def needs(self) -> tuple[Need, ...]:
        """A command whose program is there."""
        words = parsed_command(self.command_text, where=self.variable) if self.command_text else ()
        if not words:
            remedy = f"export {self.variable}='conda run --no-capture-output -n ENV python -u {self.model.script}'"
            return (Need(what="command", met=False, found=f"none in {self.variable}", remedy=remedy),)
        program = shutil.which(words[0])
        found = program or f"no program {words[0]}"
        return (Need(what="command", met=program is not None, found=found, remedy=f"see {self.variable}"),)

    def command(self) -> tuple[str, ...]:
        """Its words. Raises InputError where there is none."""
        if not self.command_text:
            accepted = f"its command after a colon, or in ${self.variable} (docs: workers)"
            raise InputError(f"{self.kind} back end {self.model.name}", found="no command", accepted=accepted)
        return parsed_command(self.command_text, where=self.variable)

    def job(self, asked: object, arrays: Iterable[NDArray[Any]]) -> Path:
        """A folder of the cache for what is asked and this command: the same again goes on where it ended."""
        if (jobs := within(FOLDER)) is None:
            raise F3srError("a worker needs a cache folder: F3SR_CACHE_DIR names one")
        hashed = hashlib.sha256(repr((self.kind, self.model.name, self.command(), SEED, asked)).encode())
        for array in arrays:
            hashed.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
        return jobs / hashed.hexdigest()[:32]

    def waits(self) -> None:
        """Tell that another process works on the same job."""
        self.tell(f"{self.model.name}: waits for another run of f3sr, which works on the same job")

    def run(self, job: Path, told: Callable[[Progressed], None]) -> None:
        """Run the command on a job folder. Raises WorkerError for a bad end."""
        self.tell(f"{self.model.name}: {self.command()[0]} is started")
        run_worker(self.command(), job, self.limits, told)


def tidy_jobs() -> None:
    """Bound the job folders of all workers; those that a process works in stay."""
    if jobs := within(FOLDER):
        tidy(jobs, depth=1, share=SHARE, may_go=lambda _: True)


def parsed_command(text: str, *, where: str) -> tuple[str, ...]:
    """The words of a command line, as a shell splits them; no shell runs it. Raises F3srError for an open quote."""
    try:
        words = tuple(shlex.split(text))
    except ValueError as error:
        raise F3srError(f"{where}: {error}") from None
    if not words:
        raise F3srError(f"{where}: an empty command")
    return words


def _silent(words: str) -> None:
    del words
