"""Results of the goal suite as text: a line while it runs, a summary, a page of markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
Rows = Mapping[str, Sequence[Row]]


def line(part: str, row: Row) -> str:
    """One row while the suite runs."""
    if part == "suite":
        marks = f"verify {yes(row['verify'])}, checklist {yes(row['checker'])}"
        return f"{row['seconds']:5.1f} s  {marks}  {row['name']}" + "".join(f"\n         {m}" for m in row["missed"])
    if part == "paraphrases":
        return f"{row['seconds']:5.1f} s  {'right' if row['right'] else 'WRONG'}  {row['words']}: {row['planned']}"
    good = row["refused"] and row["nothing_written"] and row["helpful"]
    return f"{row['seconds']:5.1f} s  {'refused' if good else 'WRONG'}  {row['why']}: {row['words'][:60]!r}"


def summary(numbers: Mapping[str, float], rows: Rows) -> str:
    """The numbers, and what went wrong row by row."""
    lines = [f"{name} {value:.4g}" for name, value in numbers.items()]
    for part, some in rows.items():
        lines += [f"{part}: {fault}" for row in some if (fault := fault_of(part, row))]
    return "\n".join(lines)


def fault_of(part: str, row: Row) -> str | None:
    """What is wrong with a row, in one line; None where nothing is."""
    if part == "suite":
        faults = [m for m in row["missed"] if not row["checker"]]
        faults += ["plan or rollout not valid"] * (not row["valid"])
        faults += ["another object was set off"] * (not row.get("right_active", True))
        faults += [f"verify says {yes(row['verify'])}, the checker {yes(row['checker'])}"] * disagree(row)
        faults += ["the second run differs"] * (not row.get("identical", True))
        faults += ["exit code and verdict differ"] * (not row.get("said", True))
        return f"{row['name']}: {'; '.join(faults)}" if faults else None
    if part == "paraphrases":
        return None if row["right"] else f"{row['words']!r}: {row['planned']}"
    faults = [] if row["refused"] else [f"exit code {row['exit']}"]
    faults += [f"wrote {row['written'][:3]}"] if row["written"] else []
    faults += [] if row["helpful"] else [f"the message lacks {row['absent']}"]
    return f"{row['words']!r}: {'; '.join(faults)}" if faults else None


def markdown(numbers: Mapping[str, float], rows: Rows) -> str:
    """All of it as a page."""
    page = ["# Goals", "", *table(["measure", "value"], [[n, f"{v:.4g}"] for n, v in numbers.items()])]
    if suite := rows.get("suite"):
        head = ["goal", "scene", "kind", "planned", "verify", "checklist", "rollouts", "s", "replay mm", "missed"]
        page += ["", "## Suite", "", *table(head, [suite_cells(r) for r in suite])]
        page += ["", "Disagreements: " + (", ".join(r["name"] for r in suite if disagree(r)) or "none") + "."]
    if paraphrases := rows.get("paraphrases"):
        cells = [[r["words"], r["scene"], yes(r["right"]), r["planned"]] for r in paraphrases]
        page += ["", "## Paraphrases", "", *table(["words", "scene", "right", "planned"], cells)]
    if refusals := rows.get("refusals"):
        head = ["words", "why", "refused", "nothing written", "helpful", "message"]
        marks = ("refused", "nothing_written", "helpful")
        cells = [[r["words"], r["why"], *(yes(r[m]) for m in marks), r["message"][:200]] for r in refusals]
        page += ["", "## Refusals", "", *table(head, cells)]
    return "\n".join(page) + "\n"


def suite_cells(r: Row) -> list[str]:
    off = f"{r['replay_mm']:.3g}" if "replay_mm" in r else "-"
    marks = [yes(r["verify"]), yes(r["checker"]), str(r.get("rollouts") or "-")]
    named = [r["words"], r["scene"], r["kind"], r.get("planned", "-")]
    return [*named, *marks, f"{r['seconds']:.1f}", off, "; ".join(r["missed"])]


def disagree(row: Row) -> bool:
    return row["verify"] != row["checker"]


def yes(value: bool) -> str:
    return "yes" if value else "no"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    cells = (" | ".join(" ".join(cell.split()).replace("|", "\\|") for cell in row) for row in rows)
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *(f"| {row} |" for row in cells)]
