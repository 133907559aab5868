"""Judges a rollout as one who reads the goal and watches the film would, from rollout.npz, scene.json and the parts.

usage: python benchmarks/goals/checker.py PACKAGE ROLLOUT_FOLDER GOAL_NAME
Shares no code with the product. Exit codes: 0 all of the checklist is met, 1 something is missed.

Beside a goal's own checklist (suite.toml; its checks are in motions.py and meetings.py) every film must hold: all
bodies of the scene, whole, in time's order; at the start they are where scene.json has them, but the active one where
the words lift it; the active one moves, and nothing else before it; nothing sinks into the ground; and at the event,
the time of the first check, at least half of the active one's vertices are in the picture.
"""

from __future__ import annotations

import inspect
import json
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import meetings
import motions
import numpy as np
import seen
from found import Before, Check, Found
from seen import GROUND, Film

SUITE = Path(__file__).with_name("suite.toml")
CHECKS = {
    name: check
    for module in (motions, meetings)
    for name, check in inspect.getmembers(module, inspect.isfunction)
    if list(inspect.signature(check).parameters) == ["film", "c", "before"]
}
"""What a checklist may hold, by name."""
STILL = np.array([1e-4, 0.1])
"""[m], [deg] What stands no farther from its place than this is in it."""
STARTED, STIRRED = np.array([1e-3, 1.0]), np.array([3e-3, 3.0])
"""[m], [deg] The active one has started from the first on; another that moved by the second before it went first."""
DENT, SUNK = 0.02, 5e-3
"""[m] Contacts are soft: what ever is deeper in the ground than the first, or at the end than the second, sank."""
IN_FRAME = 0.5
"""The share of the active one's vertices that must be in the picture at the event."""


def judge(goal: Mapping[str, Any], package: Path, rollout: Path) -> list[Found]:
    """All that is checked of a goal's rollout, in order; a rollout that cannot be read is one missed check."""
    try:
        film = seen.read(package, rollout)
    except (OSError, KeyError, ValueError, IndexError) as error:
        return [Found(check="readable", met=False, measured=f"{type(error).__name__}: {error}")]
    whole = is_whole(film)
    return [whole, *judge_film(goal, film)] if whole.met else [whole]


def judge_film(goal: Mapping[str, Any], film: Film) -> list[Found]:
    """The same of a film that is whole."""
    before: dict[str, Found] = {}
    own: list[Found] = []
    for c in goal["checks"]:
        own.append(check(film, c, before))
        before.setdefault(c["is"], own[-1])
    general = [starts_as_scene(film, goal), goes_first(film, goal), stays_above(film)]
    return [*general, *own, in_frame(film, goal["active"], own[0].time)]


def check(film: Film, c: Check, before: Before) -> Found:
    return CHECKS[c["is"]](film, c, before)


def is_whole(film: Film) -> Found:
    """Every body of the scene, with poses that are rigid and finite, at times that go on from 0."""
    T = np.stack(list(film.T.values()), axis=1) if film.T else np.zeros((0, 0, 4, 4))
    R = T[..., :3, :3]
    faults = {
        "ids differ from the scene's": list(film.T) != list(film.bodies),
        "fewer than two samples": len(film.time) < 2 or len(T) != len(film.time),
        "not finite": not np.isfinite(T).all() or not np.isfinite(film.time).all(),
        "times do not go on from 0": len(film.time) > 0
        and (film.time[0] != 0 or bool((np.diff(film.time) <= 0).any())),
        "poses are not rigid": bool(np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0) > 1e-6)
        or bool((T[..., 3, :] != [0, 0, 0, 1]).any()),
    }
    wrong = [fault for fault, there in faults.items() if there]
    return Found(check="whole", met=not wrong, measured="; ".join(wrong) or f"{len(film.time)} samples")


def starts_as_scene(film: Film, goal: Mapping[str, Any]) -> Found:
    """Every body starts in its place; a lifted active one higher, in free air, by ``lift`` where that is said."""
    off = {id: film.moved(id, film.bodies[id].T)[0] for id in film.bodies}
    displaced = [id for id, o in off.items() if (o > STILL).any() and not (goal.get("lifted") and id == goal["active"])]
    words = f"objects {displaced} are not in their places" if displaced else "all in their places"
    met, active = not displaced, goal["active"]
    if goal.get("lifted"):
        body = film.bodies[active]
        up = float(film.centre(active)[0, 2] - seen.placed(body.T, body.com)[2])
        low, high = goal.get("lift", (-1e-3, np.inf))
        free = min(film.gap(active, b, 0) for b in (GROUND, *film.bodies) if b != active)
        met = met and low <= up <= high and free > 0
        words += f", lifted {1000 * up:.0f} mm, {1000 * free:.1f} mm free"
    return Found(check="starts as the scene", met=bool(met), measured=words)


def goes_first(film: Film, goal: Mapping[str, Any]) -> Found:
    """The active one moves, or was moved to its start, and at every sample before that nothing else has."""
    active = goal["active"]
    started = np.flatnonzero((film.moved(active, film.bodies[active].T) > STARTED).any(axis=1))
    if not len(started):
        return Found(check="goes first", met=False, measured="the active one never moves")
    k = int(started[0])
    early = [b for b in film.bodies if b != active and (film.moved(b)[:k] > STIRRED).any()]
    words = f"objects {early} moved before it" if early else "nothing moved before it"
    return Found(check="goes first", met=not early, time=float(film.time[k]), measured=words)


def stays_above(film: Film) -> Found:
    """No vertex is ever deeper in the ground than a hit on soft contacts takes it, nor at the end than rest does."""
    low = np.array([[film.points(id, k)[:, 2].min() for k in range(len(film.time))] for id in film.bodies])
    met = low.min() >= -DENT and low[:, -1].min() >= -SUNK
    words = f"lowest {1000 * low.min():.1f} mm, at the end {1000 * low[:, -1].min():.1f} mm"
    return Found(check="stays above", met=bool(met), measured=words)


def in_frame(film: Film, active: int, event: float | None) -> Found:
    """Half of the active one is in the picture at the event, the film's end where there was none."""
    k = len(film.time) - 1 if event is None else int(np.abs(film.time - event).argmin())
    share = film.in_frame(active, k)
    time = float(film.time[k])
    return Found(check="in frame", met=share >= IN_FRAME, time=time, measured=f"{100 * share:.0f} % of its vertices")


def read_suite(file: Path = SUITE) -> list[dict[str, Any]]:
    return tomllib.loads(file.read_text())["goal"]


def main() -> int:
    package, folder, name = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    goals = {goal["name"]: goal for goal in read_suite()}
    if name not in goals:
        print(f"no goal {json.dumps(name)}; there are {', '.join(goals)}", file=sys.stderr)
        return 2
    found = judge(goals[name], package, folder / "rollout.npz")
    print(*(f.line for f in found), sep="\n")
    return int(not all(f.met for f in found))


if __name__ == "__main__":
    sys.exit(main())
