"""Batches under disturbance, their throughput, and ten thousand jobs (docs/batch.md).

usage: batch.py disturbed [--real 30] [--stubs 170] [--ray] [--urls] [--out out/batch]
       batch.py throughput [--real 8] [--jobs 2]
       batch.py many [--count 10000]

``disturbed`` runs the same inputs twice: once in peace, once while workers, the driver, on Ray a whole node are killed
with ``kill -9`` and the disk is full for a while. Every package must have the same bytes, every job one row. With
``--urls`` the disturbed run gets its inputs as URLs, which are fetched.
``throughput`` holds a batch against independent processes. ``many`` watches the driver's memory over stub jobs.
Exit code 1 where anything is not as docs/batch.md promises. ``disturbed`` fills a disk only as root, on a tmpfs of its
own.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE), str(ROOT / "tests")]
MEMORY_MB = 1500.0
"""Limit of a job."""
RETRIES = 6
"""Of a disturbed run: a job may be killed several times, one of them by chance."""
DISK_MB = 900
"""Size of the disk that is filled, beyond what real packages take."""
PACKAGE_MB = 16
"""Of a real scene, and its results of stages while it is made."""
SAMPLE_EVERY = 500
"""Jobs between two looks at the driver's memory."""


# --- the driver, in a process of its own ---------------------------------------------------------------------------


def drive(inputs: Path, out: str, options: argparse.Namespace) -> None:
    """Run a batch and print its events as JSON lines."""
    from f3sr.batch.job import Job
    from f3sr.batch.runs import RunPlan, run_batch
    from f3sr.batch.supervisor import JobLimits
    from f3sr.pipeline_config import Config

    limits = JobLimits(wall_s=options.wall, memory_mb=MEMORY_MB, storage_wait_s=120.0)
    plan = RunPlan(slots=options.jobs, limits=limits, retries=options.retries, ray=options.address, work="stub_job")
    done, stream = 0, sys.stdout  # Ray has words of its own, which go elsewhere

    def report(event: Any) -> None:
        nonlocal done
        done += event.state in ("done", "known", "failed")
        if options.quiet:
            if event.state in ("done", "known") and done % SAMPLE_EVERY == 0:
                print(json.dumps({"done": done, "rss_mb": resident_mb(os.getpid())}), file=stream, flush=True)
        elif event.state != "step":
            print(json.dumps(event.plain()), file=stream, flush=True)

    tally = run_batch(inputs, out, Job(name="", source="", work="stub_job"), Config(), plan, report)
    print(json.dumps({"end": dict(tally.counts), "retries": tally.retries, "wall_s": tally.wall_s}), flush=True)
    sys.stdout.flush()
    os._exit(0)  # as the command does


def driver(
    inputs: Path, out: str, *, jobs: int = 2, retries: int = 1, wall: float = 1800.0, address: str | None = None,
    quiet: bool = False,
) -> subprocess.Popen[str]:  # fmt: skip
    command = [
        *(sys.executable, str(HERE / "batch.py"), "drive", str(inputs), out, "--jobs", str(jobs)),
        *("--retries", str(retries), "--wall", str(wall)),
        *(["--address", address] if address else []),
        *(["--quiet"] if quiet else []),
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment())


def environment() -> dict[str, str]:
    paths = [str(ROOT / "tests"), str(ROOT / "src"), str(HERE)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths), "STUBS_WITH_SCENES": "1", "RAY_USAGE_STATS_ENABLED": "0"}


# --- disturbed -----------------------------------------------------------------------------------------------------


@dataclass
class Disturbed:
    """What was done to a run."""

    workers: int = 0
    drivers: int = 0
    nodes: int = 0
    full: int = 0
    waits: int = 0
    again: Counter[str] = field(default_factory=Counter[str])


def disturbed(options: argparse.Namespace) -> list[str]:
    from batch_inputs import write_inputs

    out = options.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    inputs = write_inputs(out / "inputs", real=options.real, stubs=options.stubs)
    print(f"{options.real} real scenes, {options.stubs} stubs", flush=True)
    calm = driver(inputs, str(out / "calm"), jobs=options.jobs, wall=options.wall)
    last = [json.loads(line) for line in calm.stdout or ()][-1]
    print("in peace: ", last, flush=True)
    with disk(out, options.real) as (place, fill), cluster(options.ray) as (address, kill_node):
        told = Disturbed()
        given = _urls(inputs, out / "inputs.jsonl") if options.urls else inputs
        wall = _until_done(given, place, address, options, told, fill, kill_node)
        print("disturbed:", vars(told), f"{wall:.0f} s in all", flush=True)
        faults = [*compared(out / "calm", place), *index_faults(place, len(list(inputs.iterdir())))]
        wanted = ("workers", "drivers", *(["nodes"] if options.ray else []), *(["full"] if fill else []))
        faults += [f"nothing was done to {name}" for name in wanted if not getattr(told, name)]
        shutil.copytree(place, out / "disturbed")
    return faults


def _urls(inputs: Path, manifest: Path) -> Path:
    """A manifest that names the same folders by URLs."""
    rows = (json.dumps({"path": f"file://{folder}"}) for folder in sorted(inputs.iterdir()))
    manifest.write_text("".join(f"{row}\n" for row in rows))
    return manifest


def _until_done(
    inputs: Path, place: Path, address: str | None, options: argparse.Namespace, told: Disturbed,
    fill: Callable[[float], None] | None, kill_node: Callable[[], None] | None,
) -> float:  # fmt: skip
    """Start the driver again and again until one comes to the end."""
    rng, start, total = random.Random(options.seed), time.monotonic(), options.real + options.stubs
    for kill_at in [total // 4, total // 2, 3 * total // 4, None]:
        jobs = 0 if address else options.jobs
        process = driver(inputs, str(place), jobs=jobs, retries=RETRIES, wall=options.wall, address=address)
        stop = threading.Event()
        killer = threading.Thread(target=_kill_workers, args=[rng, stop, told, options.every], daemon=True)
        killer.start()
        ended = 0
        for line in process.stdout or ():
            event = json.loads(line)
            ended += event.get("state") in ("done", "known", "failed")
            told.waits += event.get("state") == "full"
            if event.get("state") == "again":
                told.again[event["failure"]] += 1
            if fill and event.get("state") == "done" and told.full <= told.drivers and ended > total // 8:
                told.full += 1
                threading.Thread(target=fill, args=[15.0], daemon=True).start()
            if kill_node and told.drivers == 1 and not told.nodes and event.get("state") == "done":
                told.nodes += 1
                kill_node()
            if kill_at is not None and ended >= kill_at:
                process.kill()
                told.drivers += 1
                break
        stop.set()
        killer.join()
        process.wait()
        if kill_at is None and process.returncode:
            raise SystemExit(f"the last driver ended with {process.returncode}")
    return time.monotonic() - start


def _kill_workers(rng: random.Random, stop: threading.Event, told: Disturbed, every: float) -> None:
    """Now and then a worker, or a job in it."""
    while not stop.wait(rng.uniform(0.5, 1.5) * every):
        if pids := workers():
            with contextlib.suppress(ProcessLookupError):
                os.kill(rng.choice(pids), signal.SIGKILL)
                told.workers += 1


def workers() -> list[int]:
    """Processes of this test's workers and their jobs: only those that descend from this process."""
    return [pid for pid in descendants(os.getpid()) if b"f3sr.batch.job_process" in _command(pid)]


def descendants(pid: int) -> Iterator[int]:
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in map(int, file.read_text().split()):
                yield child
                yield from descendants(child)


def _command(pid: int) -> bytes:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


@contextmanager
def disk(out: Path, real: int) -> Iterator[tuple[Path, Callable[[float], None] | None]]:
    """A dataset's place on a disk of its own, and how to fill that for some seconds; None without the right to."""
    mount = out / "disk"
    mount.mkdir()
    size = f"size={DISK_MB + 2 * PACKAGE_MB * real}m"
    command = ["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(mount)]
    if subprocess.run(command, check=False, capture_output=True).returncode:
        print("no right to mount a disk: it is not filled", flush=True)
        yield mount / "dataset", None
        return

    def fill(seconds: float) -> None:
        with contextlib.suppress(OSError), (mount / "filler").open("wb") as filler:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                try:
                    filler.write(b"x" * 65536)
                    filler.flush()
                except OSError:  # full, as intended; jobs that end make room
                    time.sleep(0.02)
        (mount / "filler").unlink(missing_ok=True)

    try:
        yield mount / "dataset", fill
    finally:
        subprocess.run(["umount", "-l", str(mount)], check=False)


@contextmanager
def cluster(wanted: bool) -> Iterator[tuple[str | None, Callable[[], None] | None]]:
    """A Ray cluster of three nodes on this machine, and how to kill one of them."""
    if not wanted:
        yield None, None
        return
    from ray.cluster_utils import Cluster

    os.environ.update(environment())
    node = {"num_cpus": 1, "object_store_memory": 80_000_000}
    made = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    others = [made.add_node(**node) for _ in range(2)]

    def kill() -> None:
        made.remove_node(others[-1], allow_graceful=False)
        made.add_node(**node)

    try:
        yield made.address, kill
    finally:
        made.shutdown()


def compared(calm: Path, other: Path) -> list[str]:
    """Where packages of two datasets differ."""
    from stub_batches import packages

    a, b = packages(calm), packages(other)
    print(f"{len(a)} files of packages, {sum(a[p] == b.get(p) for p in a)} with the same bytes", flush=True)
    return [f"{path}: {'other bytes' if path in a and path in b else 'in one only'}" for path in a.keys() | b.keys()
            if a.get(path) != b.get(path)]  # fmt: skip


def index_faults(place: Path, count: int) -> list[str]:
    """Jobs that the index holds twice or not at all, or that ended as they should not."""
    from f3sr.dataset.layout import Dataset
    from f3sr.dataset.row_selection import selected

    rows = selected(Dataset.read(place), []).to_pylist()
    names = Counter(row["name"] for row in rows)
    print("index:", len(rows), dict(Counter((row["status"], row["failure"]) for row in rows)), flush=True)
    faults = [f"{name} {times} times in the index" for name, times in names.items() if times > 1]
    faults += [f"{len(names)} of {count} jobs in the index"] if len(names) != count else []
    return faults + [
        f"{row['name']}: {row['status']}, {row['reason']}"
        for row in rows
        if (row["status"] == "done") != ("-broken" not in row["name"]) and not _recovers(row["source"])
    ]


def _recovers(source: str) -> bool:
    file = Path(source.removeprefix("file://"), "stub.json")
    return file.exists() and bool(json.loads(file.read_text()).get("once"))


# --- throughput ----------------------------------------------------------------------------------------------------

LOOP = """
import sys, f3sr
from f3sr.runtime import kernels
kernels.warm_up()
for k, folder in enumerate(sys.argv[2:]):
    f3sr.deliver(f3sr.reconstruct(f3sr.read_inputs(folder)), f"{sys.argv[1]}-{k}")
"""
"""A process of its own that reconstructs folders one after another."""


def throughput(options: argparse.Namespace) -> list[str]:
    """A batch beside N processes that each take every N-th input, in alternation."""
    from batch_inputs import write_real

    out = options.out.absolute() / "throughput"
    shutil.rmtree(out, ignore_errors=True)
    folders = [write_real(out / "inputs" / f"{k:03d}", k) for k in range(options.real)]
    ratios: list[float] = []
    for turn in range(options.turns + 1):  # the first warms caches
        start = time.monotonic()
        processes = [
            subprocess.Popen(
                [sys.executable, "-c", LOOP, str(out / f"alone-{turn}-{n}"), *map(str, folders[n :: options.jobs])],
                env=environment(),
            )
            for n in range(options.jobs)
        ]
        codes = [process.wait() for process in processes]
        alone = time.monotonic() - start
        if any(codes):
            return [f"an independent process ended with {max(codes)}"]
        start = time.monotonic()
        process = driver(out / "inputs", str(out / f"batch-{turn}"), jobs=options.jobs)
        list(process.stdout or ())
        process.wait()
        together = time.monotonic() - start
        if turn:
            ratios.append(alone / together)
            print(f"independent {alone:.1f} s, batch {together:.1f} s, {alone / together:.3f}", flush=True)
    ratio = sorted(ratios)[len(ratios) // 2]
    print(f"throughput of a batch: {ratio:.3f} of {options.jobs} independent processes", flush=True)
    return [] if ratio >= 0.9 else [f"throughput {ratio:.3f}"]


# --- many ----------------------------------------------------------------------------------------------------------


def many(options: argparse.Namespace) -> list[str]:
    """Stub jobs in workers of full size: jobs a second, and the driver's memory while they go on."""
    from stub_batches import write_stubs

    out = options.out.absolute() / "many"
    shutil.rmtree(out, ignore_errors=True)
    inputs = write_stubs(out / "inputs", options.count)
    process = driver(inputs, str(out / "dataset"), jobs=options.jobs, quiet=True)
    told = [json.loads(line) for line in process.stdout or ()]
    process.wait()
    memory = [t["rss_mb"] for t in told if "rss_mb" in t]
    wall = told[-1]["wall_s"]
    rate = options.count / wall
    print(f"{options.count} jobs in {wall:.0f} s, {rate:.0f} a second", flush=True)
    print("driver's memory [MB] every", SAMPLE_EVERY, "jobs:", [round(m) for m in memory], flush=True)
    start = time.monotonic()
    again = driver(inputs, str(out / "dataset"), jobs=options.jobs, quiet=True)
    known = json.loads(list(again.stdout or ())[-1])
    again.wait()
    print(f"again: {known['end']} in {time.monotonic() - start:.0f} s", flush=True)
    size = sum(f.stat().st_size for f in (out / "dataset").glob("*.*"))
    print(f"index and list: {size / 1e6:.1f} MB", flush=True)
    faults = index_faults(out / "dataset", options.count)
    if len(memory) > 2 and memory[-1] - memory[1] > 0.1 * memory[1]:
        faults.append(f"the driver's memory grew from {memory[1]:.0f} to {memory[-1]:.0f} MB")
    return faults + ([f"{rate:.0f} jobs a second"] if rate < 50 else [])


def resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    for work in (disturbed, throughput, many):
        command = commands.add_parser(work.__name__)
        command.set_defaults(work=work)
        command.add_argument("--out", type=Path, default=Path("out/batch"))
        command.add_argument("--jobs", type=int, default=2)
        command.add_argument("--real", type=int, default=8 if work is throughput else 30)
        command.add_argument("--stubs", type=int, default=170)
        command.add_argument("--count", type=int, default=10_000)
        command.add_argument("--turns", type=int, default=3)
        command.add_argument("--ray", action="store_true")
        command.add_argument("--urls", action="store_true")
        command.add_argument("--wall", type=float, default=60.0, help="limit of a job [s]")
        command.add_argument("--seed", type=int, default=0)
        command.add_argument("--every", type=float, default=8.0, help="seconds between kills of workers")
    command = commands.add_parser("drive")
    command.add_argument("inputs", type=Path)
    command.add_argument("dataset")
    command.add_argument("--jobs", type=int)
    command.add_argument("--retries", type=int)
    command.add_argument("--wall", type=float)
    command.add_argument("--address")
    command.add_argument("--quiet", action="store_true")
    command.set_defaults(work=lambda options: drive(options.inputs, options.dataset, options))
    options = parser.parse_args(arguments)
    faults = options.work(options) or []
    for fault in faults[:30]:
        print("FAULT", fault)
    print("all as promised" if not faults else f"{len(faults)} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
