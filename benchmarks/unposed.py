"""Meshes whose poses are taken away: where masks put them, and the scenes that come of it.

usage: python benchmarks/unposed.py [NAME ...] [--data PATH] [--out FOLDER]
Each of the ten scenes' own generated meshes is turned by a random yaw in its file's axes, and asked for as from a
generator that gives no poses. The referee measures the package, as it does those with given poses (``run.py``).
Exit codes: 0 all bounds hold, 1 one does not.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from f3sr import pipeline
from f3sr.backends.protocols import ProducedMesh, PromptedImage
from f3sr.backends.registry import Backend
from f3sr.core.transforms import Array, rotation_about
from f3sr.delivery import deliver
from f3sr.generators.posed_assets import PosedAssets
from f3sr.io.inputs import Fillers, Inputs
from f3sr.io.sam3d import LOCAL_FROM_GLB
from f3sr.photo_inputs import read_inputs
from f3sr.scene import Geometry
from process import run
from run import REPO

LEAST = 0.93
"""Mean visible IoU over the scenes, at least."""
SEED = 3
COLUMNS = ("mIoU", "mIoU_visible", "N_cross", "D_max_cm", "centre_pct", "chamfer_pct", "support_recall")


@dataclass(frozen=True, eq=False)
class PosesTakenAway:
    """A MeshProducer that gives the meshes of a folder in the axes of their GLBs, each turned about its vertical."""

    given: Inputs

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """Meshes by id, +y up."""
        rng = np.random.default_rng(SEED)
        made = dict[int, ProducedMesh]()
        for id, asset in self.given.assets.items():
            R = rotation_about([0, 1, 0], rng.uniform(0, 2 * np.pi))
            mesh = asset.mesh.with_vertices(asset.mesh.vertices @ LOCAL_FROM_GLB @ R.T)
            made[id] = ProducedMesh(mesh=mesh, up="+y")
        return made


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these")
    parser.add_argument("--data", type=Path, default=REPO.parent / "shared" / "data")
    parser.add_argument("--out", type=Path, default=Path("out/unposed"))
    args = parser.parse_args()
    folders = [f for f in sorted(args.data.glob("scenes/*")) if (f / "truth.json").exists()]
    folders = [f for f in folders if not args.names or f.name in args.names]
    if not folders:
        print(f"skipped: no scenes in {args.data}")
        return 0
    args.out.mkdir(parents=True, exist_ok=True)
    seen, crossings = list[float](), 0
    for folder in folders:
        began = time.monotonic()
        generator = PosedAssets(PosesTakenAway(read_inputs(folder)))
        backend = Backend(kind="assets", name="poses-taken-away", version="1", made=generator)
        given = read_inputs(folder, ignore=("assets",), fillers=Fillers(assets=backend))
        posed = time.monotonic() - began
        out = args.out / folder.name
        deliver(pipeline.reconstruct(given), out, overwrite=True)
        referee = args.data.parent / "referee" / "evaluate.py"
        found = run([referee, folder, out], out.with_suffix(".referee.log")).answer
        seen.append(found["mIoU_visible"])
        crossings += int(found["N_cross"])
        columns = ", ".join(f"{name} {found[name]:.4g}" for name in COLUMNS)
        print(f"{folder.name}: {columns}, poses {posed:.1f} s, all {time.monotonic() - began:.1f} s", flush=True)
    print(json.dumps({"mIoU_visible": round(fmean(seen), 4), "least": LEAST, "N_cross": crossings}))
    return int(fmean(seen) < LEAST or crossings > 0)


if __name__ == "__main__":
    sys.exit(main())
