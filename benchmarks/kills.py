"""``kill -9`` at seeded points of a run: what is on disk then, and what the next run makes of it.

usage: kills.py [--folder INPUTS] [--seed 0] [--out out/kills]

Runs go one after another on one cache, each killed at the next point, so that later runs live on what killed ones left.
After each kill a copy of cache and OUT is taken to the end by a run of its own. Exit code 1 when anything is not as
docs/durability.md promises.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
STAGES = (
    *("assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine", "describe"),
    "evaluate",
)
LONG = ("align", "decompose", "refine", "evaluate")
"""Stages of seconds, killed from outside after some time; the others at a function call, as a moment is too coarse."""
ATTEMPTS = 5
"""A stage that was faster than in the cold run is killed again, after half the time."""
CHECK = """
import sys, mujoco
from pathlib import Path
from f3sr.scene_package.package import read_package
read_package(Path(sys.argv[1]))
mujoco.MjModel.from_xml_path(sys.argv[1] + "/scene.xml")
"""
"""Raises unless a folder is a whole package."""


@dataclass(frozen=True)
class Point:
    """Where a run is killed: ``in STAGE`` after a share of its time, ``start`` after seconds, or at an exact call."""

    name: str
    delay: float = 0.0
    old: bool = False
    """An older package is in the place."""


@dataclass(kw_only=True)
class Trial:
    """One kill and the run after it."""

    point: str
    old: bool
    landed: str
    """The last thing the killed run told of itself."""
    finished: list[str]
    """Stages that the store held when the run was killed."""
    found: str
    """What is in the place after the kill: nothing, the old package, the new one, or what is wrong with it."""
    left: list[str]
    """Other names beside the place after the kill."""
    resumed: list[str] = field(default_factory=list[str])
    """Stages that the next run took from the cache."""
    seconds: float = 0.0
    """Of the next run, from start to end."""
    faults: list[str] = field(default_factory=list[str])


def points(seed: int) -> list[Point]:
    """Twenty: the start, every stage, stored and half stored results, files of the package, commit, deletion."""
    rng = random.Random(seed)
    found = [Point("start", rng.uniform(0.05, 0.6))]
    for k, stage in enumerate(STAGES):
        if stage == "align":
            found.append(Point("stored:1"))  # level: assemble was stored by an earlier run
        if stage == "settle":
            found.append(Point("storing:2"))
        name = f"in {stage}" if stage in LONG else f"{stage}:{rng.randint(1, 100)}"
        found.append(Point(name, rng.uniform(0.05, 0.6), old=k % 2 == 1))
        if stage in ("decompose", "refine"):
            found.append(Point("stored:1", old=stage == "refine"))
    found += [Point(f"write:{rng.randint(1, 5)}"), Point(f"write:{rng.randint(6, 20)}", old=True)]
    found += [Point("rename1:1", old=True), Point("rename2:1", old=True)]
    return [*found, Point("delete:1", old=True), Point(f"delete:{rng.randint(2, 12)}", old=True)]


class Kills:
    """Kills runs on one folder of inputs that leave out the stages ``skip``. ``work`` is a new folder, ``kernels``
    compiled ones to begin with. ``popen`` starts a run, as ``subprocess.Popen`` does."""

    def __init__(
        self,
        folder: Path,
        work: Path,
        kernels: Sequence[Path],
        skip: Sequence[str] = (),
        popen: type[subprocess.Popen[Any]] = subprocess.Popen,
    ) -> None:
        self.folder, self.work, self.options, self.popen = folder, work, _skipping(skip), popen
        self.cache = work / "cache"
        self.cache.mkdir(parents=True)
        for compiled in kernels:
            shutil.copytree(compiled, self.cache / compiled.name)
        self.new = self._reference("new", self.options)
        self.old = self._reference("old", (*_skipping([*skip, "align", "settle", "evaluate"]), "--ignore", "ground"))
        self.stage_seconds = json.loads((self.work / "new" / "report.json").read_text())["seconds"]

    def trial(self, point: Point) -> Trial:
        """Kill a run at the point, look, and let the next one finish on a copy."""
        place = self.work / "killed"
        shutil.copytree(self.cache, self.work / "cache_before")
        for attempt in range(ATTEMPTS):
            if attempt:
                _copied(self.work / "cache_before", self.cache)
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            if point.old:
                shutil.copytree(self.work / "old", place / "out")
            landed = self._killed(point, place / "out", share=point.delay / 2**attempt)
            if not _missed(point.name, landed):
                break
        shutil.rmtree(self.work / "cache_before")
        trial = Trial(
            point=point.name,
            old=point.old,
            landed=landed,
            finished=self._finished(point, landed),
            found=self._look(place / "out"),
            left=sorted(p.name for p in place.iterdir() if p.name != "out"),
        )
        self._finish(trial, place)
        return trial

    def _reference(self, name: str, options: tuple[str, ...]) -> dict[str, str]:
        """A run of its own on an empty cache; the digests of its files."""
        cache = self.work / f"cache_{name}"
        cache.mkdir()
        for folder in (*self.cache.glob("kernels-*"), *self.work.glob("cache_*/proxies")):
            shutil.copytree(folder, cache / folder.name)
        done = self._command("none", self.work / name, cache, options).wait()
        assert done == 0, f"the {name} run ended with {done}"
        return digests(self.work / name)

    def _command(
        self, point: str, out: Path, cache: Path, options: tuple[str, ...], notes: int = 1
    ) -> subprocess.Popen[bytes]:
        command = [sys.executable, str(HERE / "killed_cli.py"), point, str(notes), "reconstruct", str(self.folder)]
        return self.popen(
            [*command, "-o", str(out), *options],
            env={**os.environ, "F3SR_CACHE_DIR": str(cache)},
            stdout=(self.work / "log").open("w"),
            stderr=(self.work / "errors").open("w"),
            pass_fds=[notes] if notes > 2 else [],
        )

    def _killed(self, point: Point, out: Path, share: float) -> str:
        """Start a run and kill it at the point; the last it told of itself."""
        ear, mouth = os.pipe()
        exact = ":" in point.name
        process = self._command(point.name if exact else "none", out, self.cache, self.options, mouth)
        os.close(mouth)
        told = "start"
        with os.fdopen(ear) as lines:
            if point.name == "start":
                time.sleep(share)
                process.kill()
            for line in lines:
                told = line.strip()
                stage = point.name.removeprefix("in ")
                if told == f"begin {stage}":
                    time.sleep(share * self.stage_seconds[stage])
                    process.kill()
        code = process.wait()
        return told if code == -signal.SIGKILL else f"{told}, and ended with exit code {code}"

    def _finished(self, point: Point, landed: str) -> list[str]:
        """Stages that the killed run said were done, and the one it was killed for having stored."""
        said = (self.work / "log").read_text()
        stored = landed.removeprefix("end ") if point.name.startswith("stored") else ""
        told = {line.partition(": ")[0] for line in said.splitlines() if not line.endswith(": skipped")}
        return [stage for stage in STAGES if stage in told or stage == stored]

    def _look(self, out: Path) -> str:
        if not out.exists():
            return "nothing"
        try:
            found = digests(out)
        except (OSError, ValueError) as error:
            return f"no package: {error}"
        if found not in (self.new, self.old):
            return "a package that is neither the old nor the new one"
        _copied(out, self.work / "looked")  # reading a package tidies up beside it, which is for the next run
        command = [sys.executable, "-c", CHECK, str(self.work / "looked")]
        check = self.popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        _, errors = check.communicate()
        if check.returncode:
            return f"a broken package: {errors.strip().splitlines()[-1]}"
        return "new" if found == self.new else "old"

    def _finish(self, trial: Trial, place: Path) -> None:
        """The next run, on copies, and what is wrong with all of it."""
        copy, cache = self.work / "finished", self.work / "cache_finished"
        _copied(place, copy)
        _copied(self.cache, cache)
        if "decompose" not in trial.point:  # elsewhere the parts of the cold run stand for those made once more
            _copied(self.work / "cache_new" / "proxies", cache / "proxies")
        start = time.perf_counter()
        code = self._command("none", copy / "out", cache, self.options).wait()
        trial.seconds = time.perf_counter() - start
        said = (self.work / "log").read_text()
        trial.resumed = [stage for stage in STAGES if f"{stage}: from the cache" in said]
        trial.faults = [
            *([f"not killed where meant: {trial.landed}"] if _missed(trial.point, trial.landed) else []),
            *([f"after the kill: {trial.found}"] if trial.found not in ("nothing", "old", "new") else []),
            *([f"the next run: {(self.work / 'errors').read_text().strip()}"] if code else []),
            *([f"done again: {stage}" for stage in trial.finished if stage not in trial.resumed]),
            *(["other bytes than the cold run"] if digests(copy / "out") != self.new else []),
            *([f"left over: {p.name}" for p in copy.iterdir() if p.name != "out"]),
            *([f"left over: {p.name}" for p in cache.rglob("*.part")]),
        ]


def _skipping(stages: Sequence[str]) -> tuple[str, ...]:
    return ("--skip", ",".join(sorted(set(stages)))) if stages else ()


def _missed(point: str, landed: str) -> bool:
    stage = point.removeprefix("in ").partition(":")[0]
    return "exit code" in landed or (stage in STAGES and landed != f"begin {stage}")


def _copied(source: Path, target: Path) -> None:
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target)


def digests(package: Path) -> dict[str, str]:
    """sha256 of every file; of report.json without the seconds, which no two runs share."""
    found: dict[str, str] = {}
    for file in sorted(p for p in package.rglob("*") if p.is_file()):
        data = file.read_bytes()
        if file.name == "report.json":
            report = json.loads(data)
            del report["seconds"]
            data = json.dumps(report).encode()
        found[file.relative_to(package).as_posix()] = hashlib.sha256(data).hexdigest()
    return found


def show(trial: Trial) -> str:
    stages = f"{len(trial.finished)} -> {len(trial.resumed)}"
    verdict = "; ".join(trial.faults) or "ok"
    before = "old" if trial.old else "-"
    return f"{trial.point:14} {before:4} {trial.landed:16} {stages:8} {trial.found:8} {trial.seconds:6.1f}  {verdict}"


def main() -> int:
    from f3sr import example
    from f3sr.runtime import kernels

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=example.folder())
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("out/kills"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    kernels.warm_up()
    compiled = list(filter(None, [kernels.kernel_folder()]))
    trials: list[Trial] = []
    with tempfile.TemporaryDirectory(prefix="f3sr-kills-") as work:
        kills = Kills(arguments.folder.resolve(), Path(work) / "work", compiled)
        print(f"{'point':14} {'had':4} {'last told':16} {'stages':8} {'found':8} {'next s':>6}  verdict", flush=True)
        for point in points(arguments.seed):
            trials.append(kills.trial(point))
            print(show(trials[-1]), flush=True)
    result: dict[str, Any] = {"seed": arguments.seed, "trials": [asdict(trial) for trial in trials]}
    (arguments.out / "kills.json").write_text(json.dumps(result, indent=1) + "\n")
    bad = sum(bool(trial.faults) for trial in trials)
    print(f"{len(trials)} kills, {bad} with faults")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
