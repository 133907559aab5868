"""Photo only: scenes from photos and masks alone, judged by the referee, and by the truth where it is known.

usage: python benchmarks/photo_only.py [NAME ...] [--data PATH] [--out FOLDER] [--again] [--limit N]
Exit codes: 0 all bounds hold, 1 one does not, or a run failed.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

from PIL import Image, ImageDraw, ImageOps

import caches
import process
from run import REPO

GROUPS = {"rendered": "scenes/*", "frames": "real/[lu]*", "photos": "photos/*"}
"""Rendered scenes with truth, RGB-D frames without assets, and photos."""
OPTIONS = ("--ignore", "assets,geometry", "--mask-overlap", "0.1")
"""Two masks of one photo overlap by 7 % of the smaller."""
COLUMNS = ("n", "fixed", "mIoU", "mIoU_visible", "N_cross", "K_max_J", "D_max_cm", "gap_pct", "below_pct", "inside",
           "tilt_deg", "focal_pct", "centre_pct", "chamfer_pct", "support_recall", "wall_s")  # fmt: skip
PRIOR_FOCAL, PRIOR_PITCH = 0.9, 32.0
"""The constant prior: focal length [image widths] and angle below the horizon [deg]."""

PICTURES = ("photo.png", "pictures/render_after.png", "pictures/overlay_after.png", "pictures/side_after.png")
Row = dict[str, Any]


def main() -> int:
    args = _arguments()
    folders = {f.name: (g, f) for g, pattern in GROUPS.items() for f in sorted(args.data.glob(pattern)) if f.is_dir()}
    if not folders:
        print(f"skipped: no data in {args.data}")
        return 0
    if unknown := set(args.names) - folders.keys():
        print(f"no {', '.join(sorted(unknown))}; there are {', '.join(folders)}", file=sys.stderr)
        return 2
    args.out.mkdir(parents=True, exist_ok=True)
    kept = caches.kept(args.out / "warm_up.log")
    rows, failed = dict[str, Row](), False
    for name in args.names or folders:
        group, folder = folders[name]
        try:
            rows[name] = {"group": group, **measured(folder, args.out / name, args.data, kept, again=args.again)}
            print(_line(name, rows[name]), flush=True)
        except process.RunError as error:
            failed = True
            print(f"{name}: FAILED: {error}", flush=True)
    if rows:
        print(f"pictures: {sheet(list(rows), args.out)}")
    (args.out / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
    return int(failed | judge(rows))


def measured(folder: Path, out: Path, data: Path, kept: tuple[Path, ...], *, again: bool) -> Row:
    """Reconstruct a photo into ``out`` and let the referee measure it; ``again``: measure the package that is there."""
    row: Row = {}
    if not again:
        with caches.fresh(*kept) as cache:
            environment = {"F3SR_CACHE_DIR": str(cache)}
            finished = process.reconstruct(folder, out, environment=environment, options=OPTIONS)
        row = {"wall_s": finished.wall, "cpu_s": finished.cpu, "seconds": finished.answer["seconds"]}
    referee = process.run([data.parent / "referee" / "evaluate.py", folder, out], out.with_suffix(".referee.log"))
    sheets = dict[str, float]()
    if (folder / "truth.json").exists():
        sheets = process.run(["billboards.py", folder, out, data / "objects"], out.with_suffix(".sheets.log")).answer
    return {**row, **referee.answer, **sheets, **camera_errors(folder, out)}


def camera_errors(folder: Path, package: Path) -> dict[str, float]:
    """Focal length against the truth [%], ours and the constant prior's, and the prior's tilt [deg]."""
    scene = json.loads((package / "scene.json").read_text())
    ours, width = scene["camera"]["K"][0][0], scene["camera"]["width"]
    if (folder / "truth.json").exists():
        truth = json.loads((folder / "truth.json").read_text())
        true, T = truth["K"][0][0], truth["T_world_camera"]
    elif (folder / "intrinsics.json").exists():
        true, T = json.loads((folder / "intrinsics.json").read_text())["K"][0][0], None
    else:
        return {}
    errors = {
        "focal_pct": 100 * (ours / true - 1),
        "prior_focal_pct": 100 * (PRIOR_FOCAL * width / true - 1),
    }
    if T is not None:
        up = [T[2][k] for k in range(3)]
        s, c = math.sin(math.radians(PRIOR_PITCH)), math.cos(math.radians(PRIOR_PITCH))
        errors["prior_tilt_deg"] = math.degrees(math.acos(min(1.0, -c * up[1] - s * up[2])))
    return errors


def sheet(names: Sequence[str], out: Path, width: int = 420) -> Path:
    """One picture: the photo, the scene's masks over it and the scene from the side, a row for every package."""
    rows = list[Image.Image]()
    for name in names:
        shown = [Image.open(out / name / file).convert("RGB") for file in PICTURES]
        tiles = [ImageOps.pad(picture, (width, round(0.75 * width)), color="white") for picture in shown]
        row = Image.new("RGB", (width * len(tiles), tiles[0].height + 16), "white")
        for k, tile in enumerate(tiles):
            row.paste(tile, (k * width, 16))
        ImageDraw.Draw(row).text((4, 2), name, fill="black")
        rows.append(row)
    whole = Image.new("RGB", (rows[0].width, sum(row.height for row in rows)), "white")
    for k, row in enumerate(rows):
        whole.paste(row, (0, k * row.height))
    whole.save(out / "sheet.jpg", quality=85)
    return out / "sheet.jpg"


def judge(rows: Mapping[str, Row]) -> bool:
    """Print means and bounds; whether one does not hold."""
    scored = [r for r in rows.values() if r["group"] != "photos"]
    rendered = [r for r in rows.values() if r["group"] == "rendered"]
    bounds = list[tuple[str, float, float]]()
    if scored:
        seen = fmean(r["mIoU_visible"] for r in scored)
        dynamic = sum(r["n"] - r["fixed"] for r in scored) / sum(r["n"] + r["excluded"] for r in scored)
        bounds += [("1 - mIoU_visible, scenes and frames", 1 - seen, 0.12), ("share fixed", 1 - dynamic, 0.2)]
    if rows:
        bounds += [
            ("N_cross", max(r["N_cross"] for r in rows.values()), 0),
            ("D_max_cm", max(r["D_max_cm"] for r in rows.values()), 0.1),
        ]
    if rendered:
        bounds += [
            ("tilt_deg, median", median(r["tilt_deg"] for r in rendered), 3.0),
            ("focal_pct, median", median(abs(r["focal_pct"]) for r in rendered), 7.0),
            (
                "chamfer over that of billboards",
                median(r["chamfer_pct"] / r["billboard_chamfer_pct"] for r in rendered),
                0.5,
            ),
        ]
        for measure in ("centre_pct", "chamfer_pct", "billboard_chamfer_pct", "prior_tilt_deg", "prior_focal_pct"):
            print(f"{measure}: median {median(abs(r[measure]) for r in rendered):.2f}")
    for name, value, bound in bounds:
        print(f"{name}: {value:.4g} (at most {bound:g}){'' if value <= bound else '  DOES NOT HOLD'}")
    return any(value > bound for _, value, bound in bounds)


def _line(name: str, row: Row) -> str:
    cells = [f"{c} {row[c]:.4g}" for c in COLUMNS if isinstance(row.get(c), (int, float))]
    return f"{name}: " + ", ".join(cells)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "photo_only")
    parser.add_argument("--again", action="store_true", help="measure the packages that are there")
    args = parser.parse_args()
    args.out = args.out.resolve()
    return args


if __name__ == "__main__":
    sys.exit(main())
