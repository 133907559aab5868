"""The goal suite through the real command: plans, rollouts and verdicts, judged by the independent checker and replay.

usage: python benchmarks/goals/run.py [PART ...] [--goals NAME ...] [--packages FOLDER] [--data PATH] [--out FOLDER]
       python benchmarks/goals/run.py suite --suite rooms.toml --packages out/bench/stress
Parts: suite, paraphrases, refusals; all by default. Packages that are not there are reconstructed first. Writes
results.json and results.md. Exit codes: 0 no regression (or no data), 1 a regression, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median

import asked
import checker
import results
from asked import Row

sys.path.append(str(Path(__file__).resolve().parents[1]))
import baseline

HERE = Path(__file__).resolve().parent
REPO = HERE.parents[1]
FILE = HERE / "baseline.json"
PARTS = ("suite", "paraphrases", "refusals")
EXAMPLE = "tabletop"
"""The scene that comes with f3sr."""

Numbers = dict[str, float]


def main() -> int:
    args = _arguments()
    goals = [g for g in checker.read_suite(args.suite) if not args.goals or g["name"] in args.goals]
    if unknown := set(args.goals) - {g["name"] for g in goals}:
        print(f"no goals {', '.join(sorted(unknown))}; {args.suite.name} has the names", file=sys.stderr)
        return 2
    asks = {"suite": goals, **{part: read(f"{part}.toml") for part in PARTS[1:]}}
    scenes = sorted({goal["scene"] for part in args.parts for goal in asks[part]})
    found = {s: package_of(s, args.packages, args.data) for s in scenes}
    packages = {s: p for s, p in found.items() if p is not None}
    if left_out := [s for s in scenes if s not in packages]:
        print(f"left out: {', '.join(left_out)}: no package in {args.packages} and no data in {args.data}")
    if not packages:
        return 0
    rows = {part: measured(part, asks[part], packages, args.out, asked.COMMAND) for part in args.parts}
    numbers = numbers_of(rows)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "results.json").write_text(json.dumps({"numbers": numbers, **rows}, indent=1) + "\n")
    (args.out / "results.md").write_text(results.markdown(numbers, rows))
    print(results.summary(numbers, rows))
    if left_out or args.goals or args.suite != checker.SUITE:
        print("not judged: not all of suite.toml was run")
        return 0
    return baseline.judged(FILE, dict.fromkeys(args.parts, numbers), update=args.update)


def package_of(scene: str, packages: Path, data: Path) -> Path | None:
    """The package of a scene, reconstructed where there is none; None where there is no data for it either."""
    package = packages / scene
    if (package / "scene.json").is_file():
        return package
    folders = [folder for folder in (data / "scenes" / scene, data / "real" / scene) if folder.is_dir()]
    if not folders and scene != EXAMPLE:
        return None
    print(f"{scene}: reconstructing ...", flush=True)
    arguments: list[str | Path] = ["demo"] if scene == EXAMPLE else ["reconstruct", folders[0]]
    made = asked.ask([*arguments, "-o", package], limit=asked.RECONSTRUCT_LIMIT_S)
    if made.code:
        print(f"{scene}: FAILED: {asked.last_words(made.printed)}", file=sys.stderr)
    return package if made.code == 0 else None


def measured(
    part: str, goals: Sequence[Row], packages: dict[str, Path], out: Path, command: Sequence[str]
) -> list[Row]:
    """Rows of one part, for goals whose scene is there."""
    rows: list[Row] = []
    there = [g for g in goals if g["scene"] in packages]
    if there and part == "suite":  # no goal pays for compiling kernels
        asked.simulate(packages[there[0]["scene"]], [there[0]["words"]], out / "warm-up", command)
    for goal in there:
        package, folder = packages[goal["scene"]], out / part
        if part == "suite":
            rows.append(asked.goal_row(goal, package, folder / slug(goal["name"]), command))
        elif part == "paraphrases":
            wordings = goal["wordings"]
            rows += [asked.paraphrase_row(goal, w, package, folder / slug(w), command) for w in wordings]
        else:
            rows.append(asked.refusal_row(goal, package, folder / f"{len(rows):02d}", command))
        print(results.line(part, rows[-1]), flush=True)
    return rows


def numbers_of(rows: dict[str, list[Row]]) -> Numbers:
    """What the baseline holds, in percent, millimetres and seconds."""
    numbers: Numbers = {}
    if suite := rows.get("suite"):
        seconds = [r["seconds"] for r in suite]
        numbers |= {"valid_pct": percent(suite, "valid"), "checklist_pct": percent(suite, "checker")}
        numbers |= {"verify_pct": percent(suite, "verify"), "identical_pct": percent(suite, "identical")}
        numbers["replay_mm"] = max((r["replay_mm"] for r in suite if "replay_mm" in r), default=float("nan"))
        numbers["disagree"] = float(sum(r["verify"] != r["checker"] for r in suite))
        numbers |= {"median_s": median(seconds), "worst_s": max(seconds)}
    if paraphrases := rows.get("paraphrases"):
        numbers["paraphrases_pct"] = percent(paraphrases, "right")
    if refusals := rows.get("refusals"):
        numbers["refused_pct"] = percent(refusals, "refused", "nothing_written", "helpful")
    return numbers


def percent(rows: Iterable[Row], *keys: str) -> float:
    met = [all(r.get(key, False) for key in keys) for r in rows]
    return 100 * sum(met) / len(met)


def read(name: str) -> list[Row]:
    return tomllib.loads((HERE / name).read_text())["goal"]


def slug(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help="suite, paraphrases, refusals")
    parser.add_argument("--goals", nargs="+", default=[], metavar="NAME", help="only these of the suite; not judged")
    parser.add_argument(
        "--suite", type=lambda name: HERE / name, default=checker.SUITE, help="goals: suite.toml, rooms.toml"
    )
    parser.add_argument("--packages", type=Path, help="finished packages by scene, by default OUT/packages")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data", help="holds scenes/, real/")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "goals", help="rollouts and results")
    parser.add_argument("--update", action="store_true", help="write the measured values to baseline.json")
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    args.parts = args.parts or list(PARTS)
    args.out = args.out.resolve()
    args.packages = (args.packages or args.out / "packages").resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
