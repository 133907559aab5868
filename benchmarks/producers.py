"""The ten scenes' own degraded assets, by a worker that leaves them in each producer's own frame.

usage: python benchmarks/producers.py [NAME ...] [--producers NAME ...] [--placed] [--data PATH] [--out FOLDER]
A real worker process (``scripted_producer.py``) answers; its meshes are placed by the product. With ``--placed`` only
that is measured: how far surfaces are from the folder's own assets [% of their size], at worst and in the mean, and the
visible IoU of the assets as they are placed. Else scenes are reconstructed too, and the referee measures them beside
the folder with its own poses; ``apart_mm`` is the largest distance of a vertex from where it then lies. A scene that
starts out equal to the folder's own to the bit (``same``) has its package, and is made again only with ``--every``.
Bounds: with poses within POSED of the folder's own, without LEAST in the mean.
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from f3sr import pipeline
from f3sr.core.mesh import Mesh
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, transform
from f3sr.delivery import deliver
from f3sr.io.assets import PosedAsset
from f3sr.io.inputs import Fillers, Inputs
from f3sr.lifting.generators import ASSET_GENERATORS
from f3sr.metrics.measures import mean_over_masks, visible_ious
from f3sr.photo_inputs import read_inputs
from f3sr.runtime.scene_serialization import pack
from f3sr.scene import Scene
from f3sr.stages.assemble import as_given
from process import run
from run import REPO
from scripted_producer import FRAMES

POSED = 0.01
LEAST = 0.93
OWN = "as given"
RUN = str(time.time_ns())
"""Makes every command a new one: no answer of an earlier run is taken."""
SAMPLES = 2_000


def produced(folder: Path, producer: str) -> Inputs:
    """The folder with what a producer's worker answers instead of its assets."""
    script = Path(__file__).parent / "scripted_producer.py"
    command = shlex.join([sys.executable, str(script), "--source", str(folder), "--frame", producer, "--run", RUN])
    generator = producer if producer in ASSET_GENERATORS.names() and "fal" not in producer else "worker"
    backend = ASSET_GENERATORS.find(f"{generator}:{command}")
    return read_inputs(folder, ignore=("assets",), fillers=Fillers(assets=backend))


def placed(given: Inputs, own: Inputs) -> dict[str, float]:
    """How far surfaces are from the folder's own [% of the size], the visible IoU of the scene as placed, and whether
    it is the folder's own to the bit."""
    off = [_apart(given.assets[i.id], own.assets[i.id]) for i in given.instances]
    scene = as_given(given)
    seen = mean_over_masks(visible_ious(scene), scene)
    return {
        "off_pct": 100 * fmean(off),
        "worst_pct": 100 * max(off),
        "mIoU_visible": seen,
        "same": is_same(scene, as_given(own)),
    }


def _apart(one: PosedAsset, other: PosedAsset) -> float:
    a, b = _samples(one), _samples(other)
    size = other.scale * other.mesh.diagonal
    return float(KDTree(a).query(b)[0].mean() + KDTree(b).query(a)[0].mean()) / 2 / size


def _samples(asset: PosedAsset) -> Array:
    points = sample_surface(asset.mesh.vertices, asset.mesh.faces, SAMPLES)
    return transform(asset.T_camera_object, asset.scale * points)


def refereed(made: pipeline.Reconstruction, folder: Path, out: Path) -> dict[str, float]:
    """A scene by the independent referee."""
    deliver(made, out, overwrite=True)
    referee = folder.parents[2] / "referee" / "evaluate.py"
    found: Mapping[str, Any] = run([referee, folder, out], out.with_suffix(".referee.log")).answer
    return {name: float(found[name]) for name in ("mIoU_visible", "N_cross", "centre_pct", "support_recall")}


def is_same(one: Scene, other: Scene) -> bool:
    """Whether two scenes of the same photo, ``as_given``, are equal to the bit."""
    (document, arrays), (others, other_arrays) = pack(one), pack(other)
    return (
        document == others
        and all(np.array_equal(array, other_arrays[name]) for name, array in arrays.items())
        and all(_is_same_mesh(a.mesh, b.mesh) for a, b in zip(one, other, strict=True))
    )


def _is_same_mesh(a: Mesh, b: Mesh) -> bool:
    held, others = _held(a), _held(b)
    return len(held) == len(others) and all(map(np.array_equal, held, others))


def _held(mesh: Mesh) -> list[Any]:
    looks = [x for material in mesh.materials for x in (material.base_color, material.texture)]
    return [mesh.vertices, mesh.faces, mesh.uv, mesh.vertex_colors, mesh.face_material, *looks]


def apart_mm(one: Scene, other: Scene) -> float:
    """How far vertices of two scenes of the same objects are apart, at most [mm]."""
    pairs = zip(one, other, strict=True)
    return 1000 * max(float(np.linalg.norm(a.vertices_world - b.vertices_world, axis=1).max()) for a, b in pairs)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these scenes")
    parser.add_argument("--producers", nargs="+", choices=list(FRAMES), default=list(FRAMES))
    parser.add_argument("--placed", action="store_true", help="only place the meshes")
    parser.add_argument("--every", action="store_true", help="make scenes that start out equal again too")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=Path("out/producers"))
    args = parser.parse_args()
    folders = [f for f in sorted(args.data.resolve().glob("scenes/*")) if (f / "truth.json").exists()]
    folders = [f for f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no scenes in {args.data}")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    rows = dict[str, list[dict[str, float]]]()
    for folder in folders:
        own, own_made, own_row = read_inputs(folder), None, dict[str, float]()
        for producer in [*([] if args.placed else [OWN]), *args.producers]:
            given = own if producer == OWN else produced(folder, producer)
            row = placed(given, own)
            if own_row and row["same"] and not args.every:
                row |= own_row
            elif not args.placed:
                made = pipeline.reconstruct(given)
                own_made = own_made or made
                found = refereed(made, folder, args.out / f"{folder.name}_{producer.replace(' ', '_')}")
                found["apart_mm"] = apart_mm(made.scene, own_made.scene)
                own_row = own_row or found
                row |= found
            rows.setdefault(producer, []).append(row)
            told = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
            print(f"{folder.name} {producer}: {told}", flush=True)
    means = {p: {name: round(fmean(r[name] for r in found), 4) for name in found[0]} for p, found in rows.items()}
    print(json.dumps(means, indent=1))
    return int(any(_missed(producer, rows) for producer in args.producers))


def _missed(producer: str, rows: Mapping[str, list[dict[str, float]]]) -> bool:
    """Whether a bound does not hold: of every scene with poses, of the mean without."""
    seen = [r["mIoU_visible"] for r in rows[producer]]
    if FRAMES[producer].pose is None:
        return fmean(seen) < LEAST
    if OWN not in rows:  # only placed: surfaces are those of the folder
        return any(r["worst_pct"] > 100 * POSED for r in rows[producer])
    return any(s < o["mIoU_visible"] - POSED for s, o in zip(seen, rows[OWN], strict=True))


if __name__ == "__main__":
    sys.exit(main())
