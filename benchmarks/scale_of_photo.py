"""The unit of a scene from one photo: by usual sizes of labelled objects, and by one known length.

usage: python benchmarks/scale_of_photo.py [NAME ...] [--data PATH]
Rendered scenes: our distances of objects over the true ones, by labels alone. Depth frames: each object in turn is the
known one, its length that of the sensor's points in its mask; our depths of the others over the sensor's.
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.io.images import open_image
from f3sr.io.inputs import Inputs
from f3sr.lifting.lifted_assets import STRAY
from f3sr.metrology.tight_box import box_sides
from f3sr.photo_inputs import length_of, read_inputs
from f3sr.scene import Scene
from f3sr.stages.assemble import as_given
from f3sr.vision import rasterizer
from f3sr.vision.regions import without_strays
from run import REPO

MOST = 0.05
"""Largest error of a scale by one known length, the largest object in the picture, median over frames."""
STRAYS = 3.0
"""Distance from the median depth, in robust standard deviations, of mixed pixels at a mask's border."""

GAP = 6
"""Gap [px] beyond which a small piece of a mask is no part of the object: nobody measures it."""


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    args = parser.parse_args()
    folders = [f for p in ("scenes/*", "real/*") for f in sorted(args.data.glob(p)) if f.is_dir()]
    folders = [f for f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no such data in {args.data}")
        return 0
    largest = list[float]()
    for folder in folders:
        given = read_inputs(folder, ignore=("geometry", "assets"))
        (unit,) = [d for d in given.decisions if "unit" in d.choice]
        if (folder / "truth.json").exists():
            print(
                f"{folder.name}: distances {100 * _rendered(folder, given):+.1f} % by labels; {unit.choice}", flush=True
            )
        else:
            largest.append(_frame(folder, given))
    if not largest:
        return 0
    error = median(map(abs, largest))
    print(f"scale by the largest object's known length: median error {100 * error:.1f} % (at most {100 * MOST:.0f})")
    return int(error > MOST)


def _rendered(folder: Path, given: Inputs) -> float:
    """Median over objects of the logarithm of our distance of the centre over the true one."""
    truth = json.loads((folder / "truth.json").read_text())
    eye = np.array(truth["T_world_camera"])[:3, 3]
    logs = list[float]()
    for known in truth["objects"]:
        asset = given.assets[known["index"]]
        middle = asset.T_camera_object @ [*(asset.scale * asset.mesh.bounds.mean(0)), 1]
        true = np.array(known["T_world_object"])[:3, 3] - eye
        logs.append(math.log(np.linalg.norm(middle[:3]) / np.linalg.norm(true)))
    return median(logs)


def _frame(folder: Path, given: Inputs) -> float:
    """The error of the scale if the largest object's length is known; prints that of every object."""
    scene = as_given(given)
    meta = json.loads((folder / "intrinsics.json").read_text())
    depth = np.asarray(open_image(folder / "depth.png")).astype(float) * meta["depth_scale"]
    ratios = {o.id: _ratio(scene, o.id, depth) for o in scene}
    instances = {i.id: i for i in given.instances}
    texts, found = list[str](), dict[int, float]()
    for o in scene:
        rest = [r for id, r in ratios.items() if id != o.id and math.isfinite(r)]
        others = np.any([other.mask for other in scene if other.id != o.id], axis=0)
        points = _points(depth, without_strays(o.mask, others, gap=GAP, share=STRAY), np.array(meta["K"]))
        ours = length_of(given, instances[o.id])
        if len(points) < 50 or not rest or _is_cut(o.mask):
            continue
        found[o.id] = math.log(float(box_sides(points)[0]) / ours) + median(rest)
        texts.append(f"{o.label or o.id} {100 * found[o.id]:+.1f}")
    best = max(found, key=lambda id: int(np.count_nonzero(scene[id].mask)))
    print(f"{folder.name}: error of the others' depths [%] by the length of: {', '.join(texts)}; largest: {best}")
    return found[best]


def _ratio(scene: Scene, id: int, depth: Array) -> float:
    """Logarithm of our depth of an object over the sensor's, median over pixels."""
    ours = rasterizer.render([scene[id]], scene.camera).depth
    both = scene[id].mask & np.isfinite(ours) & (depth > 0)
    return float(np.median(np.log(ours[both] / depth[both]))) if both.any() else math.nan


def _points(depth: Array, mask: NDArray[np.bool_], K: Array) -> Array:
    """The sensor's points (n, 3) in a mask, without strays."""
    rows, columns = np.nonzero(mask & (depth > 0))
    rays = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) @ np.linalg.inv(K).T
    points = rays * depth[rows, columns][:, None]
    if not len(points):
        return points
    off = np.abs(points[:, 2] - np.median(points[:, 2]))
    return points[off < STRAYS * 1.4826 * np.median(off) + 1e-6]


def _is_cut(mask: NDArray[np.bool_]) -> bool:
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


if __name__ == "__main__":
    sys.exit(main())
