"""The timeline below the film: conditions, actions and contacts, each in a row over the film's frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.film.event_text import named
from f3sr.film.footage import Footage, Scenario
from f3sr.goals.conditions import Judged
from f3sr.goals.plan import Impulse
from f3sr.goals.rollout import Rollout
from f3sr.scene import Scene

STEADY = 3.0
"""Times its median force that a contact may reach and still be rest."""
ALWAYS = 0.6
"""Share of the frames in which what rests on something touches it: light things lose contact for a moment."""
FAINT = 0.03
"""Share of the tallest force below which it is rest too."""
SIDE = 1000, 100
"""Units of a row's drawing along the film and up, of SVG's view box; the page stretches it."""


@dataclass(frozen=True, kw_only=True)
class BarRow:
    """A row of SVG paths, each with its class: ``force``, ``push`` or ``blow``."""

    name: str
    words: str
    bars: Sequence[tuple[str, str]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Timeline:
    """All rows. ``end``: the last time [s], ``last`` its frame; ``tallest``: the largest contact force [N]."""

    end: float
    last: int
    tallest: float
    ticks: Sequence[float]
    """Times on the ruler [s]."""
    conditions: Sequence[Judged]
    actions: Sequence[BarRow]
    contacts: Sequence[BarRow]
    resting: Sequence[BarRow]
    width: int = SIDE[0]
    height: int = SIDE[1]

    def at(self, time: float) -> str:
        """The share of the film before a time."""
        return f"{min(max(time / self.end, 0.0), 1.0):.5f}"


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
    # A contact belongs to the first frame after it.
    frames = np.minimum(np.searchsorted(rollout.time, rows["time"] + 1e-6, side="right"), T - 1)
    found: list[Pair] = []
    tallest = float(rows["force"].max(initial=0.0))
    for a, b in sorted({(int(r["a"]), int(r["b"])) for r in rows}):
        own = (rows["a"] == a) & (rows["b"] == b)
        forces = np.zeros(T)
        # Several contacts of a pair fall into one frame: ``at`` takes the largest of all, plain indexing the last.
        np.maximum.at(forces, frames[own], rows["force"][own])
        if forces.max() > 0:
            found.append(Pair(a=a, b=b, forces=forces, rests=_rests(forces, tallest)))
    return tuple(sorted(found, key=lambda p: -p.forces.max()))


def _rests(forces: NDArray[np.float64], tallest: float) -> bool:
    touching, most = forces[forces > 0], float(forces.max())
    steady = most <= max(STEADY * float(np.median(touching)), FAINT * tallest)
    return steady and len(touching) >= ALWAYS * (len(forces) - 1)


def timeline(scene: Scene, film: Footage) -> Timeline:
    """All rows of a film: conditions as judged, actions of controlled objects, contacts by their largest force."""
    rollout = film.rollout
    end = float(rollout.time[-1]) or 1.0
    pairs = pairs_of(rollout)
    tallest = max((float(p.forces.max()) for p in pairs), default=0.0)
    return Timeline(
        end=end,
        last=len(rollout.time) - 1,
        tallest=tallest,
        ticks=_ticks(end),
        conditions=[
            replace(c, time=(s.rollout.time[-1] if c.time is None else c.time) + s.start)
            for s in film.scenarios
            for c in s.verdict.conditions
        ],
        actions=[_action(scene, s, id, end) for s in film.scenarios for id in sorted(s.phase.initial.controlled)],
        contacts=[_contact(scene, p, tallest) for p in pairs if not p.rests],
        resting=[_contact(scene, p, tallest) for p in pairs if p.rests],
    )


def _ticks(end: float) -> list[float]:
    """Times at even steps, some six of them."""
    step = next(s for s in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if end / s <= 7 or s == 10)
    return np.arange(0, end + 1e-9, step).tolist()


def _action(scene: Scene, shown: Scenario, id: int, end: float) -> BarRow:
    """What moves an object: lines for what comes at once, bars for pushes."""
    initial = shown.phase.initial
    spans = [(0.0, 0.0, "starts at another place") for o in initial.offsets if o.id == id]
    spans += [(0.0, 0.0, f"starts at {np.linalg.norm(v.linear):.2g} m/s") for v in initial.velocities if v.id == id]
    spans += [(i.time, i.duration, _impulse(i)) for i in initial.impulses if i.id == id]
    bars = [_span(shown.start + time, duration, end) for time, duration, _ in spans]
    return BarRow(name=named(scene, id), words="; ".join(words for _, _, words in spans), bars=bars)


def _span(time: float, duration: float, end: float) -> tuple[str, str]:
    left, right = (SIDE[0] * t / end for t in (time, time + duration))
    if duration:
        return f"M{left:.1f} 15V85H{right:.1f}V15z", "push"
    return f"M{left:.1f} 15V85", "blow"


def _impulse(impulse: Impulse) -> str:
    amount = float(np.linalg.norm(impulse.linear))
    if impulse.duration:
        return f"pushed with {amount / impulse.duration:.2g} N for {impulse.duration:.2g} s"
    return f"struck with {amount:.2g} N s"


def _contact(scene: Scene, pair: Pair, tallest: float) -> BarRow:
    """Force as height, its square root: a bar per frame, of the time since the frame before."""
    width = SIDE[0] / max(1, len(pair.forces) - 1)
    path = "".join(
        f"M{(k - 1) * width:.1f} {SIDE[1]}v{-max(4.0, SIDE[1] * np.sqrt(f / tallest)):.1f}h{width:.1f}V{SIDE[1]}z"
        for k, f in enumerate(pair.forces)
        if f > 0
    )
    name = f"{named(scene, pair.b)} – {named(scene, pair.a)}"
    return BarRow(name=name, words=f"up to {force(pair.forces.max())}", bars=[(path, "force")])


def force(newtons: float) -> str:
    """A force [N] in words, to two digits."""
    return f"{newtons:.2g} N" if newtons < 99.5 else f"{newtons:,.0f} N"
