"""Results as plain tables: a line per scene, a line per measure, a line per step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import process

COLUMNS = (
    *("mIoU", "mIoU_visible", "PSNR", "R_pen", "K_max_J", "D_max_cm", "gap_pct", "inside", "tilt_deg"),
    *("centre_pct", "chamfer_pct", "support_precision", "support_recall", "wall_s", "cpu_s", "peak_mb"),
)
"""Of the table with a line per scene; the others are in the table of means and in results.json."""
PICTURE = ("mIoU", "mIoU_visible", "PSNR")
"""Those that depend on the camera: all that direct composition has of a fitted one."""
SHORT = {"mIoU_visible": "visible", "support_precision": "sup.prec", "support_recall": "sup.rec"}

Table = list[list[str]]


def print_results(rows: Mapping[str, Any], means: Mapping[str, Any]) -> None:
    """Scenes, then means with direct composition beside, as its own and a fitted camera see it, then mean seconds per
    step."""
    print()
    show([["scene", *(SHORT.get(c, c) for c in COLUMNS)], *([n, *_cells(r["f3sr"], COLUMNS)] for n, r in rows.items())])
    for group, sides in means.items():
        if not sides:
            continue
        count = sum(r["group"] == group for r in rows.values())
        columns = [sides[side] for side in ("direct composition", "direct composition, fitted camera", "f3sr")]
        print(f"\nmeans over {count} {group} scenes")
        header = ["", "direct", "fitted", "f3sr"]
        show([header, *([k, *(cell for side in columns for cell in _cells(side, [k]))] for k in sides["f3sr"])])
        print(f"\nmean seconds, {group}")
        show([[step, f"{s:.2f}"] for step, s in sides["stages"].items()])
    print()


def print_times(runs: Mapping[str, process.Finished]) -> None:
    """A line per step of the whole command, a column per run."""
    steps = {name: finished.answer["seconds"] for name, finished in runs.items()}
    names = next(iter(steps.values()))
    lines = [[name, *(f"{s[name]:.2f}" if name in s else "-" for s in steps.values())] for name in names]
    lines.append(["whole command, wall", *(f"{f.wall:.2f}" for f in runs.values())])
    lines.append(["processor time", *(f"{f.cpu:.2f}" for f in runs.values())])
    lines.append(["peak memory MB", *(f"{f.peak_mb:.0f}" for f in runs.values())])
    show([["seconds", *runs], *lines])


def show(table: Table) -> None:
    """First column left, the others right."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for first, *others in table:
        cells = [first.ljust(widths[0]), *(c.rjust(w) for c, w in zip(others, widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


def _cells(values: Mapping[str, float], names: Any) -> list[str]:
    return [f"{values[n]:.3g}" if n in values else "-" for n in names]
