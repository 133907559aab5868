"""Geometry models in environments of their own: one job folder per photo (docs: workers)."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from f3sr.backends.protocols import PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.runtime.cached_jobs import locked
from f3sr.workers import geometry_job
from f3sr.workers.geometry_job import WorkerDepth
from f3sr.workers.job_worker import SEED, JobWorker, tidy_jobs
from f3sr.workers.worker_process import WorkerError


class GeometryWorker(JobWorker):
    """A model that maps a photo and its camera to depths, run by a program of the user's."""

    kind: ClassVar[str] = "geometry"

    def predict(self, image: PromptedImage, K: Array) -> WorkerDepth:
        """The map of a photo; an equal job is not asked again. ``K`` (3, 3) in pixels of the photo.

        Raises InputError for a command that is missing and for a bad answer, WorkerError for a bad end."""
        told_by = image.focal.source if image.focal else None
        job = self.job((K.tolist(), told_by), (image.photo.rgb,))
        with locked(job, self.waits):
            geometry_job.write_job(job, image, K, seed=SEED)
            if geometry_job.is_done(job):
                self.tell(f"{self.model.name}: the geometry is there from an earlier run")
            else:
                self.run(job, lambda said: self.tell(f"{self.model.name}: {said.state}"))
            if not geometry_job.is_done(job):
                raise WorkerError(f"worker {self.command()[0]}: it ended without an answer; job {job}")
            answer = self._answer(job, image)
            self.models = {answer.told} if answer.told else set[str]()
            tidy_jobs()
        return answer

    def _answer(self, job: Path, image: PromptedImage) -> WorkerDepth:
        try:
            return geometry_job.read_answer(job, image.photo)
        except InputError:
            geometry_job.discard(job)  # the next run asks again
            raise
