"""Run the command line on seeded mutations of tiny folders: each is refused with one line, or gives a valid package.

usage: python benchmarks/fuzz.py [--count 2000] [--seed 0] [--case N] [--out FOLDER]
Prints one JSON object. Exit codes: 0 no finding, 1 findings (their folders and verdicts are kept in --out).
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import io
import json
import os
import resource
import shutil
import signal
import stat
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

REPO = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(REPO / "tests"), str(REPO / "benchmarks")]

import numpy as np  # noqa: E402
from PIL import Image  # noqa: E402

import folders  # noqa: E402
import mutations  # noqa: E402

LIMIT_S = 30.0
"""Most processor time of a run and all it starts [s]: what it takes on a calm machine, or a little more."""
WALL_LIMIT_S = 150.0
"""A run that takes longer hangs [s], however busy the machine is."""
MEMORY_MB = 2000
"""Most resident memory of a run."""
ADDRESS_SPACE = 16 << 30
"""Bytes a run may map: a guard of this machine, far above the memory it is judged by."""
VARIANTS = ("poses", "depth", "graph", "posed", "full")


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What became of one mutated folder. ``kind``: accepted, rejected, or the name of a finding."""

    case: int
    variant: str
    changes: list[tuple[str, str]]
    kind: str
    detail: str
    seconds: float
    cpu: float
    peak_mb: float

    @property
    def is_finding(self) -> bool:
        return self.kind not in ("accepted", "rejected")


def main() -> int:
    args = _arguments()
    started = time.perf_counter()
    args.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="f3sr-fuzz-") as place, (args.out / "verdicts.jsonl").open("w") as log:
        originals = write_variants(Path(place) / "originals")
        _load()
        os.environ["F3SR_CACHE_DIR"] = f"{place}/cache"
        _forget_cache_folder()
        cases = [args.case] if args.case is not None else range(args.start, args.start + args.count)
        verdicts = []
        for case in cases:
            verdict = run_case(case, args.seed, originals, Path(place) / "box", args.out)
            verdicts.append(verdict)
            print(json.dumps(asdict(verdict)), file=log, flush=True)
            if verdict.is_finding or args.case is not None:
                print(json.dumps(asdict(verdict)), file=sys.stderr, flush=True)
            if len(verdicts) % 100 == 0:
                print(f"{len(verdicts)} cases, {time.perf_counter() - started:.0f} s", file=sys.stderr, flush=True)
    print(json.dumps(summary(verdicts, args.seed, time.perf_counter() - started), indent=1))
    return int(any(v.is_finding for v in verdicts))


def write_variants(place: Path) -> dict[str, Path]:
    """Five small folders that hold every kind of file that is accepted."""
    textured = folders.boxes(textured=True)
    for name in VARIANTS:
        folders.write_folder(
            place / name, perturb=0.05, seed=3, objects=textured if name in ("poses", "full") else None
        )
    folders.to_depth(place / "depth")
    folders.to_posed(place / "posed")
    folders.add_graph(place / "graph")
    folders.add_graph(place / "full")
    with np.load(place / "full/geometry.npz") as archive:
        data = dict(archive)
    data["normal"] = np.zeros_like(data["points"]) + np.array([0, -0.77, -0.64], np.float32)
    data["points"] = data["points"].astype(np.float16)
    np.savez_compressed(place / "full/geometry.npz", **data, coordinate_system="opencv")
    Image.open(place / "full/image.png").save(place / "full/image.jpg", quality=95)
    (place / "full/image.png").unlink()
    (place / "full/ground.png").unlink()
    return {name: place / name for name in VARIANTS}


def run_case(case: int, seed: int, originals: dict[str, Path], box: Path, kept: Path) -> Verdict:
    """Mutate one folder, run the command on it in a process of its own, and judge what it did."""
    rng = np.random.default_rng([seed, case])
    variant = VARIANTS[case % len(VARIANTS)]
    shutil.rmtree(box, ignore_errors=True)
    for name in ("home", "tmp"):
        (box / name).mkdir(parents=True)
    shutil.copytree(originals[variant], box / "input")
    changes = mutations.mutate(box / "input", rng)
    before = snapshot(box)
    start = time.perf_counter()
    status, cpu, peak = _in_a_process(box)
    seconds = time.perf_counter() - start
    kind, detail = judge(box, status, before)
    if cpu > LIMIT_S or seconds > WALL_LIMIT_S:
        kind, detail = "slow", f"{cpu:.1f} s of processor time, {seconds:.1f} s"
    elif peak > MEMORY_MB:
        kind, detail = "memory", f"{peak:.0f} MB"
    verdict = Verdict(
        case=case,
        variant=variant,
        changes=changes,
        kind=kind,
        detail=detail,
        seconds=round(seconds, 2),
        cpu=round(cpu, 2),
        peak_mb=round(peak),
    )
    if verdict.is_finding:
        _keep(verdict, box, kept / f"seed_{seed}_case_{case}")
    return verdict


def judge(box: Path, status: int, before: dict[str, Any]) -> tuple[str, str]:
    """A verdict and why."""
    said = (box.parent / "stderr").read_bytes().decode(errors="replace")
    lines = said.splitlines()
    new = {p: v for p, v in snapshot(box).items() if before.get(p) != v}
    gone = before.keys() - snapshot(box).keys()
    if os.WIFSIGNALED(status):
        return "crash", f"signal {os.WTERMSIG(status)}: {said[-300:]}"
    code = os.waitstatus_to_exitcode(status)
    if "Traceback" in said:
        return "traceback", " / ".join(lines[-6:])
    if code == 0:
        strangers = [p for p in new if p != "out" and not p.startswith("out/")]
        if strangers or gone:
            return "files outside OUT", ", ".join([*strangers, *gone])
        return ("stderr", said[:300]) if said else ("accepted", "")
    if new or gone:
        return "left behind", ", ".join([*new, *gone])
    if code != 2:
        return f"exit {code}", said[:300]
    if len(lines) != 1 or not said.startswith("f3sr: ") or not lines[0].isprintable():
        return "not one clear line", repr(said[:300])
    if len(lines[0]) > 700:
        return "endless line", lines[0][:100]
    return "rejected", lines[0].replace(str(box), "")


def snapshot(box: Path) -> dict[str, Any]:
    """Kind, size and time of change of everything below a folder; a folder is what it holds."""
    found: dict[str, Any] = {}
    for path in sorted(box.rglob("*")):
        s = path.lstat()
        is_folder = stat.S_ISDIR(s.st_mode)
        found[path.relative_to(box).as_posix()] = (s.st_mode, *(() if is_folder else (s.st_size, s.st_mtime_ns)))
    return found


def summary(verdicts: list[Verdict], seed: int, seconds: float) -> dict[str, Any]:
    """Counts by verdict and by kind of change, and what took longest."""
    by_change: dict[str, Counter[str]] = {name: Counter() for name in mutations.MUTATIONS}
    for v in verdicts:
        for kind in {kind for kind, _ in v.changes}:
            by_change[kind][v.kind] += 1
    slowest = sorted(verdicts, key=lambda v: -v.cpu)[:5]
    return {
        "seed": seed,
        "cases": len(verdicts),
        "seconds": round(seconds),
        "verdicts": Counter(v.kind for v in verdicts),
        "findings": [v.case for v in verdicts if v.is_finding],
        "by_change": {name: dict(count) for name, count in by_change.items()},
        "by_variant": {name: Counter(v.kind for v in verdicts if v.variant == name) for name in VARIANTS},
        "slowest_s": max((v.seconds for v in verdicts), default=0),
        "slowest_cpu_s": max((v.cpu for v in verdicts), default=0),
        "slowest_rejection_s": max((v.seconds for v in verdicts if v.kind == "rejected"), default=0),
        "peak_mb": max((v.peak_mb for v in verdicts), default=0),
        "slowest": [asdict(v) for v in slowest],
    }


# --- one run ----------------------------------------------------------------------------------------------------------


def _load() -> None:
    """Everything a run imports and compiles, once, before the processes fork."""
    import f3sr.cli.main
    from f3sr.runtime import kernels

    kernels.warm_up(film=False)
    with contextlib.redirect_stderr(io.StringIO()):  # a command that is refused has imported what it would need
        f3sr.cli.main.main(["reconstruct", "/nowhere/input", "-o", "/nowhere/out"])
    for name in ("f3sr.scene_package.package", "trimesh", "mujoco", "manifold3d", "rich.table", "scipy.optimize"):
        importlib.import_module(name)
    gc.freeze()  # a collection in a run would copy all pages that it shares with this process


def _forget_cache_folder() -> None:
    """Stage results go to the sandbox; compiled kernels stay where they were found."""
    from f3sr.runtime.cache_folder import cache_folder

    cache_folder.cache_clear()


def _in_a_process(box: Path) -> tuple[int, float, float]:
    """Wait status, processor time [s] and peak memory [MB] of the command on box/input, killed at the limit."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        os._exit(_child(box))
    deadline = time.monotonic() + WALL_LIMIT_S + 1
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
            _, status, usage = os.wait4(pid, 0)
            break
        time.sleep(0.01)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # what it may have left running
    return status, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def _child(box: Path) -> int:
    """Run the command and check its package; the exit code, 99 for an exception that reached us."""
    import f3sr.cli.main

    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.environ |= {"F3SR_TRACEBACK": "1", "HOME": str(box / "home"), "TMPDIR": str(box / "tmp")}
    tempfile.tempdir = None
    os.chdir(box)
    for number, name in ((1, "stdout"), (2, "stderr")):
        with (box.parent / name).open("wb") as file:
            os.dup2(file.fileno(), number)
    code = 99
    try:
        code = f3sr.cli.main.main(["reconstruct", "input", "-o", "out"])
        if code == 0:
            check_package(box / "out", box / "input/masks")
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 99
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def check_package(out: Path, masks: Path) -> None:
    """Every mask is an object or excluded, all values are finite, and MuJoCo loads the scene."""
    import mujoco

    from f3sr.scene_package.package import read_package

    package = read_package(out)
    names = {o.mask_name for o in package.scene.objects} | {e.mask for e in package.scene.excluded}
    given = {p.name for p in masks.iterdir() if not p.name.startswith(".")}
    if names != given:
        raise AssertionError(f"masks {sorted(given)}, in the package {sorted(names)}")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if not np.isfinite(data.qpos).all() or not np.isfinite(data.qacc).all():
        raise AssertionError("scene.xml: a state that is not finite")
    if any(data.warning[k].number for k in range(len(data.warning))):
        raise AssertionError("scene.xml: MuJoCo warns")
    if mujoco_bodies(model) != len(package.scene.objects):
        raise AssertionError("scene.xml: not one body per object")


def mujoco_bodies(model: Any) -> int:
    """Bodies that hang from the world."""
    return int(np.sum(model.body_parentid[1:] == 0))


def _keep(verdict: Verdict, box: Path, place: Path) -> None:
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    (place / "verdict.json").write_text(json.dumps(asdict(verdict), indent=1))
    for name in ("stdout", "stderr"):
        shutil.copyfile(box.parent / name, place / name)
    with contextlib.suppress(shutil.Error, OSError):  # pipes and sockets stay behind
        shutil.copytree(box / "input", place / "input", symlinks=True, ignore_dangling_symlinks=True)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=2000, help="folders to try")
    parser.add_argument("--start", type=int, default=0, help="the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, help="only this one, its verdict printed")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "fuzz", help="where findings are kept")
    args = parser.parse_args()
    args.out = args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
