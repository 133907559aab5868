"""What came of a goal, as plain values: what the command line prints as JSON and agents are answered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from f3sr.goals.plan import Phase
from f3sr.goals.refusal import Refusal
from f3sr.play.goal_loop import Played

ALONG_GROUND = ("slide", "push_into", "roll")
"""Kinds of tasks that are no throws."""
FLIES = 5.0
"""Angle above the ground [deg] from which on what is set off flies."""


def telling(
    goal: str, played: Played | Refusal, place: Path | None, seconds: float, *, replayed: bool
) -> dict[str, Any]:
    """What came of a goal, as plain values."""
    told: dict[str, Any] = {"goal": goal[:2000], "seconds": round(seconds, 3)}
    if isinstance(played, Refusal):
        why = {"reason": played.reason, "message": played.message, "candidates": list(played.candidates)}
        return told | {"state": "refused", **why}
    return told | {
        "state": "met" if played.verdict.met else "missed",
        "folder": str(place),
        "phases": [
            {
                "interpretation": phase.task.interpretation,
                "assumptions": list(phase.task.assumptions),
                "launch": launch_told(phase),
                "conditions": [
                    {"met": c.met, "margin": c.margin, "unit": c.unit, "said": c.said}
                    for c in played.verdict.conditions
                    if c.phase == k
                ],
                "simulated_seconds": phase.simulation.duration,
            }
            for k, phase in enumerate(played.plan.phases)
        ],
        "stopped": played.stopped,
        "rollouts": 1 if replayed else played.plan.rollouts,
        "margin": played.verdict.margin,
        "broken_rules": list(played.verdict.broken),
        "side_effects": list(played.verdict.side_effects),
        "nearest": played.nearest,
        "calls": [call.model_dump(mode="json") for call in played.plan.calls],
    }


def launch_told(phase: Phase) -> str:
    """How the active object is set off, in words."""
    initial = phase.initial
    said = [
        f"let go {np.linalg.norm(o.translation[:2]):.2f} m aside and {o.translation[2]:.2f} m above its place"
        for o in initial.offsets
    ]
    for v in initial.velocities:
        spin, up = float(np.linalg.norm(v.angular)), np.degrees(np.arctan2(v.linear[2], np.hypot(*v.linear[:2])))
        flies = phase.task.kind in ALONG_GROUND and up > FLIES
        said.append(
            f"off at {np.linalg.norm(v.linear):.2f} m/s"
            + (f", {up:.0f} degrees up" if up > FLIES else "")
            + (f", turning at {spin:.1f} rad/s" if spin > 0.01 else "")
            + (" (thrown: something is in the way along the ground)" if flies else "")
        )
    masses = {s.id: s.mass for s in phase.semantics}
    blows = [i for i in initial.impulses if not i.duration]
    said += [f"{np.linalg.norm(i.linear) / masses[i.id]:.2f} m/s at {i.time:.2f} s" for i in blows]
    if pushes := [i for i in initial.impulses if i.duration]:
        seconds = max(i.time + i.duration for i in pushes)
        force = max(np.linalg.norm(i.linear) / i.duration for i in pushes)
        said.append(f"pushed for {seconds:.2f} s with up to {force:.1f} N")
    return "; ".join(said) or "let go"
