"""One goal put to the real command, in a process of its own, and what came of it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import checker
import replay

COMMAND = (sys.executable, "-m", "f3sr")
MET, REFUSED, MISSED = 0, 3, 4
"""Exit codes of ``simulate``."""
FILES = ("plan.json", "rollout.npz", "verdict.json")
LIMIT_S = 120.0
"""A command that takes longer is killed and counts as failed."""
RECONSTRUCT_LIMIT_S = 900.0
"""The same for making a package."""

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A command that ended: its exit code (None where it was killed), seconds on the wall, all it printed."""

    code: int | None
    seconds: float
    printed: str
    answer: dict[str, Any] = field(default_factory=dict)
    """The JSON object on stdout, where there was one."""


def ask(arguments: Sequence[str | Path], command: Sequence[str] = COMMAND, *, limit: float = LIMIT_S) -> Asked:
    """Run ``f3sr`` with arguments."""
    start = time.perf_counter()
    process = subprocess.Popen(
        [*command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    try:
        out, errors = process.communicate(timeout=limit)
        code = process.returncode
    except BaseException as error:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        out, errors = process.communicate()
        if not isinstance(error, subprocess.TimeoutExpired):
            raise
        code = None
    seconds = time.perf_counter() - start
    text, noise = out.decode(errors="replace"), errors.decode(errors="replace")
    try:
        answer = json.loads(text)
    except ValueError:
        answer = {}
    return Asked(code=code, seconds=seconds, printed=text + noise, answer=answer if isinstance(answer, dict) else {})


def goal_row(goal: Mapping[str, Any], package: Path, out: Path, command: Sequence[str] = COMMAND) -> Row:
    """A goal of the suite: plan, rollout and verdict, judged, replayed, and run again from its plan."""
    asked = simulate(package, [goal["words"]], out, command)
    row: Row = {key: goal[key] for key in ("name", "scene", "kind", "words")}
    row |= {"exit": asked.code, "seconds": asked.seconds, "valid": False, "verify": False, "checker": False}
    if asked.code not in (MET, MISSED) or not all((out / name).is_file() for name in FILES):
        return row | {"missed": [f"exit code {asked.code}: {last_words(asked.printed)}"]}
    try:
        plan, verdict = (json.loads((out / name).read_text()) for name in ("plan.json", "verdict.json"))
        task, met = plan["phases"][0]["task"], bool(verdict["met"])
        off, own = 1000 * replay.difference(package, out), plan["scene"] == digest(package / "scene.json")
    except Exception as error:  # whatever a file that is not right brings about is a finding of this goal
        return row | {"missed": [f"not readable: {type(error).__name__}: {error}"]}
    found = checker.judge(goal, package, out / "rollout.npz")
    again = out.with_name(out.name + "-again")
    simulate(package, ["--plan", out / "plan.json"], again, command)
    return row | {
        "valid": own and found[0].met,
        "planned": task["kind"],
        "right_active": task["active"] == goal["active"],
        "verify": met,
        "said": met == (asked.code == MET),
        "checker": all(f.met for f in found),
        "missed": [f.line for f in found if not f.met],
        "checks": [f.line for f in found],
        "rollouts": number_named("rollouts", asked.answer, verdict),
        "replay_mm": off,
        "identical": same_bytes(out / "rollout.npz", again / "rollout.npz"),
    }


def paraphrase_row(goal: Mapping[str, Any], words: str, package: Path, out: Path, command: Sequence[str]) -> Row:
    """A wording: right where the plan sets off the right object with a right kind, at the right target."""
    asked = simulate(package, [words], out, command)
    row: Row = {"scene": goal["scene"], "words": words, "exit": asked.code, "seconds": asked.seconds, "right": False}
    if asked.code not in (MET, MISSED):
        return row | {"planned": last_words(asked.printed)}
    try:
        task = json.loads((out / "plan.json").read_text())["phases"][0]["task"]
        planned = f"{task['kind']} {task['active']} -> {task['target']}"
        right = task["kind"] in goal["kinds"] and task["active"] == goal["active"]
        return row | {"planned": planned, "right": right and task["target"] == goal.get("target", task["target"])}
    except (OSError, ValueError, KeyError) as error:
        return row | {"planned": f"no plan: {error}"}


def refusal_row(goal: Mapping[str, Any], package: Path, out: Path, command: Sequence[str] = COMMAND) -> Row:
    """A goal that must be refused: with exit code 3, nothing written anywhere, and a message that helps."""
    words = goal["words"] * goal.get("times", 1)
    shutil.rmtree(out, ignore_errors=True)
    before = set(files_of(package)) | set(files_of(out.parent))
    asked = simulate(package, [words], out, command)
    left = sorted({str(path) for path, _ in (set(files_of(package)) | set(files_of(out.parent))) ^ before})
    absent = [m for m in goal["mentions"] if not re.search(m, asked.printed, re.IGNORECASE)]
    return {
        "scene": goal["scene"],
        "why": goal["why"],
        "words": words if len(words) <= 80 else f"{words[:77]}...",
        "exit": asked.code,
        "seconds": asked.seconds,
        "refused": asked.code == REFUSED,
        "nothing_written": not left,
        "helpful": asked.code == REFUSED and not absent and "Traceback" not in asked.printed,
        "absent": absent,
        "written": left,
        "message": asked.printed.strip(),
    }


def simulate(package: Path, what: Sequence[str | Path], out: Path, command: Sequence[str]) -> Asked:
    """``f3sr simulate`` into a folder that is not there yet; films are measured by ``film.py``."""
    shutil.rmtree(out, ignore_errors=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    return ask(["simulate", package, *what, "-o", out, "--json", "--no-film"], command)


def files_of(folder: Path) -> Iterator[tuple[Path, int]]:
    """All paths under a folder with the times of their last change [ns]."""
    for path in folder.rglob("*"):
        yield path, path.lstat().st_mtime_ns if path.is_file() else 0


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def same_bytes(a: Path, b: Path) -> bool:
    return a.is_file() and b.is_file() and a.read_bytes() == b.read_bytes()


def last_words(printed: str) -> str:
    """What was said last, in one line, without JSON."""
    return " / ".join([line for line in printed.strip().splitlines() if not line.startswith("{")][-2:])[-300:]


def number_named(name: str, *documents: Any) -> int | None:
    """The first whole number of that name anywhere in JSON documents."""
    for document in documents:
        inner = list(document.values()) if isinstance(document, dict) else document
        if isinstance(document, dict) and isinstance(document.get(name), int):
            return document[name]
        if isinstance(inner, list) and (found := number_named(name, *inner)) is not None:
            return found
    return None
