"""The summary of certificates: every object counted once, per engine."""

from __future__ import annotations

from typing import Any

import certificates


def made(package: str, *verdicts: str) -> dict[str, Any]:
    objects = [
        {"name": f"o_{k:02d}", "verdict": v, "reason": "", "drift_mm": 0.1 * k, "turn_deg": 0.2, "mass_error": 1e-8,
         "inertia_error": 2e-8}
        for k, v in enumerate(verdicts)
    ]  # fmt: skip
    return {
        "package": package,
        "engines": [{"name": "drake", "versions": {"drake": "1"}, "objects": objects}],
        "validators": [
            {"name": "usd", "state": "failed", "checked": 3, "versions": {},
             "findings": [{"severity": "error", "text": "Rule: words"}]}
        ],
    }  # fmt: skip


def test_every_object_counts_once_and_the_worst_of_what_rests_is_told() -> None:
    engines, validators = certificates.summary(
        {"a": made("a", "rests", "rolls"), "b": made("b", "rests", "moves", "rests")}
    )
    row = engines["drake"]
    assert (row["objects"], row["rests"], row["rolls"], row["others"]) == (5, 3, 1, 1)
    assert row["drift_mm"]["most"] == 0.2 and row["packages"] == 2 and row["silent"] == 0
    assert row["rolling"] == ["a o_01: rolls, 0.10 mm, 0.20 deg"] and len(row["moving"]) == 1
    assert validators["usd"]["files"] == 6 and validators["usd"]["findings"] == {"error Rule": 2}


def test_an_engine_without_an_answer_is_silent() -> None:
    engines, _ = certificates.summary({"a": made("a")})
    assert engines["drake"]["silent"] == 1 and engines["drake"]["drift_mm"] is None
