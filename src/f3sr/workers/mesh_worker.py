"""Generators in environments of their own: one job folder, one process for all masks (docs: workers)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.protocols import Axis, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError, printable
from f3sr.runtime.cached_jobs import locked
from f3sr.scene import Geometry, Instance
from f3sr.workers import mesh_job
from f3sr.workers.job_worker import SEED, JobWorker, WorkerModel, tidy_jobs
from f3sr.workers.worker_process import Progressed, WorkerError, WorkerLimits


@dataclass(frozen=True, kw_only=True)
class MeshModel(WorkerModel):
    """What is known of a generator before it answers."""

    up: Axis | None = None
    """The axis of its meshes that points up, where an answer does not tell."""


class MeshWorker(JobWorker):
    """A MeshProducer that is a program of the user's."""

    kind: ClassVar[str] = "assets"

    def __init__(
        self, model: MeshModel, choice: ModelChoice | None = None, *, limits: WorkerLimits | None = None
    ) -> None:
        super().__init__(model, choice, limits=limits)
        self.up = model.up

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """A mesh per instance; what an earlier run of the same job finished is not made again.

        Raises InputError for a command that is missing and for a bad answer, WorkerError for a bad end."""
        labels = [(i.id, i.label) for i in image.instances]
        arrays = (image.photo.rgb, geometry.points, geometry.valid, *(i.mask for i in image.instances))
        job = self.job((K.tolist(), labels), arrays)
        with locked(job, self.waits):
            mesh_job.write_job(job, image, geometry, K, seed=SEED)
            self._work(job, image)
            if extra := mesh_job.strangers(job, image):
                accepted = "one per mask that was asked for"
                raise InputError(job / extra[0], found="an answer for no mask", accepted=accepted)
            meshes = {i.id: self._answer(job, i.id) for i in image.instances}
            self.models = {mesh.told for mesh in meshes.values() if mesh.told}
            tidy_jobs()
        return meshes

    def _work(self, job: Path, image: PromptedImage) -> None:
        """Have the objects made that have no answer yet."""
        count = len(image.instances)
        done = sum(mesh_job.is_done(job, i.id) for i in image.instances)
        if done:
            self.tell(f"{self.model.name}: {done} of {count} are there from an earlier run")
        if done < count:
            self.run(job, lambda said: self.tell(_words(self.model.name, said, image.instances)))
        done = sum(mesh_job.is_done(job, i.id) for i in image.instances)
        if done < count:
            raise WorkerError(f"worker {self.command()[0]}: {done} of {count} objects done, then it ended; job {job}")

    def _answer(self, job: Path, id: int) -> ProducedMesh:
        try:
            made = mesh_job.read_answer(job, id)
        except InputError:
            mesh_job.discard(job, id)  # the next run asks for it again
            raise
        return made if made.up or made.pose else replace(made, up=self.up)


def _words(name: str, said: Progressed, instances: Sequence[Instance]) -> str:
    """A line of progress for the user: ``sam3d: 3 of 8, cup: started``."""
    for number, i in enumerate(instances, 1):
        if i.id == said.id:
            return f"{name}: {number} of {len(instances)}, {printable(i.label or i.name)}: {said.state}"
    return f"{name}: {said.state}"
