"""Models that play the goal suite: every backend through roles and through one direct call, judged by the checker.

usage: python benchmarks/goals/agents.py [--model SPEC ...] [--suite FILE] [--goals NAME ...] [--packages FOLDER]
       [--data PATH] [--out FOLDER] [--no-film]
Digests, crops, prompts, limits and runner are the same for all; each goal is asked once. Repair and launch solver are
off, and on in a further row. Without --model a loopback server answers that knows the rules' plans: its rows say so.
Writes agents.json, agents.md and films.html, a sheet of all films for a human. Exit codes: 0, 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import html
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import mean
from typing import Any

import checker

from run import REPO, package_of, slug

sys.path.append(str(REPO / "tests"))
import model_servers
import scripted_models
from f3sr.agents.model_language import AgentConfig
from f3sr.agents.played_by_model import Agent
from f3sr.errors import F3srError
from f3sr.film.studio import FilmConfig, Studio
from f3sr.goals.refusal import Refusal
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.play.rollout_folder import write_film, write_played
from f3sr.scene_package.package import Package, read_package

LOOPBACK = "loopback (scripted from the rules' plans)"
HELP = {"once": AgentConfig(solver=False, repairs=0), "repair + solver": AgentConfig(solver=True, repairs=1)}
ROLES = {"You are the Planner": "planner", "You are the Reasoner": "reasoner", "You are the Builder": "builder"}
Row = dict[str, Any]


def main() -> int:
    args = _arguments()
    goals = [g for g in checker.read_suite(args.suite) if not args.goals or g["name"] in args.goals]
    if not goals:
        print("no goals of these names", file=sys.stderr)
        return 2
    packages = {s: package_of(s, args.packages, args.data) for s in sorted({g["scene"] for g in goals})}
    read = {s: read_package(p) for s, p in packages.items() if p is not None}
    there = [g for g in goals if g["scene"] in read]
    studios = {s: Studio.of(p, FilmConfig()) for s, p in read.items()} if args.film else {}
    rows = list[Row]()
    for model in args.model or [LOOPBACK]:
        for agent in ("roles", "direct"):
            for name, config in HELP.items():
                out = args.out / slug(f"{model} {agent} {name}")
                judged = [_played(goal, read[goal["scene"]], model, agent, config, out, studios) for goal in there]
                rows.append({"model": model, "agent": agent, "help": name, "goals": judged})
                print(_line(rows[-1]), flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "agents.json").write_text(json.dumps(rows, indent=1) + "\n")
    (args.out / "agents.md").write_text(table(rows))
    (args.out / "films.html").write_text(sheet(rows, args.out))
    print(table(rows))
    return 0


def _played(
    goal: Mapping[str, Any],
    package: Package,
    model: str,
    agent: Any,
    config: AgentConfig,
    out: Path,
    studios: Mapping[str, Studio],
) -> Row:
    """One goal asked once: what was planned, judged and filmed, and how long it took."""
    row: Row = {"name": goal["name"], "words": goal["words"], "valid": False, "met": False, "passed": False}
    with _spec(model, package, goal["words"]) as spec:
        start = time.perf_counter()
        asked = Agent.of(spec, agent, config=config)
        try:
            played = asked.simulate(package, goal["words"])
        except F3srError as error:
            return row | {"error": str(error)}
        if isinstance(played, Refusal):
            return row | {"error": f"refused: {played.message}"}
        folder = write_played(played, out / slug(goal["name"]), overwrite=True)
        if studio := studios.get(goal["scene"]):
            write_film(studio.film(played).files, folder)
        seconds = time.perf_counter() - start
    found = checker.judge(goal, package.folder, folder / "rollout.npz")
    own = found[4 : 4 + len(goal["checks"])]
    calls = played.plan.calls
    return row | {
        "valid": found[0].met,
        "met": played.verdict.met,
        "passed": played.verdict.met and all(f.met for f in found),
        "checks": [f.met for f in own],
        "missed": [f.line for f in found if not f.met],
        "seconds": seconds,
        "calls": len(calls),
        "tokens": sum(c.input_tokens + c.output_tokens for c in calls),
        "folder": str(folder.relative_to(out.parent)),
    }


@contextmanager
def _spec(model: str, package: Package, words: str) -> Iterator[str]:
    """The model as it is asked for; of the loopback server, one that knows this goal's plan."""
    if model != LOOPBACK:
        yield model
        return
    played = simulate_goal(package, words)
    answers = scripted_models.answers_of(played.plan) if isinstance(played, Played) else None
    refused = {"schema_version": 1, "refusal": "the rules refuse it"}

    def script(asked: model_servers.Asked) -> str:
        role = next((role for said, role in ROLES.items() if said in asked.instructions), "direct")
        given = refused if answers is None else answers[role]
        return json.dumps(given(asked) if callable(given) else given)

    with model_servers.model_server(script) as server:
        os.environ.setdefault("OPENAI_API_KEY", "loopback")
        yield f"openai:scripted@{server.url}/v1"


def _line(row: Row) -> str:
    goals = row["goals"]
    return f"{row['model']}, {row['agent']}, {row['help']}: {sum(g['passed'] for g in goals)} of {len(goals)}"


def table(rows: Sequence[Row]) -> str:
    """The report's table: share of goals that pass end to end, prompt following over valid films, time to the film."""
    head = [
        "backend",
        "agent",
        "help",
        "goals",
        "valid %",
        "met %",
        "end to end %",
        "following %",
        "s",
        "calls",
        "tokens",
    ]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for row in rows:
        goals = row["goals"]
        valid = [g for g in goals if g["valid"]]
        checks = [met for g in valid for met in g["checks"]]
        shares = [100 * mean(g[key] for g in goals) for key in ("valid", "met", "passed")]
        cells = [row["model"], row["agent"], row["help"], str(len(goals)), *(f"{s:.1f}" for s in shares)]
        cells.append(f"{100 * mean(checks):.1f}" if checks else "-")
        cells += [f"{mean(g[key] for g in valid):.1f}" if valid else "-" for key in ("seconds", "calls", "tokens")]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def sheet(rows: Sequence[Row], out: Path) -> str:
    """A page with the key frames of every film beside its goal, for somebody who looks at them."""
    parts = ["<!doctype html><meta charset='utf-8'><title>Films of agents</title>"]
    for row in rows:
        parts.append(f"<h2>{html.escape(_line(row))}</h2>")
        for g in row["goals"]:
            parts.append(f"<h3>{html.escape(g['words'])}</h3><p>{html.escape(g.get('error', ''))}</p>")
            if "folder" in g and (out / g["folder"] / "film.png").is_file():
                folder = html.escape(g["folder"])
                parts.append(
                    f"<a href='{folder}/film.mp4'><img loading='lazy' width='900' src='{folder}/film.png'></a>"
                )
    return "\n".join(parts) + "\n"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", action="append", default=[])
    parser.add_argument("--suite", type=lambda name: checker.SUITE.with_name(name), default=checker.SUITE)
    parser.add_argument("--goals", nargs="*", default=[])
    parser.add_argument("--packages", type=Path, default=REPO / "out/bench/goals/packages")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared/data")
    parser.add_argument("--out", type=Path, default=REPO / "out/bench/agents")
    parser.add_argument("--no-film", dest="film", action="store_false")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
