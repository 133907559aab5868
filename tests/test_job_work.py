"""Real jobs of the studio on a small scene: pictures while it is made, a cancel on the way, a film, an export."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import forked
from f3sr.goals.file_names import FILM
from f3sr.scene_package.package import read_package
from f3sr.studio import job_queue
from f3sr.studio.job_queue import JobQueue
from f3sr.studio.job_record import ENDS, JobFolder
from f3sr.studio.workspace import Project, Workspace
from folders import write_folder
from waiting import soon

SHOWN = ["level", "align", "rest"]


@pytest.fixture
def started(tmp_path: Path, compiled: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[JobQueue, Project]]:
    """A queue and a project; stages of no earlier run are there, compiled kernels are."""
    (tmp_path / "cache").mkdir(mode=0o700)
    (tmp_path / "cache" / compiled.name).symlink_to(compiled)
    monkeypatch.setenv("F3SR_CACHE_DIR", str(tmp_path / "cache"))
    write_folder(tmp_path / "boxes", perturb=0.06, seed=3)
    workspace = Workspace(tmp_path / "workspace")
    queue = JobQueue(workspace)
    project = workspace.create_folder(tmp_path / "boxes")
    yield queue, project
    queue.cancel_all(project)
    queue.close()
    workspace.close()


def done(queue: JobQueue, project: Project, kind: str, **options: Any) -> JobFolder:
    job = queue.submit(project, kind, options)
    assert soon(lambda: job.record.state in ENDS, seconds=120)
    assert job.told()["problem"] == ""
    return job


def pictures(job: JobFolder) -> list[str]:
    return [event["name"] for event in job.events() if event["event"] == "picture"]


def steps(job: JobFolder, state: str) -> set[str]:
    return {event["name"] for event in job.events() if event["event"] == "step" and event["state"] == state}


def in_session(leader: int) -> list[int]:
    """Processes of a session that are no zombies."""
    found = list[int]()
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session, *_ = file.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(session) == leader and state != "Z":
            found.append(int(file.parent.name))
    return found


@pytest.mark.slow
def test_a_folder_becomes_a_scene_with_pictures_on_the_way_and_a_film(
    started: tuple[JobQueue, Project], monkeypatch: pytest.MonkeyPatch
):
    queue, project = started
    first = queue.submit(project, "reconstruct", {})
    assert soon(lambda: "align" in pictures(first) or first.end, seconds=120)
    assert pictures(first) == ["level", "align"] and (leader := first.pid) and in_session(leader)
    queue.cancel(first)
    assert soon(lambda: first.record.state in ENDS) and first.told()["state"] == "cancelled"
    assert soon(lambda: not in_session(leader), seconds=2)
    monkeypatch.setattr(job_queue, "subprocess", forked.FOR_SUBPROCESS)  # the first job started as a user's does
    left = {"project.json", "input", "jobs"}
    assert {entry.name for entry in project.folder.iterdir()} == left

    second = done(queue, project, "reconstruct")
    assert steps(second, "resumed") >= {"level", "align"} and steps(second, "done") >= {"settle", "package"}
    assert pictures(second) == SHOWN
    drawn = [np.asarray(Image.open(second.pictures / f"{name}.png")).astype(int) for name in SHOWN]
    assert all(picture.ndim == 3 and max(picture.shape) <= 900 for picture in drawn)
    assert all(np.abs(a - b).max() > 20 for a, b in pairwise(drawn))
    assert {o.id for o in read_package(project.package).scene} == {2, 5, 7}
    assert second.told()["result"]["measures"]["N_cross"] == 0

    told = done(queue, project, "play", goal="knock over the tall box").told()["result"]
    assert told["rollout"] == 1 and (project.rollouts / "1" / FILM).stat().st_size > 1000
    done(queue, project, "export", formats=["urdf"])
    assert list(project.exported.rglob("*.urdf"))
    assert {entry.name for entry in project.folder.iterdir()} == left | {"package", "rollouts", "export"}
