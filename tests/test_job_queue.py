"""Jobs of the studio: their order, their ends, and that nothing is lost when a server dies."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forked
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.io.images import encode_png
from f3sr.runtime import file_lock
from f3sr.studio import job_queue, job_record
from f3sr.studio.job_queue import JobQueue, QueueConfig
from f3sr.studio.job_record import ENDS, EVENTS, LOCK, MAX_STARTS, RECORD, SPARE, JobFolder, jobs_in
from f3sr.studio.workspace import Project, Workspace
from stub_studio_work import FILES
from waiting import is_running, soon

WORKER = "stub_studio_work"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace's folder with one project, closed. Processes of jobs that a test's own queue starts are forked, and
    it looks at them more often than for a user."""
    monkeypatch.setattr(job_queue, "subprocess", forked.FOR_SUBPROCESS)
    monkeypatch.setattr(job_queue, "POLL_S", 0.01)
    workspace = Workspace(tmp_path / "workspace")
    workspace.create_photo("a.png", encode_png(np.zeros((16, 16, 3), np.uint8)))
    workspace.close()
    return tmp_path / "workspace"


@contextlib.contextmanager
def opened(place: Path, **limits: Any) -> Generator[tuple[JobQueue, Project]]:
    workspace = Workspace(place)
    queue = JobQueue(workspace, QueueConfig(**limits), worker=WORKER)
    project = workspace.listed()[0]
    try:
        yield queue, project
    finally:
        for job in queue.jobs(project):
            queue.cancel(job)
        queue.cancel_all(project)
        queue.close()
        workspace.close()


def asked(queue: JobQueue, project: Project, goal: str) -> JobFolder:
    return queue.submit(project, "play", {"goal": goal})


def state(job: JobFolder) -> str:
    return job.told()["state"]


def ended(job: JobFolder, seconds: float = 30) -> dict[str, Any]:
    """What a job tells once it has ended, by its record."""
    assert soon(lambda: job.record.state in ENDS, seconds=seconds)
    return job.told()


def names(job: JobFolder) -> list[str]:
    return [event["event"] for event in job.events()]


# --- ends -----------------------------------------------------------------------------------------------------------


def test_jobs_are_done_one_after_another_and_no_more_wait_than_may(place: Path):
    with opened(place, waiting=3) as (queue, project):
        running = asked(queue, project, "step 0.3; write first")
        assert soon(lambda: state(running) == "running")
        later = [asked(queue, project, f"step 0; write {word}") for word in ("second", "fail", "third")]
        with pytest.raises(F3srError, match="3 jobs wait already"):
            asked(queue, project, "step 0")
        assert [job.id for job in queue.jobs(project)] == sorted(job.id for job in [running, *later])
        queue.cancel(later[1])
        assert [ended(job)["state"] for job in (running, *later)] == ["done", "done", "cancelled", "done"]
        assert later[1].events() == []
        files = [project.package / f"{k}.txt" for k in range(FILES)]
        assert {file.read_text() for file in files} == {"third"}
        order = [job.folder.joinpath(EVENTS).stat().st_mtime_ns for job in (running, later[0], later[2])]
        assert order == sorted(order)
        asked(queue, project, "step 0")


def test_jobs_of_two_projects_run_beside_each_other_those_of_one_do_not(place: Path):
    workspace = Workspace(place)
    other = workspace.create_photo("b.png", encode_png(np.zeros((16, 16, 3), np.uint8)))
    workspace.close()
    with opened(place, parallel=3) as (queue, _):
        project = next(p for p in workspace.listed() if p.id != other.id)
        first, second = asked(queue, project, "step 60"), asked(queue, project, "step 0")
        assert ended(asked(queue, other, "step 0"))["state"] == "done"
        assert (state(first), state(second)) == ("running", "queued")
        queue.cancel(first)
        assert ended(second)["state"] == "done"


@pytest.mark.parametrize(
    ("goal", "problem"),
    [
        ("fail no such thing", "no such thing"),
        ("wrong", "unforeseen ZeroDivisionError: nobody; what was there before is unchanged"),
        ("memory", "it needs more memory than a job may have"),
        ("crash", "its process was killed by SIGSEGV: the last words"),
        ("full", "could not be written (no space left on device)"),
    ],
)
def test_a_job_that_fails_says_why_in_one_line_and_changes_nothing(place: Path, goal: str, problem: str):
    with opened(place, memory_gb=4) as (queue, project):
        project.package.mkdir()
        (project.package / "old.txt").write_text("old")
        told = ended(asked(queue, project, goal))
        assert told["state"] == "failed" and problem in told["problem"] and "\n" not in told["problem"]
        assert [p.name for p in project.package.iterdir()] == ["old.txt"]
        assert {p.name for p in project.folder.iterdir()} == {"project.json", "photo.png", "package", "jobs"}
        assert ended(asked(queue, project, "step 0"))["state"] == "done"


@pytest.mark.slow
def test_a_job_ends_at_its_time_also_where_no_server_watches(place: Path):
    with opened(place, wall_s=1) as (queue, project):
        told = ended(asked(queue, project, "write some 60"))
        assert (told["state"], told["problem"]) == ("failed", "it took longer than 1 s")
        assert not project.package.exists()
    script = f"""
import sys; sys.path[:0] = {sys.path!r}
from pathlib import Path
from f3sr.studio.job_queue import JobQueue, QueueConfig
from f3sr.studio.workspace import Workspace
import os, time
w = Workspace(Path({str(place)!r}))
q = JobQueue(w, QueueConfig(wall_s=1), worker={WORKER!r})
job = q.submit(w.listed()[0], "play", {{"goal": "step 60"}})
while not job.events(): time.sleep(.01)
os._exit(0)
"""
    forked.run([sys.executable, "-c", script], check=True)
    with opened(place) as (_, project):
        assert ended(jobs_in(project.jobs)[-1])["problem"] == "it took longer than 1 s"
        assert jobs_in(project.jobs)[-1].record.starts == 1


@pytest.mark.parametrize("goal", ["write some 30", "child; step 30", "deaf; child; step 30"])
def test_cancel_ends_all_processes_in_two_seconds_and_leaves_what_was_there(place: Path, goal: str):
    with opened(place) as (queue, project):
        project.package.mkdir()
        (project.package / "old.txt").write_text("old")
        job = asked(queue, project, goal)
        assert soon(lambda: len(names(job)) == goal.count(";") + 1)
        pids = [pid for pid in (job.pid, *(event.get("pid") for event in job.events())) if pid]
        start = time.monotonic()
        queue.cancel(job)
        queue.cancel(job)
        assert soon(lambda: not any(map(is_running, pids)))
        assert time.monotonic() - start < 2.5
        told = ended(job)
        assert (told["state"], told["problem"], told["result"]) == ("cancelled", "", {})
        assert [p.name for p in project.package.iterdir()] == ["old.txt"]
        queue.cancel(job)
        assert state(job) == "cancelled"
        assert ended(asked(queue, project, "step 0"))["state"] == "done"


def test_a_job_cancelled_before_its_process_is_up_ends_at_once(place: Path):
    with opened(place) as (queue, project):
        job = asked(queue, project, "step 30")
        assert soon(lambda: job.record.state == "running")
        start = time.monotonic()
        queue.cancel(job)
        assert ended(job)["state"] == "cancelled" and time.monotonic() - start < 1.5
        assert names(job) == []


# --- servers that die -------------------------------------------------------------------------------------------------

POINTS: dict[str, Callable[[JobFolder], bool]] = {
    "asked": lambda job: True,
    "begun": lambda job: job.record.state == "running",
    "locked": lambda job: job.pid is not None,
    "up": lambda job: bool(job.pid),
    **{f"event {n}": lambda job, n=n: len(job.events()) >= n for n in (1, 3, 5)},
    "ended": lambda job: job.end is not None,
}


@pytest.mark.slow
@pytest.mark.parametrize("point", POINTS)
def test_a_job_is_done_once_wherever_its_server_is_killed(place: Path, point: str):
    command = [
        sys.executable,
        "-m",
        "stub_studio_server",
        str(place),
        "step 0.05; step 0.05; write whole 0.03",
        "step 0",
    ]
    with forked.Popen(command, stdout=subprocess.PIPE, process_group=0) as server:
        assert server.stdout and server.stdout.readline()
        (folder,) = (place / "projects").iterdir()
        first, second = jobs_in(folder / "jobs")
        assert soon(lambda: POINTS[point](first))
        server.kill()
    with opened(place) as (_, project):
        told = [ended(job) for job in (first, second)]
        assert [one["state"] for one in told] == ["done", "done"]
        assert names(first).count("ended") == 1 and names(first).count("step") == 2
        assert "again" not in names(first)
        assert {file.read_text() for file in project.package.iterdir()} == {"whole"}
        assert second.folder.joinpath(EVENTS).stat().st_mtime_ns >= first.folder.joinpath(EVENTS).stat().st_mtime_ns


def test_a_job_that_died_with_its_server_begins_again_and_not_for_ever(place: Path):
    (folder,) = (place / "projects").iterdir()
    for start in range(1, MAX_STARTS + 1):
        goals = ["write some 0.05; step 60"] if start == 1 else []
        command = [sys.executable, "-m", "stub_studio_server", str(place), *goals]
        with forked.Popen(command, stdout=subprocess.PIPE, process_group=0) as server:
            assert server.stdout and server.stdout.readline()
            (job,) = jobs_in(folder / "jobs")
            assert soon(lambda job=job, start=start: names(job).count("wrote") > FILES * (start - 1) + 2)
            server.kill()
            assert job.pid
            os.killpg(job.pid, signal.SIGKILL)
        assert job.record.starts == start and job.record.state == "running"
    with opened(place) as (_, project):
        (job,) = jobs_in(project.jobs)
        assert names(job).count("again") == MAX_STARTS - 1
        assert ended(job)["problem"] == f"its process ended {MAX_STARTS} times"
        assert {p.name for p in project.folder.iterdir()} <= {"project.json", "photo.png", "package", "jobs"}


def test_a_cancelled_job_is_not_begun_again_by_the_next_server(place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(job_queue, "GRACE_S", 0.3)
    workspace = Workspace(place)
    queue = JobQueue(workspace, worker=WORKER)
    job = asked(queue, workspace.listed()[0], "deaf; step 60")
    assert soon(lambda: "deaf" in names(job))
    pid = job.pid
    queue.close()
    queue.cancel(job)  # and it is killed before it could look whether the job ends
    workspace.close()
    assert pid and is_running(pid) and job.record.state == "running"
    with opened(place):
        assert ended(job)["state"] == "cancelled" and not is_running(pid) and job.record.starts == 1


def test_who_looks_at_a_job_keeps_nobody_from_doing_it(place: Path, monkeypatch: pytest.MonkeyPatch):
    """A look takes the lock for a moment. One that is held says that another process does the job."""
    monkeypatch.setattr(file_lock, "WAIT_S", 0.3)
    with opened(place) as (queue, project):
        job = asked(queue, project, "step 0")
        ended(job)
    with job.locked(), pytest.raises(OutputError, match="another process does this job"), job.locked():
        pass
    with (job.folder / LOCK).open("rb") as look:
        fcntl.flock(look, fcntl.LOCK_SH)
        threading.Timer(0.05, look.close).start()
        with job.locked():
            assert job.pid == 0
    assert job.pid is None


def test_a_process_with_a_recycled_number_is_not_taken_for_the_job(place: Path):
    with opened(place) as (queue, project):
        job = asked(queue, project, "step 0; write some")
        ended(job)
    with subprocess.Popen(["sleep", "60"], process_group=0) as stranger:
        job.keep(job.record.model_copy(update={"state": "running", "result": {}}))
        (job.folder / LOCK).write_text(str(stranger.pid))
        (job.folder / EVENTS).unlink()
        assert job.pid is None
        with opened(place) as (queue, project):
            queue.cancel(job)
            ended(job)
        assert stranger.poll() is None
        stranger.kill()


# --- disks and damage ------------------------------------------------------------------------------------------------


def test_a_full_disk_keeps_no_end_from_being_told(place: Path, monkeypatch: pytest.MonkeyPatch):
    """Records that cannot be written are written when there is room again, and the queue goes on."""
    kept, full = job_record.write_whole, [True]

    def write(file: Path, data: bytes) -> None:
        if full[0] and json.loads(data)["state"] in ENDS:
            raise OutputError(f"{file}: cannot be written (no space left on device)")
        kept(file, data)

    monkeypatch.setattr(job_record, "write_whole", write)
    with opened(place) as (queue, project):
        first, second = (asked(queue, project, goal) for goal in ("fail it is full", "step 0"))
        assert soon(lambda: state(first) == "failed" and state(second) == "done")
        assert first.told()["problem"] == "it is full" and first.record.state == second.record.state == "running"
        full[0] = False
        assert [ended(job)["state"] for job in (first, second)] == ["failed", "done"]


def test_a_job_that_a_full_disk_keeps_from_starting_says_so(place: Path, monkeypatch: pytest.MonkeyPatch):
    """The room that a job keeps for its end is not spent on its start."""
    kept, room = job_record.write_whole, list[bool]()

    def write(file: Path, data: bytes) -> None:
        room.append(not (file.parent / SPARE).exists())
        if json.loads(data)["state"] != "queued" and not room[-1]:
            raise OutputError(f"{file}: cannot be written (no space left on device)")
        kept(file, data)

    monkeypatch.setattr(job_record, "write_whole", write)
    with opened(place) as (queue, project):
        told = ended(asked(queue, project, "step 0"))
        assert told["state"] == "failed" and told["problem"].startswith("it could not be started: ")
        assert told["problem"].endswith("(no space left on device)") and room == [False, False, False, True]


def test_a_full_disk_for_events_leaves_the_reason(place: Path):
    """``/dev/full`` takes no byte."""
    with opened(place) as (queue, project):
        first = asked(queue, project, "step 0.2")
        second = asked(queue, project, "step 0; fail for another reason")
        (second.folder / EVENTS).symlink_to("/dev/full")
        told = ended(second)
        assert ended(first)["state"] == "done"
        assert told["state"] == "failed" and told["problem"].endswith("for another reason")


def test_a_damaged_job_ends_no_queue(place: Path):
    with opened(place) as (queue, project):
        first = asked(queue, project, "step 0.3")
        second, third = asked(queue, project, "step 0"), asked(queue, project, "step 0")
        (second.folder / RECORD).write_text("{")
        assert ended(third)["state"] == "done"
        assert [job.id for job in queue.jobs(project)] == [first.id, third.id]
    with opened(place) as (queue, project):
        assert ended(asked(queue, project, "step 0"))["state"] == "done"


def test_jobs_that_ended_long_ago_are_taken_away(place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(job_queue, "KEPT", 2)
    with opened(place) as (queue, project):
        running = asked(queue, project, "step 60")
        waiting = [asked(queue, project, "step 0") for _ in range(5)]
        for job in waiting[:4]:
            queue.cancel(job)
        last = asked(queue, project, "step 0")
        assert queue.jobs(project) == [running, *waiting[2:], last]
        assert {entry.name for entry in project.jobs.iterdir()} == {job.id for job in queue.jobs(project)}


def test_jobs_stay_in_the_order_asked_whatever_the_clock_says(place: Path, monkeypatch: pytest.MonkeyPatch):
    """Several in one millisecond, and a clock that is set back between two."""
    with opened(place) as (queue, project):
        asked_in_order = [asked(queue, project, "step 60")]
        for seconds in (0, -3600, 7200, 0):
            moment = time.time() + seconds
            monkeypatch.setattr("f3sr.studio.job_record.time.time", lambda moment=moment: moment)
            asked_in_order += [asked(queue, project, "step 0") for _ in range(2)]
            monkeypatch.undo()
        assert queue.jobs(project) == asked_in_order


def test_a_file_that_cannot_be_read_for_a_while_ends_no_queue(place: Path, monkeypatch: pytest.MonkeyPatch):
    """Too many open files, or a server of files that is away."""
    read, failed = JobFolder.events, list[str]()

    def events(job: JobFolder, after: int = 0) -> list[dict[str, Any]]:
        if len(failed) < 3:
            failed.append(job.id)
            raise OSError(errno.EMFILE, "too many open files")
        return read(job, after)

    with opened(place) as (queue, project):
        monkeypatch.setattr(JobFolder, "events", events)
        first, second = asked(queue, project, "step 0"), asked(queue, project, "step 0")
        assert [ended(job)["state"] for job in (first, second)] == ["done", "done"] and failed == 3 * [first.id]


@pytest.mark.parametrize("id", ["", ".", "..", "../../x", "a/b", "1" * 13 + "-" + "0" * 8, "\0", "1" * 10**5])
def test_no_other_name_is_a_job(place: Path, id: str):
    with opened(place) as (queue, project), pytest.raises(InputError, match="one of the project's"):
        queue.job(project, id)


def test_a_deleted_project_ends_its_jobs(place: Path):
    workspace = Workspace(place)
    queue = JobQueue(workspace, worker=WORKER)
    project = workspace.listed()[0]
    job, waits = asked(queue, project, "write some 30"), asked(queue, project, "step 0")
    assert soon(lambda: names(job) == ["wrote"])
    pid = job.pid
    queue.cancel_all(project)
    workspace.delete(project.id)
    assert pid and not is_running(pid) and not waits.folder.exists()
    assert list((place / "projects").iterdir()) == []
    other = workspace.create_photo("b.png", encode_png(np.zeros((16, 16, 3), np.uint8)))
    assert ended(asked(queue, other, "step 0"))["state"] == "done"
    queue.close()
    workspace.close()
