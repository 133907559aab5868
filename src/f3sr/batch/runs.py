"""A whole batch: from inputs to a dataset with its index, on this machine or on a Ray cluster."""

from __future__ import annotations

import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from f3sr.batch.driver import Driver, Event, Report, Tally
from f3sr.batch.executors import Executor, Told, threads
from f3sr.batch.job import Job
from f3sr.batch.manifest import jobs_of
from f3sr.batch.ray_executor import ray_tasks
from f3sr.batch.supervisor import JobLimits
from f3sr.dataset.layout import Dataset
from f3sr.errors import OutputError
from f3sr.pipeline_config import Config
from f3sr.scene_package.package_folder import hold_one_another

WORK = "f3sr.batch.scene_job"
"""What makes a scene of an input folder."""


@dataclass(frozen=True, kw_only=True)
class RunPlan:
    """How a batch runs; none of it changes a package."""

    slots: int
    """Jobs at a time."""
    limits: JobLimits
    retries: int = 1
    """Further attempts at a job that crashed or exceeded a limit."""
    again: bool = False
    """Also try inputs again that were bad in an earlier run."""
    ray: str | None = None
    """Address of a Ray cluster, or ``auto``; None for this machine."""
    work: str = field(default_factory=lambda: WORK)
    """What makes a scene of an input folder."""


def run_batch(
    inputs: Path, out: str | Path, common: Job, config: Config, plan: RunPlan, report: Report, *, begun: Any = None
) -> Tally:
    """Bring every job of ``inputs`` to its end in the dataset ``out``, and derive its index (docs: batch).

    ``common`` has what all jobs share. ``begun`` is called with the number of jobs before the first. Raises InputError
    for a manifest that is not valid, OutputError where ``out`` cannot be a dataset or another run writes it.
    """
    is_local = "://" not in str(out) and inputs.is_dir()
    if is_local and hold_one_another(*(Path(os.path.realpath(place)) for place in (inputs, out))):
        raise OutputError(f"{out}: the dataset and the folder {inputs} of inputs may not hold one another")
    count, jobs = jobs_of(inputs, common, config)
    dataset = Dataset.made(out)
    with dataset.storage.claimed():
        if begun is not None:
            begun(count)
        with _executor(dataset, plan, _steps(report)) as executor:
            driver = Driver(
                dataset,
                executor,
                retries=plan.retries,
                again=plan.again,
                report=report,
                storage_wait_s=plan.limits.storage_wait_s,
            )
            tally = driver.run(jobs)
        driver.index()
    return tally


@contextmanager
def _executor(dataset: Dataset, plan: RunPlan, told: Told) -> Generator[Executor]:
    place = dataset.storage.place
    if plan.ray is not None:
        with ray_tasks(plan.ray, plan.slots, place, plan.limits, plan.work, again=plan.again) as cluster:
            yield cluster
        return
    with threads(plan.slots, place, plan.limits, plan.work, told, again=plan.again) as made:
        yield made


def _steps(report: Report) -> Told:
    """Steps of jobs as events; they come from several threads."""

    def told(job: Job, said: Mapping[str, Any]) -> None:
        if said["event"] == "full":
            report(Event(name=job.name, state="full", key=job.key, reason=said["reason"]))
        elif said["event"] == "step" and said["state"] == "started":
            report(Event(name=job.name, state="step", key=job.key, step=said["name"]))

    return told
