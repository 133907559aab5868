"""Separation and settling side by side with the report's recipe, from the same aligned scenes.

usage: python benchmarks/contact.py [--scenes NAME ...] [--data PATH] [--out FOLDER] [--again] [--update]
Rows that earlier runs of the same code measured are taken from OUT/peers.json, unless --again.
Exit codes: 0 no regression (or no data), 1 a regression.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

import baseline
import contact_report
import tables
import truth
from f3sr import pipeline
from f3sr.contact import compounds
from f3sr.contact.polytopes import Polytope
from f3sr.io import inputs
from f3sr.metrics import measures
from f3sr.pipeline import Reconstruction
from f3sr.pipeline_config import Config
from f3sr.runtime import kernels
from f3sr.runtime.result_store import Store, code_version
from f3sr.scene import Scene
from run import REPO, find

BASELINE = Path(__file__).with_name("contact.json")
UP_TO_PROXIES = ("level", "align", "align-camera", "align-objects", "relate", "decompose")
DEEP = 1e-4
"""Overlap of proxies from which on a pair counts [m]: what stiff contact leaves is less."""
COLUMNS = (
    *("mIoU_visible", "moved_pct", "overlaps_left", "N_cross", "inside", "K_max_J", "D_max_cm", "gap_pct", "below_pct"),
    *("centre_pct", "chamfer_pct", "support_precision", "support_recall", "cpu_s"),
)

Row = dict[str, float]
Rows = dict[str, Row]


def main() -> int:
    args = arguments(__doc__, "contact")
    folders = chosen(args)
    if not folders:
        return 0
    kernels.warm_up()
    kept = Kept(args.out / "peers.json", again=args.again)
    for name, (_, folder) in folders.items():
        if name not in kept.rows:
            print(f"{name} ...", flush=True)
            kept.add(name, side_by_side(folder, args.data / "objects"))
    found: dict[str, Row] = {}
    for group in dict.fromkeys(group for group, _ in folders.values()):
        means = means_of([kept.rows[name] for name, (of, _) in folders.items() if of == group])
        print(f"\n{group}: means over {sum(of == group for of, _ in folders.values())} scenes")
        show(means, COLUMNS)
        found |= {f"{group}: {row}": mean for row, mean in means.items()}
    return judge(found, set(folders), update=args.update)


def side_by_side(folder: Path, objects: Path) -> Rows:
    """What every recipe makes of one aligned scene, and the processor time that it takes [s]."""
    aligned = reconstructed(folder, skip=after_proxies()).scene
    rows = {"aligned": measured(aligned, aligned, folder, objects)}
    for name, steps in (
        ("report, separated", [contact_report.separate]),
        ("report, settled", [contact_report.separate, contact_report.settle]),
    ):
        scene, cpu = _timed(steps, aligned)
        rows[name] = measured(scene, aligned, folder, objects) | {"cpu_s": cpu}
    cpu, whole = stage_times(folder)
    spent = 0.0
    for stage, scene in whole.scenes.items():
        if stage in cpu and stage not in (*UP_TO_PROXIES, "assemble"):
            spent += cpu[stage]
            rows[f"ours, {stage}"] = measured(scene, aligned, folder, objects) | {"cpu_s": spent}
    return rows


def stage_times(folder: Path) -> tuple[Row, Reconstruction]:
    """Processor time of every stage [s], and what came of them; nothing is resumed."""
    cpu: Row = {}
    began = 0.0

    def told(step: Any) -> None:
        nonlocal began
        if step.state == "started":
            began = time.process_time()
        elif step.state == "done":
            cpu[step.name] = time.process_time() - began

    return cpu, pipeline.reconstruct(inputs.read(folder), skip=["evaluate"], progress=told)


def reconstructed(
    folder: Path, config: Config | None = None, *, skip: Sequence[str] = (), stored: bool = True
) -> Reconstruction:
    """One scene, as far as it is not in the store already, if that may be used."""
    store = Store.default() if stored else None
    return pipeline.reconstruct(inputs.read(folder), config, skip=skip, store=store)


def after_proxies() -> list[str]:
    """All stages that touch an aligned scene with proxies."""
    return [stage for stage in pipeline.SKIPPABLE if stage not in UP_TO_PROXIES]


def measured(scene: Scene, start: Scene, folder: Path, objects: Path) -> Row:
    """All measures, physics at true scale where that is known, and how far objects are from where they stood."""
    known = truth.against_truth(scene, folder, objects) if (folder / "truth.json").exists() else {}
    ways = [np.linalg.norm(o.middle - start[o.id].middle) / start[o.id].size for o in scene]
    return {
        **measures.measure(scene).as_dict(),
        **known,
        "moved_pct": 100 * float(np.mean(ways)),
        "overlaps_left": float(len(overlapping(scene))),
    }


def overlapping(scene: Scene, depth: float = DEEP) -> list[tuple[int, int]]:
    """Pairs of objects whose proxies overlap deeper than ``depth`` [m]."""
    bodies = {o.id: [Polytope.of(p) for p in o.colliders_world] for o in scene}
    return [(a, b) for a, b in combinations(bodies, 2) if compounds.collide(bodies[a], bodies[b], depth)]


class Kept:
    """Rows by scene in a JSON file that grows with every one; those of other code are measured anew."""

    def __init__(self, file: Path, *, again: bool = False) -> None:
        self.file, self.rows = file, dict[str, Any]()
        file.parent.mkdir(parents=True, exist_ok=True)
        known = json.loads(file.read_text()) if file.exists() and not again else {}
        if known.get("code") == code_version():
            self.rows = known["rows"]

    def add(self, name: str, row: Any) -> None:
        self.rows[name] = row
        self.file.write_text(json.dumps({"code": code_version(), "rows": self.rows}, indent=1) + "\n")


def means_of(scenes: Sequence[Rows]) -> Rows:
    """The mean over scenes of what all of them have, by row."""
    names = [name for name in scenes[0] if all(name in rows for rows in scenes)]
    return {
        name: {
            measure: fmean(rows[name][measure] for rows in scenes)
            for measure in scenes[0][name]
            if all(measure in rows[name] for rows in scenes)
        }
        for name in names
    }


def show(rows: Mapping[str, Row], columns: Sequence[str]) -> None:
    shown = [c for c in columns if any(c in row for row in rows.values())]
    lines = [[name, *(f"{row[c]:.3g}" if c in row else "-" for c in shown)] for name, row in rows.items()]
    tables.show([["", *shown], *lines])


def judge(found: Mapping[str, Row], present: set[str], *, update: bool) -> int:
    """Print what became better or worse than ``contact.json``, or write the new values; returns the exit code.

    A group whose scenes are not all ``present`` is not judged."""
    groups, problems = baseline.read(BASELINE), False
    for name, group in groups.items():
        if name not in found:
            continue
        if missing := [scene for scene in group.scenes if scene not in present]:
            print(f"{name}: not judged without {', '.join(missing)}")
        elif update:
            groups[name] = baseline.updated(group, found[name])
        else:
            comparison = baseline.compare(group, found[name])
            for line in (*comparison.problems, *comparison.gains):
                print(f"{name}: {line}")
            problems |= bool(comparison.problems)
    if update:
        baseline.write(groups, BASELINE)
    return int(problems)


def chosen(args: argparse.Namespace) -> dict[str, tuple[str, Path]]:
    """Group and folder of the scenes that are asked for; none where there is no data, which is said."""
    folders = find(args.data)
    if not folders:
        print(f"skipped: no data in {args.data} (--data PATH names another folder)")
    if unknown := set(args.scenes) - folders.keys():
        raise SystemExit(f"no scenes {', '.join(sorted(unknown))}; there are {', '.join(folders)}")
    return {name: folders[name] for name in args.scenes or folders}


def arguments(doc: str | None, out: str, *more: Callable[[argparse.ArgumentParser], Any]) -> argparse.Namespace:
    """The options that all benchmarks of contact share, and those that ``more`` adds."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=[], metavar="NAME", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "bench" / out, help="results as JSON")
    parser.add_argument("--again", action="store_true", help="measure anew what is in --out already")
    parser.add_argument("--update", action="store_true", help="write the measured values to contact.json")
    for add in more:
        add(parser)
    return parser.parse_args()


def _timed(steps: Sequence[Callable[[Scene], Scene]], scene: Scene) -> tuple[Scene, float]:
    began = time.process_time()
    for step in steps:
        scene = step(scene)
    return scene, time.process_time() - began


if __name__ == "__main__":
    sys.exit(main())
