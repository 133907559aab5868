"""Laws of batches: every job ends once, also when processes are killed, and packages are the same bytes."""

from __future__ import annotations

import importlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import forked
from f3sr.backends.model_choice import ModelChoice
from f3sr.backends.registry import Kind
from f3sr.batch import ray_address, runs, scene_job, supervisor
from f3sr.batch.attempt import attempt
from f3sr.batch.driver import LOST, Driver, Event, keyed
from f3sr.batch.executors import Ended
from f3sr.batch.job import Job, fetched, inputs_digest
from f3sr.batch.manifest import jobs_of, read_goals
from f3sr.batch.scene_job import goal_rows
from f3sr.batch.supervisor import JobLimits, Worker
from f3sr.cli.main import main
from f3sr.dataset.layout import Dataset, scene_of
from f3sr.dataset.prune import prune
from f3sr.dataset.record import from_bytes, to_bytes
from f3sr.dataset.storage import RECORD
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.film.studio import FilmConfig
from f3sr.goals.file_names import ROLLOUT
from f3sr.pipeline_config import Config
from f3sr.runtime.progress import silent
from goal_scene import goal_package
from stub_batches import LIMITS, batch, packages, write_stub, write_stubs
from waiting import children, grandchildren, is_running, soon

pytest.importorskip("pyarrow", reason="no pyarrow: pip install 'f3sr[dataset]'")
TESTS = Path(__file__).parent


@pytest.fixture(autouse=True)
def quick_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers are forks of a process that has imported f3sr, and live on as any worker."""
    monkeypatch.setattr(supervisor, "started", forked.started)


def records(dataset: Path) -> dict[str, Any]:
    """The record of every listed job, by its name."""
    found = Dataset.read(dataset)
    return {job.name: found.record(job.key) for job in found.listed()}


# --- every job ends once -----------------------------------------------------------------------------------------


def test_every_job_ends_with_its_result_or_its_reason(tmp_path: Path) -> None:
    inputs = write_stubs(tmp_path / "in", 4)
    write_stub(inputs / "x10", 10, fail="bad")
    write_stub(inputs / "x11", 11, fail="crash")
    write_stub(inputs / "x12", 12, fail="error")
    write_stub(inputs / "x13", 13, fail="crash", once=True)
    events: list[Event] = []
    tally = batch(inputs, tmp_path / "out", report=events.append, goals=("a goal",))
    assert tally.counts == {"done": 5, "failed": 3} and tally.failures == {"bad input": 1, "crash": 2}
    found = records(tmp_path / "out")
    assert [r.status for r in found.values()] == ["done"] * 4 + ["failed"] * 3 + ["done"]
    assert found["x10"].attempts == 1 and "found fail = bad" in found["x10"].reason
    assert found["x11"].attempts == 2 and found["x11"].reason.startswith("was killed by SIGABRT")
    assert "unforeseen KeyError" in found["x12"].reason
    assert found["x13"].attempts == 2 and found["x13"].package is not None
    counts = Counter(e.state for e in events)
    assert [counts[state] for state in ("done", "failed", "again")] == [5, 3, 3]
    left = {p.name for p in (tmp_path / "out" / "work").iterdir()}  # stages, for the next run
    assert left == {found["x11"].key, found["x12"].key}


def test_a_second_run_does_what_is_missing_only(tmp_path: Path) -> None:
    inputs = write_stubs(tmp_path / "in", 3)
    write_stub(inputs / "bad", 7, fail="bad")
    write_stub(inputs / "crashes", 8, fail="crash")
    batch(inputs, tmp_path / "out")
    before = packages(tmp_path / "out")
    write_stub(inputs / "new", 9)
    write_stub(inputs / "bad-too", 10)
    events: list[Event] = []
    tally = batch(inputs, tmp_path / "out", report=events.append)
    started = {e.name for e in events if e.state == "started"}
    assert started == {"new", "bad-too", "crashes"}  # bad input is known, a crash is tried again
    assert tally.counts == {"known": 3, "done": 2, "failed": 2}
    assert "not tried again" in next(e.reason for e in events if e.name == "bad")
    assert packages(tmp_path / "out").items() >= before.items()
    write_stub(inputs / "bad", 7)  # mended
    assert batch(inputs, tmp_path / "out").counts == {"known": 5, "done": 1, "failed": 1}
    assert len(records(tmp_path / "out")) == 7


def test_equal_content_is_made_once_for_all_its_names(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        write_stub(tmp_path / "in" / name, 3, seconds=0.2)
    events: list[Event] = []
    tally = batch(tmp_path / "in", tmp_path / "out", report=events.append)
    assert sum(e.state == "started" for e in events) == 1 and tally.jobs == 3
    jobs = list(Dataset.read(tmp_path / "out").listed())
    assert [j.name for j in jobs] == ["a", "b", "c"] and len({j.key for j in jobs}) == 1


def test_a_key_depends_on_content_options_and_code_and_on_nothing_else(tmp_path: Path) -> None:
    a, b = write_stub(tmp_path / "a", 1), write_stub(tmp_path / "b", 1)
    job = keyed(Job(name="x", source=str(a)))
    assert job.key == keyed(Job(name="y", source=str(b))).key
    others = [
        replace(job, goals=("a",)), replace(job, skip=("refine",)), replace(job, settings={"refine.rounds": 0}),
        replace(job, film=True), replace(job, code="other"), replace(job, backends={"geometry": "x"}),
        replace(job, device="cuda"), replace(job, precision="float16"),
    ]  # fmt: skip
    (b / "more").write_text("")
    others.append(keyed(replace(job, source=str(b))))
    assert len({job.key, *(o.key for o in others)}) == len(others) + 1
    assert Job.from_plain(json.loads(json.dumps(asdict(job)))).key == job.key


def test_a_job_hands_the_choice_of_models_to_its_back_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Device, precision and downloads go through JSON to every back end; downloads change no key."""
    asked = list[tuple[str, ModelChoice]]()

    def find(kind: Kind[Any], spec: str, choice: ModelChoice | None = None) -> None:
        assert choice is not None
        asked.append((f"{kind.name} {spec}", choice))

    def refused(*_: Any, **__: Any) -> None:
        raise InputError("here", found="enough", accepted="no work")

    monkeypatch.setattr(Kind, "find", find)
    monkeypatch.setattr(scene_job, "read_inputs", refused)
    (tmp_path / "in").mkdir()
    named = {"geometry": "moge:a", "assets": "b", "scene_graph": "c"}
    job = Job(name="x", source="", backends=named, device="cuda", precision="float16", allow_downloads=True)
    told = Job.from_plain(json.loads(json.dumps(asdict(job))))
    with pytest.raises(InputError, match="enough"):
        scene_job.work(
            told, tmp_path / "in", tmp_path / "out", tmp_path / "stages", progress=silent, patiently=lambda a: a()
        )
    assert [name for name, _ in asked] == ["geometry moge:a", "assets b", "scene_graph c"]
    assert {choice for _, choice in asked} == {ModelChoice(device="cuda", precision="float16", allow_downloads=True)}
    assert replace(job, allow_downloads=False).key == job.key


@pytest.mark.parametrize(("inputs", "dataset"), [("in", "in/out"), ("out/in", "out"), ("in", "in")])
def test_a_dataset_is_no_folder_of_its_inputs(tmp_path: Path, inputs: str, dataset: str) -> None:
    write_stubs(tmp_path / inputs, 2)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(OutputError, match="may not hold one another"):
        batch(tmp_path / inputs, tmp_path / dataset)
    assert sorted(tmp_path.rglob("*")) == before


def test_what_cannot_be_read_has_a_digest_that_changes_where_it_is_mended(tmp_path: Path) -> None:
    absent = inputs_digest(tmp_path / "in")
    (tmp_path / "in").mkdir()
    os.mkfifo(tmp_path / "in" / "pipe")
    (tmp_path / "in" / "loop").symlink_to("loop")
    odd = inputs_digest(tmp_path / "in")
    (tmp_path / "in" / "loop").unlink()
    assert len({absent, odd, inputs_digest(tmp_path / "in")}) == 3


# --- limits ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fail", "failure", "said"), [("memory", "memory", "the limit is 150 MB"), ("hang", "time", "the limit is 1 s")]
)
def test_a_job_beyond_its_limit_is_ended_and_told(tmp_path: Path, fail: str, failure: str, said: str) -> None:
    write_stub(tmp_path / "in" / "a", 1, fail=fail)
    write_stub(tmp_path / "in" / "b", 2)
    limits = JobLimits(wall_s=1.0, memory_mb=150.0)
    tally = batch(tmp_path / "in", tmp_path / "out", limits=limits, retries=0)
    assert tally.counts == {"done": 1, "failed": 1} and tally.failures == {failure: 1}
    record = records(tmp_path / "out")["a"]
    assert said in record.reason and (fail != "memory" or 150 < record.costs.peak_mb < 400)


def test_memory_of_processes_that_a_job_starts_counts(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1, fail="child memory")
    tally = batch(tmp_path / "in", tmp_path / "out", limits=JobLimits(wall_s=20.0, memory_mb=150.0), retries=0)
    assert tally.failures == {"memory": 1}


def test_a_worker_that_cannot_start_is_told(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1)
    batch(tmp_path / "in", tmp_path / "out", work="no_such_module", retries=0)
    assert "No module named 'no_such_module'" in records(tmp_path / "out")["a"].reason


# --- kills and full disks ----------------------------------------------------------------------------------------


def test_a_worker_that_is_killed_is_no_fault_of_its_job(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1, full=1)  # the job tells that it waits
    worker = Worker("stub_job")
    job = keyed(Job(name="a", source=str(tmp_path / "in" / "a")))
    for name in ("result", "stages"):
        (tmp_path / name).mkdir()

    def kill(said: dict[str, Any]) -> None:
        assert worker.process is not None
        worker.process.kill()
        worker.process.wait()

    try:
        worker.start()
        kill({})  # before the job: it begins in another worker
        answer = worker.run(job, tmp_path / "in" / "a", tmp_path / "result", tmp_path / "stages", LIMITS, kill)
        assert answer.failure == "lost" and "was killed by SIGKILL" in answer.reason
        answer = worker.run(
            job, tmp_path / "in" / "a", tmp_path / "result", tmp_path / "stages", LIMITS, lambda said: None
        )
        assert not answer.failure
    finally:
        worker.close()


@pytest.mark.slow
def test_after_a_kill_of_the_driver_the_next_run_does_the_rest(tmp_path: Path) -> None:
    """``kill -9`` at several points: nothing is half written, no process stays, and in the end all bytes are there.

    All runs are forks of one process: where sources are edited meanwhile, their keys stay those of one version."""
    inputs = write_stubs(tmp_path / "in", 12, seconds=0.05)
    out = tmp_path / "out"

    def driver(dataset: Path) -> subprocess.Popen[str]:
        command = [sys.executable, str(TESTS / "stub_batches.py"), str(inputs), str(dataset)]
        env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        return forked.Popen(command, stdout=subprocess.PIPE, text=True, env=env)

    def told(dataset: Path) -> Counter[str]:
        """Events of a whole run by state."""
        with driver(dataset) as process:
            said, _ = process.communicate()
        assert process.returncode == 0
        return Counter(line.partition(" ")[0] for line in said.splitlines())

    assert told(tmp_path / "calm")["done"] == 12
    for after in (2, 7):
        process = driver(out)
        assert process.stdout is not None
        seen = 0
        while seen < after and (line := process.stdout.readline()):
            seen += line.startswith(("done", "known"))
        workers = children(process.pid) + grandchildren(process.pid)
        process.kill()
        process.wait()
        assert workers and soon(lambda workers=workers: not any(map(is_running, workers)), 5)
        with pytest.raises(OutputError, match="its list may lack jobs"):
            prune(Dataset.read(out))
        for folder in out.glob("scenes/*/*"):
            assert {p.name for p in folder.iterdir()} == {"package", RECORD}
    last = told(out)
    assert last["known"] >= 7 and last["known"] + last["done"] == 12 and not last["failed"]
    assert packages(out) == packages(tmp_path / "calm")
    assert prune(Dataset.read(out)).packages == 0


def test_a_full_disk_is_waited_for(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1, full=2)
    events: list[Event] = []
    tally = batch(tmp_path / "in", tmp_path / "out", report=events.append, retries=0)
    assert tally.counts == {"done": 1}
    full = [e for e in events if e.state == "full"]
    assert len(full) == 2 and "No space left" in full[0].reason


def test_a_disk_that_stays_full_fails_the_job_and_not_the_batch(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1, full=1000)
    write_stub(tmp_path / "in" / "b", 2)
    limits = replace(LIMITS, storage_wait_s=0.3)
    assert batch(tmp_path / "in", tmp_path / "out", limits=limits, retries=0).failures == {"storage": 1}


def test_one_run_at_a_time_writes_a_dataset(tmp_path: Path) -> None:
    inputs = write_stubs(tmp_path / "in", 1)
    with (
        Dataset.made(tmp_path / "out").storage.claimed(),
        pytest.raises(OutputError, match="another run is writing"),
    ):
        batch(inputs, tmp_path / "out")
    (tmp_path / "strange").mkdir()
    (tmp_path / "strange" / "mine.txt").write_text("")
    with pytest.raises(OutputError, match=r"found mine\.txt; accepted: a new or empty folder"):
        batch(inputs, tmp_path / "strange")


def test_a_dataset_behind_a_url_holds_the_same_bytes(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec", reason="no fsspec: pip install 'f3sr[ray]'")
    inputs = write_stubs(tmp_path / "in", 3)
    batch(inputs, tmp_path / "local")
    tally = batch(inputs, "memory://ds")
    assert tally.counts == {"done": 3} and batch(inputs, "memory://ds").counts == {"known": 3}
    files = fsspec.filesystem("memory")
    for path in packages(tmp_path / "local"):
        assert files.cat_file(f"/ds/{path}") == (tmp_path / "local" / path).read_bytes()
    manifest = tmp_path / "m.jsonl"
    files.pipe_file("/in/one/stub.json", (inputs / "stub-00001" / "stub.json").read_bytes())
    manifest.write_text('{"path": "memory://in/one"}\n')
    with fetched("memory://in/one") as folder:
        assert inputs_digest(folder) == inputs_digest(inputs / "stub-00001")
    _, jobs = jobs_of(manifest, Job(name="", source=""), Config())
    assert [(j.name, j.source) for j in jobs] == [("one", "memory://in/one")]


def test_an_input_behind_a_url_that_is_not_there_is_a_row(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="no fsspec: pip install 'f3sr[ray]'")
    write_stub(tmp_path / "in" / "a", 1)
    manifest = tmp_path / "m.csv"
    manifest.write_text("path\nin/a\nmemory://nowhere/b\n")
    assert batch(manifest, tmp_path / "out", retries=0).counts == {"done": 1, "failed": 1}
    assert "no folder there" in records(tmp_path / "out")["b"].reason


def test_an_input_behind_a_url_is_fetched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For its key and for the work; and its content counts, as that of a local folder does."""
    pytest.importorskip("fsspec", reason="no fsspec: pip install 'f3sr[ray]'")
    importlib.import_module("counted_files")
    notes = tmp_path / "notes"
    monkeypatch.setenv("COUNTED_FILES", str(notes))
    inputs = write_stubs(tmp_path / "in", 2)
    write_stub(inputs / "bad", 7, fail="bad")
    write_stub(inputs / "twin", 1)
    batch(inputs, tmp_path / "local")
    names = sorted(p.name for p in inputs.iterdir())
    manifest = tmp_path / "m.jsonl"
    manifest.write_text("".join(f'{{"path": "counted://{inputs / name}"}}\n' for name in names))
    assert batch(manifest, tmp_path / "out", slots=1).counts == {"done": 2, "known": 1, "failed": 1}
    assert sorted(notes.read_text().split()) == [str(inputs / name) for name in names]
    assert packages(tmp_path / "out") == packages(tmp_path / "local")
    assert records(tmp_path / "out")["bad"].reason.startswith(f"counted://{inputs}/bad/stub.json: found fail = bad")
    keys = [[(j.name, j.key) for j in Dataset.read(tmp_path / d).listed()] for d in ("local", "out")]
    assert keys[0] == keys[1]
    events: list[Event] = []
    assert batch(manifest, tmp_path / "out", report=events.append).counts == {"known": 3, "failed": 1}
    assert "not tried again" in next(e.reason for e in events if e.state == "failed")
    write_stub(inputs / "bad", 7)  # mended
    assert batch(manifest, tmp_path / "out").counts == {"known": 3, "done": 1}


class Losing:
    """An executor whose machines are lost so many times."""

    slots = 1

    def __init__(self, times: int, place: Path) -> None:
        self.times, self.place, self.job = times, place, Job(name="", source="")
        self.worker = Worker("stub_job")

    def submit(self, job: Job, number: int) -> None:
        self.job = job

    def ended(self, seconds: float) -> Iterator[Ended]:
        self.times -= 1
        if self.times >= 0:
            yield Ended(job=self.job, record=None, reason="NodeDiedError")
            return
        found = attempt(self.job, str(self.place), LIMITS, self.worker, lambda said: None)
        self.worker.close()
        yield Ended(job=self.job, record=found.record)


@pytest.mark.parametrize(("times", "state"), [(LOST - 1, "done"), (LOST, "failed")])
def test_a_lost_machine_is_no_fault_of_the_job_up_to_a_limit(tmp_path: Path, times: int, state: str) -> None:
    write_stub(tmp_path / "in" / "a", 1)
    events: list[Event] = []
    dataset = Dataset.made(tmp_path / "out")
    driver = Driver(
        dataset, Losing(times, tmp_path / "out"), retries=0, again=False, report=events.append, storage_wait_s=1
    )
    tally = driver.run([Job(name="a", source=str(tmp_path / "in" / "a"), work="stub_job")])
    assert tally.counts == {state: 1} and sum(e.failure == "lost" and e.state == "again" for e in events) == LOST - 1


def test_a_package_without_a_record_counts_as_nothing(tmp_path: Path) -> None:
    """An upload that was cut off: the next attempt writes over it."""
    pytest.importorskip("fsspec", reason="no fsspec: pip install 'f3sr[ray]'")
    inputs = write_stubs(tmp_path / "in", 1)
    place = f"file://{tmp_path}/remote"
    batch(inputs, place)
    key = next(Dataset.read(place).listed()).key
    whole = packages(tmp_path / "remote")
    folder = tmp_path / "remote" / scene_of(key)
    (folder / RECORD).unlink()
    (folder / "package" / "data.bin").write_bytes(b"half")
    assert batch(inputs, place).counts == {"done": 1}
    assert packages(tmp_path / "remote") == whole


def test_a_record_survives_its_file_and_a_foreign_one_is_refused(tmp_path: Path) -> None:
    write_stub(tmp_path / "in" / "a", 1)
    batch(tmp_path / "in", tmp_path / "out")
    record = records(tmp_path / "out")["a"]
    assert to_bytes(from_bytes(to_bytes(record), "here")) == to_bytes(record)
    for data in (b"{", b"[]", b'{"format": 2}', to_bytes(record).replace(b'"done"', b'"fine"')):
        with pytest.raises(InputError, match="accepted: a record that `f3sr batch` wrote"):
            from_bytes(data, "here")


# --- addresses of Ray -------------------------------------------------------------------------------------------


@contextmanager
def answering(said: bytes | None) -> Iterator[str]:
    """A server that says this to whoever connects, or nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                connection, _ = server.accept()
                with connection:
                    connection.recv(1000)
                    connection.sendall(said or b"")
                    time.sleep(0.0 if said else 2.0)

        threading.Thread(target=serve, daemon=True).start()
        yield f"127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "what answers is no Ray"),
        (b"HTTP", "what answers is no Ray"),
        (None, "nothing answers"),
        (bytes([0, 0, 6, 4, 0, 0, 0, 0, 0]) + bytes(6), ""),
    ],
)
def test_an_address_without_ray_is_told_at_once(monkeypatch: pytest.MonkeyPatch, said: bytes | None, told: str) -> None:
    monkeypatch.setattr(ray_address, "ANSWER_S", 0.3)
    with answering(said) as address:
        if not told:
            ray_address.require_answer(address, given="auto")
            return
        with pytest.raises(F3srError, match=f"--ray: no Ray cluster at auto \\({address}\\): {told}"):
            ray_address.require_answer(address, given="auto")


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:99999", "no.such.host.invalid:6379", "here"])
def test_an_address_that_cannot_be_reached_is_named(address: str) -> None:
    with pytest.raises(F3srError, match=f"no Ray cluster at {address}: ") as caught:
        ray_address.require_answer(address, given=address)
    assert "\n" not in str(caught.value)


# --- manifests ---------------------------------------------------------------------------------------------------


def manifest_of(folder: Path, text: str, name: str = "m.csv") -> list[Job]:
    file = folder / name
    file.write_text(text)
    return list(jobs_of(file, Job(name="", source="", goals=("common",)), Config())[1])


def test_a_manifest_gives_paths_names_goals_and_settings(tmp_path: Path) -> None:
    rows = "path,name,goals,skip,refine.rounds\na/b,,,,\n/c,see,push it; drop it,refine,0\n\n"
    first, second = manifest_of(tmp_path, rows)
    assert (first.name, first.source, first.goals) == ("b", str(tmp_path / "a/b"), ("common",))
    assert (second.name, second.source, second.goals) == ("see", "/c", ("push it", "drop it"))
    assert second.skip == ("refine",) and second.settings == {"refine.rounds": 0}
    row = {"path": "/c", "name": "see", "goals": ["push it", "drop it"], "skip": "refine", "refine.rounds": 0}
    (same,) = manifest_of(tmp_path, json.dumps(row), "m.jsonl")
    assert asdict(same) == asdict(second)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("m.csv", "", "row 1: found nothing; accepted: path, name, goals"),
        ("m.csv", "name\na\n", "row 1: found name; accepted: path"),
        ("m.csv", "path,path\na,b\n", "row 1: found path, path"),
        ("m.csv", "path,colour\na,red\n", "row 2: found the column 'colour'; accepted: path"),
        ("m.csv", "path,name\na\n", "row 2: found 1 values; accepted: 2, as in row 1"),
        ("m.csv", "path\na\nb/a\n", "row 3: found the name 'a' again; accepted: names that differ"),
        ("m.csv", "path,name\na,<b>\n", "row 2: found the name '<b>'; accepted: letters"),
        ("m.csv", "path,name\n,x\n", "row 2: found no path; accepted: a path"),
        ("m.csv", "path,skip\na,polish\n", "row 2: found polish; accepted: level"),
        ("m.csv", "path,asset-frame\na,left\n", "row 2: found left; accepted: auto"),
        ("m.csv", "path,align.max_yaw\na,9\n", "row 2: found align.max_yaw = 9; accepted: a number > 0"),
        ("m.csv", "path,align.no\na,9\n", "row 2: found unknown align.no"),
        ("m.csv", 'path\n"a\n', "no valid csv"),
        ("m.csv", "path\n\x00\n", "row 2: found"),
        ("m.csv", "path\n", "found no jobs"),
        ("m.jsonl", "{\n", "row 1: found no valid JSON"),
        ("m.jsonl", "[]\n", "row 1: found []; accepted: one JSON object a line"),
        ("m.jsonl", '{"path": 3}\n', "row 1: found path = 3; accepted: a printable text"),
        ("m.jsonl", '{"path": "a", "path": "b"}\n', "row 1: found no valid JSON (the key 'path' twice"),
        ("m.jsonl", '{"path": "a", "goals": 7}\n', "row 1: found goals = 7"),
        ("m.jsonl", '{"path": "a", "goals": "' + "x;" * 200 + '"}', "row 1: found 200 goals; accepted: at most 100"),
        ("m.jsonl", '{"path": "' + "a" * 200_000 + '"}', "row 1: found a longer line"),
        ("m.jsonl", '{"path": "a", "align": {"max_yaw": 1}}', "row 1: found the column 'align'"),
        ("m.jsonl", '{"path": "a", "align.max_yaw": 1, "align": 1}', "row 1: found the column 'align'"),
    ],
)  # fmt: skip
def test_a_wrong_manifest_names_row_and_what_is_accepted(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        manifest_of(tmp_path, text, name)
    assert said in str(caught.value) and str(tmp_path / name) in str(caught.value)


def test_wrong_bytes_are_no_manifest_and_no_goals(tmp_path: Path) -> None:
    for name in ("m.csv", "m.jsonl"):
        (tmp_path / name).write_bytes(b"path\n\xff\xfe\n")
        with pytest.raises(InputError, match=r"not UTF-8|no valid JSON"):
            jobs_of(tmp_path / name, Job(name="", source=""), Config())
    with pytest.raises(InputError, match="not UTF-8 at byte 5"):
        read_goals(tmp_path / "m.csv")
    (tmp_path / "goals.txt").write_text("# comment\n\n push it \ndrop it\n")
    assert read_goals(tmp_path / "goals.txt") == ("push it", "drop it")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: None, "found nothing there; accepted: a folder of input folders"),
        (Path.mkdir, "found no jobs"),
        (lambda p: p.write_text(""), "found a file"),
        (lambda p: (p / "masks").mkdir(parents=True), "found one input folder; accepted: a folder that holds such"),
    ],
)
def test_what_holds_no_inputs_is_refused(tmp_path: Path, make: Any, said: str) -> None:
    make(tmp_path / "in")
    with pytest.raises(InputError, match=said):
        jobs_of(tmp_path / "in", Job(name="", source=""), Config())


# --- goals and films ---------------------------------------------------------------------------------------------


def test_a_goal_of_a_batch_is_filmed_and_a_film_that_fails_leaves_the_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    av = pytest.importorskip("av")
    package = goal_package(tmp_path / "package")
    goals = ("knock over the cereal box", "drop the moon")
    job = Job(name="a", source="", goals=goals, film=True)

    def rows() -> list[dict[str, Any]]:
        return goal_rows(package, job, lambda step: None, lambda action: action())

    filmed, refused = rows()
    assert (filmed["state"], filmed["film"]) == ("met", "rollouts/1/film.mp4")
    with av.open(str(package.folder / filmed["film"])) as container:
        frames = [frame.time for frame in container.decode(video=0)]
    time = np.load(package.folder / filmed["folder"] / ROLLOUT)["time"]
    still = len(frames) - len(time)
    assert abs(still / 30 - FilmConfig().opening - FilmConfig().closing) < 1e-6
    assert abs(frames[-1] - still / 30 - time[-1]) < 1e-6
    assert refused["state"] == "refused" and "film" not in refused

    def no_film(*_: Any) -> None:
        raise F3srError("no light")

    monkeypatch.setattr(scene_job, "Studio", SimpleNamespace(of=no_film))
    again = rows()[0]
    assert "film" not in again and again.pop("film_reason") == "no light"
    assert again == {name: value for name, value in filmed.items() if name != "film"}


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture
def stubbed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "WORK", "stub_job")


@pytest.mark.usefixtures("stubbed")
def test_the_command_tells_and_ends_with_the_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inputs, out = write_stubs(tmp_path / "in", 2), str(tmp_path / "out")
    assert main(["batch", str(inputs), "-o", out, "--jobs", "1"]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "2 jobs" and said[1].startswith("1/2 stub-00000: done") and said[-1] == f"dataset:  {out}"
    write_stub(inputs / "bad", 5, fail="bad")
    assert main(["batch", str(inputs), "-o", out, "--json"]) == 1
    caught = capsys.readouterr()
    events = [json.loads(line) for line in caught.out.splitlines()]
    assert events[0] == {"event": "begin", "jobs": 3} and events[-1]["known"] == 2 and events[-1]["failed"] == 1
    assert caught.err == f"f3sr: 1 of 3 jobs failed (1 bad input); {out} has all others, and every reason\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--jobs", "-1"], "--jobs: found -1; accepted: a number from 0"),
        (["--timeout", "nan"], "--timeout: found nan"),
        (["--memory", "0.01"], "--memory: found 0.01"),
        (["--skip", "polish"], "--skip: found polish"),
        (["--geometry", "none-such"], "none-such"),
    ],
)
def test_wrong_options_end_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    inputs = write_stubs(tmp_path / "in", 1)
    assert main(["batch", str(inputs), "-o", str(tmp_path / "out"), *arguments]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "out").exists()
