"""Alignment measured: its basin on single meshes, variants and the report's recipe side by side on scenes, its cost.

usage: python benchmarks/alignment.py [PART ...] [--data PATH] [--out FOLDER] [--starts N] [--update]
Parts: basin, variants, cost; all by default. Exit codes: 0 no regression (or no data), 1 a regression or a miss.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path
from statistics import fmean, median
from typing import Any

import baseline
import basin
import tables
import variants
from f3sr.io.mesh_files import load_mesh
from f3sr.runtime import kernels
from f3sr.stages.align import AlignConfig
from run import REPO, find

PARTS = ("basin", "variants", "cost")
BASELINE = Path(__file__).with_name("alignment.json")
EIGHT = "dev_07_scatter"
"""A scene of eight objects, 16,384 triangles each."""
CAMERA_ONLY = "skip align-objects"
"""The variant whose time is the camera's alone."""
SAME_PROBLEM = "ours, equations 8 and 9"
"""The variant that searches what the report's does and nothing else."""
REPEATS = 8
"""Runs that a time is the median of."""

Means = dict[str, float]


def main() -> int:
    args = _arguments()
    if not (args.data / "objects").is_dir():
        print(f"skipped: no data in {args.data} (--data PATH names another folder)")
        return 0
    kernels.warm_up()
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Means] = {}
    for part in args.parts:
        print(f"\n## {part}", flush=True)
        found |= {"basin": basins, "variants": side_by_side, "cost": costs}[part](args)
    (args.out / "results.json").write_text(json.dumps(found, indent=1) + "\n")
    present = {*find(args.data), *(file.stem for file in (args.data / "objects").glob("*.glb"))}
    return judge(found, present, update=args.update)


def basins(args: argparse.Namespace) -> dict[str, Means]:
    """How many starts of every kind arrive; judged only with as many of them as the baseline has."""
    if missing := [name for name in basin.MESHES if not (args.data / "objects" / f"{name}.glb").exists()]:
        print(f"left out, as they are not in {args.data / 'objects'}: {', '.join(missing)}")
    if len(missing) == len(basin.MESHES):
        return {}
    config = AlignConfig(camera=False)
    runs = list(basin.run(args.data / "objects", starts=args.starts, config=config))
    _write(args.out / "basin.json", [asdict(r) for r in runs])
    header = ["start", "target", "arrived", "arrived as seen", "median", "least", "before", "reachable"]
    lines, means = [[*header, "evaluations", "CPU ms", "starts"]], Means()
    for kind in basin.KINDS:
        of = [r for r in runs if r.kind == kind.key]
        ends = [r.after for r in of]
        means[kind.key] = fmean(end > basin.ARRIVED for end in ends)
        shares = [kind.target, means[kind.key], fmean(r.seen > basin.ARRIVED for r in of), median(ends), min(ends)]
        shares += [median(r.before for r in of), fmean(r.reachable for r in of)]
        work = [fmean(r.evaluations for r in of), 1e3 * fmean(r.cpu for r in of), len(of)]
        lines.append([kind.name, *(f"{v:.3f}" for v in shares), *(f"{v:.0f}" for v in work)])
    tables.show(lines)
    for r in runs:
        if r.after <= basin.ARRIVED:
            print(f"missed: {r.mesh}, {r.kind}, seed {r.seed}: {r.before:.3f} -> {r.after:.3f}, as seen {r.seen:.3f}")
    return {"basin": means} if args.starts == basin.STARTS else {}


def side_by_side(args: argparse.Namespace) -> dict[str, Means]:
    """Every variant on every scene, means by group."""
    found: dict[str, Means] = {}
    folders = find(args.data)
    chosen = {name: variants.VARIANTS[name] for name in args.variants or variants.VARIANTS}
    for group in dict.fromkeys(group for group, _ in folders.values()):
        rows: dict[str, list[variants.Row]] = {name: [] for name in chosen}
        true: list[float | None] = []
        for name, (of, folder) in folders.items():
            if of == group:
                prepared = variants.Prepared.of(folder, args.data / "objects")
                true.append(variants.true_mIoU(prepared))
                for variant, step in chosen.items():
                    rows[variant].append(variants.measured(prepared, step))
                print(f"{name} ...", flush=True)
        _write(args.out / f"variants_{group}.json", {v: [asdict(r) for r in of] for v, of in rows.items()})
        means = {name: variants.summary(of) for name, of in rows.items()}
        print(f"\n{group}, {len(true)} scenes")
        _show(means)
        if known := [t for t in true if t is not None]:
            print(f"mIoU of the true scenes: {fmean(known):.4f}")
            for mean in means.values():
                mean["mIoU_of_true"] = mean["mIoU"] / fmean(known)
        found |= {f"{group}: {name}": mean for name, mean in means.items()} | _against_the_report(group, means)
    return found


def _against_the_report(group: str, means: dict[str, Means]) -> dict[str, Means]:
    """What our objects take and reach beside the report's, from the same camera: the same problem, and all we do."""
    if not {"ours", SAME_PROBLEM, "report", CAMERA_ONLY} <= means.keys():
        return {}
    found: dict[str, Means] = {}
    for name in (SAME_PROBLEM, "ours"):
        ours, report, camera = means[name], means["report"], means[CAMERA_ONLY]
        found[f"{group}: {name} against the report"] = peer = {
            "cpu_ratio": (report["cpu_s"] - camera["cpu_s"]) / (ours["cpu_s"] - camera["cpu_s"]),
            "evaluations_ratio": (report["evaluations"] - camera["evaluations"])
            / (ours["evaluations"] - camera["evaluations"]),
            "mIoU_visible_gain": ours["mIoU_visible"] - report["mIoU_visible"],
            "mIoU_gain": ours["mIoU"] - report["mIoU"],
        }
        print(f"{name}: " + ", ".join(f"{measure} {value:.3g}" for measure, value in peer.items()))
    return found


def costs(args: argparse.Namespace) -> dict[str, Means]:
    """Processor time of eight objects, and of one mesh at growing numbers of triangles: all that ``align`` does."""
    mesh = load_mesh(args.data / "objects" / f"{basin.MESHES[0]}.glb")
    counts = (len(mesh.faces), 50_000, 200_000)
    lines, times = [["triangles", "CPU ms", "evaluations"]], dict[int, float]()
    for faces in counts:
        runs = [
            basin.one(basin.with_faces(mesh, faces), "", basin.KINDS[0], seed, AlignConfig(camera=False))
            for seed in range(REPEATS)
        ]
        times[faces] = median(r.cpu for r in runs)
        lines.append([f"{faces:,}", f"{1e3 * times[faces]:.0f}", f"{fmean(r.evaluations for r in runs):.0f}"])
    tables.show(lines)
    means = {"fine_over_coarse": times[counts[-1]] / times[counts[0]]}
    if EIGHT in (folders := find(args.data)):
        prepared = variants.Prepared.of(folders[EIGHT][1], args.data / "objects")
        assert len(prepared.scene.objects) == 8
        row = variants.measured(prepared, variants.VARIANTS["ours"])
        means["eight_cpu_s"] = row.cpu_s
        print(f"eight objects of 16,384 triangles, camera included: {row.cpu_s:.2f} s, {row.evaluations} evaluations")
    return {"cost": means}


def judge(found: dict[str, Means], present: set[str], *, update: bool) -> int:
    """Print what became better or worse than the baseline, or write the new one; returns the exit code.

    A group whose scenes or meshes are not all ``present`` is not judged."""
    groups, problems = baseline.read(BASELINE), False
    for name, group in groups.items():
        if name not in found:
            continue
        if missing := [scene for scene in group.scenes if scene not in present]:
            print(f"{name}: not judged without {', '.join(missing)}")
            continue
        if update:
            groups[name] = baseline.updated(group, found[name])
            continue
        comparison = baseline.compare(group, found[name])
        for line in (*comparison.problems, *comparison.gains):
            print(f"{name}: {line}")
        if not comparison.problems:
            print(f"{name}: no regression")
        problems |= bool(comparison.problems)
    if update:
        baseline.write(groups, BASELINE)
    return int(problems)


def _show(means: dict[str, Means]) -> None:
    names = list(next(iter(means.values())))
    tables.show([["", *names], *([name, *(f"{m[n]:.4g}" for n in names)] for name, m in means.items())])


def _write(file: Path, content: Any) -> None:
    file.write_text(json.dumps(content, indent=1, default=float) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", default=PARTS, metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench" / "alignment", help="results as JSON")
    parser.add_argument("--starts", type=int, default=basin.STARTS, help="per mesh and kind of the basin")
    parser.add_argument("--variants", nargs="+", default=[], choices=variants.VARIANTS, metavar="NAME")
    parser.add_argument("--update", action="store_true", help="write the measured values to alignment.json")
    args = parser.parse_args()
    if unknown := sorted(set(args.parts) - set(PARTS)):
        parser.error(f"no parts {', '.join(unknown)}; there are {', '.join(PARTS)}")
    return args


if __name__ == "__main__":
    sys.exit(main())
