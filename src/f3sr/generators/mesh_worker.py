"""Generators in environments of their own: one job folder, one process for all masks (docs: workers)."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import Axis, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import F3srError, InputError
from f3sr.generators import worker_job
from f3sr.generators.worker_process import Progressed, WorkerError, WorkerLimits, parsed_command, run_worker
from f3sr.runtime.cache_folder import within
from f3sr.scene import Geometry

VARIABLE = "F3SR_WORKER_"
"""Beginning of the environment variables with commands of workers: F3SR_WORKER_SAM3D."""
SEED = 0


@dataclass(frozen=True, kw_only=True)
class WorkerModel:
    """What is known of a generator before it answers."""

    name: str
    up: Axis | None = None
    """The axis of its meshes that points up, where an answer does not tell."""
    licence: str = ""
    script: str = ""
    """The script of f3sr's ``workers/`` folder that runs it."""


class MeshWorker:
    """A MeshProducer that is a program of the user's. Its command comes from the spec or from the environment."""

    def __init__(
        self, model: WorkerModel, choice: ModelChoice | None = None, *, limits: WorkerLimits | None = None
    ) -> None:
        self.model = model
        self.command_text = (choice or ModelChoice()).model or os.environ.get(self.variable, "")
        self.limits = limits or WorkerLimits()
        self.told: Callable[[Progressed], None] = _silent
        self.models = set[str]()

    @property
    def variable(self) -> str:
        """The environment variable that may hold the command."""
        return VARIABLE + self.model.name.upper().replace("-", "_")

    @property
    def provenance(self) -> Mapping[str, str]:
        """What the worker told of its models, and their licence where it told none."""
        return {"model": "; ".join(sorted(self.models)), "licence": "" if self.models else self.model.licence}

    def needs(self) -> tuple[Need, ...]:
        """A command whose program is there."""
        words = parsed_command(self.command_text, where=self.variable) if self.command_text else ()
        if not words:
            remedy = f"export {self.variable}='conda run --no-capture-output -n ENV python -u {self.model.script}'"
            return (Need(what="command", met=False, found=f"none in {self.variable}", remedy=remedy),)
        program = shutil.which(words[0])
        found = program or f"no program {words[0]}"
        return (Need(what="command", met=program is not None, found=found, remedy=f"see {self.variable}"),)

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """A mesh per instance; what an earlier run of the same job finished is not made again.

        Raises InputError for a command that is missing and for a bad answer, WorkerError for a bad end."""
        command = self._command()
        job = self._job(command, image, geometry, K)
        worker_job.write_job(job, image, geometry, K, seed=SEED)
        ids = [i.id for i in image.instances]
        if not all(worker_job.is_done(job, id) for id in ids):
            run_worker(command, job, self.limits, self.told)
        if extra := worker_job.strangers(job, image):
            raise InputError(job / extra[0], found="an answer for no mask", accepted="one per mask that was asked for")
        if missing := [id for id in ids if not worker_job.is_done(job, id)]:
            done = len(ids) - len(missing)
            raise WorkerError(f"worker {command[0]}: {done} of {len(ids)} objects done, then it ended; job {job}")
        meshes = {id: self._answer(job, id) for id in ids}
        self.models = {mesh.told for mesh in meshes.values() if mesh.told}
        return meshes

    def _answer(self, job: Path, id: int) -> ProducedMesh:
        try:
            made = worker_job.read_answer(job, id)
        except InputError:
            worker_job.discard(job, id)  # the next run asks for it again
            raise
        return made if made.up or made.poses else replace(made, up=self.model.up)

    def _command(self) -> Sequence[str]:
        if not self.command_text:
            accepted = f"its command after a colon, or in ${self.variable} (docs: workers)"
            raise InputError(f"assets back end {self.model.name}", found="no command", accepted=accepted)
        return parsed_command(self.command_text, where=self.variable)

    def _job(self, command: Sequence[str], image: PromptedImage, geometry: Geometry, K: Array) -> Path:
        """A folder of the cache for these inputs and this command: the same again goes on where it ended."""
        if (jobs := within("workers")) is None:
            raise F3srError("a worker needs a cache folder: F3SR_CACHE_DIR names one")
        hashed = hashlib.sha256(repr((self.model.name, tuple(command), SEED, K.tolist())).encode())
        for array in (image.photo.rgb, geometry.points, geometry.valid, *(i.mask for i in image.instances)):
            hashed.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
        hashed.update(repr([(i.id, i.label) for i in image.instances]).encode())
        return jobs / hashed.hexdigest()[:32]


def _silent(_: Progressed) -> None:
    return None
