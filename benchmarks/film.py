"""Films through the real command: from words to film, frame by frame, twice the same; strips to look at.

usage: python benchmarks/film.py [--goals NAME ...] [--packages FOLDER] [--data PATH] [--out FOLDER] [--update]
Packages that are not there are reconstructed first. Writes every rollout with its film, and results.json.
Exit codes: 0 no regression (or no data), 1 a regression, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from statistics import median
from typing import Any

import av
import numpy as np

import baseline
import tables
from f3sr.film.footage import LIFTING
from f3sr.film.studio import FilmConfig

sys.path.append(str(Path(__file__).resolve().parent / "goals"))
import asked
import checker

HERE = Path(__file__).resolve().parent
_spec = importlib.util.spec_from_file_location("goals_run", HERE / "goals" / "run.py")
assert _spec and _spec.loader
goals_run = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(goals_run)
REPO = HERE.parent
FILE = HERE / "film.json"
FILMED = (
    *("topple the mustard", "cube bumps mustard", "lemon onto the plate", "ball out of the pan", "drop the brick"),
    *("apple bounces into the plane", "ball tips the soup", "strawberry over the padlock", "ball bounces into the can"),
    *("lemon into the bowl", "apple into the pan", "lemon bounces into the bottle"),
    *("mustard tips onto the bowl", "brick into the bowl", "mug into soup", "bleach towards gelatin"),
)
"""Goals of goals/suite.toml: eleven of rendered scenes, one of the example, four of real frames."""
FRAME_S = Fraction(1, 30)


def main() -> int:
    args = _arguments()
    goals = {g["name"]: g for g in checker.read_suite()}
    wanted = args.goals or [name for name in FILMED if name in goals]
    if unknown := [name for name in wanted if name not in goals]:
        print(f"no goals {', '.join(unknown)}; goals/suite.toml has the names", file=sys.stderr)
        return 2
    rows = list[dict[str, Any]]()
    for name in wanted:
        package = goals_run.package_of(goals[name]["scene"], args.packages, args.data)
        if package is None:
            print(f"left out: {name}: no package of {goals[name]['scene']}")
            continue
        rows.append(row(goals[name], package, args.out / name.replace(" ", "_")))
        print(", ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    if not rows:
        return 0
    numbers = summary(rows)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "results.json").write_text(json.dumps({"numbers": numbers, "rows": rows}, indent=1) + "\n")
    tables.show([list(rows[0]), *([str(value) for value in r.values()] for r in rows)])
    print("\n".join(f"{name} {value:.4g}" for name, value in numbers.items()))
    return 0 if args.goals else baseline.judged(FILE, {"film": numbers}, update=args.update)


def row(goal: Mapping[str, Any], package: Path, out: Path) -> dict[str, Any]:
    """A goal filmed once by ``simulate`` and once more by ``film``."""
    first = asked.ask(["simulate", package, goal["words"], "-o", out, "--json", "--overwrite"])
    told = first.answer["goals"][0]
    data = {name: (out / name).read_bytes() for name in ("film.mp4", "film.png", "player.html")}
    again = asked.ask(["film", out, "--package", package, "--json"])
    long = of_three_seconds(out, package)
    time = np.load(out / "rollout.npz")["time"]
    shown = frame_times(out / "film.mp4")
    return {
        "goal": goal["name"],
        "scene": goal["scene"],
        "met": told["state"] == "met",
        "goal_to_film_s": round(first.seconds, 2),
        "film_s": told["film"]["seconds"],
        "frames": len(shown),
        "of_3_s": long,
        "in_time": len(shown) == frames_of(plan_of(out), len(time)) and are_even(shown),
        "same_bytes": again.code == 0 and all((out / name).read_bytes() == before for name, before in data.items()),
        "MB": round(sum(map(len, data.values())) / 1e6, 2),
    }


def of_three_seconds(played: Path, package: Path) -> float:
    """Seconds that a film of the same plan takes when it is played for 3 s."""
    plan = plan_of(played)
    plan["phases"][0]["simulation"]["duration"] = 3.0
    edited, out = played.with_name(played.name + ".plan.json"), played.with_name(played.name + "-3s")
    edited.write_text(json.dumps(plan))
    again = asked.ask(["simulate", package, "--plan", edited, "-o", out, "--json", "--overwrite"])
    film = again.answer["goals"][0]["film"]
    assert film["frames"] == frames_of(plan, 91), film
    return film["seconds"]


def plan_of(played: Path) -> dict[str, Any]:
    return json.loads((played / "plan.json").read_text())


def frames_of(plan: Mapping[str, Any], samples: int) -> int:
    """Frames that show a rollout: one each of its samples, which phases share at their ends, and those that stand
    still at the beginning and the end or lift an object to where a phase starts."""
    lifts = sum(bool(phase["initial"]["offsets"]) for phase in plan["phases"])
    config = FilmConfig()
    around = [config.opening, config.closing, *[LIFTING] * lifts]
    return samples - len(plan["phases"]) + 1 + sum(round(seconds / FRAME_S) for seconds in around)


def are_even(shown: Sequence[float]) -> bool:
    """Whether frame k is shown at k frames."""
    return float(np.abs(np.array(shown) - np.arange(len(shown)) * float(FRAME_S)).max()) < float(FRAME_S) / 100


def frame_times(film: Path) -> list[float]:
    """When every frame of a film is shown [s]."""
    with av.open(str(film)) as container:
        return [float(frame.time or 0.0) for frame in container.decode(video=0)]


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    return {
        "in_time_pct": 100 * sum(r["in_time"] for r in rows) / len(rows),
        "same_bytes_pct": 100 * sum(r["same_bytes"] for r in rows) / len(rows),
        "goal_to_film_median_s": median(r["goal_to_film_s"] for r in rows),
        "film_of_3_s_median_s": median(r["of_3_s"] for r in rows),
        "film_of_3_s_worst_s": max(r["of_3_s"] for r in rows),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--goals", nargs="+", default=[], metavar="NAME")
    parser.add_argument("--packages", type=Path, default=REPO / "out" / "bench")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "films")
    parser.add_argument("--update", action="store_true", help="keep these numbers as the baseline")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
