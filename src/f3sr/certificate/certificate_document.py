"""What a certificate says: one row per engine and object, one per validator; as plain values for certificate.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

import f3sr
from f3sr.certificate.client_answers import Finding
from f3sr.certificate.clients_table import Client
from f3sr.certificate.rest_rule import PASSING, CertificateConfig, ObjectVerdict

EngineState = Literal["passed", "failed", "no answer", "not installed"]
ValidatorState = Literal["passed", "warned", "failed", "no answer", "not installed"]
KIND = "f3sr certificate"
SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class CertifiedObject:
    """An object in an engine."""

    id: int
    label: str
    name: str
    fixed: bool
    verdict: ObjectVerdict
    penetration: float | None
    """Its largest overlap [m], where the engine tells."""


@dataclass(frozen=True, kw_only=True)
class EngineRow:
    """An engine, and the objects in it."""

    client: Client
    state: EngineState
    reason: str = ""
    """Why there is no answer."""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    settings: str = ""
    timestep: float | None = None
    seconds: float = 0.0
    """Wall time of the engine [s], loading and compiling included."""
    notes: Sequence[str] = ()
    objects: Sequence[CertifiedObject] = ()

    def count(self, *verdicts: str) -> int:
        """How many objects have one of these verdicts."""
        return sum(o.verdict.verdict in verdicts for o in self.objects)

    @property
    def drift(self) -> float | None:
        """Farthest way of what rests [m]."""
        return max((o.verdict.drift or 0.0 for o in self.objects if o.verdict.verdict == "rests"), default=None)

    @property
    def turn(self) -> float | None:
        """Largest rotation of what rests [rad]."""
        return max((o.verdict.turn or 0.0 for o in self.objects if o.verdict.verdict == "rests"), default=None)


@dataclass(frozen=True, kw_only=True)
class ValidatorRow:
    """A validator, and what it found."""

    client: Client
    state: ValidatorState
    reason: str = ""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    checked: int = 0
    findings: Sequence[Finding] = ()

    def of(self, severity: str) -> int:
        """How many findings are of a severity."""
        return sum(finding.severity == severity for finding in self.findings)


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """All rows, and the rule that they are judged by."""

    package: str
    """Name of the package's folder."""
    scene_sha256: str
    config: CertificateConfig
    engines: Sequence[EngineRow]
    validators: Sequence[ValidatorRow]
    named: Sequence[str] = ()
    """Clients that were asked for by name."""

    @property
    def problems(self) -> list[str]:
        """What stands against it: failures, and clients that were named and gave no answer."""
        found = [f"{row.client.title}: {_told(row)}" for row in self.engines if self._counts(row)]
        found += [f"{row.client.title}: {_faults(row)}" for row in self.validators if self._counts(row)]
        return found or (["no engine released it"] if self.engines and not self.passed_engines else [])

    @property
    def passed_engines(self) -> int:
        return sum(row.state == "passed" for row in self.engines)

    @property
    def verdict(self) -> str:
        """In one line."""
        if not self.engines:
            passed = sum(row.state in ("passed", "warned") for row in self.validators)
            return f"{passed} of {len(self.validators)} validators pass"
        asked = [row for row in self.engines if row.state not in ("not installed", "no answer")]
        rests = f"at rest in {self.passed_engines} of {len(asked)} engines"
        rolls = sorted({f"{o.id} {o.label}".strip() for e in self.engines for o in e.objects if _rolls(o)})
        return rests + (f"; {', '.join(rolls)} rolled" if rolls else "")

    def _counts(self, row: EngineRow | ValidatorRow) -> bool:
        if row.state == "failed":
            return True
        return row.state in ("no answer", "not installed") and row.client.name in self.named


def _rolls(o: CertifiedObject) -> bool:
    return o.verdict.verdict == "rolls"


def _told(row: EngineRow) -> str:
    """Of an engine that did not pass."""
    if row.state != "failed":
        return f"{row.state}, {row.reason}"
    bad = [
        f"{o.id} {o.label}".strip() + f" {o.verdict.verdict}" for o in row.objects if o.verdict.verdict not in PASSING
    ]
    return ", ".join(bad[:3]) + (f" and {len(bad) - 3} more" if len(bad) > 3 else "")


def _faults(row: ValidatorRow) -> str:
    return f"{row.of('error')} errors" if row.state == "failed" else f"{row.state}, {row.reason}"


def as_plain(certificate: Certificate) -> dict[str, Any]:
    """The certificate as JSON has it: lengths in mm, angles in degrees, as people compare them."""
    return {
        "kind": KIND,
        "schema_version": SCHEMA_VERSION,
        "f3sr": f3sr.__version__,
        "package": certificate.package,
        "scene_sha256": certificate.scene_sha256,
        "rule": asdict(certificate.config),
        "verdict": certificate.verdict,
        "problems": certificate.problems,
        "engines": [_engine(row) for row in certificate.engines],
        "validators": [_validator(row) for row in certificate.validators],
    }


def _engine(row: EngineRow) -> dict[str, Any]:
    return {
        **_client(row),
        "given": row.client.given,
        "cannot": row.client.cannot,
        "settings": row.settings,
        "timestep": row.timestep,
        "seconds": round(row.seconds, 1),
        "notes": list(row.notes),
        "objects": [_object(o) for o in row.objects],
    }


def _object(o: CertifiedObject) -> dict[str, Any]:
    v = o.verdict
    return {
        "id": o.id,
        "label": o.label,
        "name": o.name,
        "fixed": o.fixed,
        "verdict": v.verdict,
        "reason": v.reason,
        "drift_mm": _scaled(v.drift, 1000),
        "turn_deg": None if v.turn is None else float(np.degrees(v.turn)),
        "penetration_mm": _scaled(o.penetration, 1000),
        "mass_error": v.mass_error,
        "inertia_error": v.inertia_error,
    }


def _validator(row: ValidatorRow) -> dict[str, Any]:
    return {
        **_client(row),
        "checked": row.checked,
        "findings": [finding.model_dump() for finding in row.findings],
    }


def _client(row: EngineRow | ValidatorRow) -> dict[str, Any]:
    return {
        "name": row.client.name,
        "title": row.client.title,
        "state": row.state,
        "reason": row.reason,
        "install": row.client.install,
        "versions": dict(row.versions),
    }


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
