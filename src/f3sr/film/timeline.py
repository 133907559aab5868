"""The timeline below the film: conditions, what sets things off and contacts, each in a row over the film's frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.film.event_text import named
from f3sr.goals.conditions import Judged
from f3sr.goals.plan import Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.verify import Verdict
from f3sr.scene import Scene
from f3sr.web.markup import Child, Markup, el

STEADY = 3.0
"""Times its median force that a contact may reach and still be rest."""
ALWAYS = 0.6
"""Share of the frames in which what rests on something touches it: light things lose contact for a moment."""
FAINT = 0.03
"""Share of the tallest force below which it is rest too."""
SIDE = 1000, 100
"""Units of a row's drawing along the film and up; it is stretched."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Pair:
    """Two objects, or the ground and one, that touch at some time."""

    a: int
    b: int
    forces: NDArray[np.float64]
    """(T,) the largest normal force [N] since the frame before; 0 where they do not touch."""

    rests: bool = False
    """Whether one only lies on or against the other nearly all the time."""


def pairs_of(rollout: Rollout) -> tuple[Pair, ...]:
    """Every pair that touches, the one with the largest force first."""
    rows, T = rollout.contacts, len(rollout.time)
    frames = np.minimum(np.searchsorted(rollout.time, rows["time"] + 1e-6, side="right"), T - 1)
    found: list[Pair] = []
    tallest = float(rows["force"].max(initial=0.0))
    for a, b in sorted({(int(r["a"]), int(r["b"])) for r in rows}):
        own = (rows["a"] == a) & (rows["b"] == b)
        forces = np.zeros(T)
        np.maximum.at(forces, frames[own], rows["force"][own])
        if forces.max() > 0:
            found.append(Pair(a=a, b=b, forces=forces, rests=_rests(forces, tallest)))
    return tuple(sorted(found, key=lambda p: -p.forces.max()))


def _rests(forces: NDArray[np.float64], tallest: float) -> bool:
    touching, most = forces[forces > 0], float(forces.max())
    steady = most <= max(STEADY * float(np.median(touching)), FAINT * tallest)
    return steady and len(touching) >= ALWAYS * (len(forces) - 1)


def timeline(scene: Scene, plan: Plan, rollout: Rollout, verdict: Verdict) -> Markup:
    """All rows. The first is a slider over the frames; the script adds the line that moves."""
    last = len(rollout.time) - 1
    end = float(rollout.time[-1]) or 1.0
    pairs = pairs_of(rollout)
    busy, resting = [p for p in pairs if not p.rests], [p for p in pairs if p.rests]
    slider = el("input", type="range", id="slider", min=0, max=last, step=1, value=0, aria_label="Frame", disabled=True)
    return el(
        "div",
        el("div", el("div", id="head"), id="lane", aria_hidden="true"),
        el("div", el("div", "Time"), el("div", _ruler(end), class_="ruler track", id="ruler"), class_="line times"),
        el("div", el("div"), el("div", slider), class_="line"),
        _part("Goal", (_condition(j, end) for j in verdict.conditions)),
        _part("Set off", _controls(scene, plan, end)),
        _part("Contacts", (_contact(scene, p, pairs) for p in busy)),
        _resting(scene, resting, pairs),
        id="timeline",
    )


def _part(title: str, rows: Iterable[Child]) -> Child:
    shown = list(rows)
    return el("section", el("h3", title), shown, class_="rows") if shown else None


def _row(name: Child, track: Child, title: str, kind: str) -> Markup:
    return el(
        "div",
        el("div", name, class_="name", title=title),
        el("div", track, class_="track"),
        class_=f"line {kind}",
    )


def _ruler(end: float) -> Child:
    """Times at even steps, some six of them; the script puts them in their places."""
    step = next(s for s in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if end / s <= 7 or s == 10)
    times = np.arange(0, end + 1e-9, step)
    return [el("span", f"{t:g} s", class_="tick", data_at=_share(float(t), end)) for t in times]


def _share(time: float, end: float) -> str:
    return f"{min(max(time / end, 0.0), 1.0):.5f}"


def _condition(judged: Judged, end: float) -> Markup:
    """A mark where it was met, or nearest to it; what has no moment of its own is marked at the end."""
    time = end if judged.time is None else judged.time
    verdict = "met" if judged.met else "missed"
    mark = el(
        "button",
        "✓" if judged.met else "✗",
        type="button",
        class_=f"mark {verdict}",
        data_at=_share(time, end),
        data_time=f"{time:.6f}",
        aria_label=f"{verdict} at {time:.2f} s: {judged.said}",
        title=f"{verdict}, {time:.2f} s: {judged.said}",
    )
    return _row(el("bdi", judged.said), mark, judged.said, f"condition {verdict}")


def _controls(scene: Scene, plan: Plan, end: float) -> Iterable[Markup]:
    """A row per object that is set off: starts as marks, pushes as bars."""
    initial = plan.initial
    for id in sorted(initial.controlled):
        name = named(scene, id)
        spans = [(0.0, 0.0, "is let go elsewhere") for o in initial.offsets if o.id == id]
        spans += [(0.0, 0.0, f"starts at {np.linalg.norm(v.linear):.2g} m/s") for v in initial.velocities if v.id == id]
        spans += [(i.time, i.duration, _impulse(i)) for i in initial.impulses if i.id == id]
        bars = [_control(time, duration, end) for time, duration, _ in spans]
        words = "; ".join(words for _, _, words in spans)
        yield _row([el("bdi", name), " ", el("small", words)], _drawing(bars), f"{name}: {words}", "control")


def _control(time: float, duration: float, end: float) -> Markup:
    """A line for what comes at once, a bar for a push."""
    left, right = (SIDE[0] * t / end for t in (time, time + duration))
    d = f"M{left:.1f} 15V85" + (f"H{right:.1f}V15z" if duration else "")
    return el("path", d=Markup(d), class_="push" if duration else "blow")


def _impulse(impulse: Any) -> str:
    amount = float(np.linalg.norm(impulse.linear))
    if impulse.duration:
        return f"pushed with {amount / impulse.duration:.2g} N for {impulse.duration:.2g} s"
    return f"struck with {amount:.2g} N s"


def _contact(scene: Scene, pair: Pair, pairs: Iterable[Pair]) -> Markup:
    """Force as height, its square root: a bar per frame, of the time since the frame before."""
    most = max(p.forces.max() for p in pairs)
    width = SIDE[0] / max(1, len(pair.forces) - 1)
    bars = "".join(
        f"M{(k - 1) * width:.1f} {SIDE[1]}v{-max(4.0, SIDE[1] * np.sqrt(f / most)):.1f}h{width:.1f}V{SIDE[1]}z"
        for k, f in enumerate(pair.forces)
        if f > 0
    )
    who = f"{named(scene, pair.b)} – {named(scene, pair.a)}"
    peak = f"up to {force(pair.forces.max())}"
    drawing = _drawing(el("path", d=Markup(bars), class_="force"))
    return _row([el("bdi", who), " ", el("small", peak)], drawing, f"{who}, {peak}", "contact")


def force(newtons: float) -> str:
    return f"{newtons:.2g} N" if newtons < 99.5 else f"{newtons:,.0f} N"


def _resting(scene: Scene, resting: list[Pair], pairs: Iterable[Pair]) -> Child:
    if not resting:
        return None
    count = f"{len(resting)} {'pair rests' if len(resting) == 1 else 'pairs rest'} on each other throughout"
    return el("details", el("summary", count), [_contact(scene, p, pairs) for p in resting], class_="rows")


def _drawing(shapes: Child) -> Markup:
    return el(
        "svg", shapes, viewBox=f"0 0 {SIDE[0]} {SIDE[1]}", preserveAspectRatio="none", aria_hidden="true", class_="bars"
    )
