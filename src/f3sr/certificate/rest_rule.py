"""The rule of the certificate: what an object may do in the seconds after its release, and what it must weigh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from f3sr.certificate.client_answers import BodyTold, State
from f3sr.core.transforms import Array, rotation_angle, rotation_from_quaternion
from f3sr.physics.mujoco_model import Body
from f3sr.settings import settings

Verdict = Literal["rests", "rolls", "moves", "differs", "lost"]
PASSING: tuple[Verdict, ...] = ("rests", "rolls")


@settings
class CertificateConfig:
    """When a package counts as at rest in another engine."""

    seconds: Annotated[float, Interval(ge=0.1, le=60)] = 5.0
    """Time after the release [s]: what creeps a tenth of a millimetre a second shows."""
    drift: Annotated[float, Interval(gt=0, le=0.1)] = 0.001
    """Largest way of a centre of mass [m]: nobody sees a millimetre in a photo of a table."""
    turn: Annotated[float, Interval(gt=0, le=1)] = float(np.radians(1.0))
    """Largest rotation, about any axis [rad]: one degree."""
    mass_error: Annotated[float, Interval(gt=0, le=1)] = 1e-6
    """Largest relative difference of masses: several engines hold single precision, 6e-8."""
    inertia_error: Annotated[float, Interval(gt=0, le=1)] = 1e-5
    """Largest difference of an entry of the inertia, relative to its largest entry: axes in single precision."""
    rolling_lift: Annotated[float, Interval(ge=0, le=1)] = 0.25
    """Largest change of height of what rolls [shares of its size]: what falls off something does not roll."""


@dataclass(frozen=True, kw_only=True)
class ObjectVerdict:
    """How an object fared in an engine: m and rad; None where a number was not finite or is not told."""

    drift: float | None
    """Farthest way of its centre of mass."""
    turn: float | None
    """Largest rotation."""
    mass_error: float | None
    inertia_error: float | None
    verdict: Verdict
    reason: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Released:
    """An object of the package, as far as the rule needs it."""

    body: Body
    round: bool
    """Whether it is round across some horizontal direction."""
    size: float
    """Diagonal of its bounding box [m]."""


def judged(o: Released, states: Sequence[State], told: BodyTold | None, config: CertificateConfig) -> ObjectVerdict:
    """The verdict on one object: where it was, sample by sample, against where the package has it."""
    mass_error, inertia_error = _differences(o.body, told)
    table = np.array(states, float)  # None is NaN
    norms = np.linalg.norm(table[:, 3:], axis=1)
    known = {"mass_error": mass_error, "inertia_error": inertia_error}
    if not np.isfinite(table).all() or (np.abs(norms - 1) > 1e-3).any():
        return ObjectVerdict(drift=None, turn=None, **known, verdict="lost", reason="no finite pose")
    way, turn = _motion(o.body, table)
    drift, most_turn = float(np.linalg.norm(way, axis=1).max()), float(turn.max())
    verdict, reason = _verdict(o, drift, most_turn, float(np.abs(way[:, 2]).max()), mass_error, inertia_error, config)
    return ObjectVerdict(drift=drift, turn=most_turn, **known, verdict=verdict, reason=reason)


def _motion(body: Body, table: Array) -> tuple[Array, Array]:
    """Ways (n, 3) of the centre of mass and rotations (n,) from the package's pose, of states (n, 7)."""
    T = body.T_world_body
    start = T[:3, :3] @ body.center + T[:3, 3]
    R = rotation_from_quaternion(table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True))
    way = table[:, :3] + R @ body.center - start
    return way, np.array([rotation_angle(r @ T[:3, :3].T) for r in R])


def _differences(body: Body, told: BodyTold | None) -> tuple[float | None, float | None]:
    """Relative errors of mass and inertia; None for what is not told or not finite, as of fixed objects."""
    if told is None:
        return None, None
    mass = np.array(told.mass, float)
    inertia = np.array(told.inertia, float)
    errors = abs(mass / body.mass - 1), np.abs(inertia - body.inertia).max() / np.abs(body.inertia).max()
    mass_error, inertia_error = (float(e) if np.isfinite(e) else None for e in errors)
    return mass_error, inertia_error


def _verdict(
    o: Released,
    drift: float,
    turn: float,
    lift: float,
    mass_error: float | None,
    inertia_error: float | None,
    config: CertificateConfig,
) -> tuple[Verdict, str]:
    if not o.body.fixed:
        for name, error, most in (
            ("mass", mass_error, config.mass_error),
            ("inertia", inertia_error, config.inertia_error),
        ):
            if error is None:
                return "differs", f"no finite {name}"
            if error > most:
                return "differs", f"another {name}: {error:.1e} of it"
    if drift <= config.drift and turn <= config.turn:
        return "rests", ""
    if o.round and lift <= config.rolling_lift * o.size:
        return "rolls", "it is round"
    return "moves", "it is not round" if not o.round else "it falls"
