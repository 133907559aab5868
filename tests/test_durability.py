"""Runs that die, in processes of their own: signals, kill -9, full disks, closed pipes, rivals, damaged caches."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import forked
from f3sr import settings
from f3sr.errors import OutputError
from f3sr.pipeline_config import Config
from f3sr.report import Outcome
from f3sr.runtime.result_store import Store
from f3sr.runtime.stage_runner import Runner
from f3sr.scene import Scene
from f3sr.scene_package import package
from f3sr.scene_package.package import read_package, write_package
from folders import part_of_example
from scenes import box_stack_scene
from waiting import children, grandchildren, is_running, soon

IN_PROC = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at threads and children in /proc")
INTERRUPTED = "f3sr: interrupted; nothing was written\n"
TO_WORKERS = ("--skip", "level,align,relate")
QUICK = ("--skip", "align,refine,uncertainty,evaluate,inpaint")


@pytest.fixture
def cache(tmp_path: Path, compiled: Path) -> Path:
    """A cache folder with nothing but compiled kernels in it."""
    shutil.copytree(compiled, tmp_path / "cache" / compiled.name)
    return tmp_path / "cache"


def start(*arguments: str | Path, cache: Path, fresh: bool = False, **more: Any) -> subprocess.Popen[str]:
    """The command, by which no signal is ignored, as would be where the tests run in the background.

    ``fresh``: a new interpreter, where its start is what is tested; else a fork of one that has imported f3sr."""
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "preexec_fn": heed}
    return (subprocess.Popen if fresh else forked.Popen)(
        [sys.executable, "-m", "f3sr", *map(str, arguments)],
        env={**os.environ, "F3SR_CACHE_DIR": str(cache), **more.pop("env", {})},
        **{**usual, **more},
    )


def heed() -> None:
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def digests(package: Path) -> dict[str, str]:
    """sha256 of every file; of report.json without the seconds, which no two runs share."""
    found = {p.relative_to(package).as_posix(): p.read_bytes() for p in package.rglob("*") if p.is_file()}
    report = json.loads(found["report.json"])
    del report["seconds"]
    found["report.json"] = json.dumps(report).encode()
    return {name: hashlib.sha256(data).hexdigest() for name, data in found.items()}


# --- signals --------------------------------------------------------------------------------------------------


@IN_PROC
@pytest.mark.parametrize("after", [0.0, 0.1, 0.3, 1.0])
def test_ctrl_c_while_starting_ends_at_once_with_one_line(after: float, cache: Path, tmp_path: Path):
    process = start("demo", "-o", tmp_path / "out", cache=cache, fresh=True)
    tasks = Path(f"/proc/{process.pid}/task")
    assert soon(lambda: len(list(tasks.iterdir())) > 1, 60), "a second thread waits for signals"
    assert after or "numpy" not in Path(f"/proc/{process.pid}/maps").read_text(), "before anything heavy is imported"
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, errors = process.communicate()
    assert (process.returncode, errors) == (1, INTERRUPTED)
    assert time.monotonic() - began < 1 and not (tmp_path / "out").exists()


@pytest.mark.slow
@IN_PROC
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_no_worker_outlives_a_run_that_is_ended(number: signal.Signals, cache: Path, tmp_path: Path):
    """Ctrl-C is sent in the tests above and below; all three signals are heard by one thread."""
    part = part_of_example(tmp_path / "part")
    process = start("reconstruct", part, "-o", tmp_path / "out", *TO_WORKERS, cache=cache)
    assert soon(lambda: grandchildren(process.pid), 60), "a worker forks a process for a mesh"
    workers = children(process.pid) + grandchildren(process.pid)
    process.send_signal(number)
    began = time.monotonic()
    _, errors = process.communicate()
    if number != signal.SIGKILL:
        assert (process.returncode, errors) == (1, INTERRUPTED)
    assert soon(lambda: not any(map(is_running, workers)), 2) and time.monotonic() - began < 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cache", "part"]


@IN_PROC
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_signal_during_compilation_ends_all_compilers_at_once(number: signal.Signals, tmp_path: Path, folder: Path):
    process = start("reconstruct", folder, "-o", tmp_path / "out", cache=tmp_path / "empty")
    assert soon(lambda: list(tmp_path.glob("empty/kernels-*/*.kernel")), 120)
    compilers = children(process.pid)
    assert len(compilers) == 2
    process.send_signal(number)
    began = time.monotonic()
    _, errors = process.communicate()
    if number != signal.SIGKILL:
        assert (process.returncode, errors) == (1, INTERRUPTED)
    assert soon(lambda: not any(map(is_running, compilers)), 2) and time.monotonic() - began < 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("after", [0.0, 0.05, 0.2])
def test_a_signal_after_the_last_line_does_not_kill(after: float, cache: Path):
    """The command has ended by then, or says that it was interrupted."""
    process = start("config", cache=cache)
    assert process.stdout and process.stderr
    last = settings.describe(Config()).splitlines(keepends=True)[-1]
    while process.stdout.readline() != last:
        pass
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    errors = process.stderr.read()
    assert (process.wait(), errors) in ((0, ""), (1, INTERRUPTED))


def test_nohup_is_respected(cache: Path):
    def ignore() -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = start("config", cache=cache, fresh=True, preexec_fn=ignore)
    time.sleep(0.3)
    process.send_signal(signal.SIGHUP)
    process.communicate()
    assert process.returncode == 0


# --- the output's reader -----------------------------------------------------------------------------------------


def test_a_reader_that_goes_away_is_no_traceback(cache: Path, tmp_path: Path, folder: Path):
    process = start("reconstruct", folder, "-o", tmp_path / "out", *QUICK, cache=cache)
    assert process.stdout and process.stderr
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == "f3sr: nobody reads the output; nothing was written\n"
    assert process.wait() == 1 and not (tmp_path / "out").exists()


def test_a_full_disk_behind_the_output_is_told(cache: Path):
    with open("/dev/full", "w") as full:  # noqa: PTH123
        process = start("config", cache=cache, stdout=full)
        _, errors = process.communicate()
    assert process.returncode == 1 and errors.count("\n") == 1 and "No space left" in errors


# --- disks ------------------------------------------------------------------------------------------------------


def test_a_full_disk_leaves_the_old_package(cache: Path, tmp_path: Path, folder: Path):
    """A limit on the size of files stands for the disk: every larger write fails, in the package as in the cache."""
    small_files = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (4000, 4000))
    place = tmp_path / "place"
    write_package(box_stack_scene(), place / "out")
    before = digests(place / "out")
    process = start("reconstruct", folder, "-o", place / "out", *QUICK, cache=cache, preexec_fn=small_files)
    _, errors = process.communicate()
    assert process.returncode == 1 and errors == f"f3sr: {place / 'out'}: could not be written (file too large)\n"
    assert digests(place / "out") == before and [p.name for p in place.iterdir()] == ["out"]
    assert not list(cache.rglob("*.part"))


@pytest.mark.parametrize("name", ["out", "deeper/out"])
def test_a_folder_one_may_not_write_to_is_refused_first(name: str, tmp_path: Path):
    """Root may write anywhere, so root becomes nobody in a child."""
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o555)
    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(0o755)
    child = os.fork()
    if not child:
        try:
            if os.geteuid() == 0:
                os.setuid(65534)
            package.prepare_output(locked / name)
        except OutputError as error:
            os._exit(0 if str(locked) in str(error) and "\n" not in str(error) else 3)
        finally:
            os._exit(4)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert not list(locked.iterdir())


def test_preparing_leaves_no_folder(tmp_path: Path):
    package.prepare_output(tmp_path / "a" / "b")
    package.prepare_output(tmp_path / "c")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("megabytes", [60, 300, 370])
def test_little_memory_is_one_line(megabytes: int, cache: Path):
    """Where Python finds out. What a library does that finds out itself, as LLVM, is to abort."""

    def little() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20))

    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    process = start("config", cache=cache, fresh=True, preexec_fn=little, env={"F3SR_TRACEBACK": "", **alone})
    _, errors = process.communicate()
    assert process.returncode == 1 and errors.startswith("f3sr: ") and errors.count("\n") == 1, errors


def test_no_threads_are_one_line(cache: Path):
    """Root may start as many as it wants, so it becomes somebody; the watch over signals is the first thread."""
    code = "import threading, f3sr.__main__ as m; threading.Thread.start = lambda _: 1 / 0; m.run()"
    done = forked.run([sys.executable, "-c", code], env={**os.environ, "F3SR_TRACEBACK": ""})
    assert done.returncode == 1
    assert done.stderr.startswith("f3sr: unforeseen ZeroDivisionError") and done.stderr.count("\n") == 1


# --- rivals ----------------------------------------------------------------------------------------------------

RIVAL = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from folders import part_of_example
from scenes import box_stack_scene
from f3sr.errors import OutputError
from f3sr.scene_package.package import write_package
for _ in range(6):
    try:
        write_package(box_stack_scene(int(sys.argv[1])), Path(sys.argv[2]))
        print("wrote")
    except OutputError as error:
        print(error)
"""


def test_rivals_for_one_place_never_break_it(tmp_path: Path):
    out = tmp_path / "place" / "out"
    command = [sys.executable, "-c", RIVAL]
    rivals = [
        forked.Popen([*command, str(n), str(out), str(Path(__file__).parent)], stdout=subprocess.PIPE, text=True)
        for n in (1, 2, 3)
    ]
    said = [line for rival in rivals for line in rival.communicate()[0].splitlines()]
    assert [rival.returncode for rival in rivals] == [0, 0, 0] and len(said) == 18
    assert set(said) <= {"wrote", f"{out}: another run is writing it right now"} and "wrote" in said
    assert len(read_package(out).scene.objects) in (1, 2, 3)
    assert [p.name for p in out.parent.iterdir()] == ["out"]


# --- the same bytes -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_seeds_threads_and_places_change_no_byte(cache: Path, compiled: Path, tmp_path: Path, folder: Path):
    found: list[dict[str, str]] = []
    for k, threads in enumerate("12"):
        other = shutil.copytree(cache, tmp_path / f"cache_{k}")
        names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        env = dict.fromkeys(names, threads) | {"PYTHONHASHSEED": str(k)}
        (tmp_path / f"cwd_{k}").mkdir()
        place = tmp_path / f"cwd_{k}"
        process = start("reconstruct", folder, "-o", f"name {k}", cache=other, fresh=True, env=env, cwd=place)
        assert process.communicate()[1] == "" and process.returncode == 0
        found.append(digests(tmp_path / f"cwd_{k}" / f"name {k}"))
    assert found[0] == found[1] and len(found[0]) > 10


# --- caches -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_damaged_kernel_files_are_told_once_and_made_anew(cache: Path):
    files = sorted(cache.glob("kernels-*/f3sr.vision.*.kernel"), key=lambda file: file.stat().st_size)
    files[0].write_bytes(files[0].read_bytes()[:1000])
    data = bytearray(files[1].read_bytes())
    data[len(data) // 2] ^= 1
    files[1].write_bytes(data)
    told = "lambda step: print(step) if step.state == 'started' else None"
    code = f"from f3sr.runtime import kernels\nwith kernels.compiling() as compilers: compilers.finish({told})"
    said = [
        forked.run([sys.executable, "-c", code], env={**os.environ, "F3SR_CACHE_DIR": str(cache)}, check=True).stdout
        for _ in range(2)
    ]
    assert "2 damaged files" in said[0] and said[1] == "kernels: ...\n"


def test_the_store_drops_what_was_used_longest_ago(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("F3SR_CACHE_LIMIT_GB", "0.00005")  # 45 kB for stages
    store = Store(tmp_path)
    for k in range(6):
        store.save(str(k), {}, {"x": np.zeros(1000)})
        os.utime(tmp_path / f"{k}.npz", (k, k))
        assert store.load("0")
    assert [k for k in range(6) if (tmp_path / f"{k}.npz").exists()] == [0, 2, 3, 4, 5]


def test_half_written_files_go_once_their_writer_is_gone(tmp_path: Path):
    import fcntl

    for name in ("dead", "alive"):
        (tmp_path / f"{name}.part").write_bytes(b"half")
    with (tmp_path / "alive.part").open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        Store(tmp_path).save("key", {}, {})
        assert sorted(p.name for p in tmp_path.iterdir()) == ["alive.part", "key.npz"]


@pytest.mark.parametrize("text", ["", "many", "inf", "-1"])
def test_a_limit_that_is_no_number_stops_nothing(text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("F3SR_CACHE_LIMIT_GB", text)
    Store(tmp_path).save("key", {}, {})


@dataclass(frozen=True)
class Limit:
    cut: bool


class A(Outcome):
    stage = "a"


class B(Outcome):
    stage = "b"


class C(Outcome):
    stage = "c"


def test_what_a_time_limit_cut_short_is_not_stored_nor_what_follows(tmp_path: Path):
    def stage(scene: Scene, config: Limit, kind: type[Outcome]) -> tuple[Scene, Outcome]:
        return scene, kind(cut_short=config.cut)

    def run() -> tuple[str, ...]:
        runner = Runner("key", skip=(), skippable=(), store=Store(tmp_path), progress=lambda _: None)
        scene = box_stack_scene()
        for kind, cut in ((A, False), (B, True), (C, False)):
            scene, _ = runner.stage(kind, stage, scene, Limit(cut), kind)
        return tuple(runner.resumed)

    assert run() == () and run() == ("a",)
