"""Stress: seeded scenes of towers, nested bowls, leaning planks, piles, furniture and deep overlaps through the whole
command; and how its time grows with the number of objects.

usage: python benchmarks/stress.py [CASE ...] [--seeds N ...] [--views VIEW ...] [--growth] [--out FOLDER]
       python benchmarks/stress.py --containers [--update] [--out FOLDER]
Exit codes: 0 all bounds hold, 1 one does not, a run failed, or containers are worse than containers.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import baseline
import caches
import process
import tables
from run import REPO
from scene_views import USUAL, VIEWS, scene_name

CASES = ("tower", "bowls", "planks", "pile", "floor", "overlaps", "dining", "shelf")
CONTAINERS = {"in_bowl": 3, "in_pan": 3, "in_mug": 2, "on_plate": 2, "in_crate": 2}
"""Scans in containers, and how many seeds make the family of twelve; by default they are not run."""
CONTAINERS_FILE = Path(__file__).with_name("containers.json")
"""What is expected of their means."""
ROOMS = ("kitchen", "lounge", "bedroom", "study", "dining_room", "storeroom")
"""Floors with furniture that is itself objects; by default they are not run."""
SCANS = ("scan_pile", "scan_stack", "scan_scatter", "scan_mixed")
"""Scans as the ten rendered scenes have them; by default they are not run."""
GROWTH = (5, 10, 20, 50)
STAGES = (
    *("assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine", "coarsen"),
    *("describe", "uncertainty", "evaluate", "inpaint"),
)
COLUMNS = (
    *(
        "n",
        "mIoU_visible",
        "N_cross",
        "overlaps_left",
        "inside",
        "K_max_J",
        "K_mm",
        "D_max_cm",
        "gap_pct",
        "proxy_out_pct",
    ),
    *("centre_pct", "raw_centre_pct", "support_precision", "support_recall", "fallen", "far_pct", "wall_s"),
)
BOUNDS: Mapping[str, tuple[float, str]] = {
    "N_cross": (0, "nothing is left in another"),
    "inside": (0, "nothing is left in another"),
    "K_mm": (0.08, "it rests, undamped: two contact margins of ours are so much less than two of the release"),
    "D_max_cm": (0.2, "it rests, undamped: the release pushes every level of a tower up by .08 mm"),
    "gap_pct": (2.0, "nothing floats"),
    "far_pct": (100.0, "nothing leaves the scene"),
    "left_scene": (0, "nothing leaves the scene"),
    "unnamed": (0, "what is left is said per pair"),
    "wall_s": (300.0, "bounded time, proxies included"),
}
"""The most of every measure, and why. K_mm: K_max as a fall of everything, for furniture weighs a thousand times what
lies on a table."""

Row = dict[str, Any]


def main() -> int:
    args = _arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    kernels, proxies = caches.kept(args.out / "warm_up.log")
    if args.growth:
        return grow(args, kernels)
    rows: dict[str, Row] = {}
    family = [(case, seed, USUAL) for case, count in CONTAINERS.items() for seed in range(count)]
    for case, seed, view in family if args.containers else product(args.cases, args.seeds, args.views):
        name = scene_name(case, seed, view)
        print(f"{name} ...", end=" ", flush=True)
        try:
            rows[name] = one(case, seed, view, args.out, (kernels, proxies))
            print(said(rows[name]), flush=True)
        except process.RunError as error:
            rows[name] = {"failed": str(error)}
            print(f"FAILED: {error}", flush=True)
    _keep(args.out / "results.json", rows)
    show(rows)
    problems = [line for name, row in rows.items() for line in misses(name, row)]
    print("\n".join(problems) or "all bounds hold")
    code = int(bool(problems))
    if args.containers and not any("failed" in row for row in rows.values()):
        code |= baseline.judged(CONTAINERS_FILE, {"containers": means(rows)}, update=args.update)
    return code


def means(rows: Mapping[str, Row]) -> dict[str, float]:
    """The mean over all rows of what the containers' baseline has."""
    wanted = baseline.read(CONTAINERS_FILE)["containers"].measures
    return {measure: fmean(row[measure] for row in rows.values()) for measure in wanted}


def one(case: str, seed: int, view: str, out: Path, kept: Sequence[Path]) -> Row:
    """Build a case, unless that was done, reconstruct it in a process of its own and judge what came of it."""
    data, name, made = out / "data", scene_name(case, seed, view), {"case": case, "seed": seed, "view": view}
    folder = Path(process.run(["stress_scenes.py", data, json.dumps(made)], out / f"{name}.built.log").answer)
    skip = json.loads((folder / "truth.json").read_text())["skip"]
    with caches.fresh(*kept) as cache:
        finished = process.reconstruct(
            folder,
            out / name,
            environment={"F3SR_CACHE_DIR": str(cache)},
            options=["--skip", skip] if skip else [],
        )
    true = process.run(["truth.py", folder, out / name, data / "objects"], out / f"{name}.truth.log").answer
    picture = out / f"{name}.png"
    judged = process.run(
        ["stress_judged.py", folder, out / name, data / "objects", picture], out / f"{name}.judged.log"
    ).answer
    energy = finished.answer["f3sr"]["K_max_J"]
    return {
        "K_mm": 1000 * energy / judged["weight_N"],
        **finished.answer["f3sr"],
        **true["f3sr"],
        **{f"raw_{k}": v for k, v in {**finished.answer["direct composition"], **true["direct composition"]}.items()},
        **judged,
        "seconds": finished.answer["seconds"],
        "cpu": finished.answer["cpu"],
        "wall_s": finished.wall,
        "cpu_s": finished.cpu,
        "peak_mb": finished.peak_mb,
    }


def grow(args: argparse.Namespace, kernels: Path) -> int:
    """A column of processor seconds per number of objects, nothing cached but compiled kernels."""
    columns: dict[str, Row] = {}
    for count in args.counts:
        print(f"{count} objects ...", end=" ", flush=True)
        columns[str(count)] = one(f"mixed_{count}", args.seeds[0], USUAL, args.out, (kernels,))
        print(said(columns[str(count)]), flush=True)
        _keep(args.out / "growth.json", columns)
    steps = [s for s in STAGES if any(s in c["cpu"] for c in columns.values())]
    lines = [["processor seconds", *columns]]
    lines += [[step, *(f"{c['cpu'].get(step, 0):.1f}" for c in columns.values())] for step in steps]
    lines.append(["whole command", *(f"{c['cpu_s']:.1f}" for c in columns.values())])
    lines.append(["without decompose", *(f"{c['cpu_s'] - c['cpu']['decompose']:.1f}" for c in columns.values())])
    lines.append(["wall", *(f"{c['wall_s']:.1f}" for c in columns.values())])
    lines.append(["peak memory MB", *(f"{c['peak_mb']:.0f}" for c in columns.values())])
    tables.show(lines)
    return 0


def misses(name: str, row: Row) -> Iterator[str]:
    """What a row exceeds. Where something is kept fixed in the air, a report says so, and gaps tell nothing."""
    if "failed" in row:
        yield f"{name}: FAILED: {row['failed']}"
        return
    for measure, (most, why) in BOUNDS.items():
        if measure == "gap_pct" and row["fixed"]:
            continue
        value = row[measure]
        if (len(value) if isinstance(value, list) else value) > most:
            said = value if isinstance(value, list) else f"{value:.3g}"
            yield f"{name}: {measure} {said}, at most {most:g}: {why}"


def show(rows: Mapping[str, Row]) -> None:
    """A line per case, then where the time goes."""
    whole = {name: row for name, row in rows.items() if "failed" not in row}
    if not whole:
        return
    print()
    tables.show([["", *COLUMNS], *([name, *(_cell(row.get(c)) for c in COLUMNS)] for name, row in whole.items())])
    print("\nprocessor seconds")
    steps = [s for s in STAGES if any(s in row["cpu"] for row in whole.values())]
    tables.show([["", *steps], *([n, *(f"{r['cpu'].get(s, 0):.1f}" for s in steps)] for n, r in whole.items())])
    print()


def said(row: Row) -> str:
    return f"{row['wall_s']:.0f} s, {row['cpu_s']:.0f} s of processor time"


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return str(len(value)) if isinstance(value, list) else f"{value:.3g}"


def _keep(file: Path, rows: Mapping[str, Row]) -> None:
    """Add rows to those of earlier runs."""
    known = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps({**known, **rows}, indent=1) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*", default=list(CASES), metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], metavar="N")
    parser.add_argument("--views", nargs="+", choices=VIEWS, default=[USUAL], metavar="VIEW", help=", ".join(VIEWS))
    parser.add_argument("--growth", action="store_true", help="only the growth table, cold")
    parser.add_argument("--containers", action="store_true", help="the family of twelve, held against containers.json")
    parser.add_argument("--update", action="store_true", help="write the means of --containers to containers.json")
    parser.add_argument("--counts", nargs="+", type=int, default=list(GROWTH), choices=GROWTH, metavar="N")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench" / "stress", help="inputs, packages, tables")
    args = parser.parse_args()
    known = (*CASES, *CONTAINERS, *ROOMS, *SCANS)
    if unknown := sorted(set(args.cases) - {*known}):
        parser.error(f"no cases {', '.join(unknown)}; there are {', '.join(known)}")
    if args.update and not args.containers:
        parser.error("--update belongs to --containers")
    args.out = args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
