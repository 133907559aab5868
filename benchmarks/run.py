"""Reconstruct every benchmark scene, print its measures and times, and compare their means with baseline.json.

usage: python benchmarks/run.py [--scenes NAME ...] [--data PATH] [--out FOLDER] [--update] [--times NAME]
Exit codes: 0 no regression (or no data), 1 a regression, a failed scene or a missing measure, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import baseline
import caches
import process
import tables
import times

REPO = Path(__file__).resolve().parents[1]
GROUPS = {"rendered": "scenes/*", "real": "real/ycb_table_*"}
"""Groups of scenes, each with means of its own, and where their folders are in the data."""

Numbers = dict[str, float]
Row = dict[str, Any]
"""One scene: its group, measures of every one of SIDES, ``stages`` [s]."""
SIDES = ("direct composition", "direct composition, fitted camera", "f3sr")
"""The second has only measures of the picture; the others are those of the first."""


def main() -> int:
    args = _arguments()
    folders = find(args.data)
    if not folders:
        print(f"skipped: no data in {args.data} (--data PATH names another folder)")
        return 0
    if unknown := {*args.scenes, *([args.times] if args.times else [])} - folders.keys():
        print(f"no scenes {', '.join(sorted(unknown))}; there are {', '.join(folders)}", file=sys.stderr)
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    try:
        if args.times:
            tables.print_times(times.cold_and_warm(folders[args.times][1], args.out / "times"))
            return 0
        rows, failures = measure_all({name: folders[name] for name in args.scenes or folders}, args)
    except process.RunError as error:
        print(error, file=sys.stderr)
        return 1
    means = {group: means_of([r for r in rows.values() if r["group"] == group]) for group in GROUPS}
    results = {"scenes": rows, "means": means, "failures": failures}
    (args.out / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    tables.print_results(rows, means)
    try:
        return judge(rows, failures, update=args.update)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1


def find(data: Path) -> dict[str, tuple[str, Path]]:
    """Group and folder of every scene by name."""
    return {
        folder.name: (group, folder)
        for group, pattern in GROUPS.items()
        for folder in sorted(data.glob(pattern))
        if (folder / "masks").is_dir()
    }


def measure_all(chosen: dict[str, tuple[str, Path]], args: argparse.Namespace) -> tuple[dict[str, Row], dict[str, str]]:
    """The rows of the scenes that went through, and why the others did not."""
    rows: dict[str, Row] = {}
    failures: dict[str, str] = {}
    kept = caches.kept(args.out / "warm_up.log")  # no scene pays for compiling kernels
    for name, (group, folder) in chosen.items():
        print(f"{name} ...", end=" ", flush=True)
        try:
            rows[name] = {"group": group, **measure_one(folder, args.out / name, args.data / "objects", kept)}
            print(f"{rows[name]['f3sr']['wall_s']:.0f} s", flush=True)
        except process.RunError as error:
            failures[name] = str(error)
            print(f"FAILED: {error}", flush=True)
    return rows, failures


def measure_one(folder: Path, out: Path, objects: Path, kept: Sequence[Path]) -> Row:
    """Reconstruct one scene into ``out`` and measure it, against the truth where that is known."""
    with caches.fresh(*kept) as cache:
        finished = process.reconstruct(folder, out, environment={"F3SR_CACHE_DIR": str(cache)})
    direct, fitted, ours = (finished.answer[side] for side in SIDES)
    stages: Numbers = finished.answer["seconds"]
    if (folder / "truth.json").exists() and objects.is_dir():
        truth = process.run(["truth.py", folder, out, objects], out.with_suffix(".truth.log")).answer
        ours, direct = ours | truth["f3sr"], direct | truth["direct composition"]
    ours["wall_s"] = finished.wall
    ours["warm_s"] = finished.wall - stages["decompose"]
    ours["cpu_s"] = finished.cpu - finished.answer["cpu"]["decompose"]
    ours["peak_mb"] = finished.peak_mb
    seen = {measure: fitted[measure] for measure in tables.PICTURE}
    return {**dict(zip(SIDES, (direct, seen, ours), strict=True)), "stages": stages}


def means_of(rows: list[Row]) -> dict[str, Numbers]:
    """The mean over scenes of every measure that all of them have, for each side and the stages."""
    return {
        side: {key: fmean(r[side][key] for r in rows) for key in rows[0][side] if all(key in r[side] for r in rows)}
        for side in (*SIDES, "stages")
        if rows
    }


def judge(rows: dict[str, Row], failures: dict[str, str], *, update: bool) -> int:
    """Print what became better or worse than the baseline, or write the new one; returns the exit code."""
    for name, reason in failures.items():
        print(f"{name}: FAILED: {reason}")
    groups, problems = baseline.read(), bool(failures)
    for name, group in groups.items():
        if missing := [scene for scene in group.scenes if scene not in rows]:
            print(f"{name}: means not judged without {', '.join(missing)}")
            continue
        means = means_of([rows[scene] for scene in group.scenes])["f3sr"]
        if update:
            groups[name] = baseline.updated(group, means)
            print(f"{name}: new values in {baseline.FILE}")
        else:
            problems |= report(name, baseline.compare(group, means))
    if update:
        baseline.write(groups)
    return int(problems)


def report(group: str, comparison: baseline.Comparison) -> bool:
    """Print a comparison; True where it holds a problem."""
    for line in comparison.gains:
        print(f"{group}: {line} (--update keeps it)")
    for line in comparison.problems:
        print(f"{group}: REGRESSION {line}")
    if not comparison.problems:
        print(f"{group}: no regression")
    return bool(comparison.problems)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--scenes", nargs="+", default=[], metavar="NAME", help="only these; their means are not judged"
    )
    parser.add_argument(
        "--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/, real/, objects/"
    )
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench", help="packages, logs and results.json")
    parser.add_argument("--update", action="store_true", help="write the measured means to baseline.json")
    parser.add_argument("--times", metavar="NAME", help="only time one scene, with cold and with warm proxy cache")
    args = parser.parse_args()
    args.out = args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
