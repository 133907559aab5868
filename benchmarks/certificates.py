"""Certificates of many packages: how many objects rest, roll or move in every engine, and what validators find.

usage: python benchmarks/certificates.py PACKAGE ... -o DIR [--engines NAMES] [--python CLIENT=PATH ...]
Writes a certificate per package to DIR, and DIR/summary.json. Exit codes: 0 every object rests or rolls in every engine
that answered, and at most 5 % roll; 1 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from f3sr.certificate.certificate_document import as_plain
from f3sr.certificate.certification import certify
from f3sr.scene_package.package import read_package

MOST_ROLLING = 0.05
"""Largest share of objects that may roll in an engine."""


def main() -> int:
    args = _arguments()
    plain = dict[str, dict[str, Any]]()
    for package in args.packages:
        made = certify(
            read_package(package),
            args.out / package.name,
            clients=args.engines.split(",") if args.engines else (),
            programs=dict(given.split("=", 1) for given in args.python),
            deadline=args.deadline,
            overwrite=True,
        )
        plain[package.name] = as_plain(made)
        print(f"{package.name}: {made.verdict}; {'; '.join(made.problems) or 'no problem'}", flush=True)
    engines, validators = summary(plain)
    (args.out / "summary.json").write_text(json.dumps({"engines": engines, "validators": validators}, indent=1) + "\n")
    for name, row in engines.items():
        print(f"{name}: {json.dumps(row)}")
    for name, row in validators.items():
        print(f"{name}: {json.dumps(row)}")
    bad = [n for n, row in engines.items() if row["others"] or row["rolls"] > MOST_ROLLING * row["objects"]]
    return int(bool(bad) or any(row["failed"] for row in validators.values()))


def summary(plain: dict[str, dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Per engine: packages that it answered for, objects by verdict, and the worst of what rests; per validator: files
    and findings."""
    engines, validators = dict[str, Any](), dict[str, Any]()
    for made in plain.values():
        for row in made["engines"]:
            of = engines.setdefault(row["name"], {"packages": 0, "silent": 0, "objects": [], "versions": {}})
            of["packages" if row["objects"] else "silent"] += 1
            of["versions"] |= row["versions"]
            of["objects"] += [{**o, "package": made["package"]} for o in row["objects"]]
        for row in made["validators"]:
            of = validators.setdefault(row["name"], {"files": 0, "failed": 0, "findings": Counter(), "versions": {}})
            of["files"] += row["checked"]
            of["failed"] += row["state"] in ("failed", "no answer")
            of["versions"] |= row["versions"]
            of["findings"].update(f"{f['severity']} {f['text'].partition(':')[0]}" for f in row["findings"])
    return {name: _engine(of) for name, of in engines.items()}, validators


def _engine(of: dict[str, Any]) -> dict[str, Any]:
    counts = Counter(o["verdict"] for o in of["objects"])
    rests = [o for o in of["objects"] if o["verdict"] == "rests"]
    drifts, turns = ([o[key] for o in rests] for key in ("drift_mm", "turn_deg"))
    told = [o for o in of["objects"] if o["mass_error"] is not None]
    return {
        "packages": of["packages"],
        "silent": of["silent"],
        "versions": of["versions"],
        "objects": len(of["objects"]),
        "rests": counts["rests"],
        "rolls": counts["rolls"],
        "others": len(of["objects"]) - counts["rests"] - counts["rolls"],
        "drift_mm": {"median": _round(np.median(drifts)), "most": _round(max(drifts))} if drifts else None,
        "turn_deg": {"median": _round(np.median(turns)), "most": _round(max(turns))} if turns else None,
        "mass_error": max((o["mass_error"] for o in told), default=None),
        "inertia_error": max((o["inertia_error"] for o in told), default=None),
        "rolling": [_named(o) for o in of["objects"] if o["verdict"] == "rolls"],
        "moving": [_named(o) for o in of["objects"] if o["verdict"] not in ("rests", "rolls")],
    }


def _named(o: dict[str, Any]) -> str:
    drift, turn = ("-" if o[key] is None else f"{o[key]:.2f}" for key in ("drift_mm", "turn_deg"))
    return f"{o['package']} {o['name']}: {o['verdict']}, {drift} mm, {turn} deg {o['reason']}".strip()


def _round(value: Any) -> float:
    return float(f"{float(value):.3g}")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", nargs="+", type=Path, metavar="PACKAGE")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--engines", default="")
    parser.add_argument("--python", action="append", default=[], metavar="CLIENT=PATH")
    parser.add_argument("--deadline", type=float, default=900.0)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
