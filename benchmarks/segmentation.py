"""Segmentation: masks from loose boxes, then from one stroke on each of the worst, against given masks.

usage: python benchmarks/segmentation.py [NAME ...] [--data PATH] [--out FOLDER] [--segmenter NAME]
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from f3sr.backends.protocols import Prompt
from f3sr.io.images import as_rgb, open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import read_instances
from f3sr.scene import Photo
from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, SEGMENTERS
from f3sr.segmentation.selection import Outlines, Selection, outlined
from f3sr.vision.regions import distance_to, parts_of, shrunk
from run import REPO

PATTERNS = ("scenes/*", "real/*")
LOOSE = 5
"""By which boxes are wider than the given masks [px], on every side."""
WORST = 0.25
"""Share of objects that get one stroke."""
BOXES, STROKES = 0.88, 0.93
"""Least mean IoU of boxes alone, and with those strokes."""
SHOWN = 10
"""Objects on the sheet of the worst."""
TILE = 300
"""Side of a picture on the sheet [px]."""

Mask = NDArray[np.bool_]


@dataclass(eq=False)
class Case:
    """A photo with its given masks, and what was found."""

    name: str
    photo: Photo
    labels: list[str]
    given: list[Mask]
    ground: Mask | None
    selection: Selection
    found: Outlines | None = None
    seconds: float = 0.0

    def scores(self) -> list[float]:
        assert self.found
        return [iou(a, b) for a, b in zip(self.found.masks, self.given, strict=True)]


def main() -> int:
    args = _arguments()
    folders = [f for p in PATTERNS for f in sorted(args.data.glob(p)) if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no data in {args.data}")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    backend, cases = SEGMENTERS.find(args.segmenter), [_case(f) for f in folders]
    rows = dict[str, Any]()
    for case in cases:
        _outline(case, backend)
        print(
            f"{case.name:18} {np.mean(case.scores()):.3f}  {case.seconds / len(case.given):.2f} s an object", flush=True
        )
    rows["boxes"] = _summary(cases)
    _sheet(cases, args.out / "boxes.png")
    rows["again_s"] = _stroke_worst(cases, backend)
    rows["strokes"] = _summary(cases)
    _sheet(cases, args.out / "strokes.png")
    (args.out / "results.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(json.dumps(rows, indent=1))
    return int(rows["boxes"]["iou"] < BOXES or rows["strokes"]["iou"] < STROKES)


def _case(folder: Path) -> Case:
    source = InputFolder(folder)
    photo = Photo(rgb=as_rgb(open_image(next(folder.glob("image.*")))))
    instances = read_instances(source, photo)
    prompts = tuple(Prompt(box=loose_box(i.mask)) for i in instances)
    ground = np.asarray(open_image(folder / "ground.png").convert("L")) > 127
    return Case(
        folder.name, photo, [i.name for i in instances], [i.mask for i in instances], ground, Selection(prompts=prompts)
    )


def _outline(case: Case, backend: Any) -> None:
    begin = time.perf_counter()
    case.found = outlined(case.photo, case.selection, backend)
    case.seconds = time.perf_counter() - begin


def _stroke_worst(cases: Sequence[Case], backend: Any) -> float:
    """One stroke on each of the worst quarter, all of a photo at once; seconds that one more stroke takes then."""
    ranked = sorted((score, c, k) for c, case in enumerate(cases) for k, score in enumerate(case.scores()))
    worst, again = ranked[: round(WORST * len(ranked))], list[float]()
    for number in sorted({c for _, c, _ in worst}):
        case = cases[number]
        assert case.found
        prompts = list(case.selection.prompts)
        for k in (k for _, c, k in worst if c == number):
            prompts[k] = corrected(prompts[k], case.found.masks[k], case.given[k])
            case.selection = replace(case.selection, prompts=tuple(prompts))
        _outline(case, backend)
        again.append(case.seconds / sum(c == number for _, c, _ in worst))
    return float(np.mean(again))


def corrected(prompt: Prompt, found: Mask, given: Mask) -> Prompt:
    """With the stroke that a user would draw: through the largest part that is wrong."""
    part, missing = max(
        ((_largest(m), missing) for m, missing in ((given & ~found, True), (found & ~given, False))),
        key=lambda each: each[0].sum(),
    )
    stroke = medial_line(part)
    if missing:
        return replace(prompt, inside=(*prompt.inside, stroke))
    return replace(prompt, outside=(*prompt.outside, stroke))


def _largest(mask: Mask) -> Mask:
    parts = parts_of(mask)
    return parts == 1 + np.argmax(np.bincount(parts.ravel())[1:]) if mask.any() else mask


def medial_line(part: Mask) -> tuple[tuple[float, float], ...]:
    """The line through the middle of a part, where it is at least half as wide as at its widest, as points (x, y)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    depth = np.maximum(distance_to(~np.pad(part, 1))[1:-1, 1:-1], 1e-3)
    thick = _largest(part & (depth >= depth.max() / 2))
    number = np.cumsum(thick.ravel()).reshape(thick.shape) - 1
    pairs = [
        (number[a][both], number[b][both], (1 / depth[a] + 1 / depth[b])[both] * length)
        for a, b, length in (
            (np.s_[:, :-1], np.s_[:, 1:], 1.0),
            (np.s_[:-1], np.s_[1:], 1.0),
            (np.s_[:-1, :-1], np.s_[1:, 1:], 1.5),
            (np.s_[:-1, 1:], np.s_[1:, :-1], 1.5),
        )
        if (both := thick[a] & thick[b]) is not None
    ]
    rows, columns, prices = (np.concatenate([p[k] for p in pairs]) for k in range(3))
    count = int(thick.sum())
    graph = coo_array((prices, (rows, columns)), shape=(count, count)).tocsr()
    start = int(np.argmax(dijkstra(graph, directed=False, indices=0)))
    far, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    at, line = int(np.argmax(far)), list[int]()
    while at >= 0:
        line.append(at)
        at = int(before[at])
    y, x = np.nonzero(thick)
    kept = [*line[:-1:3], line[-1]]
    return tuple((float(x[k] + 0.5), float(y[k] + 0.5)) for k in kept)


# --- measures and pictures ------------------------------------------------------------------------------------------


def loose_box(mask: Mask) -> tuple[float, float, float, float]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    h, w = mask.shape
    left, top = max(0, int(columns[0]) - LOOSE), max(0, int(rows[0]) - LOOSE)
    return left, top, min(w, int(columns[-1]) + 1 + LOOSE), min(h, int(rows[-1]) + 1 + LOOSE)


def iou(a: Mask, b: Mask) -> float:
    return float((a & b).sum() / max(1, (a | b).sum()))


def _summary(cases: Sequence[Case]) -> dict[str, float]:
    by = {group: [s for c in cases if c.name.startswith("dev") == (group == "rendered") for s in c.scores()]
          for group in ("rendered", "real")}  # fmt: skip
    every = np.array([*by["rendered"], *by["real"]])
    grounds = [iou(c.found.ground, c.ground) for c in cases if c.found and c.ground is not None]
    return {
        **{group: round(float(np.mean(values)), 4) for group, values in by.items() if values},
        "iou": round(float(every.mean()), 4),
        "median": round(float(np.median(every)), 4),
        "worst": round(float(every.min()), 4),
        "ground": round(float(np.mean(grounds)), 4),
        "object_s": round(sum(c.seconds for c in cases) / len(every), 3),
    }


def _sheet(cases: Sequence[Case], file: Path) -> None:
    """The worst objects: the given outline green, ours red, strokes white."""
    worst = sorted((score, c, k) for c, case in enumerate(cases) for k, score in enumerate(case.scores()))[:SHOWN]
    sheet = Image.new("RGB", (TILE * 5, (TILE + 20) * 2))
    for place, (score, c, k) in enumerate(worst):
        x, y = place % 5 * TILE, place // 5 * (TILE + 20)
        sheet.paste(_tile(cases[c], k), (x, y + 20))
        ImageDraw.Draw(sheet).text((x + 3, y + 4), f"{score:.2f} {cases[c].name} {cases[c].labels[k]}", fill="white")
    sheet.save(file)


def _tile(case: Case, k: int) -> Image.Image:
    assert case.found
    rgb = case.photo.rgb.copy()
    for mask, colour in ((case.given[k], (0, 255, 0)), (case.found.masks[k], (255, 0, 0))):
        rgb[mask & ~shrunk(mask, 1)] = colour
    picture = Image.fromarray(rgb)
    for strokes in (case.selection.prompts[k].inside, case.selection.prompts[k].outside):
        for stroke in strokes:
            ImageDraw.Draw(picture).line(stroke, fill="white", width=2)
    left, top, right, bottom = case.selection.prompts[k].box or (0, 0, *picture.size)
    part = picture.crop((int(left) - 20, int(top) - 20, int(right) + 20, int(bottom) + 20))
    scale = min(TILE / part.width, TILE / part.height)
    return part.resize((max(1, int(part.width * scale)), max(1, int(part.height * scale))))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=REPO / "out" / "segmentation")
    parser.add_argument("--segmenter", default=DEFAULT_SEGMENTER)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
