"""Random edits of packages: seconds of each with measuring, crossings, rest, what is told, and whether undo is exact.

    python benchmarks/edits.py PACKAGE ... [--edits 20] [--seed 0] [--json FILE]

Edits of all kinds come one after another, each to the scene that the one before left. Undo is exact where the files of
the list without its last edit, applied anew to the package, are those from before that edit, to the byte.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import statistics
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from f3sr.edits import EditOutcome, EditSession, edit_of, edited_files
from f3sr.edits.edit_list import KINDS, Edit
from f3sr.edits.edit_session import REST
from f3sr.runtime import kernels
from f3sr.scene import GROUND, Scene
from f3sr.scene_package.package import read_package

SHIFT = 0.1
"""Standard deviation of random moves along each axis, as a share of the scene's diagonal."""
LARGEST_FACTOR = 1.5
DENSITIES = 200.0, 8000.0
FRICTIONS = 0.1, 1.0


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("packages", nargs="+", type=Path)
    asked.add_argument("--edits", type=int, default=20, help="edits of each package")
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--json", type=Path)
    given = asked.parse_args()
    with kernels.compiling() as compilers:
        compilers.finish(print)
        tables = [edited(folder, given.edits, given.seed + k) for k, folder in enumerate(given.packages)]
    rows = [row for table in tables for row in table["edits"]]
    seconds = [row["seconds"] for row in rows]
    told = {
        "edits": len(rows),
        "median_s": statistics.median(seconds),
        "p90_s": float(np.percentile(seconds, 90)),
        "worst_s": max(seconds),
        "median_processor_s": statistics.median(row["processor_seconds"] for row in rows),
        "crossings": sum(row["N_cross"] for row in rows),
        "restless_untold": sum(row["D_max_cm"] > REST and not row["told"] for row in rows),
        "restless": sum(row["D_max_cm"] > REST for row in rows),
        "told": sum(bool(row["told"]) for row in rows),
        "not_applied": sum(not row["done"] for row in rows),
        "undo_exact": all(table["undo_exact"] for table in tables),
        "by_kind_s": {k: statistics.median(s) for k in KINDS if (s := [r["seconds"] for r in rows if r["kind"] == k])},
    }
    print(json.dumps(told, indent=1))
    if given.json:
        given.json.write_text(json.dumps({"seed": given.seed, **told, "scenes": tables}, indent=1) + "\n")


def edited(folder: Path, count: int, seed: int) -> dict[str, Any]:
    """One line per edit, and whether undo gives the bytes of before."""
    rng = np.random.default_rng(seed)
    session = EditSession(read_package(folder))
    print(f"{folder.name}: {session.scene.summary}")
    rows, digests = list[dict[str, Any]](), [digest_of(session)]
    for k in range(count):
        start = time.process_time()
        outcome = session.add(random_edit(session.scene, KINDS[k % len(KINDS)], rng))
        rows.append(row := {**row_of(outcome), "processor_seconds": time.process_time() - start})
        print(line_of(row), flush=True)
        digests.append(digest_of(session) if k >= count - 2 else "")
    session.undo()
    fresh = EditSession(read_package(folder), session.edits)
    undo_exact = digest_of(session) == digests[-2] == digest_of(fresh)
    session.redo()
    undo_exact = undo_exact and digest_of(session) == digests[-1]
    while session.can_undo:
        session.undo()
    undo_exact = undo_exact and digest_of(session) == digests[0]
    print(f"  undo exact: {undo_exact}")
    return {"package": folder.name, "edits": rows, "undo_exact": undo_exact}


def digest_of(session: EditSession) -> str:
    """Of all files of the edited package."""
    found = hashlib.sha256()
    for name, data in sorted(edited_files(session)):
        found.update(name.encode() + b"\0" + hashlib.sha256(data).digest())
    return found.hexdigest()


def random_edit(scene: Scene, kind: str, rng: np.random.Generator) -> Edit:
    """An edit of a random object that fits the scene; a fixed one is released where that is asked for."""
    objects = [o for o in scene if o.mobility == ("fixed" if kind == "release" else "dynamic")] or list(scene)
    o = objects[rng.integers(len(objects))]
    others = [GROUND, *(p.id for p in scene if p.id not in scene.subtree(o.id))]
    upright = rng.random() < 0.5
    values: Mapping[str, Mapping[str, Any]] = {
        "move": {"by": tuple(map(float, rng.normal(0, SHIFT * scene.diagonal, 3)))},
        "turn": {
            "axis": (0.0, 0.0, 1.0) if upright else tuple(map(float, rng.uniform(-1, 1, 3))),
            "degrees": float(rng.uniform(-180, 180)),
        },
        "scale": {"factor": float(LARGEST_FACTOR ** rng.uniform(-1, 1))},
        "support": {"on": int(rng.choice(others))},
        "material": {
            "density": float(math.exp(rng.uniform(*np.log(DENSITIES)))),
            "friction": float(rng.uniform(*FRICTIONS)),
        },
        "label": {"to": f"thing {rng.integers(100)}"},
    }
    return edit_of({"kind": kind, "id": o.id, "label": o.label, **values.get(kind, {})})


def row_of(outcome: EditOutcome) -> dict[str, Any]:
    assert outcome.edit is not None
    measures = outcome.measures
    return {
        **outcome.edit.model_dump(exclude_none=True),
        "seconds": outcome.seconds,
        "done": outcome.done,
        "N_cross": measures.N_cross,
        "D_max_cm": measures.D_max_cm,
        "K_max_J": measures.K_max_J,
        "gap_pct": measures.gap_pct,
        "mIoU_visible": measures.mIoU_visible,
        "told": [f"{d.choice}: {d.reason}" for d in outcome.decisions if d.fallback],
    }


def line_of(row: Mapping[str, Any]) -> str:
    told = "; ".join(row["told"])
    return (
        f"  {row['kind']:8} {row['id']:3} {row['seconds']:5.2f} s, of processors {row['processor_seconds']:5.2f}"
        f"  N {row['N_cross']}  D {row['D_max_cm']:.3f} cm  gap {row['gap_pct']:.2f} %"
        f"  mIoU_visible {row['mIoU_visible']:.3f}  {told}"
    )


if __name__ == "__main__":
    main()
